"""Dynamic servo control (DSC) of telegrams 5, 6, 105 and 106: position error and gain of the PLC to a position or speed
setpoint.

Source: the rule of public technology manuals: speed = NSOLL_B + KPC x (XERR - (newest position - position the controller
used)). Exact integer arithmetic. KPC = 0 is DSC off, NSOLL_B alone is the speed. Only for a purely proportional position loop
in the PLC. Not here: the SYNC and the modes 8 and 9 it needs (executors), torque. Choices without a public source: KPC in
0.001/s, +XERR moves forward.
"""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Final

from pdgw.base.durations import SECOND, SECONDS_PER_MINUTE
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.modulo import difference
from pdgw.gateway.motion.units import round_half_away
from pdgw.profidrive.datatypes import N4_100_PERCENT, DataType

KPC_PER_UNIT: Final = 1000
"""KPC counts 0.001/s."""
SYNC_PERIODS_TO_EFFECT = Fraction(5, 2)
"""SYNC periods from a TPDO to the effect of its RPDO: until the PLC's frame, until the next SYNC, half a period in the
drive.
"""
_E = Fraction(2_718_281_828, 1_000_000_000)
_PI = Fraction(3_141_592_654, 1_000_000_000)
_LOWEST, _HIGHEST = DataType.INTEGER32.integer_range
_TURN = 1 << 32
DELAY_CYCLES_MAX: Final = 8
FOLLOWING_WINDOW_MAX = _HIGHEST


def dead_time_ns(sync_period_ns: int) -> int:
    """Time from measuring a position to the effect of the speed calculated from it."""
    return round_half_away(sync_period_ns * SYNC_PERIODS_TO_EFFECT.numerator, SYNC_PERIODS_TO_EFFECT.denominator)


def highest_gain(dead_time: int) -> int:
    """The largest KPC (0.001/s) without overshoot over a dead time T (ns), 1 / (e x T); from pi / (2T) on it oscillates."""
    return int(Fraction(KPC_PER_UNIT * SECOND, dead_time) / _E)


def longest_hold_ns(dead_time: int) -> int:
    """Longest time (ns) for which a setpoint may be used without a new one.

    Its age is dead time too: from T + age = pi / (2 x KPC) on the loop oscillates, with the highest gain from 4.27 T on.
    """
    return int(dead_time * (_PI * _E / 2 - 1))


def wrapped(position: int) -> int:
    """A computed position as it counts round in 32 bits."""
    return (position - _LOWEST) % _TURN + _LOWEST


class DscForm(enum.Enum):
    """``dsc``: where the loop is closed."""

    POSITION = "position"
    """In the drive (mode 8), by its own gain; any KPC but 0 only switches DSC on."""
    SPEED = "speed"
    """The gateway calculates the speed and sends it over CAN (mode 9)."""


@dataclass(frozen=True, slots=True)
class DscChoices:
    """The user's choices (docs/motion.md). GatewayError for one that is out of range."""

    form: DscForm
    following_window: int
    """Increments within which the setpoint must be of the actual position when DSC starts."""
    delay_cycles: int = 1
    """Age of the position the PLC used, in cycles."""

    def __post_init__(self) -> None:
        _check("following_window", self.following_window, 1, FOLLOWING_WINDOW_MAX)
        _check("dsc_delay_cycles", self.delay_cycles, 0, DELAY_CYCLES_MAX)


def _check(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise GatewayError(f"{name}: {value} is not allowed, expected {low}..{high}")


@dataclass(frozen=True, slots=True)
class DscSettings:
    """One axis' values. GatewayError for one that is out of range."""

    choices: DscChoices
    increments_per_revolution: int
    """Increments of G1_XIST1, which has no fine resolution; position units of the drive."""
    reference_speed: Fraction
    """rpm of 100 % NSOLL_B."""
    velocities_per_rpm: Fraction
    """Units of 60FFh and 60B1h in one rpm."""
    sync_period_ns: int
    position_span: int = _TURN
    """Number of positions after which the drive's position starts again."""
    velocity_range: tuple[int, int] = (_LOWEST, _HIGHEST)
    """Range of the object of the speed, or of the feed-forward."""

    def __post_init__(self) -> None:
        _check("increments per revolution", self.increments_per_revolution, 1, _HIGHEST)
        _check("SYNC period", self.sync_period_ns, 1, SECOND)
        if self.reference_speed <= 0 or self.velocities_per_rpm <= 0:
            raise GatewayError("reference speed and velocity units: 0 is not allowed, expected values above 0")


@dataclass(slots=True)
class DscSetpoint:
    """One cycle's setpoint, reused, and all that a next one is made from. ``position`` is None where the speed counts alone."""

    velocity: int = 0
    """Units of 60FFh; with a position, the feed-forward for 60B1h."""
    position: int | None = None
    active: bool = False
    """DSC is on: KPC is not 0, the setpoint began near the axis, operation is enabled."""
    gain_clamped: bool = False
    reason: Reason | None = Reason.DSC_OUT_OF_DATE
    """Why the setpoint is not that of the PLC; before the first frame after a restart of DSC there is none."""
    target: int | None = None
    """The position of the cycle before,"""
    way: int = 0
    """and how far it was from the one before that."""
    sent: deque[int] = field(default_factory=deque)
    """Positions sent to the PLC, oldest first; the oldest is the one it used."""

    def clear(self) -> None:
        """Switch DSC off; it starts again from the beginning."""
        self.velocity = self.way = 0
        self.position = self.target = None
        self.reason = Reason.DSC_OUT_OF_DATE
        self.active = self.gain_clamped = False
        self.sent.clear()


class Dsc:
    """DSC of one axis; ``step`` once per SYNC period."""

    def __init__(self, settings: DscSettings) -> None:
        self.settings = settings
        self.choices = settings.choices
        self.setpoint = DscSetpoint()
        self.dead_time_ns = dead_time_ns(settings.sync_period_ns)
        self.gain_limit = highest_gain(self.dead_time_ns)
        self.hold_ns = longest_hold_ns(self.dead_time_ns)
        """So old may XERR and KPC be; who steps this stops the axis then."""
        speed = settings.reference_speed * settings.velocities_per_rpm / N4_100_PERCENT
        self._speed = speed.as_integer_ratio()
        turn = KPC_PER_UNIT * settings.increments_per_revolution
        loop = Fraction(SECONDS_PER_MINUTE, turn) * settings.velocities_per_rpm
        self._loop = loop.as_integer_ratio()

    def stop(self) -> None:
        """Operation ended: DSC starts again, near the axis."""
        self.setpoint.clear()

    def step(self, nsoll_b: int, xerr: int, kpc: int, position: int, *, fresh: bool = True) -> DscSetpoint:
        """The setpoint of one cycle, while operation is enabled.

        ``nsoll_b``, ``xerr``, ``kpc``: raw values of the telegram. ``position``: the newest actual position, sent to the PLC in
        this cycle. ``fresh``: a frame of the PLC arrived in this cycle; otherwise a speed stays and a position is extrapolated.
        """
        result = self.setpoint
        result.sent.append(position)
        if len(result.sent) > self.choices.delay_cycles + 1:
            result.sent.popleft()
        if not fresh:
            if result.position is not None and result.target is not None:
                result.target = result.position = wrapped(result.target + result.way)
                result.way = 0
            return result
        numerator, denominator = self._speed
        feed_forward = self._limited(round_half_away(nsoll_b * numerator, denominator))
        result.gain_clamped = False
        result.reason = None
        if kpc <= 0:
            result.target = None
            result.velocity, result.position, result.active = feed_forward, None, False
        elif self.choices.form is DscForm.POSITION:
            self._position(feed_forward, xerr, position)
        else:
            self._velocity(feed_forward, xerr, kpc, position)
        return result

    def _limited(self, velocity: int) -> int:
        low, high = self.settings.velocity_range
        return max(low, min(velocity, high))

    def _starts_near(self, error: int) -> bool:
        """Whether the setpoint is within the following window of the axis; checked until DSC is active."""
        result = self.setpoint
        if not result.active and abs(error) > self.choices.following_window:
            result.reason = Reason.DSC_FAR_FROM_AXIS
            result.velocity, result.position = 0, None
            return False
        result.active = True
        return True

    def _position(self, feed_forward: int, xerr: int, position: int) -> None:
        result = self.setpoint
        target = wrapped(result.sent[0] + xerr)
        if not self._starts_near(difference(target, position)):
            result.target = None
            return
        result.way = difference(target, result.target) if result.target is not None else 0
        result.target = result.position = target
        result.velocity = feed_forward

    def _velocity(self, feed_forward: int, xerr: int, kpc: int, position: int) -> None:
        result = self.setpoint
        error = xerr - difference(position, result.sent[0], self.settings.position_span)
        if not self._starts_near(error):
            return
        if kpc > self.gain_limit:
            kpc = self.gain_limit
            result.gain_clamped = True
        numerator, denominator = self._loop
        speed = feed_forward + round_half_away(kpc * error * numerator, denominator)
        result.velocity = self._limited(speed)
        result.position = None
