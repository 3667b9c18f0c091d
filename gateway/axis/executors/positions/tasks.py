"""Motions of the positioner on a drive: profile position (6060h = 1), profile velocity (3) and homing (6), with their handshakes.

Source: docs/motion.md, docs/translation.md. Each setpoint is sent once: CW.4 rises with its data and falls when the drive has
acknowledged it (SW.12), independent of STW1.6. The mode changes at standstill only and never with Halt. The position is
counted beyond the wrap of the drive: 607Bh if it wraps, else 32 bit. An absolute way across the wrap is sent as a relative task
from standstill, after an absolute task to the actual position. Then every reading of 60F2h starts at that position.
"""

from __future__ import annotations

from typing import ClassVar

from pdgw.ds301.objects import CanType
from pdgw.dsp402.drive_type import DriveType, Dsp402Error, Quantity
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH, POSITIVE_LIMIT_SWITCH
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.gateway.axis.demand_report import Flag, Report
from pdgw.gateway.axis.executors.executor import AxisRecords, highest, known
from pdgw.gateway.axis.executors.positions.drive_positions import DrivePositions
from pdgw.gateway.axis.executors.positions.halt import HALT
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGED
from pdgw.gateway.axis.executors.positions.homing import TASK_WARNINGS
from pdgw.gateway.axis.executors.positions.limits import TorqueLimit, position_mode
from pdgw.gateway.axis.executors.positions.motion import MotionExecutor
from pdgw.gateway.axis.values import ProbeAnswer, ProbeWish
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.motion.blocks import BlockTask
from pdgw.gateway.motion.modulo import Ring
from pdgw.gateway.motion.requests import (
    Command,
    HomingResult,
    Motion,
    MotionKind,
    PositionerChoices,
    PositionerRequest,
    Seen,
)
from pdgw.gateway.motion.states import State
from pdgw.gateway.motion.travel import ENDLESS
from pdgw.gateway.motion.units import DriveUnits, LengthUnits
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.normalisation import Normalisation

_STAND, _POSITION, _HOMING = MotionKind.STAND, MotionKind.POSITION, MotionKind.HOMING
_POSITION_MODE, _VELOCITY_MODE, _HOMING_MODE = Mode.POSITION.value, Mode.VELOCITY.value, Mode.HOMING.value
_WITHOUT_FUNCTION = (State.IDLE, State.TRACKING, State.BRAKING)
_FOLLOWING_ERROR = StatusBit.MODE_13
"""Following error bit of mode 1."""
_REPORTED = (Reason.HOMING_ERROR, Reason.MOVES_UNASKED, Reason.NOT_ACKNOWLEDGED)
"""Warnings that are reported where they are detected."""
_AT_LIMIT = 20
"""Divisor of the torque limit: within this part, the torque is at its limit."""


class PositionerExecutor(MotionExecutor):
    """The positioner of one axis, and its drive. GatewayError without the user's settings for a positioner."""

    POSITION_FOLLOWS: ClassVar[int] = 2
    """Position and Statusword are in different PDOs: one of them waits for the end of its inhibit time, a cycle."""

    def __init__(self, records: AxisRecords) -> None:
        choices = records.settings.positioner
        if choices is None:
            raise GatewayError("[axis.positioner] is missing: a telegram of the positioner needs it")
        self._basic = BasicPositioner(choices)
        self._travel = self._basic.travel
        super().__init__(records, self._basic, _POSITION_MODE, modulo=choices.modulo > 0)
        self.choices: PositionerChoices = choices
        self._bounded = choices.software_limits is not None
        self._units: LengthUnits | None = None
        self._speed: Normalisation | None = None
        self._limits = (0, 0, 0)
        """Highest velocity (also of the axis, over which OVERRIDE must not go), acceleration, deceleration of the drive."""
        self._one_ramp = False
        """The drive has no 6084h: 6083h is its acceleration and its deceleration."""
        self._torque = TorqueLimit(self.outputs)
        self._why = ""
        """Values of the last warning."""
        self._anchored = 0
        """Serial number of the motion before which the drive was sent to its actual position."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        choices, scaling = self.choices, drive.scaling
        position_mode(drive)
        if Mode.VELOCITY not in drive.modes:
            raise Dsp402Error("modes of the drive (6502h)", sorted(drive.modes), "3 for setting up and jog")
        units = DriveUnits(
            known(scaling.counts_per_revolution, "position units per revolution", "counts_per_revolution"),
            known(scaling.velocity_per_rpm, "velocity units per rpm", "velocity_unit"),
            known(scaling.acceleration_per_rpm_s, "acceleration units per rpm/s", "acceleration_unit"),
        )
        super().set_drive(drive, homing_method)
        length = self._units = LengthUnits(
            choices.lu_per_revolution, choices.max_acceleration, choices.max_deceleration, units
        )
        reference = scaling.reference(Quantity.SPEED)
        self._speed = n4(reference, drive.limits("velocity_actual"))
        self._limits = (
            min(
                highest(drive, Quantity.PROFILE_VELOCITY, "profile_velocity", "target_velocity"),
                length.velocity(choices.max_velocity),
            ),
            highest(drive, Quantity.ACCELERATION, "profile_acceleration"),
            highest(drive, Quantity.DECELERATION, "profile_deceleration"),
        )
        self._one_ramp = not drive.has("profile_deceleration")
        self._torque.set_base(drive.max_torque)
        if self.clamps:
            if drive.max_torque <= 0:
                raise Dsp402Error("Max Torque 6072h", drive.max_torque, "a value above 0, which a fixed stop lowers")
            drive.entry("current_actual")  # without it a fixed stop is never detected
        self._window = length.to_drive(choices.position_window)
        travel, limits, targets = self._travel, self._positions.ends, self._positions.targets
        travel.ends = scaling.range_source
        if limits is None and targets != CanType.I32.integer_range:
            limits, travel.ends = targets, "607Ah"
        travel.positions = ENDLESS if limits is None else _in_length(length, limits)
        travel.distances = _in_length(length, targets)
        travel.turn = _in_length(length, self._ring.turn)
        travel.only_velocity = 0 if self._positions.has_velocity else choices.max_velocity

    @property
    def clamps(self) -> bool:
        """A task may lower the torque limit of the drive."""
        choices = self.choices
        fixed_stop = any(block.task is BlockTask.FIXED_STOP for block in choices.blocks)
        return fixed_stop or choices.clamping_torque is not None

    def _ring_of(self, positions: DrivePositions) -> Ring:
        """The ring for the position of this drive; Dsp402Error if it overflows at another value than the modulo range."""
        ring, choices, scaling = super()._ring_of(positions), self.choices, positions.scaling
        counts = scaling.counts_per_revolution
        if not scaling.position_wraps or not choices.modulo or counts is None:
            return ring
        size = counts * choices.modulo / choices.lu_per_revolution
        # 607Bh is the last position, or the one equal to the first: drives differ.
        if size not in {ring.size - 1, ring.size}:
            allowed = f"the range at which the drive wraps (607Bh {ring.low} to {ring.turn[1]}), or 607Bh = 0/0"
            raise Dsp402Error("modulo_range", f"{choices.modulo} LU = {float(size):g} position units", allowed)
        return Ring(ring.low, int(size))

    @property
    def range_note(self) -> str:
        return self._range_line

    def restarted(self) -> None:
        self._torque.restarted(lowers=self.clamps)
        super().restarted()

    def lost(self) -> None:
        self._torque.lost()
        super().lost()

    def refuse(self) -> Report:
        super().refuse()
        positioner = self._basic
        return self.report.fill_motion(
            self.interlock.reason, position=positioner.position, positioner=positioner.words(0, reached=False)
        )

    def sdo_done(self, error: str | None) -> None:
        if not self._torque.answered(error):
            super().sdo_done(error)

    def probed(self, answer: ProbeAnswer) -> None:
        units = self._units
        if answer.wish is not self.outputs.probe or units is None:
            return
        for position in answer.positions.values():
            self._basic.latch(units.to_length(self._ring.near(position)))
        if answer.error is not None:
            self._basic.latch(Reason.PASSIVE_HOMING_NOT_SUPPORTED)

    def _probe(self, request: PositionerRequest) -> None:
        """Arm or disarm the probe of passive homing."""
        outputs = self.outputs
        self._basic.latch(None)
        outputs.probe = None
        if self._basic.armed:
            commands = request.commands
            outputs.probe = ProbeWish(
                (2 * (commands & Command.PROBE_2 != 0) + (commands & Command.PROBE_FALLING_EDGE != 0),)
            )

    def step(self) -> Report:
        units, conversion, reason = self._units, self._speed, self.interlock.reason
        if units is None or conversion is None:
            return self.report.fill_motion(reason)
        positioner, feedback, outputs = self._basic, self.feedback, self.outputs
        course, before = positioner.course, positioner.course.warning
        why = self._cycle()
        request, operating = positioner.request, self._seen.bits & Seen.OPERATING != 0
        if positioner.armed is (outputs.probe is None):
            self._probe(request)
        if operating:
            reason = outputs.reason or why
            if reason is Reason.HOMING_ERROR:
                reason = self.homing.failure
                if reason is not Reason.HOMING_ERROR and not request.commands & Command.START_HOMING:
                    positioner.warn(None)  # a refused order is withdrawn
        self._torque.follow(course.motion.torque if operating else None)
        if course.warning is not before or (before is not None and self._travel.evidence != self._why):
            self._warn(course.warning)
        reached = positioner.reached and (not self._halt.continued or self._halt.axis_stopped)
        flags = Flag.STANDING if self.inputs.standstill else 0
        if reached or self._stop_reached(request):
            flags |= Flag.REACHED
        if positioner.home_set:
            flags |= Flag.HOME_SET
        if positioner.acknowledged:
            flags |= Flag.TASK_ACKNOWLEDGED
        if not feedback.statusword & _FOLLOWING_ERROR or not self._mode.shows_base():
            flags |= Flag.WITHIN_TOLERANCE
        speed = conversion.to_wire(feedback.velocity_actual)
        length_speed = units.to_length_speed(feedback.velocity_actual)
        words = positioner.words(speed, reached=reached)
        return self.report.fill_motion(reason, flags, speed, positioner.position, length_speed, positioner=words)

    def _warn(self, warning: Reason | None) -> None:
        """Report another warning of the positioner once; it is shown while it is active. An edge that started nothing is none."""
        why = self._why = self._travel.evidence
        if warning not in _REPORTED:
            self.outputs.end_warnings(TASK_WARNINGS)
            if warning is not None and warning is not Reason.LOST_EDGE:
                self.outputs.warn(FaultNumber.POSITIONER, f"{warning.value}; {why}" if why else warning.value)

    # -- state of the drive ---------------------------------------------------------------------------------------------

    def _read_state(self) -> int:
        seen, feedback, units = self._seen, self.feedback, self._units
        assert units is not None, "cycles begin when the drive is known"
        statusword, inputs = feedback.statusword, feedback.digital_inputs
        ring = self._ring
        base = ring.base
        seen.position = units.to_length(ring.follow(feedback.position_actual))
        if ring.base != base:
            self._travel.turn = _in_length(units, ring.turn)
        torque, bits = self._basic.course.motion.torque, 0
        if torque is not None and abs(feedback.current_actual) * _AT_LIMIT >= torque * (_AT_LIMIT - 1):
            bits = Seen.TORQUE_AT_LIMIT
        if inputs & NEGATIVE_LIMIT_SWITCH:
            bits |= Seen.NEGATIVE_LIMIT
        if inputs & POSITIVE_LIMIT_SWITCH:
            bits |= Seen.POSITIVE_LIMIT
        executes = False
        handshake = self._handshake
        if handshake.raised_at >= 0:
            if handshake.read():
                handshake.fall()
        elif not statusword & ACKNOWLEDGED and seen.taken == seen.given:
            # A waiting setpoint keeps the acknowledgement until the drive starts it.
            executes = True
            if seen.executing != seen.taken and self._mode.shows_base():
                handshake.executes()
        return bits | self._read_arrival(executes=executes)

    # -- commands -------------------------------------------------------------------------------------------------------

    def _execute(self, before: State, reason: Reason | None) -> int:
        motion, units = self._basic.course.motion, self._units
        kind = motion.kind
        assert units is not None, "cycles begin when the drive is known"
        if kind is _STAND:
            return self._ramp_down()
        mode, handshake, halt = self._mode, self._handshake, self._halt
        if self._crosses(motion) and not halt.axis_stopped and not halt.released:
            return self._slow_down()
        wanted = _HOMING_MODE if kind is _HOMING else _POSITION_MODE if kind is _POSITION else _VELOCITY_MODE
        if mode.mode != wanted and not self.inputs.standstill and not halt.released:
            return self._slow_down()
        if mode.mode == wanted and halt.keeps_mode:
            mode.request(wanted)
            return HALT
        if mode.halted and not (kind is _HOMING and halt.has_stopped):
            return 0  # reset Halt alone: a setpoint or a mode together with it is not allowed
        if kind is _HOMING:
            return self._home_axis(motion)
        confirmed = mode.request(wanted)
        if kind is not _POSITION:
            handshake.fall()  # replaced before its acknowledge
            if confirmed:
                self._turn(motion, units)
            return 0
        if handshake.raised_at >= 0:
            # One edge for each task: the bit stays until the acknowledge, also while the drive shows another mode.
            if handshake.is_replaced(motion, max(self._seen.given, self._anchored)):
                handshake.fall()
            return handshake.bits
        if not confirmed:
            return 0
        if motion.serial != self._seen.given:
            self._send_setpoint(motion, units)
        return handshake.bits

    def _crosses(self, motion: Motion) -> bool:
        """An absolute setpoint that was not given yet leads across an end of what the drive shows."""
        goal = motion.goal
        if motion.serial == self._seen.given or motion.kind is not _POSITION or goal.distance is not None:
            return False
        first, last = self._travel.turn
        return not first <= goal.target <= last

    def _slow_down(self) -> int:
        """Decelerate to standstill in the present mode."""
        self._handshake.fall()
        self.command.target_velocity = 0
        if self._mode.mode == _VELOCITY_MODE:
            return 0
        return self._halt.begin()

    def _ramp_down(self) -> int:
        """Ramp down; Halt stays while a function is kept, and falls at standstill without a restart otherwise."""
        mode, positioner, halt = self._mode, self._basic, self._halt
        kept = positioner.state not in _WITHOUT_FUNCTION
        if kept:
            self._handshake.fall()
        else:
            self._seen.given = positioner.course.motion.serial
            self._handshake.end()
        if mode.mode == _VELOCITY_MODE:
            self.command.target_velocity = 0
            return HALT if halt.keeps_mode else 0
        if mode.mode == _HOMING_MODE and (self.inputs.standstill or halt.released):
            if not mode.halted:
                mode.request(mode.base)
            return 0
        if not kept:
            return halt.rest()
        return halt.begin()

    def _set_ramps(self, motion: Motion, units: LengthUnits) -> None:
        command, goal, (_, highest_acceleration, highest_deceleration) = self.command, motion.goal, self._limits
        acceleration = min(units.acceleration(goal.acceleration), highest_acceleration)
        deceleration = min(units.deceleration(goal.deceleration), highest_deceleration)
        command.profile_acceleration = min(acceleration, deceleration) if self._one_ramp else acceleration
        command.profile_deceleration = deceleration

    def _velocity(self, motion: Motion, units: LengthUnits) -> int:
        wanted, highest = units.velocity(motion.goal.velocity, motion.override), self._limits[0]
        limited = max(-highest, min(wanted, highest))
        if limited != wanted:
            self.outputs.saturations += 1
        return limited

    def _turn(self, motion: Motion, units: LengthUnits) -> None:
        seen = self._seen
        if motion.serial != seen.given or not self.command.target_velocity:
            self._set_ramps(motion, units)
            self.command.target_velocity = self._velocity(motion, units)
            seen.given = seen.taken = seen.executing = motion.serial
            self._halt.rested = False

    def _send_setpoint(self, motion: Motion, units: LengthUnits) -> None:
        """Send a setpoint when the drive is free for it and has the torque limit."""
        if not self._handshake.free:
            self._handshake.blocked = abs(units.velocity(motion.goal.velocity, motion.override))
            return
        if not self._torque.holds(motion.torque):
            self.outputs.reason = Reason.TORQUE_LIMIT
            return
        self._set_ramps(motion, units)
        velocity = self._velocity(motion, units)
        goal = motion.goal
        relative = goal.distance is not None
        target = units.to_drive(goal.target if goal.distance is None else goal.distance)
        ring = self._ring
        if self._crosses(motion):
            if self._anchored != motion.serial:
                self._anchored = motion.serial
                self._set_point(ring.position, velocity, ControlBit.CHANGE_IMMEDIATELY)
                return
            relative = True
            target -= ring.near(ring.position)
        elif not relative:
            first, last = ring.turn  # the last unit may end beyond it
            target = max(first, min(target, last)) - ring.base
        immediate = 0 if motion.serial == self._travel.queued else ControlBit.CHANGE_IMMEDIATELY
        self._set_point(target, velocity, immediate | (ControlBit.RELATIVE if relative else 0))
        self._seen.given = motion.serial

    def _home_axis(self, motion: Motion) -> int:
        method = self.choices.homing_method
        if self._seen.given != motion.serial and not self.homing.require_method(method):
            self._begin_homing(motion)
            self._homing_ends(HomingResult.FAILED)
            return 0
        return 0 if method is None else self._home(motion, method, None)


def _in_length(length: LengthUnits, positions: tuple[int, int]) -> tuple[int, int]:
    low, high = positions
    return length.to_length(low), length.to_length(high)
