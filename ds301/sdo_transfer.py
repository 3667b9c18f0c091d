"""SDO transfers of both sides, sans-I/O: expedited, segmented and block, uploads and downloads.

Source: CiA DS 301 V4.02 chapter 7.2.4. ``Upload`` and ``Download`` (not by blocks) are the accesses of a client, ``SdoServer`` is
a server. They take the frames of the other side and return the frames to send. In both directions a ``Source`` sends the data and
a ``Sink`` receives them.
"""

from __future__ import annotations

import abc
from binascii import crc_hqx
from typing import Final, Protocol

from pdgw.ds301.aborts import Abort, SdoAbortedError

FRAME_SIZE: Final = 8
SEGMENT_SIZE: Final = 7
EXPEDITED_SIZE: Final = 4
COMMAND: Final = 0xE0
"""The command of a frame; commands of the client and of the server have the same numbers."""
SEGMENT: Final = 0x00
"""Either side: data."""
DOWNLOAD: Final = 0x20
"""Client: begin of a download. Server: confirmation of a segment."""
UPLOAD: Final = 0x40
"""Client: begin of an upload. Server: its answer."""
CONFIRM: Final = 0x60
"""Client: request of a segment. Server: answer to the begin of a download."""
ABORT: Final = 0x80
BLOCK_SINK: Final = 0xA0
"""Block transfer, the side that receives the data: begin, end, acknowledgement, start."""
BLOCK_SOURCE: Final = 0xC0
"""Block transfer, the side that sends the data: begin, end."""
BLOCK_STEP: Final = 0x03
END: Final = 1
ACKNOWLEDGE: Final = 2
START: Final = 3
EXPEDITED: Final = 0x02
SIZE: Final = 0x01
_BLOCK_SIZE: Final = 0x02
CRC: Final = 0x04
TOGGLE: Final = 0x10
_NO_MORE: Final = 0x01
LAST_SEGMENT: Final = 0x80
"""In a segment of a block, beside its number."""
BLOCK_LIMIT: Final = 127
_UNNAMED: Final = b"\0\0\0"
"""Address in the aborts of devices that do not name the object."""
_NEVER: Final = 1 << 62
_TOO_LONG: Final = " is too long to be read"


def address_in(frame: bytes) -> bytes:
    """The address in a frame that names an object."""
    return frame[1:4]


def address_of(index: int, subindex: int) -> bytes:
    """The address of an object in a frame."""
    return bytes((index & 0xFF, index >> 8, subindex))


def object_of(address: bytes) -> tuple[int, int]:
    """Index and sub-index of an address."""
    return int.from_bytes(address[:2], "little"), address[2]


def _frame(head: int, content: bytes = b"") -> bytes:
    return bytes((head,)) + content.ljust(SEGMENT_SIZE, b"\0")


def _abort(address: bytes, code: int) -> bytes:
    return _frame(ABORT, address + code.to_bytes(4, "little"))


class Source:
    """The data of a transfer on the side that sends them."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._offset = 0
        """Bytes that were sent in segments, or that are confirmed in blocks."""
        self._in_block = 0
        """Segments of the last block."""
        self.block_size = 0
        """Segments of the first block of an upload."""
        self.toggle = 0
        self.crc = False
        """Both sides support the checksum of a block transfer."""
        self.complete = False
        """The last segment was sent, or the end of the blocks is confirmed."""

    def first(self, command: int, address: bytes) -> bytes:
        """The frame that begins the transfer: with the data if they are 1 to 4 bytes and not sent in blocks."""
        size = len(self._data)
        if command == BLOCK_SOURCE:
            command |= CRC | _BLOCK_SIZE
        elif 1 <= size <= EXPEDITED_SIZE:
            self.complete = True
            return _frame(command | EXPEDITED | SIZE | (EXPEDITED_SIZE - size) << 2, address + self._data)
        else:
            command |= SIZE
        return _frame(command, address + size.to_bytes(4, "little"))

    def segment(self) -> bytes:
        """The next segment."""
        part = self._data[self._offset : self._offset + SEGMENT_SIZE]
        self._offset += SEGMENT_SIZE
        self.complete = self._offset >= len(self._data)
        frame = _frame(SEGMENT | self.toggle | (SEGMENT_SIZE - len(part)) << 1 | self.complete, part)
        self.toggle ^= TOGGLE
        return frame

    def block(self, size: int) -> list[bytes]:
        """The segments of the next block, of which the other side requests ``size``."""
        if not 1 <= size <= BLOCK_LIMIT:
            raise SdoAbortedError(Abort.INVALID_BLOCK_SIZE)
        rest = self._data[self._offset :]
        count = -(-len(rest) // SEGMENT_SIZE)
        self._in_block = min(size, count)
        return [
            _frame(
                number | (LAST_SEGMENT if number == count else 0), rest[SEGMENT_SIZE * (number - 1) :][:SEGMENT_SIZE]
            )
            for number in range(1, self._in_block + 1)
        ]

    def confirm(self, frame: bytes) -> list[bytes]:
        """The frames after one of the side that receives blocks."""
        step = frame[0] & BLOCK_STEP
        if step == START:
            return self.block(self.block_size)
        if step == END:
            self.complete = True
            return []
        if step != ACKNOWLEDGE:
            raise SdoAbortedError(Abort.INVALID_COMMAND)
        if frame[1] > self._in_block:
            raise SdoAbortedError(Abort.INVALID_SEQUENCE_NUMBER)
        self._offset += SEGMENT_SIZE * frame[1]
        size = len(self._data)
        if self._offset < size:
            return self.block(frame[2])
        checksum = crc_hqx(self._data, 0) if self.crc else 0
        return [_frame(BLOCK_SOURCE | END | (self._offset - size) << 2, checksum.to_bytes(2, "little"))]


class Sink:
    """The data of a transfer on the side that receives them, or for an observer. Of more than ``limit`` bytes the end is lost."""

    def __init__(self, limit: int = _NEVER) -> None:
        self.data = bytearray()
        self._limit = limit
        self.truncated = False
        """There are more data than the limit."""
        self.size: int | None = None
        """Number of bytes that the other side has announced."""
        self.toggle = 0
        self.in_blocks = False
        """A block transfer has begun."""
        self.crc = True
        """Both sides support its checksum."""
        self._block: dict[int, bytes] = {}
        """Segments of this block by number."""
        self._last = 0
        """Number of the segment that is marked as the last one; 0: not received."""
        self.ending = False
        """The last block is confirmed: the end follows."""
        self.complete = False

    @property
    def awaits_block(self) -> bool:
        """The next frame of the other side is a segment of a block."""
        return self.in_blocks and not self.ending

    def first(self, frame: bytes) -> None:
        """The frame of the source that begins the transfer, with the data if it is expedited."""
        head, size_bit = frame[0], SIZE
        if head & COMMAND == BLOCK_SOURCE:
            self.crc, size_bit = self.crc and head & CRC != 0, _BLOCK_SIZE
        elif head & EXPEDITED:
            self.data += frame[4 : FRAME_SIZE - (head >> 2 & 3 if head & SIZE else 0)]
            self.complete = True
            return
        if head & size_bit:
            self.size = int.from_bytes(frame[4:], "little")

    def segment(self, frame: bytes) -> None:
        """A segment; SdoAbortedError if its toggle bit has not alternated."""
        if frame[0] & TOGGLE != self.toggle:
            raise SdoAbortedError(Abort.TOGGLE_NOT_ALTERNATED)
        self.toggle ^= TOGGLE
        self._append(frame[1 : FRAME_SIZE - (frame[0] >> 1 & SEGMENT_SIZE)])
        self.complete = frame[0] & _NO_MORE != 0

    def segment_of_block(self, frame: bytes) -> None:
        """A segment of a block, in any order."""
        number = frame[0] & ~LAST_SEGMENT
        self._block[number] = frame[1:]
        if frame[0] & LAST_SEGMENT:
            self._last = number

    def accept(self, count: int) -> None:
        """The first segments of the block are confirmed. The others are sent again, in the next block."""
        for number in range(1, count + 1):
            self._append(self._block.get(number, b""))
        self.ending = 0 < self._last <= count
        self._block.clear()
        self._last = 0

    def end(self, frame: bytes) -> None:
        """The end of a block transfer; SdoAbortedError if the checksum does not match the data."""
        if not self.truncated:
            del self.data[len(self.data) - (frame[0] >> 2 & SEGMENT_SIZE) :]
            if self.crc and crc_hqx(self.data, 0) != int.from_bytes(frame[1:3], "little"):
                raise SdoAbortedError(Abort.CRC_ERROR)
        self.complete = True

    def acknowledge(self) -> bytes:
        """Confirm the segments of the block without a gap."""
        count = 0
        while count + 1 in self._block:
            count += 1
        self.accept(count)
        return _frame(BLOCK_SINK | ACKNOWLEDGE, bytes((count, BLOCK_LIMIT)))

    def confirm(self, frame: bytes) -> list[bytes]:
        """The answer to a frame of a block transfer."""
        if not self.ending:
            self.segment_of_block(frame)
            is_end = frame[0] & LAST_SEGMENT or frame[0] == BLOCK_LIMIT
            return [self.acknowledge()] if is_end else []
        if frame[0] & (COMMAND | END) != BLOCK_SOURCE | END:
            raise SdoAbortedError(Abort.INVALID_COMMAND)
        self.end(frame)
        return [_frame(BLOCK_SINK | END)]

    def _append(self, part: bytes) -> None:
        if len(self.data) + len(part) > self._limit:
            self.truncated = True
        else:
            self.data += part


class Transfer(abc.ABC):
    """An access of a client to one object. Send ``request`` and call ``begin``, and send what ``take`` and ``check`` return."""

    def __init__(self, index: int, subindex: int, request: bytes, timeout_ns: int, limit_ns: int = _NEVER) -> None:
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
            if address_in(frame) in (self.address, _UNNAMED):
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
        return _abort(self.address, code)


class Upload(Transfer):
    """Read an object: by blocks, if the server supports them, or by segments."""

    def __init__(
        self,
        index: int,
        subindex: int,
        timeout_ns: int,
        *,
        by_blocks: bool = False,
        limit: int = _NEVER,
        limit_ns: int = _NEVER,
    ) -> None:
        address = address_of(index, subindex)
        request = _frame(BLOCK_SINK | CRC, address + bytes((BLOCK_LIMIT,))) if by_blocks else _frame(UPLOAD, address)
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
            return [_frame(BLOCK_SINK | START)]
        elif command != (SEGMENT if self._begun else UPLOAD):
            return None
        else:
            (sink.segment if self._begun else sink.first)(frame)
            if not sink.complete:
                frames = [_frame(CONFIRM | sink.toggle)]
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
        self._address = _UNNAMED
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
            return [_abort(self._address, error.code)]

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
            return [_frame(DOWNLOAD | head & TOGGLE)]
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
            return _frame(CONFIRM, address)
        sink.in_blocks = True
        return _frame(BLOCK_SINK | CRC, address + bytes((BLOCK_LIMIT,)))

    def _store(self, sink: Sink) -> None:
        if sink.complete:
            self._sink = None
            self._objects.set_data(*object_of(self._address), bytes(sink.data), check_writable=True)
