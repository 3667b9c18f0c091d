"""SDO transfers put together from their frames: expedited, segmented and block, both directions.

Source: CiA DS 301 V4.02 chapter 7.2.4. One ``SdoChannel`` follows the default SDO of one node. Whatever comes is described;
nothing is refused. Left out: further SDO servers (1201h upwards).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.sdo_frames import (
    ABORT,
    ACKNOWLEDGE,
    BLOCK_SINK,
    BLOCK_SOURCE,
    BLOCK_STEP,
    COMMAND,
    CONFIRM,
    CRC,
    DOWNLOAD,
    END,
    FRAME_SIZE,
    LAST_SEGMENT,
    SEGMENT,
    START,
    UPLOAD,
    Sink,
    address_in,
    object_of,
)

MAX_TRANSFER: Final = 1 << 20
"""Bytes that are kept of one transfer; of a longer one the end is dropped and said so."""
_BLOCK_UPLOAD_END: Final = "block upload end"
_BLOCK_UPLOAD_LAST: Final = "block upload end response"
_CLIENT: Final = {
    SEGMENT: "download segment",
    DOWNLOAD: "download request",
    UPLOAD: "upload request",
    CONFIRM: "upload segment request",
}
"""Frames of the client by their command, and those of the server."""
_SERVER: Final = {
    SEGMENT: "upload segment",
    DOWNLOAD: "download segment response",
    UPLOAD: "upload response",
    CONFIRM: "download response",
}
_BLOCK_STEPS: Final = {END: "end response", ACKNOWLEDGE: "acknowledge", START: "start"}
_NOTES: Final = {
    Abort.TOGGLE_NOT_ALTERNATED: "toggle bit not alternated",
    Abort.CRC_ERROR: "the CRC does not match the data",
}


@dataclass(slots=True)
class Step:
    """The role of one frame in its transfer; see ``SdoRecord`` for the fields."""

    name: str
    from_client: bool
    index: int | None = None
    subindex: int | None = None
    value: bytes | None = None
    abort: int | None = None
    note: str = ""
    latency_ns: int | None = None

    @property
    def completes(self) -> bool:
        """The server's frame with which the transfer has succeeded."""
        return not self.from_client and self.value is not None


class _Transfer:
    """One transfer of ``address``, as an observer sees it."""

    def __init__(self, address: bytes, *, upload: bool) -> None:
        self.address = address
        self.upload = upload
        self.sink = Sink(MAX_TRANSFER)


class SdoChannel:
    """The default SDO of one node: feed every frame of both directions in order."""

    def __init__(self) -> None:
        self._transfer: _Transfer | None = None
        self._asked_ns: int | None = None

    def feed(self, from_client: bool, data: bytes, time_ns: int) -> Step:
        """Describe one frame of eight bytes (ValueError otherwise)."""
        if len(data) != FRAME_SIZE:
            raise ValueError(f"an SDO frame of {len(data)} bytes, expected {FRAME_SIZE}")
        step = self._describe(from_client, data)
        transfer = self._transfer
        if step.index is None and transfer is not None:
            _name(step, transfer.address)
        if transfer is not None and transfer.sink.truncated and step.value is not None:
            step.note = f"longer than {MAX_TRANSFER} bytes: the rest is discarded"
        # A block upload has one more frame after the one that completes it.
        if (
            step.abort is not None
            or step.name == _BLOCK_UPLOAD_LAST
            or (step.completes and step.name != _BLOCK_UPLOAD_END)
        ):
            self._transfer = None
        if from_client:
            self._asked_ns = time_ns
        elif self._asked_ns is not None:
            # Logs written by several threads are not always in order of time.
            step.latency_ns = max(0, time_ns - self._asked_ns)
            self._asked_ns = None
        return step

    def _describe(self, from_client: bool, data: bytes) -> Step:
        transfer, command = self._transfer, data[0] & COMMAND
        if data[0] == ABORT:
            return _name(Step("abort", from_client, abort=int.from_bytes(data[4:], "little")), address_in(data))
        if transfer is not None and transfer.upload != from_client and transfer.sink.awaits_block:
            transfer.sink.segment_of_block(data)
            last = ", last" if data[0] & LAST_SEGMENT else ""
            kind = "upload" if transfer.upload else "download"
            return Step(f"block {kind} segment", from_client, note=f"{data[0] & ~LAST_SEGMENT}{last}")
        if command == BLOCK_SINK:
            return self._block_sink(from_client, data)
        if command == BLOCK_SOURCE:
            return self._block_source(from_client, data)
        name = (_CLIENT if from_client else _SERVER).get(command)
        if name is None:
            return Step("unknown command", from_client, note=f"{data[0]:02X}h")
        step = Step(name, from_client)
        if command == SEGMENT:
            self._segment(step, data)
        elif command == UPLOAD or (command == DOWNLOAD and from_client):
            self._first(step, data, upload=command == UPLOAD)
        elif command == CONFIRM and not from_client:
            self._confirm(_name(step, address_in(data)), address_in(data))
        elif command == DOWNLOAD:
            self._confirm(step)
        return step

    def _begin(self, step: Step, address: bytes, *, upload: bool) -> Sink:
        """A transfer begins, unless this frame answers its request. Without a recorded request the answer is sufficient."""
        _name(step, address)
        transfer = self._transfer
        if step.from_client or transfer is None or transfer.address != address:
            transfer = self._transfer = _Transfer(address, upload=upload)
        return transfer.sink

    def _first(self, step: Step, data: bytes, *, upload: bool) -> None:
        """The request of an access without blocks, or the answer to that of an upload."""
        sink = self._begin(step, address_in(data), upload=upload)
        if upload != step.from_client:
            sink.first(data)
            if sink.complete:
                step.value = bytes(sink.data)
            elif sink.size is not None:
                step.note = f"{sink.size} bytes"

    def _segment(self, step: Step, data: bytes) -> None:
        transfer = self._transfer
        if transfer is None or transfer.upload == step.from_client:
            step.note = "start of the transfer missing"
            return
        sink = transfer.sink
        try:
            sink.segment(data)
        except SdoAbortedError as error:
            step.note = _NOTES[Abort(error.code)]
            return
        if sink.complete:
            if sink.size is not None and sink.size != len(sink.data):
                step.note = f"{len(sink.data)} bytes received, {sink.size} announced"
            if transfer.upload:
                step.value = bytes(sink.data)

    def _confirm(self, step: Step, address: bytes = b"") -> None:
        """The server confirms a part of a download, or all of it. Only some of these frames name the object."""
        transfer = self._transfer
        if (
            transfer is not None
            and not transfer.upload
            and address in (b"", transfer.address)
            and transfer.sink.complete
        ):
            step.value = bytes(transfer.sink.data)

    def _block_sink(self, from_client: bool, data: bytes) -> Step:
        """A frame of the side that receives blocks."""
        upload, part = from_client, data[0] & BLOCK_STEP
        begin = "request" if from_client else "response"
        step = Step(f"block {'upload' if upload else 'download'} {_BLOCK_STEPS.get(part, begin)}", from_client)
        if not part:
            sink = self._begin(step, address_in(data), upload=upload)
            sink.crc = sink.crc and data[0] & CRC != 0
            sink.in_blocks = not upload
            step.note = f"blocks of {data[4]}"
        elif part == ACKNOWLEDGE:
            step.note = f"{data[1]} segments"
            if self._transfer is not None:
                self._transfer.sink.accept(data[1])
        elif part == START and self._transfer is not None:
            self._transfer.sink.in_blocks = True
        elif part == END and not from_client:
            self._confirm(step)
        return step

    def _block_source(self, from_client: bool, data: bytes) -> Step:
        """A frame of the side that sends blocks, other than a segment."""
        upload, kind = not from_client, "download" if from_client else "upload"
        if not data[0] & END:
            step = Step(f"block {kind} {'request' if from_client else 'response'}", from_client)
            sink = self._begin(step, address_in(data), upload=upload)
            sink.first(data)
            step.note = "" if sink.size is None else f"{sink.size} bytes"
            return step
        step, transfer = Step(f"block {kind} end", from_client), self._transfer
        if transfer is not None and transfer.sink.ending:
            try:
                transfer.sink.end(data)
            except SdoAbortedError as error:
                step.note = _NOTES[Abort(error.code)]
            else:
                step.value = bytes(transfer.sink.data) if upload else None
        return step


def _name(step: Step, address: bytes) -> Step:
    """Enter the object of a frame."""
    step.index, step.subindex = object_of(address)
    return step
