"""Modulo correction: positions of a rotary axis that wrap after a range, and the way to a position."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Direction(IntEnum):
    """Direction of a modulo axis to an absolute target."""

    SHORTEST = 0
    POSITIVE = 1
    NEGATIVE = 2


def way(start: int, target: int, modulo: int, direction: Direction, window: int) -> int:
    """The way from a position (across any number of turns) to one in 0..``modulo`` - 1, signed.

    A target within ``window`` is reached by the shortest way in any direction, so an axis slightly beside its target does not
    turn round. Half a turn is forward.
    """
    forward = (target - start) % modulo
    shortest = forward if 2 * forward <= modulo else forward - modulo
    if direction is Direction.SHORTEST or abs(shortest) <= window:
        return shortest
    return forward if direction is Direction.POSITIVE else forward - modulo


def difference(newer: int, older: int, span: int = 1 << 32) -> int:
    """``newer`` - ``older`` of positions that start again after ``span``, the shorter way."""
    half = span // 2
    return (newer - older + half) % span - half


@dataclass(slots=True, eq=False)
class Ring:
    """The position of one axis."""

    low: int
    """The first position that the drive shows,"""
    size: int
    """and how many there are."""
    base: int = 0
    """The count at the drive's position 0."""
    wrapped: bool = False
    """The drive has wrapped there."""
    _raw: int = 0
    """The last position that the drive showed."""
    _known: bool = False
    """The drive has shown a position in its present coordinates."""

    def reset(self) -> None:
        """The drive's coordinates are new: the next position counts from 0."""
        self._known = False

    def follow(self, raw: int) -> int:
        """The count of a position the drive shows, less than half a ring after the last."""
        if not self._known:
            self.base = 0
            self._known = True
        elif raw != self._raw and (turn := self._turn(raw)):
            self.base += turn
            self.wrapped = True
        self._raw = raw
        return self.base + raw

    def near(self, raw: int) -> int:
        """The count of a position the drive latched, less than half a ring from where it is."""
        return self.base + self._turn(raw) + raw

    def _turn(self, raw: int) -> int:
        """Turns of the count besides the difference of the positions."""
        return difference(raw, self._raw, self.size) - (raw - self._raw)

    @property
    def turn(self) -> tuple[int, int]:
        """First and last count that the drive shows without a wrap from where it is."""
        first = self.base + self.low
        return first, first + self.size - 1

    def shown(self, count: int) -> int:
        """A count as the drive shows it."""
        return (count - self.low) % self.size + self.low

    @property
    def position(self) -> int:
        """Where the drive is, as it shows it."""
        return self._raw
