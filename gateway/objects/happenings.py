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
_REPEATS_NS: Final = 30 * SECOND
"""What is repeated so soon is counted."""
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
    """One line: the same thing at the same time of several drive objects is one, and so are its repetitions."""

    time_ns: int
    labels: tuple[str, ...]
    text: str


def around_the_last_stop(happenings: Iterable[Happening]) -> list[Line]:
    """The lines around the last fault or stop, the oldest first; empty when there was none."""
    lines: list[Line] = []
    stops: list[int] = []
    repeated: dict[int, list[int]] = {}
    """Times of the repetitions of each line, by its place."""
    places: dict[tuple[str, str], int] = {}
    for item in sorted(happenings, key=lambda item: item.time_ns):
        last = lines[-1] if lines else None
        place = places.get((item.label, item.text))
        if last is not None and last.text == item.text and item.time_ns - last.time_ns < SECOND:
            place = len(lines) - 1
            lines[-1] = last._replace(labels=tuple(dict.fromkeys((*last.labels, item.label))))
        elif place is not None and item.time_ns - repeated.get(place, [lines[place].time_ns])[-1] < _REPEATS_NS:
            repeated.setdefault(place, [lines[place].time_ns]).append(item.time_ns)
        else:
            place = len(lines)
            lines.append(Line(item.time_ns, (item.label,), item.text))
        places[item.label, item.text] = place
        if item.stops and (not stops or stops[-1] != place):
            stops.append(place)
    if not stops:
        return []
    for place, times in repeated.items():
        line = lines[place]
        text = f"{line.text} ({len(times)} times in {max(1, (times[-1] - times[0]) // SECOND)} s)"
        lines[place] = line._replace(text=text)
    # Shorten a long series in its middle: its first fault or stop and the last one stay among the lines.
    first, end = _first(lines, stops), min(len(lines), max(stops) + _AFTER)
    begin = max(0, first - _BEFORE)
    if end - begin <= LINES:
        return lines[begin : begin + LINES]
    return [lines[first], *lines[max(first + 1, end - LINES + 1) : end]][:LINES]


def _first(lines: Sequence[Line], stops: Sequence[int]) -> int:
    """The place of the fault or stop with which the last series of them began."""
    first = stops[-1]
    for place in reversed(stops):
        if lines[first].time_ns - lines[place].time_ns > _TOGETHER_NS:
            break
        first = place
    return first
