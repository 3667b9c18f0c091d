"""Speed ramps of the simulated drive, and the trapezoid to a target position, per millisecond.

Source: the manufacturer's guide 7.8 and 7.9 (ramp types of 6086h). Speeds in rpm, positions in increments, times in seconds.
"""

from __future__ import annotations

import math
from typing import Final

from pdgw.base.durations import SECONDS_PER_MINUTE

INCREMENTS_PER_REVOLUTION: Final = 4096
SECOND_ENCODER_STEPS: Final = 4
"""Increments of the second encoder on the same shaft, per increment of the first."""
TICK: Final = 0.001
"""Seconds of one simulation step."""
COAST_DECELERATION: Final = 1500.0
"""rpm/s of the free-running motor."""
TORQUE_ACCELERATION: Final = 6000.0
"""rpm/s of the unloaded motor at rated current."""


def increments_per_second(rpm: float) -> float:
    """Speed of the shaft in increments."""
    return rpm * INCREMENTS_PER_REVOLUTION / SECONDS_PER_MINUTE


def rpm_of(increments: float) -> float:
    """Speed of the shaft in rpm from increments per second."""
    return increments * SECONDS_PER_MINUTE / INCREMENTS_PER_REVOLUTION


class Ramp:
    """A speed setpoint with ramp: linear by acceleration, or sine-squared by ramp time."""

    def __init__(self) -> None:
        self.speed = 0.0
        self._from = self.target = 0.0
        self._elapsed = self._time = 0.0
        self._ticks = 0
        """Length of the present ramp, if it has a limited jerk."""
        self._slowing = False

    def set(self, speed: float) -> None:
        """Set a speed without a ramp (coasting, mechanical stop)."""
        self.speed = self._from = self.target = speed
        self._time = 0.0

    def linear(self, target: float, acceleration: float, deceleration: float, jerk_ms: int = 0) -> float:
        """One tick towards ``target``, in rpm/s. Uses ``deceleration`` to slow down, also to zero before a reversal.

        ``jerk_ms``: time until the ramp has its full rate.
        """
        slowing = self.speed != 0.0 and (abs(target) < abs(self.speed) or target * self.speed < 0)
        step = (deceleration if slowing else acceleration) * TICK
        if jerk_ms:
            same = slowing is self._slowing and self.speed != target
            self._slowing, self._ticks = slowing, self._ticks + 1 if same else 1
            step *= min(1.0, self._ticks / jerk_ms)
        if slowing and target * self.speed < 0 and abs(self.speed) < step:
            self.speed = 0.0
        elif abs(target - self.speed) <= step + 1e-9:
            self.speed = target
        else:
            self.speed += math.copysign(step, target - self.speed)
        self.target = self.speed
        return self.speed

    def sine_squared(self, target: float, rise_time: float, fall_time: float) -> float:
        """One tick towards ``target``. The times are those of a complete ramp in seconds, at any height."""
        if target != self.target or self._time == 0.0 and self.speed != target:
            self._from, self.target, self._elapsed = self.speed, target, 0.0
            self._time = fall_time if abs(target) < abs(self.speed) else rise_time
        if self.speed == target:
            return target
        self._elapsed += TICK
        if self._elapsed >= self._time:
            self.speed = target
        else:
            share = math.sin(math.pi / 2 * self._elapsed / self._time) ** 2
            self.speed = self._from + (self.target - self._from) * share
        return self.speed


def speed_toward(distance: float, speed_limit: float, deceleration: float) -> float:
    """Highest speed (rpm, signed) from which ``deceleration`` (rpm/s) stops within ``distance`` increments."""
    rate = increments_per_second(deceleration)
    # The speed is constant during this tick: solve v*T + v^2/(2a) = distance.
    reach = rate * TICK
    fastest = math.sqrt(reach * reach + 2 * rate * abs(distance)) - reach
    return math.copysign(min(speed_limit, rpm_of(fastest)), distance)
