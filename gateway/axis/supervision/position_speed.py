"""The way of a position against the way of the speed that its device shows: do both mean the same motion?

A speed may agree with its setpoint even if its unit is wrong; the position over time does not. The comparison is pure: the
values of a cycle in, a difference out. Source: docs/devices.md "The check in operation".
"""

from __future__ import annotations

from statistics import median
from typing import Final, NamedTuple

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive_type import POSITIONS

SAMPLE_NS: Final = 100 * MS
"""Positions are compared over steps of at least this time."""
_STEPS: Final = 4
"""Number of steps for the median: one jump of the position (homing, preset) does not count."""
TOLERANCE: Final = 1.25
"""Largest factor between two speeds, in either direction."""
_CONSTANT: Final = 1.1
_FEWEST_COUNTS: Final = 20
"""A step of fewer position units is too small to be compared. Neither is one in which the speed varies by more than its mean: an
axis that accelerates and brakes between two values shows speeds that say nothing about its way."""
MOST_OF_SPAN: Final = 0.25
"""A step of a larger part of the position's range is not compared: it may look like another one."""


class Difference(NamedTuple):
    """Two speeds in position units a second that should be the same."""

    moved: float
    """By the position; negative if it moves against the direction of the speed."""
    shown: float
    """By the speed, not negative."""
    constant: bool
    """The speed has hardly changed. On a ramp, a position that arrives later than the speed causes a difference."""

    @property
    def factor(self) -> float:
        """How often ``shown`` is in ``moved``."""
        return self.moved / self.shown


class Step(NamedTuple):
    """What happened between two positions."""

    seconds: float
    moved: int
    """Position units by the position, the shortest way."""
    shown: float
    """By the speed, in velocity units times seconds."""


class Travel:
    """A position over time, and the speed of its device. Add the speed to ``way`` in each cycle."""

    def __init__(self) -> None:
        self.counts_per_unit = 0.0
        """Position units a second of one velocity unit; 0 where one of them is not known."""
        self.span = POSITIONS
        """The position wraps after it."""
        self.restart()

    def restart(self) -> None:
        """Forget what was seen."""
        self.way = 0
        """Integral of the speed since the last position, in velocity units times nanoseconds."""
        self.position_ns = self._position = 0
        """The position a step began with; 0 ns before the first."""

    def measure(self, position: int, position_ns: int) -> Step | None:
        """End a step with this position, and begin the next one with it; None for the first position."""
        begun, moved, shown = self.position_ns, shortest(position - self._position, self.span), self.way / SECOND
        self._position, self.position_ns, self.way = position, position_ns, 0
        return Step((position_ns - begun) / SECOND, moved, shown) if begun else None


class PositionSpeed(Travel):
    """For drives: the speed is as new as the position. ``compare`` positions ``SAMPLE_NS`` apart."""

    def __init__(self) -> None:
        self._floor = 0
        self._compares_signs = True
        """Position and speed have the same sign in the same direction."""
        super().__init__()

    def set_scaling(self, counts_per_unit: float, floor: int, span: int, *, same_signs: bool) -> None:
        """Set the units. ``floor``: speeds within it count as standstill; ``span``: the position wraps after it."""
        self.counts_per_unit = counts_per_unit
        self.span = span
        self._floor = floor
        self._compares_signs = same_signs
        self.restart()

    def restart(self) -> None:
        """Forget what was seen."""
        super().restart()
        self._lowest = self._highest = 0
        """Between which values the speed was in this step."""
        self._steps: tuple[tuple[float, float], ...] = ()
        """For each step, position units a second by the position, negative against the speed, and by the speed."""

    def note(self, velocity: int) -> None:
        """Note a speed of this step."""
        self._lowest, self._highest = min(self._lowest, velocity), max(self._highest, velocity)

    def compare(self, velocity: int, position: int, position_ns: int) -> Difference | None:
        """The position has moved on: by how much, and by how much it should have. None while both agree, or nothing is known."""
        spread = self._highest - self._lowest
        self._lowest = self._highest = velocity
        step = self.measure(position, position_ns)
        if step is None:
            return None
        duration, moved, shown = step
        steady = spread * duration <= max(abs(shown), self._floor * duration)
        way = shown * self.counts_per_unit
        expected = abs(way)
        least = max(_FEWEST_COUNTS, self._floor * self.counts_per_unit * duration)
        if not steady or max(abs(moved), expected) < least or expected > self.span * MOST_OF_SPAN:
            self._steps = ()
            return None
        opposite = moved * way < 0 and min(abs(moved), expected) >= least
        seen = -abs(moved) if opposite else abs(moved)
        self._steps = (*self._steps[1 - _STEPS :], (seen / duration, max(expected, least) / duration))
        return self._difference() if len(self._steps) == _STEPS else None

    def _difference(self) -> Difference | None:
        moves, shown = (median(map(abs, values)) for values in zip(*self._steps, strict=True))
        # A position that arrives later than the speed moves in the old direction for a step after a reversal.
        backwards = self._compares_signs and all(step < 0 for step, _ in self._steps)
        shares = [expected for _, expected in self._steps]
        found = Difference(-moves if backwards else moves, shown, max(shares) <= _CONSTANT * min(shares))
        # A shaft that dithers may show each sample of its speed at one place of the swing.
        small = abs(found.moved - shown) <= self._floor * self.counts_per_unit
        return None if small or 1 / TOLERANCE <= found.factor <= TOLERANCE else found


def shortest(step: int, span: int) -> int:
    """Distance between two positions of a counter that wraps after ``span``."""
    return (step + span // 2) % span - span // 2
