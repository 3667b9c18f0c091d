"""Modulo correction: positions of a rotary axis that wrap after a range, and the way to a position.

Source: modulo axes of public basic positioners (docs/motion.md). A ``Ring`` counts a drive's position beyond its wrap, at 607Bh
or at 32 bit. Pure; integers in any unit.
"""

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


@dataclass(slots=True, eq=False)
class Ring:
    """The position of one axis."""

    _low: int
    """The first position that the drive shows,"""
    _size: int
    """and how many there are."""
    _raw: int = 0
    """The last position that the drive showed."""
    _base: int = 0
    """The count at the drive's position 0."""
    _known: bool = False
    """The drive has shown a position in its present coordinates."""

    def reset(self) -> None:
        """The drive's coordinates are new: the next position counts from 0."""
        self._known = False

    def follow(self, raw: int) -> int:
        """The count of a position the drive shows, less than half a ring after the last."""
        if not self._known:
            self._base = 0
            self._known = True
        elif raw != self._raw:
            self._base += self._turn(raw)
        self._raw = raw
        return self._base + raw

    def near(self, raw: int) -> int:
        """The count of a position the drive latched, less than half a ring from where it is."""
        return self._base + self._turn(raw) + raw

    def _turn(self, raw: int) -> int:
        """Turns of the count besides the difference of the positions."""
        moved = raw - self._raw
        half = self._size // 2
        return (moved + half) % self._size - half - moved

    def target(self, count: int) -> int | None:
        """Position as shown by the drive."""
        raw = count - self._base
        return raw if self._low <= raw < self._low + self._size else None

    @property
    def position(self) -> int:
        """Where the drive is, as it shows it."""
        return self._raw
