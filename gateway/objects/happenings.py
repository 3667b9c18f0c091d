"""Events around the last fault or stop, in at most ten lines; each drive object stores its own.

They are kept beside the flight recorder, which may be switched off and forgets after some minutes; its steps have the reasons as
numbers, and not the texts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from pdgw.base.durations import SECOND
from pdgw.gateway.base.finding_text import with_count

KEPT: Final = 100
"""Happenings that a drive object keeps."""
LINES: Final = 10
_BEFORE: Final = 3
"""Lines before the first fault or stop."""
_AFTER: Final = 3
"""Lines from the last fault or stop on, at least."""
_REPEATS_NS: Final = 30 * SECOND
"""What is repeated so soon is counted."""
_TOGETHER_NS: Final = 5 * SECOND
"""Faults and stops that follow each other so soon belong together."""


class Happening(NamedTuple):
    """One thing that happened to a drive object."""

    time_ns: int
    """Monotonic."""
    do_id: int
    text: str
    stops: bool
    """A fault, or the end of operation."""


@dataclass(eq=False, slots=True)
class Line:
    """One line: the same thing at the same time of several drive objects is one, and so are its repetitions."""

    text: str
    objects: set[int]
    """DO-IDs."""
    begin_ns: int
    time_ns: int
    """The last time."""
    order: int
    """Place of the last time among all happenings."""
    stops: bool = False
    count: int = 1
    last: set[int] = field(default_factory=set)
    """DO-IDs of the last time."""

    @property
    def shown(self) -> str:
        """The text, and how often."""
        return with_count(self.text, self.count, self.time_ns - self.begin_ns)


def around_the_last_stop(happenings: Iterable[Happening], at_most: int = LINES) -> list[Line]:
    """The lines around the last fault or stop, the oldest first; empty when there was none."""
    lines = _folded(happenings)
    stops = [place for place, line in enumerate(lines) if line.stops]
    if not stops:
        return []
    # Shorten a long series in its middle: its first fault or stop and the last one stay among the lines.
    first, end = _first(lines, stops), min(len(lines), stops[-1] + _AFTER)
    begin = max(0, first - _BEFORE)
    if end - begin <= at_most:
        return lines[begin : begin + at_most]
    return [lines[first], *lines[max(first + 1, end - at_most + 1) : end]][:at_most]


def _folded(happenings: Iterable[Happening]) -> list[Line]:
    """All lines in the order of their last times."""
    lines: list[Line] = []
    newest: dict[str, Line] = {}
    """By text."""
    own: dict[tuple[int, str], Line] = {}
    """By DO-ID and text."""
    for order, item in enumerate(sorted(happenings, key=lambda item: item.time_ns)):
        key = item.do_id, item.text
        line = newest.get(item.text)
        if line is None or item.do_id in line.last or item.time_ns - line.time_ns >= SECOND:
            line = own.get(key)
            if line is None or item.time_ns - line.time_ns >= _REPEATS_NS:
                line = Line(item.text, set(), item.time_ns, item.time_ns, order)
                lines.append(line)
            else:
                line.time_ns, line.order = item.time_ns, order
                line.count += 1
                line.last.clear()
        line.last.add(item.do_id)
        line.objects.add(item.do_id)
        line.stops |= item.stops
        newest[item.text] = own[key] = line
    return sorted(lines, key=lambda line: line.order)


def _first(lines: Sequence[Line], stops: Sequence[int]) -> int:
    """The place of the fault or stop with which the last series of them began."""
    first = stops[-1]
    for place in reversed(stops):
        if lines[first].time_ns - lines[place].time_ns > _TOGETHER_NS:
            break
        first = place
    return first
