"""What the ring file holds and where: the one description that writer and reader share.

A page with the fixed part and its words, a JSON text that describes the rest, the records of the cycles, the records of the CAN
frames. Both kinds are 2^n of one size; record ``sequence`` is at ``sequence mod 2^n``. Its first eight bytes are its sequence
number, 0 while it is written, the number last. All numbers have the byte order and the alignment of the machine; records start
at multiples of eight. See docs/flight-recorder.md.
"""

from __future__ import annotations

import json
import mmap
import struct
import sys
from dataclasses import asdict, dataclass, field
from enum import IntEnum, IntFlag
from typing import Final, Self

from pydantic import TypeAdapter

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.format_version import problem

MAGIC: Final = b"PDGWRING"
VERSION: Final = 1
PAGE: Final = mmap.PAGESIZE
SUFFIX: Final = ".ring"
START: Final = struct.Struct("@8sIIII")
"""Magic, layout version, bytes of the JSON text, records of cycles, records of frames."""
WORD: Final = 8
SEQUENCE: Final = struct.Struct("@Q")
PEER_OFFSET: Final = 256
PEER_SIZE: Final = 64
"""The present or last PLC as text, padded with zeros."""
FRAME: Final = struct.Struct("@QqIBBBB8s")
"""Sequence, time, identifier with the flags of SocketCAN, number of the bus, sent (1) or received (0), length, spare, data."""
_CYCLE_HEAD: Final = "@QqIHHH6x"
"""Sequence, time, flags, bytes of the frame from and to the PLC, time to the answer in microseconds (65535: as much or more)."""
_OBJECT: Final = "iiHHBBBx"
"""Velocity, position, Statusword, Controlword, code of the reason, flags, number of faults modulo 256."""
OBJECT_FIELDS: Final = 7
HEAD_FIELDS: Final = 6


class Word(IntEnum):
    """Numbers of 64 bits after the start of the file, by their index in units of eight bytes."""

    WALL_OFFSET = 4
    """Wall clock minus monotonic clock in nanoseconds, signed."""
    NEWEST_CYCLE = 5
    """Sequence number of the newest cycle, 0 before the first one."""
    NEWEST_FRAME = 6
    ENDED = 7
    """1: the daemon ended in order, nothing more comes."""
    PROCESS = 8
    """Its process ID."""
    FRAMES_BEFORE = 9
    """Where stores may be seen out of order (``ordering``): sequence number of the newest CAN frame before the newest cycle."""


class CycleFlag(IntFlag):
    """Flags of a cycle."""

    FRESH = 1
    """Begun by a frame of the PLC."""
    CONNECTED = 2
    ANSWERED = 4
    """The PLC was sent its frame in this cycle."""


class ObjectFlag(IntFlag):
    """Flags of a drive object in a cycle."""

    SETPOINTS = 1
    """They are valid."""
    GOOD = 2
    """The actual values are valid."""
    ACTIVE_FAULT = 4
    """A fault is not acknowledged."""


@dataclass(frozen=True)
class FramePlaces:
    """Place of a drive object's data in the frames; None: none. Offsets count from the first stored byte.

    ``received_size`` and ``sent_size``: stored bytes of a frame from and to the PLC. ``kind``: ``udp`` frames start with the
    FrameID; sent ``profinet`` frames start with the Ethernet header.
    """

    kind: str
    received_size: int
    sent_size: int
    setpoints: tuple[int | None, ...]
    actuals: tuple[int | None, ...]


@dataclass(frozen=True)
class TracedObject:
    """A drive object; ``mapped``: velocity and position are in its PDOs."""

    do_id: int
    kind: str
    node_id: int
    bus: str
    telegram: int
    velocity_mapped: bool = False
    position_mapped: bool = False


@dataclass(frozen=True)
class RingLayout:
    """Description of the file for a reader."""

    name: str
    cycle_ns: int
    places: FramePlaces
    objects: tuple[TracedObject, ...]
    buses: tuple[str, ...]
    cycles: int
    """Records, a power of two."""
    frames: int
    address: tuple[str, int] = ("", 0)
    """Where the PLC's frames are received."""
    reasons: tuple[str, ...] = ()
    """Names of the reasons; code 1 is the first."""
    configuration: str = ""
    """The effective configuration, as TOML."""
    byte_order: str = field(default=sys.byteorder)

    @property
    def cycle(self) -> struct.Struct:
        """The record of a cycle."""
        places = self.places
        received, sent = _rounded(places.received_size), _rounded(places.sent_size)
        return struct.Struct(f"{_CYCLE_HEAD}{received}s{sent}s" + _OBJECT * len(self.objects))

    @property
    def text(self) -> bytes:
        """The description, as JSON."""
        return json.dumps(asdict(self)).encode()

    @property
    def cycles_offset(self) -> int:
        """Offset of the cycle records: after the description, on a page."""
        return PAGE + _paged(len(self.text))

    @property
    def frames_offset(self) -> int:
        return self.cycles_offset + _paged(self.cycles * self.cycle.size)

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.frames_offset + _paged(self.frames * FRAME.size)

    def head(self) -> bytes:
        """The start of the file and the description."""
        text = self.text
        return START.pack(MAGIC, VERSION, len(text), self.cycles, self.frames).ljust(PAGE, b"\0") + text

    @classmethod
    def parse(cls, data: bytes | memoryview, name: str) -> Self:
        """Parse the bytes of a file called ``name``; GatewayError for another or damaged file."""
        if len(data) < PAGE or START.unpack_from(data)[0] != MAGIC:
            raise GatewayError(f"{name}: not a ring file of the flight recorder")
        _, version, length, cycles, frames = START.unpack_from(data)
        if text := problem(version, VERSION):
            raise GatewayError(f"{name}: {text}")
        try:
            layout = TypeAdapter(cls).validate_json(bytes(data[PAGE : PAGE + length]))
            whole = (layout.cycles, layout.frames, layout.byte_order) == (cycles, frames, sys.byteorder)
            if not whole or layout.size > len(data) or any(n & (n - 1) or n < 1 for n in (cycles, frames)):
                raise GatewayError(f"{name}: damaged, or written by another type of machine")
        except (ValueError, struct.error) as error:
            raise GatewayError(f"{name}: damaged description") from error
        return layout


def _rounded(size: int) -> int:
    return -(-size // WORD) * WORD


def _paged(size: int) -> int:
    return -(-size // PAGE) * PAGE


def sized(layout: RingLayout, limit: int) -> tuple[int, int]:
    """Records of cycles and frames: powers of two, as many as the layout has at least, halved until ``limit`` bytes hold them."""
    cycle = layout.cycle.size
    cycles, frames = _power(layout.cycles), _power(layout.frames)
    while cycles * cycle + frames * FRAME.size > limit and max(cycles, frames) > 1:
        if cycles * cycle >= frames * FRAME.size:
            cycles //= 2
        else:
            frames //= 2
    return max(1, cycles), max(1, frames)


def _power(count: int) -> int:
    return 1 << max(0, count - 1).bit_length()
