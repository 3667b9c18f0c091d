"""SDO transfers put together from their frames: expedited, segmented and block, both directions.

Source: CiA DS 301 V4.02 chapter 7.2.4. One ``SdoChannel`` follows the default SDO of one node. Whatever comes is described;
nothing is refused. Left out: further SDO servers (1201h upwards).
"""

from __future__ import annotations

import binascii
import enum
from dataclasses import dataclass
from typing import Final

FRAME_SIZE: Final = 8
MAX_TRANSFER: Final = 1 << 20
"""Bytes that are kept of one transfer; of a longer one the end is dropped and said so."""
_ABORT: Final = 0x80
_BLOCK_UPLOAD_END: Final = "block upload end"
_BLOCK_UPLOAD_LAST: Final = "block upload end response"


class Phase(enum.Enum):
    """Kinds of the frames of a transfer, in order."""

    SEGMENTS = "segments"
    BLOCK = "block"
    END = "end"


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


@dataclass(slots=True)
class _Transfer:
    index: int
    subindex: int
    upload: bool
    data: bytearray
    phase: Phase = Phase.SEGMENTS
    announced: int | None = None
    toggle: int = 0
    block: dict[int, bytes] | None = None
    last: int | None = None
    """Sequence number of the block's segment that is marked as the last one."""
    ended: bool = False
    """The last segment was seen."""
    truncated: bool = False
    checked: bool = True
    """The block transfer's CRC agrees with the data (or none was sent)."""


class SdoChannel:
    """The default SDO of one node: feed every frame of both directions in order."""

    def __init__(self) -> None:
        self._transfer: _Transfer | None = None
        self._asked_ns: int | None = None
        self._crc = False

    def feed(self, from_client: bool, data: bytes, time_ns: int) -> Step:
        """Describe one frame of eight bytes (ValueError otherwise)."""
        if len(data) != FRAME_SIZE:
            raise ValueError(f"an SDO frame of {len(data)} bytes, expected {FRAME_SIZE}")
        step = self._client(data) if from_client else self._server(data)
        transfer = self._transfer
        if step.index is None and transfer is not None:
            step.index, step.subindex = transfer.index, transfer.subindex
        if transfer is not None and transfer.truncated and step.value is not None:
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

    # -- frames that both sides have -------------------------------------------------------------------------------

    @staticmethod
    def _abort(data: bytes, from_client: bool) -> Step:
        index, subindex = _multiplexer(data)
        return Step("abort", from_client, index, subindex, abort=int.from_bytes(data[4:8], "little"))

    def _block_segment(self, data: bytes, from_client: bool, transfer: _Transfer) -> Step:
        number = data[0] & 0x7F
        block = transfer.block if transfer.block is not None else {}
        block[number] = data[1:]
        transfer.block = block
        transfer.last = number if data[0] & 0x80 else transfer.last
        kind = "block upload segment" if transfer.upload else "block download segment"
        return Step(kind, from_client, note=f"{number}{', last' if data[0] & 0x80 else ''}")

    @staticmethod
    def _acknowledge(transfer: _Transfer, acknowledged: int) -> None:
        """The receiver accepted segments 1..n of the block; the next block repeats the others."""
        block = transfer.block or {}
        for number in range(1, acknowledged + 1):
            _append(transfer, block.get(number, b""))
        if transfer.last is not None and transfer.last <= acknowledged:
            transfer.phase = Phase.END
        transfer.block, transfer.last = None, None

    def _block_end(self, data: bytes, transfer: _Transfer) -> str:
        """The sender's end frame: unused bytes of the last segment, CRC."""
        unused = data[0] >> 2 & 7
        if unused and not transfer.truncated:
            del transfer.data[-unused:]
        checksum = int.from_bytes(data[1:3], "little")
        if self._crc and not transfer.truncated and binascii.crc_hqx(bytes(transfer.data), 0) != checksum:
            transfer.checked = False
            return "the CRC does not match the data"
        return ""

    # -- client to server ------------------------------------------------------------------------------------------

    def _client(self, data: bytes) -> Step:
        transfer = self._transfer
        if data[0] == _ABORT:
            return self._abort(data, True)
        if transfer is not None and not transfer.upload and transfer.phase is Phase.BLOCK:
            return self._block_segment(data, True, transfer)
        command = data[0] >> 5
        if command == 1:
            return self._download_request(data)
        if command == 0:
            return self._segment(data, True, "download segment")
        if command == 2:
            return self._begin(data, "upload request", upload=True)
        if command == 3:
            return Step("upload segment request", True)
        if command == 6:
            if data[0] & 1:
                return self._block_download_end(data)
            self._crc = bool(data[0] & 4)
            announced = int.from_bytes(data[4:8], "little") if data[0] & 2 else None
            return self._begin(data, "block download request", upload=False, announced=announced)
        if command == 5:
            return self._block_upload_request(data)
        return Step("unknown command", True, note=f"{data[0]:02X}h")

    def _begin(self, data: bytes, name: str, *, upload: bool, announced: int | None = None) -> Step:
        index, subindex = _multiplexer(data)
        self._transfer = _Transfer(index, subindex, upload, bytearray(), announced=announced)
        return Step(name, True, index, subindex, note="" if announced is None else f"{announced} bytes")

    def _download_request(self, data: bytes) -> Step:
        value, announced = _initiate(data)
        step = self._begin(data, "download request", upload=False, announced=announced)
        if value is not None and self._transfer is not None:
            self._transfer.data += value
            self._transfer.ended = True
            step.value = value
        return step

    def _block_download_end(self, data: bytes) -> Step:
        step = Step("block download end", True)
        transfer = self._transfer
        if transfer is not None and transfer.phase is Phase.END:
            step.note = self._block_end(data, transfer)
            transfer.ended = True
        return step

    def _block_upload_request(self, data: bytes) -> Step:
        sub = data[0] & 3
        transfer = self._transfer
        if sub == 0:
            step = self._begin(data, "block upload request", upload=True)
            self._crc = bool(data[0] & 4)
            step.note = f"blocks of {data[4]}"
            return step
        if sub == 3:
            if transfer is not None:
                transfer.phase = Phase.BLOCK
            return Step("block upload start", True)
        if sub == 2:
            if transfer is not None:
                self._acknowledge(transfer, data[1])
            return Step("block upload acknowledge", True, note=f"{data[1]} segments")
        return Step(_BLOCK_UPLOAD_LAST, True)

    # -- server to client ------------------------------------------------------------------------------------------

    def _server(self, data: bytes) -> Step:
        transfer = self._transfer
        if data[0] == _ABORT:
            return self._abort(data, False)
        if transfer is not None and transfer.upload and transfer.phase is Phase.BLOCK:
            return self._block_segment(data, False, transfer)
        command = data[0] >> 5
        if command == 2:
            return self._upload_response(data)
        if command == 0:
            return self._segment(data, False, "upload segment")
        if command == 3:
            return self._confirmed("download response", *_multiplexer(data))
        if command == 1:
            return self._confirmed("download segment response")
        if command == 5:
            return self._block_download_response(data)
        if command == 6:
            return self._block_upload_response(data)
        return Step("unknown command", False, note=f"{data[0]:02X}h")

    def _upload_response(self, data: bytes) -> Step:
        index, subindex = _multiplexer(data)
        transfer = self._transfer
        if transfer is None or (transfer.index, transfer.subindex) != (index, subindex):
            # The request was not recorded; the answer is sufficient.
            transfer = self._transfer = _Transfer(index, subindex, True, bytearray())
        value, transfer.announced = _initiate(data)
        note = f"{transfer.announced} bytes" if value is None and transfer.announced is not None else ""
        return Step("upload response", False, index, subindex, value, note=note)

    def _confirmed(self, name: str, index: int | None = None, subindex: int | None = None) -> Step:
        step = Step(name, False, index, subindex)
        transfer = self._transfer
        same = transfer is not None and (index is None or (transfer.index, transfer.subindex) == (index, subindex))
        if transfer is not None and same and transfer.ended and not transfer.upload:
            step.value = bytes(transfer.data)
        return step

    def _block_download_response(self, data: bytes) -> Step:
        sub = data[0] & 3
        transfer = self._transfer
        if sub == 0:
            self._crc = self._crc and bool(data[0] & 4)
            if transfer is not None:
                transfer.phase = Phase.BLOCK
            return Step("block download response", False, note=f"blocks of {data[4]}")
        if sub == 2:
            if transfer is not None:
                self._acknowledge(transfer, data[1])
            return Step("block download acknowledge", False, note=f"{data[1]} segments")
        return self._confirmed("block download end response")

    def _block_upload_response(self, data: bytes) -> Step:
        transfer = self._transfer
        if not data[0] & 1:
            self._crc = self._crc and bool(data[0] & 4)
            announced = int.from_bytes(data[4:8], "little") if data[0] & 2 else None
            if transfer is not None:
                transfer.announced = announced
            note = "" if announced is None else f"{announced} bytes"
            return Step("block upload response", False, *_multiplexer(data), note=note)
        step = Step(_BLOCK_UPLOAD_END, False)
        if transfer is not None and transfer.phase is Phase.END:
            step.note = self._block_end(data, transfer)
            step.value = bytes(transfer.data) if transfer.checked else None
        return step

    # -- segments --------------------------------------------------------------------------------------------------

    def _segment(self, data: bytes, from_client: bool, name: str) -> Step:
        step = Step(name, from_client)
        transfer = self._transfer
        if transfer is None or transfer.upload == from_client:
            step.note = "start of the transfer missing"
            return step
        toggle = data[0] >> 4 & 1
        if toggle != transfer.toggle:
            step.note = "toggle bit not alternated"
            return step
        transfer.toggle ^= 1
        _append(transfer, data[1 : FRAME_SIZE - (data[0] >> 1 & 7)])
        if data[0] & 1:
            transfer.ended = True
            if transfer.announced is not None and transfer.announced != len(transfer.data):
                step.note = f"{len(transfer.data)} bytes received, {transfer.announced} announced"
            if not from_client:
                step.value = bytes(transfer.data)
        return step


def _append(transfer: _Transfer, part: bytes) -> None:
    if len(transfer.data) + len(part) > MAX_TRANSFER:
        transfer.truncated = True
    else:
        transfer.data += part


def _multiplexer(data: bytes) -> tuple[int, int]:
    return int.from_bytes(data[1:3], "little"), data[3]


def _initiate(data: bytes) -> tuple[bytes | None, int | None]:
    """Expedited value or announced size of an initiate frame."""
    expedited, size_given = data[0] & 2, data[0] & 1
    if expedited:
        unused = data[0] >> 2 & 3 if size_given else 0
        return data[4 : FRAME_SIZE - unused], None
    return None, int.from_bytes(data[4:8], "little") if size_given else None
