"""What the simulated drive does in each mode of operation: one object for each mode it has, chosen by 6061h.

Source: the manufacturer's guide chapters 6 and 7, CiA DSP 402 V2.0 (profile position, profile velocity, homing), CiA 402-2
(cyclic synchronous modes). Which state the power section is in, and the quick stop, is the model's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH as NEGATIVE_LIMIT
from pdgw.dsp402.objects import POSITIVE_LIMIT_SWITCH as POSITIVE_LIMIT
from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.peers.drive.family import HOMING_METHODS
from pdgw.peers.drive.motion import INCREMENTS_PER_REVOLUTION, TICK, increments_per_second, speed_toward

if TYPE_CHECKING:
    from pdgw.peers.drive.model import DriveModel

_VL_RAMP = 0x70
"""Controlword of velocity mode (vl): enable ramp, unlock ramp, reference ramp. All three let the set-point through."""
COAST_DECELERATION = 1500.0
"""rpm/s of the free-running motor."""
TORQUE_ACCELERATION = 6000.0
"""rpm/s that rated current gives the unloaded motor."""


@dataclass(slots=True)
class Setpoint:
    """A target of profile position as it was taken: increments, rpm, rpm/s."""

    target: float
    speed: float
    acceleration: float
    deceleration: float


class ModeOfOperation:
    """One mode of one drive."""

    even: ClassVar[bool] = False
    """At constant speed nothing but the position changes."""
    makes_torque: ClassVar[bool] = False
    """It sets the torque itself."""
    synchronous: ClassVar[bool] = False
    """It needs a set-point with each SYNC."""

    def __init__(self, drive: DriveModel) -> None:
        self.drive = drive

    def selected(self) -> None:
        """6061h is this mode from now on: nothing of earlier times is left."""
        self.enabled()

    def enabled(self) -> None:
        """Operation begins."""

    def disabled(self) -> None:
        """Operation was left."""

    def command(self, word: int, previous: int) -> None:
        """A Controlword in operation."""

    def received(self) -> None:
        """New set-points may be in the image."""

    def move(self) -> None:
        """One tick in operation."""
        raise NotImplementedError

    def bits(self, halted: bool, units: int) -> int:
        """The Statusword's bits of the mode. ``halted``: Halt in operation; ``units``: actual velocity."""
        return StatusBit.TARGET_REACHED if halted and units == 0 else 0

    def condition(self) -> tuple[object, ...]:
        """What a tick can change of it."""
        return ()

    def _rises(self, word: int, previous: int) -> bool:
        return bool(word & ControlBit.NEW_SETPOINT and not previous & ControlBit.NEW_SETPOINT)

    def _allowed(self, word: int, previous: int) -> bool:
        """Resetting Halt and setting bit 4 in one Controlword is not allowed: the set-point is not taken."""
        return not (word | previous) & ControlBit.HALT


# -- speeds -----------------------------------------------------------------------------------------------------------


class _SpeedMode(ModeOfOperation):
    """Target Velocity under the profile's ramps."""

    even = True

    def move(self) -> None:
        drive = self.drive
        if drive.halted:
            drive.target_velocity = 0
        limit = drive.speed_limit
        target = min(max(self._wanted(), -limit), limit)
        drive.limited = drive.against_limit(target)
        self._follow(0.0 if drive.limited else target)

    def _wanted(self) -> float:
        return self.drive.target_velocity * self.drive.unit

    def _follow(self, target: float) -> None:
        drive = self.drive
        if drive.sine:
            drive.ramp.sine_squared(target, *drive.sine_times)
            return
        acceleration = drive.acceleration(drive.profile_acceleration, 0x60C5)
        acceleration = min(acceleration, TORQUE_ACCELERATION * self._torque() / 1000)
        drive.ramp.linear(target, acceleration, drive.acceleration(drive.profile_deceleration, 0x60C6))

    def _torque(self) -> int:
        return self.drive.max_torque


class ProfileVelocity(_SpeedMode):
    def bits(self, halted: bool, units: int) -> int:
        drive = self.drive
        bits = 0
        if abs(units) <= drive.read(0x606F, 0):
            bits |= StatusBit.MODE_12
        if abs(units - drive.target_velocity) <= drive.read(0x606D, 0):
            bits |= StatusBit.TARGET_REACHED
        return bits


class SpeedControl(ProfileVelocity):
    """The manufacturer's: with a limit of the torque by PDO."""

    def _torque(self) -> int:
        drive = self.drive
        return min(drive.max_torque, drive.dynamic_torque_limit, drive.read(0x6073, 0))


class VelocityMode(_SpeedMode):
    """vl, of frequency converters."""

    def _wanted(self) -> float:
        return super()._wanted() if self.drive.controlword & _VL_RAMP == _VL_RAMP else 0.0

    def _follow(self, target: float) -> None:
        drive = self.drive
        up, down = (drive.read(index, 1) / max(1, drive.read(index, 2)) for index in (0x6048, 0x6049))
        drive.ramp.linear(target, up, down)


def _follows(drive: DriveModel, halted: bool) -> int:
    """Bit 12 of the cyclic synchronous modes: the drive follows the command value."""
    operating = drive.state is State.OPERATION_ENABLED
    return StatusBit.MODE_12 if operating and not halted and not drive.limited else 0


class CyclicVelocity(_SpeedMode):
    """The master makes the ramp: the drive follows as fast as it can. A set-point that stays away: the speed stays."""

    synchronous = True

    def bits(self, halted: bool, units: int) -> int:
        return _follows(self.drive, halted)

    def _follow(self, target: float) -> None:
        drive = self.drive
        most = drive.acceleration(drive.read(0x60C5, 0), 0x60C5)
        drive.ramp.linear(target, most, most)


class Torque(ModeOfOperation):
    """Target Torque accelerates the unloaded motor up to a speed."""

    even = True
    makes_torque = True

    def move(self) -> None:
        drive = self.drive
        rated = min(1000, drive.read(0x6073, 0))
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
        """No torque is asked for."""
        drive = self.drive
        deceleration = drive.acceleration(drive.profile_deceleration, 0x60C6)
        drive.ramp.linear(0.0, deceleration, deceleration)


class CyclicTorque(Torque):
    """Without torque the motor runs out. A set-point that stays away: the torque stays."""

    synchronous = True

    def bits(self, halted: bool, units: int) -> int:
        return _follows(self.drive, halted)

    def _release(self) -> None:
        self.drive.slow_down(COAST_DECELERATION)


class CurrentControl(Torque):
    """The manufacturer's: with a limit of the speed by PDO."""

    def _highest(self) -> float:
        return min(super()._highest(), self.drive.dynamic_speed_limit * 0.5)


# -- positions --------------------------------------------------------------------------------------------------------


class CyclicPosition(ModeOfOperation):
    """To the newest target in a straight line over 60C2h.

    A target that stays away is the end of the way; where SYNC has a period (1006h) the way goes on for one more 60C2h first.
    """

    synchronous = True

    def __init__(self, drive: DriveModel) -> None:
        super().__init__(drive)
        self._goal = 0.0
        self._way = 0.0
        """From the goal before."""
        self._left = 0
        """Ticks to the goal."""
        self._extrapolated = True

    def enabled(self) -> None:
        self._goal, self._way, self._left = self.drive.position, 0.0, 0
        self._extrapolated = True

    @property
    def _period(self) -> int:
        read = self.drive.read
        return max(1, round(read(0x60C2, 1) * 10.0 ** read(0x60C2, 2) / TICK))

    def received(self) -> None:
        goal = float(self.drive.target_position)
        self._goal, self._way, self._left = goal, goal - self._goal, self._period
        self._extrapolated = not self.drive.sync_ticks

    def move(self) -> None:
        drive = self.drive
        if not self._left and not self._extrapolated:
            self._extrapolated = True
            self._goal += self._way
            self._left = self._period
        ticks = max(1, self._left)
        self._left = ticks - 1
        drive.follow_at_once((self._goal - drive.position) / (ticks * TICK) * 60 / INCREMENTS_PER_REVOLUTION)

    def bits(self, halted: bool, units: int) -> int:
        return _follows(self.drive, halted)

    def condition(self) -> tuple[object, ...]:
        return self._goal, self._left, self._extrapolated


class ProfilePosition(ModeOfOperation):
    """Set-points by a handshake, each with its speed and ramps; one may wait for the end of another."""

    def __init__(self, drive: DriveModel) -> None:
        super().__init__(drive)
        self.setpoint: Setpoint | None = None
        self._queued: Setpoint | None = None
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
            drive.acceleration(drive.profile_acceleration, 0x60C5),
            drive.acceleration(drive.profile_deceleration, 0x60C6),
        )
        self._acknowledged = True
        if self.setpoint is not None and not word & ControlBit.CHANGE_IMMEDIATELY:
            self._queued = setpoint
            return
        self._activate(setpoint)

    def _activate(self, setpoint: Setpoint) -> None:
        self.drive.started += 1
        self.setpoint = setpoint
        self._reached = False

    def _target(self, word: int) -> float:
        drive = self.drive
        target = float(drive.target_position)
        if word & ControlBit.RELATIVE:
            target += drive.position
        low, high = drive.read(0x607B, 1), drive.read(0x607B, 2)
        if low == high == 0:
            return target
        limited = min(max(target, low), high)
        drive.limited = limited != target
        return limited

    def move(self) -> None:
        drive, setpoint = self.drive, self.setpoint
        if drive.halted or setpoint is None:
            if drive.halted:
                self.setpoint = self._queued = None
            deceleration = setpoint.deceleration if setpoint else drive.acceleration(drive.profile_deceleration, 0x60C6)
            if drive.slow_down(deceleration) and drive.halted:
                self._reached = True
            return
        distance = setpoint.target - drive.position
        if drive.sine:
            target = self._sine_speed(setpoint, distance)
        else:
            target = speed_toward(distance, setpoint.speed, setpoint.deceleration)
        drive.limited = drive.limited and drive.read(0x607B, 2) != 0
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
        """Speed setpoint for sine-squared ramps: the braking distance of a whole ramp is half speed times ramp time."""
        ramp = self.drive.ramp
        rise, fall = self.drive.sine_times
        if ramp.speed == 0.0 and abs(distance) > 1:
            rpm = 2 * abs(distance) / (rise + fall) * 60 / INCREMENTS_PER_REVOLUTION
            return math.copysign(min(setpoint.speed, rpm), distance)
        braking = increments_per_second(abs(ramp.speed)) * fall / 2
        if ramp.target == 0.0 or abs(distance) <= braking or distance * ramp.speed < 0:
            # The last increments are crept: a ramp by time cannot meet a position exactly.
            creep = math.copysign(min(setpoint.speed, abs(distance) * 60 / INCREMENTS_PER_REVOLUTION * 5), distance)
            return creep if abs(ramp.speed) < 1.0 else 0.0
        return ramp.target

    def _arrive(self, setpoint: Setpoint) -> None:
        drive = self.drive
        drive.stand_at(setpoint.target)
        self.setpoint = None
        if self._queued is not None:
            self._activate(self._queued)
            self._queued = None
            if not drive.controlword & ControlBit.NEW_SETPOINT:
                self._acknowledged = False
        else:
            self._reached = True


class Turntable(ProfilePosition):
    """The manufacturer's: angles of one revolution instead of positions."""

    def _target(self, word: int) -> float:
        """The nearest absolute position with this angle in the wanted direction."""
        drive = self.drive
        if word & ControlBit.RELATIVE:
            return drive.position + drive.target_position
        rev = INCREMENTS_PER_REVOLUTION
        forward = (drive.target_position - drive.position) % rev
        if word & ControlBit.TURNTABLE_SHORTEST:
            distance = forward if forward <= rev / 2 else forward - rev
        elif word & ControlBit.TURNTABLE_CCW:
            distance = forward - rev if forward else 0.0
        else:
            distance = forward
        return drive.position + distance


class Homing(ModeOfOperation):
    """The methods of the family; what they look for are limit switches, index pulses and mechanical stops."""

    def __init__(self, drive: DriveModel) -> None:
        super().__init__(drive)
        self._phase = ""
        self._attained = self._error = False
        self._reached = True
        self._index_from = 0.0

    def selected(self) -> None:
        self.disabled()
        self._attained = self._error = False
        self._reached = True

    def enabled(self) -> None:
        self._reached = True

    def disabled(self) -> None:
        self._phase = ""

    def condition(self) -> tuple[object, ...]:
        return self._phase, self._attained, self._error, self._reached

    def bits(self, halted: bool, units: int) -> int:
        bits = 0
        if self._attained:
            bits |= StatusBit.MODE_12
        if self._error:
            bits |= StatusBit.MODE_13
        return bits | StatusBit.TARGET_REACHED if self._reached or (halted and units == 0) else bits

    def command(self, word: int, previous: int) -> None:
        if self._rises(word, previous) and self._allowed(word, previous):
            self._start()
        elif not word & ControlBit.NEW_SETPOINT and self._phase:
            self._phase = "stopping"

    def _start(self) -> None:
        self.drive.started += 1
        self._attained = self._error = False
        self._reached = False
        method = self.drive.homing_method
        if method not in HOMING_METHODS:
            self._error = True
        elif method == 35:
            self._home_here()
        else:
            self._phase = "search"

    def _home_here(self) -> None:
        self.drive.home_here()
        self._phase = ""
        self._attained = True
        self._reached = True

    def move(self) -> None:
        drive, phase = self.drive, self._phase
        acceleration = drive.acceleration(drive.read(0x609A, 0), 0x60C5)
        if not phase or phase == "stopping" or drive.halted:
            if drive.slow_down(acceleration):
                self._reached = self._reached or not phase or drive.halted
                if phase == "stopping":
                    self._phase = ""
                    self._reached = True
            return
        method = drive.homing_method
        direction = -1.0 if method in {1, 17, -17} else 1.0
        fast, slow = (min(drive.read(0x6099, sub) * drive.unit, drive.speed_limit) for sub in (1, 2))
        on_switch = bool(drive.digital_inputs & (NEGATIVE_LIMIT if direction < 0 else POSITIVE_LIMIT))
        if phase == "search":
            self._search(direction, fast, acceleration, on_switch)
        elif phase == "leave":
            drive.ramp.linear(-direction * slow, acceleration, acceleration)
            if not on_switch and drive.ramp.speed * direction < 0:
                if method in {1, 2}:
                    self._phase = "index"
                    self._index_from = drive.machine_position
                else:
                    self._home_here()
        elif phase == "index":
            drive.ramp.linear(-direction * slow, acceleration, acceleration)
            before = math.floor(self._index_from / INCREMENTS_PER_REVOLUTION)
            after = math.floor(drive.machine_position / INCREMENTS_PER_REVOLUTION)
            if before != after:
                drive.machine_position = float(max(before, after) * INCREMENTS_PER_REVOLUTION)
                self._home_here()

    def _search(self, direction: float, speed: float, acceleration: float, on_switch: bool) -> None:
        """Toward the limit switch or the mechanical stop; a switch that is not there is a homing error."""
        drive = self.drive
        at_stop = drive.machine_position == drive.machine.stop(direction)
        if drive.homing_method < 0:
            if at_stop:
                self._home_here()
                return
        elif on_switch:
            if drive.slow_down(acceleration):
                self._phase = "leave"
            return
        elif at_stop:
            self._phase = ""
            self._error = True
            drive.ramp.set(0.0)
            return
        drive.ramp.linear(direction * speed, acceleration, acceleration)


MODES: dict[Mode, type[ModeOfOperation]] = {
    Mode.TURNTABLE: Turntable,
    Mode.CURRENT_CONTROL: CurrentControl,
    Mode.SPEED_CONTROL: SpeedControl,
    Mode.POSITION: ProfilePosition,
    Mode.VL_VELOCITY: VelocityMode,
    Mode.VELOCITY: ProfileVelocity,
    Mode.TORQUE: Torque,
    Mode.HOMING: Homing,
    Mode.CYCLIC_POSITION: CyclicPosition,
    Mode.CYCLIC_VELOCITY: CyclicVelocity,
    Mode.CYCLIC_TORQUE: CyclicTorque,
}
"""What each mode does."""
