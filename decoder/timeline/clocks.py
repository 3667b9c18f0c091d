"""The offset between the clocks of two captures, from the edges that both contain.

An edge of STW1 is followed by the same edge of the Controlword, an edge of the Statusword by the same edge of ZSW1, each after
a short delay. True pairs have similar distances: the most frequent distance between equal edges is the offset. The delays have
opposite directions (PLC to CAN, CAN to PLC), so the offset is between the two groups: the result is the middle, and half their
distance is the uncertainty. Without edges from CAN to PLC the delay of the gateway remains in the offset.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, NamedTuple

from pdgw.decoder.frames.canopen.records import CanRecord, PdoRecord
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.records import CyclicRecord
from pdgw.dsp402.objects import CONTROLWORD, STATUSWORD
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.durations import MS, SECOND
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import ApplicationMode, Direction, telegram

MAX_EDGES: Final = 300
"""Edges of one bit that are compared: the first ones."""
_WIDTH_CYCLES = 4
"""True pairs of both directions are within this number of cycles: gateway and drive answer within one each."""
_OUTLIERS = 0.1
"""Share of a group that may be late."""
_AMBIGUOUS = 0.8
ONE_CLOCK: Final = "one clock"
"""The origin where nothing had to be found out."""


class Word(NamedTuple):
    """A control or status word that differs from the one before."""

    time_ns: int
    value: int


@dataclass
class AxisWords:
    """The words of one axis as both buses carried them; a word that repeats the one before may be left out."""

    control: list[Word] = field(default_factory=list)
    """First signal of the PLC's frames (STW1, Controlword)."""
    status: list[Word] = field(default_factory=list)
    """First signal of the gateway's frames (ZSW1, Statusword)."""
    controlword: list[Word] = field(default_factory=list)
    statusword: list[Word] = field(default_factory=list)


def collect(words: Mapping[int, AxisWords], axes: Sequence[Axis], record: CyclicRecord | CanRecord) -> None:
    """Add the words of a record; ``words`` by DO-ID."""
    if isinstance(record, CyclicRecord):
        to_gateway = record.direction is Direction.SETPOINT
        for do_id, _, _, first, _, _ in record.layout.axes:
            if (known := words.get(do_id)) is not None:
                _add(known.control if to_gateway else known.status, record.time_ns, record.values[first])
    elif isinstance(record, PdoRecord):
        layout = record.layout
        for axis in axes:
            if axis.node == record.node and axis.bus in {"", record.channel}:
                known = words[axis.do_id]
                for address, kept in ((CONTROLWORD, known.controlword), (STATUSWORD, known.statusword)):
                    if address in layout.addresses:
                        _add(kept, record.time_ns, layout.unpack(record.data)[layout.addresses.index(address)])


def _add(words: list[Word], now: int, value: object) -> None:
    if isinstance(value, int) and (not words or words[-1].value != value):
        words.append(Word(now, value))


@dataclass(frozen=True)
class Clocks:
    """``offset_ns``: the CAN capture's clock minus the PLC's; ``uncertainty_ns``: its possible error.

    ``pairs`` edges out of ``edges`` agree with it; ``rivals`` agree with the second best offset. ``origin``: ``given``, ``one
    clock``, ``correlated`` or ``not known`` (offset 0).
    """

    offset_ns: int
    uncertainty_ns: int = 0
    pairs: int = 0
    edges: int = 0
    rivals: int = 0
    origin: str = "given"

    @property
    def ambiguous(self) -> bool:
        """Another offset fits nearly as well."""
        return self.origin == "correlated" and self.rivals >= _AMBIGUOUS * self.pairs

    @property
    def text(self) -> str:
        """Offset and quality for the reader."""
        said = f"the CAN clock differs by {self.offset_ns / SECOND:+.6f} s from the clock of the PLC's frames"
        if self.origin == "given":
            return f"{said}, as given"
        if self.origin == ONE_CLOCK:
            return ONE_CLOCK
        if self.origin == "not known":
            return "no edges in common: clock offset unknown, both captures are treated as one clock"
        quality = f"{self.pairs} of {self.edges} edges match, uncertainty {self.uncertainty_ns / MS:.3f} ms"
        if self.offset_ns == 0:
            said = "the clocks match"
        if self.ambiguous:
            quality += f"; AMBIGUOUS: another offset matches {self.rivals} edges"
        return f"{said}: {quality}"


_COMMON = {
    signal("STW1").bit(name).mask: (mask, False)
    for name, mask in (
        ("ON", ControlBit.SWITCH_ON),
        ("NO_COAST_STOP", ControlBit.ENABLE_VOLTAGE),
        ("NO_QUICK_STOP", ControlBit.QUICK_STOP),
        ("ENABLE_OPERATION", ControlBit.ENABLE_OPERATION),
        ("FAULT_ACKNOWLEDGE", ControlBit.FAULT_RESET),
    )
}
_TASKS = {
    signal("STW1").bit(name, positioning=True).mask: pair
    for name, pair in {
        "ACTIVATE_TASK": (ControlBit.NEW_SETPOINT, False),
        "NO_INTERMEDIATE_STOP": (ControlBit.HALT, True),
    }.items()
}
_CONTROL: Final[dict[ApplicationMode, dict[int, tuple[int, bool]]]] = {
    ApplicationMode.VELOCITY: _COMMON,
    ApplicationMode.POSITIONING: _COMMON | _TASKS,
    ApplicationMode.TRANSPARENT: {1 << bit: (1 << bit, False) for bit in range(16)},
}
"""Controlword bit (and whether inverted) that follows a bit of the PLC's control word at once, when anything follows."""
_STATUS: Final = (
    StatusBit.READY_TO_SWITCH_ON,
    StatusBit.SWITCHED_ON,
    StatusBit.FAULT,
    StatusBit.VOLTAGE_ENABLED,
    StatusBit.NO_QUICK_STOP,
    StatusBit.SWITCH_ON_DISABLED,
    StatusBit.REMOTE,
)
"""Bits a status word shows as the Statusword does."""


def _edges(words: Sequence[Word], mask: int, inverted: bool = False) -> Iterator[tuple[bool, int]]:
    """Direction and time of each change of a bit."""
    for before, word in pairwise(words):
        if (before.value ^ word.value) & mask:
            yield bool(word.value & mask) is not inverted, word.time_ns


def _times(words: Sequence[Word], mask: int, rising: bool, inverted: bool = False) -> list[int]:
    return [now for up, now in _edges(words, mask, inverted) if up is rising][:MAX_EDGES]


Distance = tuple[int, bool, object]
"""CAN time minus PLC time of two equal edges, whether the CAN edge is the effect, and the PLC edge."""


def _distances(words: AxisWords, number: int, key: object) -> tuple[list[Distance], int]:
    """Distances of all pairs of equal edges of one axis, and how many edges of the PLC's side there are."""
    found: list[Distance] = []
    edges = 0
    for rising in (True, False):
        for mask, (other, inverted) in _CONTROL.get(telegram(number).mode, {}).items():
            effects = _times(words.controlword, other, rising, inverted)
            causes = _times(words.control, mask, rising)
            edges += len(causes) if effects else 0
            found += [(effect - cause, True, (key, mask, cause)) for cause in causes for effect in effects]
        for mask in _STATUS:
            causes = _times(words.statusword, mask, rising)
            effects = _times(words.status, mask, rising)
            edges += len(effects) if causes else 0
            found += [(cause - effect, False, (key, -mask, effect)) for cause in causes for effect in effects]
    return found, edges


def correlate(words: Mapping[int, AxisWords], telegrams: Mapping[int, int], cycle_ns: int) -> Clocks:
    """Find the offset; ``telegrams`` by DO-ID, ``words`` each side on its own clock."""
    distances: list[Distance] = []
    edges = 0
    for do_id, item in words.items():
        found, count = _distances(item, telegrams[do_id], do_id)
        distances += found
        edges += count
    if not distances:
        return Clocks(0, origin="not known")
    distances.sort(key=lambda item: item[0])
    values = [item[0] for item in distances]
    width = _WIDTH_CYCLES * cycle_ns
    counts = _votes(distances, values, width)
    # One clock is more likely than two: of equal candidates take the one nearest to 0.
    best = max(range(len(values)), key=lambda i: (counts[i], -abs(values[i] + width // 2)))
    low, high = values[best], values[best] + width
    rivals = max((counts[i] for i, value in enumerate(values) if not low - width < value < high), default=0)
    cluster = distances[best : bisect_right(values, high)]
    offset, uncertainty = _between(cluster, cycle_ns)
    return Clocks(offset, uncertainty, counts[best], edges, rivals, "correlated")


def _votes(distances: Sequence[Distance], values: Sequence[int], width: int) -> list[int]:
    """Number of different edges of the PLC's side with a partner in the window that starts at each distance."""
    counts = []
    inside: dict[object, int] = {}
    end = 0
    for begin, value in enumerate(values):
        while end < len(values) and values[end] <= value + width:
            inside[distances[end][2]] = inside.get(distances[end][2], 0) + 1
            end += 1
        counts.append(len(inside))
        edge = distances[begin][2]
        inside[edge] -= 1
        if not inside[edge]:
            del inside[edge]
    return counts


def _between(cluster: Sequence[Distance], cycle_ns: int) -> tuple[int, int]:
    """Offset and uncertainty: effects on CAN come after the offset, causes before it."""
    after = sorted(distance for distance, effect, _ in cluster if effect)
    before = sorted(distance for distance, effect, _ in cluster if not effect)
    highest = after[int(_OUTLIERS * len(after))] if after else None
    lowest = before[-1 - int(_OUTLIERS * len(before))] if before else None
    if highest is None or lowest is None:
        # With one direction only, delay of the gateway and clock offset cannot be separated.
        lowest = highest = highest if highest is not None else lowest or 0
        error_bound = cycle_ns
    else:
        error_bound = (highest - lowest) // 2
        if lowest > highest:  # the recorders' own delays are longer than those between the edges
            lowest, highest = highest, lowest
            error_bound = (cluster[-1][0] - cluster[0][0]) // 2
    if lowest - cycle_ns // 2 <= 0 <= highest + cycle_ns // 2:
        return 0, max(error_bound, abs(lowest), abs(highest))
    return (lowest + highest) // 2, error_bound
