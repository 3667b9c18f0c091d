"""The PROFINET cyclic (RT) frame: FrameID, C_SDU, APDU status, and the C_SDU layout of a static relationship."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.telegrams import Direction, Telegram, TelegramHalf

CYCLIC_PORT: Final = 34962
"""PROFINET RT over UDP (8892h)."""
ETHERTYPE: Final = 0x8892
FRAME_ID_MIN: Final = 0xC000
FRAME_ID_MAX: Final = 0xF7FF
FRAME_ID_TO_DEVICE: Final = 0xC001
FRAME_ID_TO_CONTROLLER: Final = 0xC000
C_SDU_MIN: Final = 40
C_SDU_MAX: Final = 1440
HEADER: Final = struct.Struct(">H")
TRAILER: Final = struct.Struct(">HBB")
"""CycleCounter, DataStatus, TransferStatus."""
TICK: Final = struct.Struct(">I")
"""The gateway's clock in its last bytes before the trailer, which the PLC copies back (docs/plc.md)."""

IOPS_GOOD: Final = 0x80
IOPS_BAD: Final = 0x00

STATUS_PRIMARY: Final = 0x01
STATUS_DATA_VALID: Final = 0x04
STATUS_RUN: Final = 0x10
STATUS_NO_PROBLEM: Final = 0x20
STATUS_NORMAL: Final = STATUS_PRIMARY | STATUS_DATA_VALID | STATUS_RUN | STATUS_NO_PROBLEM
STATUS_STOP: Final = STATUS_NORMAL & ~STATUS_RUN

COUNTER_UNIT_NS: Final = 31_250
"""One step of the cycle counter in nanoseconds."""
COUNTER_NEWEST: Final = 61_440
"""A frame is newer than the last one when (new - last) mod 65536 is in 1..COUNTER_NEWEST."""


@dataclass(frozen=True, slots=True)
class RtFrame:
    """A cyclic frame taken apart; ``c_sdu`` keeps its padding."""

    frame_id: int
    c_sdu: bytes
    cycle_counter: int
    data_status: int = STATUS_NORMAL
    transfer_status: int = 0

    def encode(self) -> bytes:
        """The frame's bytes, C_SDU padded to its minimum."""
        return b"".join(
            (
                HEADER.pack(self.frame_id),
                self.c_sdu.ljust(C_SDU_MIN, b"\0"),
                TRAILER.pack(self.cycle_counter, self.data_status, self.transfer_status),
            )
        )

    @classmethod
    def decode(cls, data: bytes) -> RtFrame:
        """Take a frame apart; ProfidriveError when it cannot be a cyclic frame."""
        low = HEADER.size + C_SDU_MIN + TRAILER.size
        high = HEADER.size + C_SDU_MAX + TRAILER.size
        if not low <= len(data) <= high:
            raise ProfidriveError("RT frame length", len(data), f"{low}..{high} bytes")
        (frame_id,) = HEADER.unpack_from(data)
        if not FRAME_ID_MIN <= frame_id <= FRAME_ID_MAX:
            raise ProfidriveError("FrameID", f"{frame_id:04X}h", f"{FRAME_ID_MIN:04X}h..{FRAME_ID_MAX:04X}h")
        end = len(data) - TRAILER.size
        counter, status, transfer = TRAILER.unpack_from(data, end)
        return cls(frame_id, data[HEADER.size : end], counter, status, transfer)


def is_newer(counter: int, last: int) -> bool:
    """Whether a cycle counter is newer than the last accepted one."""
    return 1 <= (counter - last) & 0xFFFF <= COUNTER_NEWEST


class CSduLayout:
    """The places of the data objects of several axes in one frame of a static relationship.

    For each axis in order: telegram words, then its IOPS byte; after the last axis one IOCS byte per axis; the tick in the last
    four bytes. Offsets count from the first byte of the frame (the FrameID), so that a codec can work on the whole datagram.
    """

    def __init__(self, telegrams: Sequence[Telegram], direction: Direction) -> None:
        if not telegrams:
            raise ProfidriveError("axes of a frame", 0, "at least one axis")
        self.direction = direction
        self.halves: tuple[TelegramHalf, ...] = tuple(t.half(direction) for t in telegrams)
        offset = HEADER.size
        offsets: list[int] = []
        iops: list[int] = []
        for half in self.halves:
            offsets.append(offset)
            iops.append(offset + half.size)
            offset += half.size + 1
        self.offsets = tuple(offsets)
        self.iops = tuple(iops)
        self.iocs = tuple(range(offset, offset + len(self.halves)))
        self.used = offset + len(self.halves) - HEADER.size
        """Bytes of the data objects, without padding and tick."""
        if self.used + TICK.size > C_SDU_MAX:
            raise ProfidriveError("C_SDU length", self.used + TICK.size, f"at most {C_SDU_MAX} bytes; use fewer axes")
        self.trailer = HEADER.size + max(C_SDU_MIN, self.used + TICK.size)
        self.tick = self.trailer - TICK.size
        self.frame_size = self.trailer + TRAILER.size
        codes = "".join(f"{half.struct.format[1:]}B" for half in self.halves) + "B" * len(self.halves)
        self.struct = struct.Struct(f">H{codes}{self.tick - offset - len(self.halves)}xIHBB")
        """The whole frame: FrameID, the words and IOPS of each axis, the IOCS, tick, CycleCounter, DataStatus, TransferStatus."""

    def new_frame(self, frame_id: int) -> bytearray:
        """An empty frame to fill in place: all IOPS and IOCS BAD, counter 0, status 0."""
        frame = bytearray(self.frame_size)
        HEADER.pack_into(frame, 0, frame_id)
        return frame
