"""Generate captures of both buses for measurements: cyclic frames of telegram 1 over UDP, and PDOs of the drives.

Source: draft-ietf-opsawg-pcapng. The frames come from ``profidrive.frame`` and ``dsp402.pdo.layouts``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import BinaryIO

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.gateway.trace.pcapng import udp_header
from pdgw.profidrive.frame import (
    CYCLIC_PORT,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    IOPS_GOOD,
    STATUS_NORMAL,
    TRAILER,
    CSduLayout,
)
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.tools.decoder.frames.records import LinkType

_CYCLE_NS = MS
_COUNTER_STEP = 32
_BEGIN_NS = 1_700_000_000 * SECOND
_NODE = 1


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    """A pcapng block in one byte order."""
    body += bytes(-len(body) % 4)
    length = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + length + body + length


def _udp(frame: bytes) -> bytes:
    ends = (f"10.0.0.{host}:{CYCLIC_PORT}" for host in (1, 2))
    return udp_header(*ends, len(frame)) + frame


def _rt(direction: Direction, counter: int, word: int, value: int) -> bytes:
    layout = CSduLayout([telegram(1)], direction)
    frame = layout.new_frame(FRAME_ID_TO_DEVICE if direction is Direction.SETPOINT else FRAME_ID_TO_CONTROLLER)
    layout.halves[0].encode_into(frame, layout.offsets[0], (word, value))
    frame[layout.iops[0]] = frame[layout.iocs[0]] = IOPS_GOOD
    TRAILER.pack_into(frame, layout.trailer, counter & 0xFFFF, STATUS_NORMAL, 0)
    return bytes(frame)


def _can(pdo: Pdo, **values: int) -> bytes:
    """A CAN frame with values by name of the process image, in the order of the PDO."""
    data = pdo.pack(SimpleNamespace(**values))
    return struct.pack(">IBxxx", pdo.cob_id(_NODE), len(data)) + data


def _cycles() -> Iterator[tuple[int, bytes]]:
    """Endless packets, four in each cycle: (interface, bytes)."""
    layouts = LAYOUTS[Operation.VELOCITY]
    rpdo, tpdo = layouts.rpdos[0], layouts.tpdos[0]
    cycle = 0
    while True:
        speed = cycle % 0x4000
        yield 0, _udp(_rt(Direction.SETPOINT, cycle * _COUNTER_STEP, 0x047F, speed))
        yield 1, _can(rpdo, controlword=0x000F, target_velocity=speed)
        yield 1, _can(tpdo, statusword=0x0637, velocity_actual=speed - 1)
        yield 0, _udp(_rt(Direction.ACTUAL, cycle * _COUNTER_STEP, 0x0637, speed - 1))
        cycle += 1


def write_capture(path: Path, packets: int) -> None:
    """Write a capture. Four packets are one millisecond."""
    with path.open("wb") as file:
        _write(file, packets)


def _write(file: BinaryIO, packets: int) -> None:
    file.write(block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)))
    nanoseconds = struct.pack("<HHB3xI", 9, 1, 9, 0)
    for link in (LinkType.ETHERNET, LinkType.CAN_SOCKETCAN):
        file.write(block(1, struct.pack("<HHI", link, 0, 0) + nanoseconds))
    for number, (interface, data) in zip(range(packets), _cycles(), strict=False):
        time_ns = _BEGIN_NS + number * _CYCLE_NS // 4
        head = struct.pack("<IIIII", interface, time_ns >> 32, time_ns & 0xFFFFFFFF, len(data), len(data))
        file.write(block(6, head + data))
