"""Whether an axis turns as fast as it shows and as commanded: position against clock, speed against setpoint.

60FFh and 606Ch share their unit and agree even if it is wrong; the position 6064h over time does not. The check is pure: the
values of a cycle in, a contradiction out. Source: docs/devices.md "The check in operation".
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS, SECONDS_PER_MINUTE
from pdgw.dsp402.drive_type import Quantity, Scaling
from pdgw.gateway.axis.supervision.position_speed import SAMPLE_NS, Difference, PositionSpeed
from pdgw.gateway.base.reasons import FaultNumber

_COMPARE_NS: Final = 10 * MS
"""Speeds are compared so often: the cycle has no time for more. The way they make is added up in every cycle."""
_FAULT: Final = 5.0
"""Largest factor between position and speed, in either direction."""
_OVERSPEED: Final = 1.5
"""Largest allowed speed, times the setpoint."""
_OVERSPEED_NS: Final = 500 * MS
"""A speed above it for this time is not an overshoot."""
_GROWING: Final = 1.2
"""Speed, times the setpoint, from which growth is checked."""
_GROWTH: Final = 1.01
"""Smallest growth from one step to the next."""
_GROWTH_STEPS: Final = 5
"""Number of consecutive steps with growth."""
_TOLERANCE: Final = 0.05
"""A speed that differs from its setpoint by this share follows it."""
_RAMP_MARGIN: Final = 2
"""Factor on the stop time for a slower setpoint."""


class VelocityCheck:
    """One axis. Call ``step`` in each cycle."""

    def __init__(self, stop_time_ns: int) -> None:
        self._stop_time = stop_time_ns
        self._compared = PositionSpeed()
        self._counts = 0.0
        self._full = self._floor = 0
        self._restart()

    @property
    def counts_per_unit(self) -> float:
        """Position units a second of one velocity unit; 0 where one of them is not known."""
        return self._compared.counts_per_unit

    def set_drive(self, scaling: Scaling, window: int) -> None:
        """Set the drive's units. ``window``: speeds within it count as standstill."""
        counts, per_rpm = scaling.counts_per_revolution, scaling.velocity_per_rpm
        if counts is None or per_rpm is None:
            self._counts = per_unit = 0.0
        else:
            self._counts = float(counts)
            per_unit = float(counts / per_rpm / SECONDS_PER_MINUTE)
        self._compared.set_scaling(per_unit, window, scaling.position_span, same_signs=scaling.same_signs)
        self._full = int(scaling.reference(Quantity.SPEED))
        self._floor = window
        self._restart()

    def _restart(self) -> None:
        self._at = self._compared_at = -1
        self._compared.restart()
        self._target = 0
        self._ceiling = 0.0
        self._over_since = -1
        self._apart = self._apart_at = 0
        """The smallest difference to the setpoint since it last changed, and when it became so small; 0: none."""
        self._grown = self._grown_at = self._grown_speed = 0
        self._warned = False

    def lags_since(self, now: int) -> int:
        """Since when the speed has not approached a setpoint that it does not have; 0 while it follows."""
        return self._apart_at if self._apart and now - self._apart_at > _RAMP_MARGIN * self._stop_time else 0

    def step(
        self, operating: bool, target: int | None, velocity: int, position: int, position_ns: int, now: int
    ) -> tuple[FaultNumber, str] | None:
        """One cycle; what does not fit, when it is found. After ``FaultNumber.VELOCITY`` the units count as unknown.

        ``operating``: the drive follows the PLC. ``target``: the speed it is sent, None where it follows something else.
        ``position``, ``position_ns``: the newest 6064h and when it came, 0 never. Times are monotonic nanoseconds.
        """
        compared = self._compared
        if not operating:
            if self._at >= 0:
                self._restart()
            return None
        if self._at < 0:
            self._ceiling = float(0 if target is None else abs(velocity))
            self._compared_at = now
        elif compared.position_ns:
            compared.way += velocity * (now - self._at)
        self._at = now
        elapsed = now - self._compared_at
        if 0 < elapsed < _COMPARE_NS:
            return None
        self._compared_at = now
        if compared.position_ns:
            compared.note(velocity)
        speed = abs(velocity)
        if target is not None:
            self._follow(target, abs(target - velocity), now)
        text = "" if target is None else self._overspeed(abs(target), speed, elapsed, now)
        if text:
            return FaultNumber.VELOCITY, text
        if compared.counts_per_unit and position_ns - compared.position_ns >= SAMPLE_NS:
            difference = compared.compare(velocity, position, position_ns)
            return None if difference is None else self._contradiction(difference)
        return None

    def _follow(self, target: int, apart: int, now: int) -> None:
        """Note whether the speed approaches its setpoint."""
        if apart <= max(self._floor, abs(target) * _TOLERANCE):
            self._apart = 0
        elif abs(target) != self._target or not self._apart or apart < self._apart - self._floor:
            self._apart, self._apart_at = apart, now

    def _overspeed(self, target: int, speed: int, elapsed: int, now: int) -> str:
        """606Ch above the setpoint for longer than an overshoot, or growing; a drive on its ramp down may take its time."""
        falls = self._full * elapsed / (_RAMP_MARGIN * self._stop_time)
        self._ceiling = max(_OVERSPEED * target + self._floor, self._ceiling - falls)
        if not target or speed <= self._ceiling:
            self._over_since = -1
        elif self._over_since < 0:
            self._over_since = now
        elif now - self._over_since >= _OVERSPEED_NS:
            return f"606Ch is {speed} with a setpoint of {target}, above 150 %"
        if target != self._target:
            self._target = target
            self._grown, self._grown_at, self._grown_speed = 0, now, speed
        elif now - self._grown_at >= SAMPLE_NS:
            grows = target and speed > _GROWING * target + self._floor and speed > _GROWTH * self._grown_speed
            self._grown = self._grown + 1 if grows else 0
            self._grown_at, self._grown_speed = now, speed
            if self._grown >= _GROWTH_STEPS:
                return f"606Ch is {speed} and keeps growing with a constant setpoint of {target}"
        return ""

    def _contradiction(self, difference: Difference) -> tuple[FaultNumber, str] | None:
        rpm, factor = SECONDS_PER_MINUTE / self._counts, difference.factor
        moved, shown = difference.moved * rpm, difference.shown * rpm
        text = f"6064h moves at {moved:.4g} rpm, 606Ch reports {shown:.4g} rpm: factor {factor:.3g}"
        if not 1 / _FAULT <= factor <= _FAULT:
            return (
                FaultNumber.VELOCITY,
                f"{text}, opposite directions: check the polarity 607Eh" if factor < 0 else text,
            )
        if self._warned or not difference.constant:
            return None
        self._warned = True
        return FaultNumber.VELOCITY_DEVIATES, text
