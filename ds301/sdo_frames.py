"""The frames of SDO transfers, and the data in them: expedited, segmented and block, uploads and downloads.

Source: CiA DS 301 V4.02 chapter 7.2.4. In both directions a ``Source`` sends the data and a ``Sink`` receives them.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

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
UNNAMED: Final = b"\0\0\0"
"""Address in the aborts of devices that do not name the object."""
NEVER: Final = 1 << 62


def address_in(frame: bytes) -> bytes:
    """The address in a frame that names an object."""
    return frame[1:4]


def address_of(index: int, subindex: int) -> bytes:
    """The address of an object in a frame."""
    return bytes((index & 0xFF, index >> 8, subindex))


def object_of(address: bytes) -> tuple[int, int]:
    """Index and sub-index of an address."""
    return int.from_bytes(address[:2], "little"), address[2]


def sdo_frame(head: int, content: bytes = b"") -> bytes:
    """A frame of eight bytes: ``head``, then up to seven bytes, filled with zeros."""
    return bytes((head,)) + content.ljust(SEGMENT_SIZE, b"\0")


def abort_frame(address: bytes, code: int) -> bytes:
    """The frame by which either side ends a transfer with an abort code."""
    return sdo_frame(ABORT, address + code.to_bytes(4, "little"))


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
            return sdo_frame(command | EXPEDITED | SIZE | (EXPEDITED_SIZE - size) << 2, address + self._data)
        else:
            command |= SIZE
        return sdo_frame(command, address + size.to_bytes(4, "little"))

    def segment(self) -> bytes:
        """The next segment."""
        part = self._data[self._offset : self._offset + SEGMENT_SIZE]
        self._offset += SEGMENT_SIZE
        self.complete = self._offset >= len(self._data)
        frame = sdo_frame(SEGMENT | self.toggle | (SEGMENT_SIZE - len(part)) << 1 | self.complete, part)
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
            sdo_frame(
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
        return [sdo_frame(BLOCK_SOURCE | END | (self._offset - size) << 2, checksum.to_bytes(2, "little"))]


class Sink:
    """The data of a transfer on the side that receives them, or for an observer. Of more than ``limit`` bytes the end is lost."""

    def __init__(self, limit: int = NEVER) -> None:
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
        return sdo_frame(BLOCK_SINK | ACKNOWLEDGE, bytes((count, BLOCK_LIMIT)))

    def confirm(self, frame: bytes) -> list[bytes]:
        """The answer to a frame of a block transfer."""
        if not self.ending:
            self.segment_of_block(frame)
            is_end = frame[0] & LAST_SEGMENT or frame[0] == BLOCK_LIMIT
            return [self.acknowledge()] if is_end else []
        if frame[0] & (COMMAND | END) != BLOCK_SOURCE | END:
            raise SdoAbortedError(Abort.INVALID_COMMAND)
        self.end(frame)
        return [sdo_frame(BLOCK_SINK | END)]

    def _append(self, part: bytes) -> None:
        if len(self.data) + len(part) > self._limit:
            self.truncated = True
        else:
            self.data += part
