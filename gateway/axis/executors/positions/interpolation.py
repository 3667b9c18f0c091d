"""Profile position and profile velocity for a drive that has neither: the gateway makes the setpoints of mode 8.

Source: CiA 402-2 (profile position and its handshake, cyclic synchronous position), docs/motion.md "Drives with cyclic
synchronous position alone". An executor of tasks commands and sees a drive of modes 1, 3 and 6 (``wished``, ``seen``); what the
real one gets is a position with each SYNC. Homing (6) is the drive's own, and passes. Left out: turntables, sine-squared ramps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import lcm
from types import MappingProxyType
from typing import Final, Protocol

from pdgw.ds301.objects import CanType, Entry
from pdgw.dsp402.drive.images import DriveCommand, DriveFeedback
from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.errors import Dsp402Error
from pdgw.dsp402.modes import MODE_NAMES, Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import STATE_OF_STATUS, ControlBit, State, StatusBit
from pdgw.durations import SECOND, SECONDS_PER_MINUTE
from pdgw.gateway.axis.demand_report import STATE_MASK
from pdgw.gateway.axis.executors.base import AxisRecords, known
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.motion.dsc import wrapped
from pdgw.gateway.motion.profile import Profile
from pdgw.gateway.reasons import Reason

_CYCLIC: Final = Mode.CYCLIC_POSITION.value
_POSITION: Final = Mode.POSITION.value
_VELOCITY: Final = Mode.VELOCITY.value
_HOMING: Final = Mode.HOMING.value
_NEW_SETPOINT, _HALT = ControlBit.NEW_SETPOINT, ControlBit.HALT
_RELATIVE, _AT_ONCE = ControlBit.RELATIVE, ControlBit.CHANGE_IMMEDIATELY
_OF_THE_MODE: Final = _NEW_SETPOINT | _AT_ONCE | _RELATIVE | _HALT
"""Controlword bits that mean something else, or nothing, in mode 8."""
_FOLLOWS = StatusBit.MODE_12
"""In mode 8: the drive takes the target position."""
_MADE_HERE: Final = StatusBit.TARGET_REACHED | StatusBit.MODE_12
_OPERATES = (Action.ENABLE_OPERATION, Action.RAMP)
_ALL_POSITIONS = CanType.I32.integer_range
_PROFILE_OBJECTS = ("profile_velocity", "profile_acceleration", "profile_deceleration", "target_velocity")


def _offered(drive: DriveType) -> DriveType:
    """The drive as the executor sees it."""
    homing = _HOMING in drive.modes
    own: dict[str, Entry] = {}
    for attribute in _PROFILE_OBJECTS:
        entry = DRIVE_OBJECTS.attribute(attribute)
        low, _ = CanType.I32.integer_range if attribute == "target_velocity" else (1, 0)
        own[attribute] = replace(entry, low=0 if attribute == "profile_velocity" else low, high=None)
    modes: Mapping[int, str] = {mode.value: MODE_NAMES[mode] for mode in (Mode.POSITION, Mode.VELOCITY)}
    return replace(
        drive,
        entries=MappingProxyType({**drive.entries, **own}),
        modes=MappingProxyType({**modes, _HOMING: drive.modes[_HOMING]} if homing else modes),
        homing_methods=drive.homing_methods if homing else MappingProxyType({}),
        quirks=replace(drive.quirks, turntable=None),
    )


class Tasks(Protocol):
    """The methods of an executor of modes 1, 3 and 6 that are called, as in ``Executor``."""

    def step(self) -> Reason | None: ...

    def refuse(self) -> None: ...


@dataclass(frozen=True, slots=True)
class _Setpoint:
    """A setpoint of profile position as it was taken, in units of the profile."""

    target: int
    speed: int
    acceleration: int
    deceleration: int


class Interpolation:
    """Between an executor of modes 1, 3 and 6 and the drive of one axis."""

    def __init__(self, records: AxisRecords) -> None:
        self._inputs, self._interlock = records.inputs, records.interlock
        self._command, self._feedback = records.outputs.command, records.inputs.feedback
        self.wished, self.seen = DriveCommand(), DriveFeedback()
        """The images used by the executor, instead of those of the drive."""
        self._cycle_ns = records.settings.cycle_ns
        self._profile = Profile()
        self._resolution = 1
        """Units of the profile in one position unit."""
        self._speed_unit = 1
        """Value of one velocity unit per cycle, in units of the profile,"""
        self._ramp_unit = 1
        """and of one acceleration unit."""
        self._range = _ALL_POSITIONS
        """Range of setpoints. An overflowing range (607Bh) limits them too: drives may treat its jump as a motion."""
        self._turns_on = True
        """Without a range, positions continue beyond 32 bits, as in every drive."""
        self._window: int | None = None
        self._mode = _POSITION
        """The last mode requested by the executor, of the two."""
        self._setpoint: _Setpoint | None = None
        self._queued: _Setpoint | None = None
        self._deceleration = 1
        """Deceleration of the newest setpoint in units of the profile; a stop uses it."""
        self._acknowledged = False
        self._word = 0
        """Controlword of the cycle before."""
        self._cut = False
        """The target was outside the range, and is its end."""
        self._held = 0
        """Direction in which a limit of the drive stops the axis, until another request; 0: none."""
        self._unseen = False
        """The drive was lost or its state unknown: its next state counts as new."""

    def set_drive(self, drive: DriveType, *, modulo: bool) -> DriveType:
        """Drive type for the executor in place of the real one; ``modulo``: positions wrap at the end of a range.

        Dsp402Error if a unit is unknown, or if the range of the drive wraps under a modulo axis.
        """
        if modulo and drive.scaling.position_wraps:
            raise Dsp402Error("modulo_range", "607Bh wraps", "a drive without 607Bh, or with profile position (6502h)")
        if self._cycle_ns <= 0:
            raise Dsp402Error(
                "cycle", f"{self._cycle_ns} ns", "a time above 0: the gateway calculates a setpoint for each cycle"
            )
        scaling = drive.scaling
        counts = known(scaling.counts_per_revolution, "position units per revolution", "counts_per_revolution")
        velocity = known(scaling.velocity_per_rpm, "velocity units per rpm", "velocity_unit")
        acceleration = known(scaling.acceleration_per_rpm_s, "acceleration units per rpm/s", "acceleration_unit")
        cycle = Fraction(self._cycle_ns, SECOND)
        speed = counts / velocity / SECONDS_PER_MINUTE * cycle
        ramp = counts / acceleration / SECONDS_PER_MINUTE * cycle * cycle
        self._resolution = lcm(speed.denominator, ramp.denominator)
        self._speed_unit = int(speed * self._resolution)
        self._ramp_unit = int(ramp * self._resolution)
        self._deceleration = int(scaling.reference(Quantity.DECELERATION)) * self._ramp_unit
        positions = drive.limits("target_position")
        self._range = scaling.position_range or positions
        self._turns_on = self._range == _ALL_POSITIONS
        self._window = drive.position_window
        return _offered(drive)

    # -- the machine's side -------------------------------------------------------------------------------------------

    def refuse(self, executor: Tasks) -> None:
        """As ``Executor.refuse``."""
        executor.refuse()
        self._command.controlword = self.wished.controlword
        self._track_actual_position(self._feedback)
        self._unseen = True

    def step(self, executor: Tasks) -> Reason | None:
        """As ``Executor.step``."""
        feedback = self._feedback
        cyclic = feedback.modes_of_operation_display == _CYCLIC
        self._show(feedback, self._inputs.standstill, cyclic=cyclic)
        reason = executor.step()
        command, wished = self._command, self.wished
        mode, word = wished.modes_of_operation, wished.controlword
        if mode == _HOMING:
            command.modes_of_operation, command.controlword = mode, word
            self._track_actual_position(feedback)
            return reason
        command.modes_of_operation, command.controlword = _CYCLIC, word & ~_OF_THE_MODE
        operates = STATE_OF_STATUS[feedback.statusword & STATE_MASK] is State.OPERATION_ENABLED
        if not (cyclic and operates) or self._unseen:
            self._unseen = False
            self._track_actual_position(feedback)
            return reason
        if self._interlock.action not in _OPERATES:
            word |= _HALT  # the drive has not followed yet: send no further position meanwhile
        if mode != self._mode:
            self._mode = mode
            self._forget()
        wants = self._turn(word, feedback) if mode == _VELOCITY else self._travel(word, feedback)
        self._word = word
        command.target_position = self._demanded
        return Reason.NOT_FOLLOWING if wants and self._ignored(feedback) and not self._held else reason

    # -- state of the executor ------------------------------------------------------------------------------------------

    def _show(self, feedback: DriveFeedback, standstill: bool, *, cyclic: bool) -> None:
        seen = self.seen
        seen.position_actual = feedback.position_actual
        seen.velocity_actual = feedback.velocity_actual
        seen.velocity_demand = feedback.velocity_demand
        seen.current_actual = feedback.current_actual
        seen.digital_inputs = feedback.digital_inputs
        statusword = feedback.statusword
        if not cyclic:
            # An executor that waits for its own mode must not use the mode shown by the drive.
            display = feedback.modes_of_operation_display
            seen.modes_of_operation_display = display if display == _HOMING else 0
            seen.statusword = statusword
            return
        seen.modes_of_operation_display = self._mode
        bits = self._reached(feedback, standstill)
        if self._acknowledged:
            bits |= StatusBit.MODE_12
        if self._cut or self._held:
            bits |= StatusBit.INTERNAL_LIMIT
        seen.statusword = statusword & ~_MADE_HERE | bits

    def _reached(self, feedback: DriveFeedback, standstill: bool) -> int:
        if self._setpoint is not None or self._profile.speed or not standstill:
            return 0
        window, way = self._window, abs(self._demanded - feedback.position_actual)
        return StatusBit.TARGET_REACHED if window is None or way <= window else 0

    # -- state of the drive -----------------------------------------------------------------------------------------------

    @property
    def _position(self) -> int:
        """Position of the profile in position units, beyond 32 bits without a range."""
        return (self._profile.position + self._resolution // 2) // self._resolution

    @property
    def _demanded(self) -> int:
        """The setpoint."""
        return wrapped(self._position) if self._turns_on else self._position

    def _track_actual_position(self, feedback: DriveFeedback) -> None:
        """Not in operation, or in another mode: where the axis is, so that nothing jumps when it is enabled."""
        self._forget()
        self._word = 0
        self._command.target_position = feedback.position_actual
        self._profile.stand(feedback.position_actual * self._resolution)

    def _forget(self) -> None:
        self._setpoint = self._queued = None
        self._acknowledged = self._cut = False
        self._held = 0

    def _ignored(self, feedback: DriveFeedback) -> bool:
        return not feedback.statusword & _FOLLOWS

    def _is_held(self, direction: int, feedback: DriveFeedback) -> bool:
        """While a drive does not accept the targets, its setpoint stays at the actual position. Otherwise it would jump
        afterwards."""
        if self._ignored(feedback):
            if feedback.statusword & StatusBit.INTERNAL_LIMIT:
                self._held = direction
            self._profile.stand(feedback.position_actual * self._resolution)
            return True
        return self._held != 0

    def _turn(self, word: int, feedback: DriveFeedback) -> bool:
        """Profile velocity; True if the drive must move."""
        wished, profile = self.wished, self._profile
        if wished.profile_deceleration:
            self._deceleration = wished.profile_deceleration * self._ramp_unit
        wanted = 0 if word & _HALT else wished.target_velocity
        direction = (wanted > 0) - (wanted < 0)
        if direction != self._held:
            self._held = 0
        self._cut = False
        if self._is_held(direction, feedback):
            return direction != 0
        speed, acceleration = wanted * self._speed_unit, wished.profile_acceleration * self._ramp_unit
        end = self._range[direction > 0] * self._resolution
        if not direction or self._turns_on:
            profile.turn(speed, acceleration, self._deceleration)
        elif (end - profile.position) * direction <= 0:
            self._cut = True
            profile.stop(self._deceleration)
        else:
            profile.toward(end, abs(speed), acceleration, self._deceleration)
        return direction != 0

    def _travel(self, word: int, feedback: DriveFeedback) -> bool:
        """Profile position; True if the drive must move."""
        before, profile = self._word, self._profile
        if word & _HALT:
            self._setpoint = self._queued = None
            self._cut = False
        elif word & _NEW_SETPOINT and not before & (_NEW_SETPOINT | _HALT) and not self._acknowledged:
            self._take(word)
        if not word & _NEW_SETPOINT and self._queued is None:
            self._acknowledged = False
        setpoint = self._setpoint
        if setpoint is None:
            if not self._ignored(feedback):
                profile.stop(self._deceleration)
            self._held = 0
            return False
        if self._is_held(1 if setpoint.target >= profile.position else -1, feedback):
            return True
        profile.toward(setpoint.target, setpoint.speed, setpoint.acceleration, setpoint.deceleration)
        if profile.position == setpoint.target and abs(profile.speed) <= setpoint.deceleration:
            self._setpoint, self._queued = self._queued, None
            if self._setpoint is not None:
                self._deceleration = self._setpoint.deceleration
                if not word & _NEW_SETPOINT:
                    self._acknowledged = False
        return True

    def _take(self, word: int) -> None:
        wished = self.wished
        setpoint = _Setpoint(
            self._target(word) * self._resolution,
            wished.profile_velocity * self._speed_unit,
            max(1, wished.profile_acceleration) * self._ramp_unit,
            max(1, wished.profile_deceleration) * self._ramp_unit,
        )
        self._acknowledged = True
        self._held = 0
        if self._setpoint is not None and not word & _AT_ONCE:
            self._queued = setpoint
            return
        self._setpoint, self._queued = setpoint, None
        self._deceleration = setpoint.deceleration

    def _target(self, word: int) -> int:
        """End of the setpoint in position units."""
        target = self.wished.target_position
        if self._turns_on:
            self._profile.position -= (self._position - self._demanded) * self._resolution
        if word & _RELATIVE:
            target += self._position
        if self._turns_on:
            return target
        low, high = self._range
        limited = min(max(target, low), high)
        self._cut = limited != target
        return limited
