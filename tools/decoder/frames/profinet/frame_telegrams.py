"""The telegrams of a cyclic frame: the struct of given ones, which decodes a whole frame in one call, and inferred ones.

Source: docs/plc.md (C_SDU of a static relationship). Telegrams are inferred from the places of IOPS and IOCS.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

from pdgw.dsp402.identification.overlay import Families
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import HEADER, IOPS_GOOD, TICK, TRAILER, CSduLayout
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram, TelegramHalf, telegram
from pdgw.tools.decoder.frames.fields import half_fields
from pdgw.tools.decoder.frames.records import FrameLayout, ProcessDataLayout

_MAX_INFERRED_AXES = 8


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis of the relationship, in the order of the frame.

    ``node`` is its CANopen node-ID, 0 if unknown; ``bus`` the channel of that node, empty for any. ``slot`` is its PROFINET
    slot, 0 if the order defines it.
    """

    do_id: int
    telegram: int
    node: int = 0
    bus: str = ""
    slot: int = 0


@cache
def unit_layout(half: TelegramHalf, families: Families) -> ProcessDataLayout:
    """The fields of one telegram direction."""
    return ProcessDataLayout(half_fields(half, families), half.telegram, half.direction)


@dataclass(frozen=True, slots=True)
class Placement:
    """The place of an axis in a frame; offsets count from the first byte of the frame, the FrameID."""

    axis: Axis
    half: TelegramHalf
    data: int
    iops: int
    iocs: int


def placed_layout(
    placements: Sequence[Placement], direction: Direction, length: int, families: Families
) -> FrameLayout | None:
    """The layout of a frame of ``length`` bytes; None when something overlaps or does not fit into it."""
    pieces: list[tuple[int, int, str]] = []
    for placement in placements:
        half = placement.half
        pieces.append((placement.data, half.size, "".join(signal.type.char for signal in half.signals)))
        pieces += [(placement.iops, 1, "B"), (placement.iocs, 1, "B")]
    characters = [">H"]
    positions: dict[int, int] = {}
    at, count = HEADER.size, 1
    for offset, size, text in sorted(pieces):
        if offset < at:
            return None
        characters.append(f"{offset - at}x{text}")
        positions[offset] = count
        at, count = offset + size, count + len(text)
    padding = length - TRAILER.size - at
    if padding < 0:
        return None
    axes = []
    for placement in placements:
        axis, unit = placement.axis, unit_layout(placement.half, families)
        first, iops, iocs = positions[placement.data], positions[placement.iops], positions[placement.iocs]
        if first + len(unit.fields) != iops:
            return None
        axes.append((axis.do_id, axis.node, unit, first, iops, iocs))
    return FrameLayout(struct.Struct("".join(characters) + f"{padding}xHBB"), direction, tuple(axes))


def frame_layout(
    axes: Sequence[Axis], direction: Direction, length: int, telegrams: Mapping[int, Telegram], families: Families
) -> FrameLayout | None:
    """The layout of a static relationship's frame with these axes; None when they do not fit into ``length`` bytes."""
    try:
        static = CSduLayout([telegram(axis.telegram, telegrams) for axis in axes], direction)
    except ProfidriveError:  # more axes than a frame can have
        return None
    places = zip(axes, static.halves, static.offsets, static.iops, static.iocs, strict=True)
    layout = placed_layout([Placement(*place) for place in places], direction, length, families)
    # A shorter frame is of a version without ticks.
    return (
        layout
        if layout is None or length < static.frame_size
        else replace(layout, tick=length - TRAILER.size - TICK.size)
    )


def given_axes(numbers: Sequence[int]) -> tuple[Axis, ...]:
    """Axes of which only the telegrams are known: DO-ID and node-ID 1 upwards; ProfidriveError for an unknown telegram."""
    return tuple(Axis(position, telegram(number).number, position) for position, number in enumerate(numbers, 1))


Candidate = tuple[frozenset[int], ...]
"""The telegrams possible for each axis."""


def _of_size(direction: Direction) -> dict[int, frozenset[int]]:
    sizes = sorted({t.half(direction).size for t in TELEGRAMS.values()})
    return {size: frozenset(n for n, t in TELEGRAMS.items() if t.half(direction).size == size) for size in sizes}


_BY_SIZE = {direction: _of_size(direction) for direction in Direction}


def infer(c_sdu: bytes, direction: Direction) -> list[Candidate]:
    """The telegrams that explain the places of the GOOD status bytes of a C_SDU, fewest axes first; empty if none do.

    Its last bytes may be a tick.
    """
    return _explained(c_sdu[: -TICK.size], direction) or _explained(c_sdu, direction)


def _explained(c_sdu: bytes, direction: Direction) -> list[Candidate]:
    used = len(c_sdu.rstrip(b"\0"))
    found: list[Candidate] = []

    def extend(offset: int, remaining: int, end: int, parts: Candidate) -> None:
        if not remaining:
            if offset == end:
                found.append(parts)
            return
        for size, numbers in _BY_SIZE[direction].items():
            iops = offset + size
            if iops < end and c_sdu[iops] == IOPS_GOOD:
                extend(iops + 1, remaining - 1, end, (*parts, numbers))

    for count in range(1, _MAX_INFERRED_AXES + 1):
        end = used - count
        if end > 0 and all(status == IOPS_GOOD for status in c_sdu[end:used]):
            extend(0, count, end, ())
    return found


def combine(one: list[Candidate], other: list[Candidate]) -> list[Candidate]:
    """What explains the frames of both directions."""
    combined = []
    for left in one:
        for right in other:
            if len(left) == len(right):
                parts = tuple(a & b for a, b in zip(left, right, strict=True))
                if all(parts):
                    combined.append(parts)
    return combined


def is_one_of(numbers: Sequence[int], candidate: Candidate) -> bool:
    """Whether these telegrams are among the possible ones."""
    return len(numbers) == len(candidate) and all(n in possible for n, possible in zip(numbers, candidate, strict=True))
