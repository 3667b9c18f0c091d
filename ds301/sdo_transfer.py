"""SDO transfers of both sides, sans-I/O.

Source: CiA DS 301 V4.02 chapter 7.2.4. ``Upload`` and ``Download`` (not by blocks) are the accesses of a client, ``SdoServer`` is
a server. They take the frames of the other side and return the frames to send.
"""

from __future__ import annotations

import abc
from typing import Final, Protocol

from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.sdo_frames import (
    ABORT,
    BLOCK_LIMIT,
    BLOCK_SINK,
    BLOCK_SOURCE,
    BLOCK_STEP,
    COMMAND,
    CONFIRM,
    CRC,
    DOWNLOAD,
    END,
    EXPEDITED_SIZE,
    FRAME_SIZE,
    NEVER,
    SEGMENT,
    START,
    TOGGLE,
    UNNAMED,
    UPLOAD,
    Sink,
    Source,
    abort_frame,
    address_in,
    address_of,
    object_of,
    sdo_frame,
)

_TOO_LONG: Final = " is too long to be read"


class Transfer(abc.ABC):
    """An access of a client to one object. Send ``request`` and call ``begin``, and send what ``take`` and ``check`` return."""

    def __init__(self, index: int, subindex: int, request: bytes, timeout_ns: int, limit_ns: int = NEVER) -> None:
        self.index = index
        self.subindex = subindex
        self.address = address_in(request)
        self.request = request
        self._timeout_ns = timeout_ns
        """For each answer of the server."""
        self._limit_ns = limit_ns
        """For the whole transfer."""
        self._end = 0
        self.due = 0
        """When ``check`` must be called, in nanoseconds."""
        self.ended = False
        """Successfully, unless ``code`` or ``failure`` says otherwise."""
        self.code: int | None = None
        """The abort code of the server."""
        self.failure = ""
        """Why the client has aborted the transfer."""
        self.broken = ""
        """The length of an answer that is not an SDO frame."""
        self._begun = False
        """The server has answered."""

    def begin(self, now: int) -> None:
        """The request is sent."""
        self._end = now + self._limit_ns
        self.due = min(now + self._timeout_ns, self._end)

    def expire(self) -> None:
        """Its time is over: the next ``check`` aborts it."""
        self.due = self._end = 0

    def take(self, frame: bytes, now: int) -> list[bytes]:
        """Process a frame of the server. Answers to other requests are ignored."""
        if len(frame) != FRAME_SIZE:
            self.broken = f"{len(frame)} bytes, {FRAME_SIZE} expected"
            if not self._is_enough(frame):
                return []
            frame = frame.ljust(FRAME_SIZE, b"\0")
        if frame[0] == ABORT:
            if address_in(frame) in (self.address, UNNAMED):
                self.code = int.from_bytes(frame[4:], "little")
                self.ended = True
            return []
        if not self._begun and address_in(frame) != self.address:
            return []
        try:
            frames = self._continue(frame)
        except SdoAbortedError as error:
            return [self._fail(error.code, f": {error}")]
        if frames is None:
            return []
        self._begun = True
        self.due = min(now + self._timeout_ns, self._end)
        return frames

    def check(self, now: int) -> list[bytes]:
        """Abort the transfer if its time is over."""
        missing = f"its answer has {self.broken}" if self.broken else "No SDO response received"
        return [self._fail(Abort.TIMEOUT, f": {missing}")] if now >= self.due else []

    def _is_enough(self, frame: bytes) -> bool:
        """A frame of another length has all that is needed."""
        return False

    @abc.abstractmethod
    def _continue(self, frame: bytes) -> list[bytes] | None:
        """The frames after an answer; None: it does not belong to this transfer."""

    def _fail(self, code: int, failure: str) -> bytes:
        self.failure = failure
        self.ended = True
        return abort_frame(self.address, code)


class Upload(Transfer):
    """Read an object: by blocks, if the server supports them, or by segments."""

    def __init__(
        self,
        index: int,
        subindex: int,
        timeout_ns: int,
        *,
        by_blocks: bool = False,
        limit: int = NEVER,
        limit_ns: int = NEVER,
    ) -> None:
        address = address_of(index, subindex)
        request = (
            sdo_frame(BLOCK_SINK | CRC, address + bytes((BLOCK_LIMIT,))) if by_blocks else sdo_frame(UPLOAD, address)
        )
        super().__init__(index, subindex, request, timeout_ns, limit_ns)
        self.sink = Sink(limit)
        self._repeated = False
        """The segments that are missing of a block were requested once more."""

    def check(self, now: int) -> list[bytes]:
        sink = self.sink
        if self._begun and now >= self._end:
            return [self._fail(Abort.GENERAL, _TOO_LONG)]
        if now >= self.due and sink.awaits_block and not self._repeated:
            self._repeated = True
            self.due = now + self._timeout_ns
            return [sink.acknowledge()]
        return super().check(now)

    def _continue(self, frame: bytes) -> list[bytes] | None:
        sink, command = self.sink, frame[0] & COMMAND
        frames: list[bytes] = []
        if sink.in_blocks:
            self._repeated = False
            frames = sink.confirm(frame)
        elif command == BLOCK_SOURCE and not self._begun and self.request[0] != UPLOAD:
            sink.first(frame)
            sink.in_blocks = True
            return [sdo_frame(BLOCK_SINK | START)]
        elif command != (SEGMENT if self._begun else UPLOAD):
            return None
        else:
            (sink.segment if self._begun else sink.first)(frame)
            if not sink.complete:
                frames = [sdo_frame(CONFIRM | sink.toggle)]
        if sink.truncated:
            return [self._fail(Abort.GENERAL, _TOO_LONG)]
        self.ended = sink.complete
        return frames


class Download(Transfer):
    """Write an object: expedited or by segments."""

    def __init__(self, index: int, subindex: int, data: bytes, timeout_ns: int) -> None:
        self._source = Source(data)
        request = self._source.first(DOWNLOAD, address_of(index, subindex))
        super().__init__(index, subindex, request, timeout_ns)

    def _is_enough(self, frame: bytes) -> bool:
        """A confirmation has no data: some devices send only the address of it, or the command of that of a segment."""
        if self._begun:
            return len(frame) > 0 and frame[0] & COMMAND == DOWNLOAD
        return len(frame) > EXPEDITED_SIZE - 1 and frame[0] == CONFIRM

    def _continue(self, frame: bytes) -> list[bytes] | None:
        source = self._source
        if frame[0] & COMMAND != (DOWNLOAD if self._begun else CONFIRM):
            return None
        if self._begun and frame[0] & TOGGLE == source.toggle:
            raise SdoAbortedError(Abort.TOGGLE_NOT_ALTERNATED)
        self.ended = source.complete
        return [] if self.ended else [source.segment()]


class Objects(Protocol):
    """The objects of a server. Both methods may raise SdoAbortedError."""

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """The data of an object."""

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Store the data of an object."""


class SdoServer:
    """A server of ``objects``."""

    def __init__(self, objects: Objects) -> None:
        self._objects = objects
        self._address = UNNAMED
        """Of the transfer that was begun last."""
        self._source: Source | None = None
        """Of an upload,"""
        self._sink: Sink | None = None
        """and of a download."""

    def answer(self, frame: bytes) -> list[bytes]:
        """The answers to a frame of a client, of eight bytes."""
        try:
            return self._continue(frame)
        except SdoAbortedError as error:
            self._source = self._sink = None
            return [abort_frame(self._address, error.code)]

    def _continue(self, frame: bytes) -> list[bytes]:
        head, command = frame[0], frame[0] & COMMAND
        source, sink = self._source, self._sink
        if head == ABORT:
            self._source = self._sink = None
            return []
        if sink is not None and sink.in_blocks:
            frames = sink.confirm(frame)
            self._store(sink)
            return frames
        if command == UPLOAD or (command == BLOCK_SINK and not head & BLOCK_STEP):
            return [self._begin_upload(frame)]
        if command == DOWNLOAD or (command == BLOCK_SOURCE and not head & END):
            return [self._begin_download(frame)]
        if source is not None and command == BLOCK_SINK:
            return source.confirm(frame)
        if source is not None and command == CONFIRM and not source.complete:
            if head & TOGGLE != source.toggle:
                raise SdoAbortedError(Abort.TOGGLE_NOT_ALTERNATED)
            return [source.segment()]
        if sink is not None and command == SEGMENT:
            sink.segment(frame)
            self._store(sink)
            return [sdo_frame(DOWNLOAD | head & TOGGLE)]
        raise SdoAbortedError(Abort.INVALID_COMMAND)

    def _begin_upload(self, frame: bytes) -> bytes:
        self._address = address = address_in(frame)
        data = self._objects.get_data(*object_of(address), check_readable=True)
        if not data:
            raise SdoAbortedError(Abort.NO_DATA)
        source = Source(data)
        self._source, self._sink = source, None
        if frame[0] & COMMAND == UPLOAD:
            return source.first(UPLOAD, address)
        source.crc, source.block_size = frame[0] & CRC != 0, frame[4]
        return source.first(BLOCK_SOURCE, address)

    def _begin_download(self, frame: bytes) -> bytes:
        self._address = address = address_in(frame)
        sink = Sink()
        self._source, self._sink = None, sink
        sink.first(frame)
        if frame[0] & COMMAND == DOWNLOAD:
            self._store(sink)
            return sdo_frame(CONFIRM, address)
        sink.in_blocks = True
        return sdo_frame(BLOCK_SINK | CRC, address + bytes((BLOCK_LIMIT,)))

    def _store(self, sink: Sink) -> None:
        if sink.complete:
            self._sink = None
            self._objects.set_data(*object_of(self._address), bytes(sink.data), check_writable=True)
