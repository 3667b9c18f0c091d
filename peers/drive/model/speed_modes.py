"""Speed and torque modes of the simulated drive; the sources are those of ``modes``."""

from __future__ import annotations

import math

from pdgw.dsp402.drive_type import VL_RAMP
from pdgw.dsp402.objects import (
    MAX_ACCELERATION,
    MAX_CURRENT,
    MAX_DECELERATION,
    VELOCITY_THRESHOLD,
    VELOCITY_WINDOW,
    VL_ACCELERATION,
    VL_DECELERATION,
)
from pdgw.dsp402.states import StatusBit
from pdgw.peers.drive.model.mode_of_operation import COAST_DECELERATION, TORQUE_ACCELERATION, ModeOfOperation, follows


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
        drive.ramp.linear(target, acceleration, drive.acceleration(drive.profile_braking, MAX_DECELERATION))

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
    """Velocity mode (vl) of frequency converters."""

    def _demanded(self) -> float:
        return super()._demanded() if self.drive.controlword & VL_RAMP == VL_RAMP else 0.0

    def _follow(self, target: float) -> None:
        drive = self.drive
        up, down = (drive.read(index, 1) / max(1, drive.read(index, 2)) for index in (VL_ACCELERATION, VL_DECELERATION))
        drive.ramp.linear(target, up, down)


class CyclicVelocity(_SpeedMode):
    """The master generates the ramp; the drive follows as fast as possible. Without new setpoints the speed stays."""

    synchronous = True

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
        """Command zero torque."""
        drive = self.drive
        deceleration = drive.acceleration(drive.profile_braking, MAX_DECELERATION)
        drive.ramp.linear(0.0, deceleration, deceleration)


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
