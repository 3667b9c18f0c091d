"""Events around the last fault or stop, in at most ten lines; each drive object stores its own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from pdgw.durations import SECOND

KEPT: Final = 100
"""Happenings that a drive object keeps."""
LINES: Final = 10
_BEFORE: Final = 3
"""Lines before the first fault or stop."""
_AFTER: Final = 3
"""Lines from the last fault or stop on, at least."""
_TOGETHER_NS: Final = 5 * SECOND
"""Faults and stops that follow each other so soon belong together."""


class Happening(NamedTuple):
    """One thing that happened to a drive object."""

    time_ns: int
    """Monotonic."""
    do_id: int
    label: str
    text: str
    stops: bool
    """A fault, or the end of operation."""


class Line(NamedTuple):
    """One line: the same thing at the same time of several drive objects is one."""

    time_ns: int
    labels: tuple[str, ...]
    text: str


def around_the_last_stop(happenings: Iterable[Happening]) -> list[Line]:
    """The lines around the last fault or stop, the oldest first; empty when there was none."""
    lines: list[Line] = []
    stops: list[int] = []
    for item in sorted(happenings, key=lambda item: item.time_ns):
        last = lines[-1] if lines else None
        if last is not None and last.text == item.text and item.time_ns - last.time_ns < SECOND:
            lines[-1] = last._replace(labels=tuple(dict.fromkeys((*last.labels, item.label))))
            continue
        if item.stops:
            stops.append(len(lines))
        lines.append(Line(item.time_ns, (item.label,), item.text))
    if not stops:
        return []
    # Shorten a long series at its start: the last fault or stop stays among the lines.
    begin = max(0, _first(lines, stops) - _BEFORE, stops[-1] + _AFTER - LINES)
    return lines[begin : begin + LINES]


def _first(lines: Sequence[Line], stops: Sequence[int]) -> int:
    """The place of the fault or stop with which the last series of them began."""
    first = stops[-1]
    for place in reversed(stops):
        if lines[first].time_ns - lines[place].time_ns > _TOGETHER_NS:
            break
        first = place
    return first
