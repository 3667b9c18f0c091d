"""The offset between the clocks of two captures, from the edges that both contain.

An edge of STW1 is followed by the same edge of the Controlword, an edge of the Statusword by the same edge of ZSW1, each after
a short delay. True pairs have similar distances: the most frequent distance between equal edges is the offset. The delays have
opposite directions (PLC to CAN, CAN to PLC), so the offset is between the two groups: the result is the middle, and half their
distance is the uncertainty. Without edges from CAN to PLC the delay of the gateway remains in the offset.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import STATE_BITS, Command, ControlBit, StatusBit
from pdgw.tools.decoder.timeline.entries import Edge, WordKind

MAX_EDGES: Final = 300
"""Edges of one bit that are compared: the first ones."""
_WIDTH_CYCLES = 4
"""True pairs of both directions are within this number of cycles: gateway and drive answer within one each."""
_OUTLIERS = 0.1
"""Share of a group that may be late."""
_AMBIGUOUS = 0.8
ONE_CLOCK: Final = "one clock"
"""The origin where nothing had to be found out."""


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


_COMMANDS: Final = {WordKind.CONTROL, WordKind.CONTROLWORD}
_STATUS: Final = STATE_BITS & ~StatusBit.OPERATION_ENABLED | StatusBit.VOLTAGE_ENABLED | StatusBit.REMOTE
"""Bits that ZSW1 shows as the Statusword does."""
_CONTROL: Final = Command.ENABLE_OPERATION.mask | ControlBit.FAULT_RESET
"""Bits of the Controlword that follow those of STW1 at once, when anything follows."""


def _changes(edge: Edge) -> Iterator[tuple[int, bool]]:
    """The changed bits that both buses show, by their mask on CAN, and whether they were set."""
    changed = edge.before ^ edge.after
    shown = changed & (_CONTROL if edge.kind in _COMMANDS else _STATUS)
    for mask in (1 << place for place in range(shown.bit_length())):
        if shown & mask:
            yield mask, bool(edge.after & mask)
    task = edge.field.bit("activate_task") or edge.field.bit("new_setpoint")
    if task is not None and changed & task.mask:
        yield ControlBit.NEW_SETPOINT, bool(edge.after & task.mask)


class _Distance(NamedTuple):
    """CAN time minus PLC time of two equal edges, whether the CAN edge is the effect, and the PLC edge."""

    value: int
    is_effect: bool
    edge: object


def _distances(edges: Iterable[Edge]) -> tuple[list[_Distance], int]:
    """Distances of all pairs of equal edges in their order, and how many edges of the PLC's side there are."""
    times: defaultdict[tuple[int, bool, int, bool], tuple[list[int], list[int]]] = defaultdict(lambda: ([], []))
    for edge in edges:
        for mask, is_set in _changes(edge):
            found = times[edge.do_id, edge.kind in _COMMANDS, mask, is_set][edge.kind.on_can]
            if len(found) < MAX_EDGES:
                found.append(edge.time_ns)
    distances = [
        _Distance(there - here, key[1], (key, here))
        for key, (of_plc, of_can) in times.items()
        for here in of_plc
        for there in of_can
    ]
    return sorted(distances, key=lambda item: item.value), sum(
        len(of_plc) for of_plc, of_can in times.values() if of_can
    )


def correlate(edges: Iterable[Edge], cycle_ns: int) -> Clocks:
    """Find the offset from the edges of both captures, each side on its own clock."""
    distances, count = _distances(edges)
    if not distances:
        return Clocks(0, origin="not known")
    values = [item.value for item in distances]
    width = _WIDTH_CYCLES * cycle_ns
    counts = _votes(distances, values, width)
    # One clock is more likely than two: of equal candidates take the one nearest to 0.
    best = max(range(len(values)), key=lambda i: (counts[i], -abs(values[i] + width // 2)))
    low, high = values[best], values[best] + width
    rivals = max((counts[i] for i, value in enumerate(values) if not low - width < value < high), default=0)
    offset, uncertainty = _between(distances[best : bisect_right(values, high)], cycle_ns)
    return Clocks(offset, uncertainty, counts[best], count, rivals, "correlated")


def _votes(distances: Sequence[_Distance], values: Sequence[int], width: int) -> list[int]:
    """Number of different edges of the PLC's side with a partner in the window that starts at each distance."""
    counts = []
    inside: Counter[object] = Counter()
    end = 0
    for begin, value in enumerate(values):
        while end < len(values) and values[end] <= value + width:
            inside[distances[end].edge] += 1
            end += 1
        counts.append(len(inside))
        edge = distances[begin].edge
        inside[edge] -= 1
        if not inside[edge]:
            del inside[edge]
    return counts


def _between(cluster: Sequence[_Distance], cycle_ns: int) -> tuple[int, int]:
    """Offset and uncertainty: effects on CAN come after the offset, causes before it."""
    after = [item.value for item in cluster if item.is_effect]
    before = [item.value for item in cluster if not item.is_effect]
    early, late = after or before, before or after
    lowest, highest = sorted((early[int(_OUTLIERS * len(early))], late[-1 - int(_OUTLIERS * len(late))]))
    # With one direction only, delay of the gateway and clock offset cannot be separated.
    error_bound = (highest - lowest) // 2 if after and before else cycle_ns
    if lowest - cycle_ns // 2 <= 0 <= highest + cycle_ns // 2:
        return 0, max(error_bound, abs(lowest), abs(highest))
    return (lowest + highest) // 2, error_bound
