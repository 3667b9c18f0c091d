"""The modes of operation of the simulated drive: one object for each mode, selected by 6061h. Homing is in ``homing``.

Source: the manufacturer's guide chapters 6 and 7, CiA DSP 402 V2.0 (profile position, profile velocity, homing), CiA 402-2
(cyclic synchronous modes). The model has the state of the power section and the quick stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from pdgw.dsp402.drive_type import VL_RAMP
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import (
    HALT_OPTION,
    INTERPOLATION_TIME,
    MAX_ACCELERATION,
    MAX_CURRENT,
    POSITION_OFFSET,
    POSITION_RANGE_LIMIT,
    POSITIONING_OPTION,
    VELOCITY_THRESHOLD,
    VELOCITY_WINDOW,
    VL_ACCELERATION,
    VL_DECELERATION,
    VL_MIN_MAX,
)
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.peers.drive.model.homing import Homing
from pdgw.peers.drive.model.image import DriveImage
from pdgw.peers.drive.model.mode_of_operation import ModeOfOperation, follows
from pdgw.peers.drive.model.ramps import (
    COAST_DECELERATION,
    INCREMENTS_PER_REVOLUTION,
    TICK,
    TORQUE_ACCELERATION,
    increments_per_second,
    rpm_of,
    speed_toward,
)
from pdgw.peers.drive.objects import CURRENT_CONTROL, SPEED_CONTROL, TURNTABLE
from pdgw.peers.drive.option_codes import Braking

_RELATIVE_OPTION: Final = 0x0003
"""Bits of 60F2h: 0 is relative to the previous target; else to the demanded or actual position, which are equal here."""
_DIRECTION_SHIFT: Final = 6
NEGATIVE_WAY, POSITIVE_WAY, SHORTEST_WAY = 1, 2, 3
"""Direction of a rotary axis, in 60F2h from this bit on; 0: as on a linear axis."""


def way_to(forward: float, turn: float, direction: int) -> float:
    """The way to an angle that is ``forward`` away, of ``turn``, in a direction."""
    backward = direction == NEGATIVE_WAY or (direction == SHORTEST_WAY and forward > turn / 2)
    return forward - turn if backward and forward else forward


@dataclass(slots=True)
class Setpoint:
    """An accepted target of profile position: increments, rpm, rpm/s."""

    target: float
    speed: float
    acceleration: float
    deceleration: float


class CyclicPosition(ModeOfOperation):
    """Move to the newest target, with the offset of 60B0h, in a straight line over 60C2h.

    A target beyond the end of the positions is one after it.

    Without a new target the motion ends there. If SYNC has a period (1006h), it first continues for one more 60C2h.
    """

    synchronous = True
    halts = False

    def __init__(self, drive: DriveImage) -> None:
        super().__init__(drive)
        self._goal = 0.0
        self._way = 0.0
        """Distance from the previous target."""
        self._left = 0
        """Ticks to the target."""
        self._extrapolated = True

    def enabled(self) -> None:
        self._goal, self._way, self._left = self.drive.position, 0.0, 0
        self._extrapolated = True

    @property
    def _period(self) -> int:
        read = self.drive.read
        return max(1, round(read(INTERPOLATION_TIME, 1) * 10.0 ** read(INTERPOLATION_TIME, 2) / TICK))

    def received(self) -> None:
        goal = self.drive.target_position + self.drive.read(POSITION_OFFSET, 0)
        half = self.drive.position_span / 2
        self._way = (goal - self._goal + half) % (2 * half) - half
        self._goal, self._left = self._goal + self._way, self._period
        self._extrapolated = not self.drive.sync_ticks

    def move(self) -> None:
        drive = self.drive
        if not self._left and not self._extrapolated:
            self._extrapolated = True
            self._goal += self._way
            self._left = self._period
        ticks = max(1, self._left)
        self._left = ticks - 1
        drive.follow_at_once(rpm_of((self._goal - drive.position) / (ticks * TICK)))

    def bits(self, halted: bool, units: int) -> int:
        return follows(self.drive, halted)

    def condition(self) -> tuple[object, ...]:
        return self._goal, self._left, self._extrapolated


class ProfilePosition(ModeOfOperation):
    """Setpoints by handshake, each with speed and ramps. One may wait for the end of another."""

    def __init__(self, drive: DriveImage) -> None:
        super().__init__(drive)
        self.setpoint: Setpoint | None = None
        self._queued: Setpoint | None = None
        self._previous = 0.0
        """The target before."""
        self._acknowledged = False
        self._reached = True

    def enabled(self) -> None:
        self.disabled()
        self._reached = True

    def disabled(self) -> None:
        self.setpoint = self._queued = None
        self._acknowledged = False

    def condition(self) -> tuple[object, ...]:
        return self.setpoint, self._queued, self._acknowledged, self._reached

    def bits(self, halted: bool, units: int) -> int:
        bits = StatusBit.MODE_12 if self._acknowledged else 0
        return bits | StatusBit.TARGET_REACHED if (units == 0 if halted else self._reached) else bits

    def command(self, word: int, previous: int) -> None:
        if self._rises(word, previous) and self._allowed(word, previous) and not self._acknowledged:
            self._take(word)
        elif not word & ControlBit.NEW_SETPOINT and self._queued is None:
            self._acknowledged = False

    def _take(self, word: int) -> None:
        drive = self.drive
        setpoint = Setpoint(
            self._target(word),
            min(drive.profile_velocity * drive.unit, drive.speed_limit),
            drive.acceleration(drive.profile_acceleration, MAX_ACCELERATION),
            drive.slow_down_rate,
        )
        self._acknowledged = True
        self._previous = setpoint.target
        if self.setpoint is not None and not word & ControlBit.CHANGE_IMMEDIATELY:
            self._queued = setpoint
            return
        self._activate(setpoint)

    def _activate(self, setpoint: Setpoint) -> None:
        self.drive.started += 1
        self.setpoint = setpoint
        self._reached = False

    def _target(self, word: int) -> float:
        """Position in increments, by the options of 60F2h."""
        drive, relative = self.drive, word & ControlBit.RELATIVE
        option = drive.read(POSITIONING_OPTION, 0)
        target = float(drive.target_position)
        if relative:
            target += drive.position if option & _RELATIVE_OPTION else self._previous
        low, high = drive.read(POSITION_RANGE_LIMIT, 1), drive.read(POSITION_RANGE_LIMIT, 2)
        if low == high == 0 or (drive.wraps and relative):
            return target
        if drive.wraps:
            span, here = high - low, round(drive.position)
            forward, direction = (target - here) % span, option >> _DIRECTION_SHIFT & SHORTEST_WAY
            # By default the value wraps; then like a linear axis, not across the end of the range.
            linear = (target - low) % span - (here - low) % span
            return here + (way_to(forward, span, direction) if direction else linear)
        limited = min(max(target, low), high)
        drive.limited = limited != target
        return limited

    def move(self) -> None:
        drive, setpoint = self.drive, self.setpoint
        if drive.halted or setpoint is None:
            deceleration = setpoint.deceleration if setpoint else drive.slow_down_rate
            if drive.halted:
                self.setpoint = self._queued = None
                deceleration = drive.halt_rate(deceleration)
            if drive.slow_down(deceleration) and drive.halted:
                self._reached = True
            return
        distance = setpoint.target - drive.position
        if drive.sine:
            target = self._sine_speed(setpoint, distance)
        else:
            target = speed_toward(distance, setpoint.speed, setpoint.deceleration)
        drive.limited = drive.limited and drive.read(POSITION_RANGE_LIMIT, 2) != 0
        if drive.against_limit(target):
            drive.limited = True
            drive.slow_down(setpoint.deceleration)
            return
        if drive.sine:
            drive.ramp.sine_squared(target, *drive.sine_times)
        else:
            drive.ramp.linear(target, setpoint.acceleration, setpoint.deceleration + 1e-6)
        step = increments_per_second(drive.ramp.speed) * TICK
        slow = increments_per_second(2 * setpoint.deceleration * TICK) * TICK
        if abs(distance) <= max(1.0, abs(slow)) and abs(step) <= max(1.0, 2 * abs(slow)):
            self._arrive(setpoint)

    def _sine_speed(self, setpoint: Setpoint, distance: float) -> float:
        """Speed setpoint for sine-squared ramps: the braking distance of a complete ramp is half the speed times the ramp
        time.
        """
        ramp = self.drive.ramp
        rise, fall = self.drive.sine_times
        if ramp.speed == 0.0 and abs(distance) > 1:
            return math.copysign(min(setpoint.speed, rpm_of(2 * abs(distance) / (rise + fall))), distance)
        braking = increments_per_second(abs(ramp.speed)) * fall / 2
        if ramp.target == 0.0 or abs(distance) <= braking or distance * ramp.speed < 0:
            # Creep to the target: a ramp by time cannot reach a position exactly.
            creep = math.copysign(min(setpoint.speed, rpm_of(abs(distance)) * 5), distance)
            return creep if abs(ramp.speed) < 1.0 else 0.0
        return ramp.target

    def _arrive(self, setpoint: Setpoint) -> None:
        drive = self.drive
        drive.stop_at(setpoint.target)
        self.setpoint = None
        if self._queued is not None:
            self._activate(self._queued)
            self._queued = None
            if not drive.controlword & ControlBit.NEW_SETPOINT:
                self._acknowledged = False
        else:
            self._reached = True


class Turntable(ProfilePosition):
    """The manufacturer's mode with angles of one revolution as positions."""

    def _target(self, word: int) -> float:
        """The nearest absolute position with this angle in the commanded direction."""
        drive = self.drive
        if word & ControlBit.RELATIVE:
            return drive.position + drive.target_position
        rev = INCREMENTS_PER_REVOLUTION
        forward = (drive.target_position - drive.position) % rev
        counter = NEGATIVE_WAY if word & TURNTABLE.ccw else POSITIVE_WAY
        return drive.position + way_to(forward, rev, SHORTEST_WAY if word & TURNTABLE.shortest else counter)


class _SpeedMode(ModeOfOperation):
    """Target Velocity with the ramps of the profile."""

    even = True

    def move(self) -> None:
        drive = self.drive
        if drive.halted:
            drive.target_velocity = 0
        limit = drive.speed_limit
        target = min(max(self._demanded(), -limit), limit)
        drive.limited = drive.against_limit(target)
        if drive.halted and not (drive.sine and drive.action(HALT_OPTION) is Braking.SLOW_DOWN):
            drive.slow_down(drive.halt_rate(self.slow_down_rate))
        else:
            self._follow(0.0 if drive.limited else target)

    def _demanded(self) -> float:
        return self.drive.target_velocity * self.drive.unit

    def _follow(self, target: float) -> None:
        drive = self.drive
        if drive.sine:
            drive.ramp.sine_squared(target, *drive.sine_times)
            return
        acceleration = drive.acceleration(drive.profile_acceleration, MAX_ACCELERATION)
        acceleration = min(acceleration, TORQUE_ACCELERATION * self._torque() / 1000)
        drive.ramp.linear(target, acceleration, drive.slow_down_rate, drive.jerk_ms)

    def _torque(self) -> int:
        return self.drive.max_torque


class ProfileVelocity(_SpeedMode):
    def bits(self, halted: bool, units: int) -> int:
        drive = self.drive
        bits = 0
        if abs(units) <= drive.read(VELOCITY_THRESHOLD, 0):
            bits |= StatusBit.MODE_12
        if abs(units - drive.target_velocity) <= drive.read(VELOCITY_WINDOW, 0):
            bits |= StatusBit.TARGET_REACHED
        return bits


class SpeedControl(ProfileVelocity):
    """The manufacturer's speed mode, with a torque limit by PDO."""

    def _torque(self) -> int:
        drive = self.drive
        return min(drive.max_torque, drive.dynamic_torque_limit, drive.read(MAX_CURRENT, 0))


class VelocityMode(_SpeedMode):
    """Velocity mode (vl) of frequency converters, with the limits of the setpoint before the ramp (6046h)."""

    def _demanded(self) -> float:
        drive, demanded = self.drive, super()._demanded()
        if drive.controlword & VL_RAMP != VL_RAMP or (not demanded and drive.stands_at_setpoint_0):
            return 0.0
        lowest, highest = (drive.read(VL_MIN_MAX, sub) * drive.unit for sub in (1, 2))
        return math.copysign(min(max(abs(demanded), lowest), highest), demanded)

    def _follow(self, target: float) -> None:
        drive = self.drive
        drive.ramp.linear(target, self._rate_of(VL_ACCELERATION), self.slow_down_rate)

    def _rate_of(self, index: int) -> float:
        return self.drive.profile_rate(self.drive.read(index, 1) / max(1, self.drive.read(index, 2)))

    @property
    def slow_down_rate(self) -> float:
        return self._rate_of(VL_DECELERATION)


class CyclicVelocity(_SpeedMode):
    """The master generates the ramp; the drive follows as fast as possible. Without new setpoints the speed stays."""

    synchronous = True

    def _demanded(self) -> float:
        return super()._demanded() + self.drive.velocity_offset * self.drive.unit

    def bits(self, halted: bool, units: int) -> int:
        return follows(self.drive, halted)

    def _follow(self, target: float) -> None:
        drive = self.drive
        most = drive.acceleration(drive.read(MAX_ACCELERATION, 0), MAX_ACCELERATION)
        drive.ramp.linear(target, most, most)


class Torque(ModeOfOperation):
    """Target Torque accelerates the unloaded motor up to a speed limit."""

    even = True
    makes_torque = True

    def move(self) -> None:
        drive = self.drive
        rated = min(1000, drive.read(MAX_CURRENT, 0))
        torque = 0 if drive.halted else min(max(drive.target_torque, -rated), rated)
        if torque == 0:
            self._release()
        else:
            rate = TORQUE_ACCELERATION * abs(torque) / 1000
            target = math.copysign(self._highest(), torque)
            drive.limited = drive.against_limit(target)
            drive.ramp.linear(0.0 if drive.limited else target, rate, rate)
        drive.current_actual = torque

    def _highest(self) -> float:
        return self.drive.max_rpm

    def _release(self) -> None:
        """Command zero torque, or Halt."""
        drive = self.drive
        rate = drive.halt_rate(drive.slow_down_rate) if drive.halted else drive.slow_down_rate
        drive.ramp.linear(0.0, rate, rate)


class CyclicTorque(Torque):
    """Without torque the motor coasts. Without new setpoints the torque stays."""

    synchronous = True

    def bits(self, halted: bool, units: int) -> int:
        return follows(self.drive, halted)

    def _release(self) -> None:
        self.drive.slow_down(COAST_DECELERATION)


class CurrentControl(Torque):
    """The manufacturer's torque mode, with a speed limit by PDO."""

    def _highest(self) -> float:
        return min(super()._highest(), self.drive.dynamic_speed_limit * 0.5)


MODES: dict[int, type[ModeOfOperation]] = {
    TURNTABLE.mode: Turntable,
    CURRENT_CONTROL: CurrentControl,
    SPEED_CONTROL: SpeedControl,
    Mode.POSITION: ProfilePosition,
    Mode.VL_VELOCITY: VelocityMode,
    Mode.VELOCITY: ProfileVelocity,
    Mode.TORQUE: Torque,
    Mode.HOMING: Homing,
    Mode.CYCLIC_POSITION: CyclicPosition,
    Mode.CYCLIC_VELOCITY: CyclicVelocity,
    Mode.CYCLIC_TORQUE: CyclicTorque,
}
"""The class of each mode by its value of 6060h."""
