"""Whether an axis turns as fast as it shows and as commanded: position against clock, speed against setpoint.

60FFh and 606Ch share their unit and agree even if it is wrong; the position 6064h over time does not. The check is pure: the
values of a cycle in, a contradiction out. Source: docs/devices.md "The check in operation".
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS, SECOND, SECONDS_PER_MINUTE
from pdgw.dsp402.drive_type import Quantity, Scaling
from pdgw.gateway.axis.supervision.growth import Growth
from pdgw.gateway.axis.supervision.position_speed import SAMPLE_NS, Difference, PositionSpeed
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.base.fault_numbers import FaultNumber

_COMPARE_NS: Final = 20 * MS
"""Speeds are compared so often: the cycle has no time for more. The way they make is added up in every cycle."""
_OLDER_NS: Final = 3 * SAMPLE_NS
"""A speed that is older than the position by more than this is not that of the same motion."""
_FAULT: Final = 5.0
"""Largest factor between position and speed, in either direction."""
_OVERSPEED: Final = 1.5
"""Largest allowed speed, times the setpoint."""
_OVERSPEED_NS: Final = 500 * MS
"""A speed above it for this time is not an overshoot."""
_GROWING: Final = 1.2
"""Speed, times the setpoint, from which growth is checked."""
_TOLERANCE: Final = 0.05
"""A speed that differs from its setpoint by this share follows it."""
_RAMP_MARGIN: Final = 2
"""Factor on the stop time for a slower setpoint."""
_LAG_NS: Final = SECOND
"""A drive that follows its setpoint comes closer to it within this time."""


class VelocityCheck:
    """One axis. Call ``is_due`` in each cycle, and ``step`` when it says so."""

    def __init__(self, stop_time_ns: int, evidence: TorqueEvidence) -> None:
        self._stop_time = stop_time_ns
        self._evidence = evidence
        self._compared = PositionSpeed()
        self._growth = Growth(SAMPLE_NS)
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
        self._up = self._down = -1.0
        """Highest speeds in both directions; -1 without a setpoint."""
        self._over_since = -1
        self._spared = 0
        """Time above them that does not count."""
        self.apart = False
        """The speed is not that of the setpoint."""
        self._apart = self._apart_at = 0
        """The smallest difference to it since it last changed, and when it became so small."""
        self._warned = False

    def lags_since(self, now: int) -> int:
        """Since when the speed has not approached a setpoint that it does not have; 0 while it follows."""
        return self._apart_at if self.apart and now - self._apart_at > _LAG_NS else 0

    def is_late(self, now: int) -> bool:
        """It has not approached it for longer than any ramp takes."""
        return self.apart and now - self._apart_at > _RAMP_MARGIN * self._stop_time

    def is_due(self, operating: bool, velocity: int, now: int) -> bool:
        """Call in each cycle. True if ``step`` has to be called in it. ``operating``: the drive follows the PLC."""
        if not operating:
            if self._at >= 0:
                self._restart()
            return False
        compared = self._compared
        if self._at < 0:
            self._compared_at = now
        elif compared.position_ns:
            compared.way += velocity * (now - self._at)
        self._at = now
        return not 0 < now - self._compared_at < _COMPARE_NS

    def step(
        self, speeds: tuple[int, int] | None, velocity: int, position: int, position_ns: int, now: int
    ) -> tuple[FaultNumber, str] | None:
        """What does not fit, when it is found. After ``FaultNumber.VELOCITY`` the units count as unknown.

        ``speeds``: the lowest and the highest that the drive is sent, None where it follows something else. ``position``,
        ``position_ns``: the newest 6064h and when it came, 0 never. ``now``: the cycle, or when the speed was requested by
        SDO: it may be older than the position. Times are monotonic nanoseconds.
        """
        compared, elapsed = self._compared, now - self._compared_at
        if elapsed < 0:
            return None  # a speed from before the operation is that of another motion
        self._compared_at = now
        if compared.position_ns:
            compared.note(velocity)
        if speeds is None:
            self._up = self._down = -1.0
        else:
            low, high = speeds
            if low == high:
                self._follow(high, abs(high - velocity), now)
            text = self._overspeed(low, high, velocity, elapsed, now)
            if text:
                return FaultNumber.VELOCITY, text
        if compared.counts_per_unit and position_ns - compared.position_ns >= SAMPLE_NS:
            if position_ns - now > _OLDER_NS:
                compared.restart()
                return None
            difference = compared.compare(velocity, position, position_ns)
            return None if difference is None else self._contradiction(difference)
        return None

    def _follow(self, target: int, apart: int, now: int) -> None:
        """Note whether the speed approaches its setpoint."""
        if apart <= self._floor or apart <= abs(target) * _TOLERANCE:
            self.apart = False
        elif abs(target) != self._target or not self.apart or apart < self._apart - self._floor:
            self.apart, self._apart, self._apart_at = True, apart, now

    def _overspeed(self, low: int, high: int, velocity: int, elapsed: int, now: int) -> str:
        """606Ch beyond the setpoint for longer than an overshoot, or growing; a drive on its ramp down may take its time."""
        floor = self._floor
        if self._up < 0:
            elapsed = 0
            self._up, self._down = float(max(velocity, 0)), float(max(-velocity, 0))
            self._growth.restart(abs(velocity), now)
        falls = self._full * elapsed / (_RAMP_MARGIN * self._stop_time)
        up, down = self._up - falls, self._down - falls
        highest = _OVERSPEED * high + floor if high > 0 else floor
        lowest = floor - _OVERSPEED * low if low < 0 else floor
        up, down = highest if up < highest else up, lowest if down < lowest else down
        if -floor <= low and high <= floor:
            up = down = max(up, down)  # a load may swing back
        self._up, self._down = up, down
        if -down <= velocity <= up:
            self._over_since = -1
        elif self._over_since < 0:
            self._over_since, self._spared = now, 0
        else:
            self._spared += self._evidence.spares(low - floor, high + floor, elapsed)
            over = now - self._over_since
            if over >= _OVERSPEED_NS > over - self._spared:
                self._evidence.excuse()
            elif over >= _OVERSPEED_NS:
                return f"606Ch is {velocity} with a setpoint of {high if velocity > 0 else low}, above 150 %"
        self._target = wanted = high if high > -low else -low
        if self._growth.step(velocity if velocity > 0 else -velocity, _GROWING * wanted + floor, now):
            return f"606Ch is {velocity} and keeps growing with a setpoint of {high if velocity > 0 else low}"
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
