"""Whether the speed that an encoder reports is that of its position: 6030h against 6004h or 6020h.

An encoder may measure its speed over a gate time of seconds, and send the position later than the speed. So each speed that the
position had in the last seconds may be right, also their mean; a speed below or above all of them is not. Source:
docs/devices.md "Speed of an encoder".
"""

from __future__ import annotations

from collections import deque
from typing import Final

from pdgw.gateway.axis.supervision.position_speed import MOST_OF_SPAN, SAMPLE_NS, TOLERANCE, Step, Travel

_STEPS: Final = 50
"""Steps of ``SAMPLE_NS`` whose speeds may be right, for a speed"""
_LATER: Final = 10
"""that came this number of steps before the last one: longer than gate times and delays of encoders."""
_PROOF: Final = 10
"""Consecutive steps with the same result."""
_FEWEST_POSITIONS: Final = 2
"""New positions in a step. With fewer, a motion between them is not seen."""
_FLOOR: Final = 0.01
"""Speeds within this share of 100 % count as standstill: an encoder may report 0."""
REMEDY: Final = (
    "check the unit of 6030h in the encoder (6031h, 6005h), or use a data sheet (eds) without 6030h: then the gateway uses the "
    "speed of the position"
)


class EncoderSpeedCheck:
    """One channel of an encoder. Call ``step`` in each cycle with a speed and a position, ``restart`` in one without."""

    def __init__(self) -> None:
        self.deviates = False
        """Speed and position contradict each other; until they have agreed in an even motion."""
        self._travel = Travel()
        self._floor = 0.0
        self._moved: deque[float] = deque(maxlen=_STEPS)
        """Position units a second in each step, by the position,"""
        self._shown: deque[float] = deque(maxlen=_LATER)
        """and by the speed."""
        self._at = 0
        """The last cycle, in monotonic nanoseconds; 0: none."""
        self._newest = self._positions = 0
        """When the newest position came, and the number of positions in this step."""
        self._result: int | None = None
        """Of the last step: the speed is above (1) or below (-1) all speeds of the position, or agrees (0); None: unknown."""
        self._in_row = 0
        """Number of steps with this result."""

    def set_scaling(self, counts_per_unit: float, full: float, span: int) -> None:
        """Set position units a second of one step of the speed and of 100 %; the position wraps after ``span``."""
        self._travel.counts_per_unit = counts_per_unit
        self._travel.span = span
        self._floor = _FLOOR * full
        self.deviates = False
        self.restart()

    def restart(self) -> None:
        """Forget the motion."""
        if self._at:
            self._at = 0
            self._travel.restart()
            self._moved.clear()
            self._shown.clear()
            self._positions = 0
            self._result, self._in_row = None, 0

    def step(self, speed: int, position: int, position_ns: int, now: int) -> str:
        """One cycle. The text when speed and position begin to contradict each other; else empty.

        ``position_ns``: when the position came. Times are monotonic nanoseconds.
        """
        travel = self._travel
        if travel.position_ns:
            travel.way += speed * (now - self._at)
        self._at = now
        if position_ns == self._newest:
            return ""
        self._newest = position_ns
        self._positions += 1
        if position_ns - travel.position_ns < SAMPLE_NS:
            return ""
        step = travel.measure(position, position_ns)
        return self._compare(step) if step is not None else ""

    def _compare(self, step: Step) -> str:
        shown, seconds = abs(step.shown) * self._travel.counts_per_unit, step.seconds
        if self._positions < _FEWEST_POSITIONS or shown > self._travel.span * MOST_OF_SPAN:
            self.restart()
            return ""
        self._positions = 0
        self._moved.append(step.moved / seconds)
        self._shown.append(shown / seconds)
        shown = self._shown[0]
        result = self._evaluate(shown) if len(self._moved) == _STEPS else None
        self._in_row = self._in_row + 1 if result == self._result else 1
        self._result = result
        if result is None or self._in_row < _PROOF or self.deviates == bool(result):
            return ""
        self.deviates = bool(result)
        moved = abs(sum(self._moved)) / _STEPS
        return f"the position moves at {moved:.0f} steps/s, 6030h reports {shown:.0f}" if result else ""

    def _evaluate(self, shown: float) -> int | None:
        """See ``_result``."""
        first, last = min(self._moved), max(self._moved)
        lowest = max(first, -last, 0.0)  # 0 if the direction has changed
        highest = max(-first, last)
        if shown > TOLERANCE * max(highest, self._floor):
            return 1
        if lowest > TOLERANCE * max(shown, self._floor):
            return -1
        even = highest <= TOLERANCE * lowest
        return 0 if even and lowest > TOLERANCE * self._floor else None
