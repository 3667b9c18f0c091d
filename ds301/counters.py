"""Counters: each is registered with a name, a unit and a meaning, and every display lists them all.

Counts stay plain integers in the hot path; a registration defines how to read one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Counter:
    """A count of one part of the gateway. It never falls while that part lives."""

    part: str
    """The counting part: ``bus can0``, ``axis 1``, ``link``."""
    name: str
    unit: str
    meaning: str
    """One sentence for a reader who sees it rise."""
    read: Callable[[], int]


class Counters:
    """All counters of a process, in the order of their registration."""

    def __init__(self) -> None:
        self._counters: dict[tuple[str, str], Counter] = {}

    def add(self, part: str, name: str, unit: str, meaning: str, read: Callable[[], int]) -> None:
        """Register a count; one of the same part and name is replaced."""
        self._counters[part, name] = Counter(part, name, unit, meaning, read)

    def __iter__(self) -> Iterator[Counter]:
        return iter(tuple(self._counters.values()))

    def values(self) -> list[dict[str, object]]:
        """All counters as plain data."""
        return [
            {"part": item.part, "name": item.name, "value": item.read(), "unit": item.unit, "meaning": item.meaning}
            for item in self
        ]
