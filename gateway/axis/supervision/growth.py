"""A speed that grows against its command: a runaway drive has a broken loop, whatever limits its torque."""

from __future__ import annotations

from typing import Final

_STEP: Final = 1.01
"""Smallest growth from one step to the next."""
STEPS: Final = 5
"""Number of consecutive steps with growth."""


class Growth:
    """One speed. Call ``step`` while it must not grow, ``restart`` before. ``step_ns``: time of a step."""

    def __init__(self, step_ns: int) -> None:
        self._step_ns = step_ns
        self.restart(0, 0)

    def restart(self, speed: int, now: int) -> None:
        """The next step begins with this speed."""
        self._count, self._speed, self._at = 0, speed, now
        self._above = self._above_before = 0.0
        """The highest of each step: what the drive shows may be its answer to an earlier setpoint."""

    def step(self, speed: int, above: float, now: int) -> bool:
        """Whether it has grown by 1 % in each of the last steps, at the end of each ``above`` this speed."""
        self._above = max(self._above, above)
        if now - self._at >= self._step_ns:
            grows = speed > _STEP * self._speed and speed > self._above and speed > self._above_before
            self._count = self._count + 1 if grows else 0
            self._speed, self._at = speed, now
            self._above, self._above_before = above, self._above
        return self._count >= STEPS
