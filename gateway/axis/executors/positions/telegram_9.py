"""Telegram 9: traversing tasks in profile position (6060h = 1, -5 on a modulo axis), and homing between them.

Source: docs/translation.md "Positioning, telegram 9 (MDI)"; the manufacturer's guide 5.2 and 6.7-6.14. CW.4 stays until STW1.6
falls; a homing may begin in any state, and its CW.4 stays until STW1.11 falls.
"""

from __future__ import annotations

from pdgw.dsp402.drive_type import DriveType, Quantity
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit
from pdgw.gateway.axis.demand_report import Flag, Report
from pdgw.gateway.axis.executors.executor import AxisRecords
from pdgw.gateway.axis.executors.positions.halt import HALT
from pdgw.gateway.axis.executors.positions.handshake import NEW_SETPOINT
from pdgw.gateway.axis.executors.positions.homing import TASK_WARNINGS
from pdgw.gateway.axis.executors.positions.limits import TaskScaling, base_mode
from pdgw.gateway.axis.executors.positions.motion import MotionExecutor
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.mdi import MdiPositioner
from pdgw.gateway.motion.modulo import Direction
from pdgw.gateway.motion.requests import Command, Goal, HomingResult, Motion, MotionKind, PositionerRequest, Seen
from pdgw.gateway.motion.states import State
from pdgw.profidrive.signals import signal

_ACTIVATE, _MDI_SELECTED = Command.ACTIVATE_TASK, Command.MDI
_IDLE, _HOMING, _BRAKING = State.IDLE, State.HOMING, State.BRAKING
_ACTUAL_METHOD = signal("AKTSATZ").bit("HOMING_METHOD").mask
_MDI_ACTIVE = signal("AKTSATZ").bit("MDI_ACTIVE").mask
_ENABLED = (Action.ENABLE_OPERATION, Action.RAMP)


class PositioningExecutor(MotionExecutor):
    """Tasks and homing of one axis with telegram 9."""

    def __init__(self, records: AxisRecords) -> None:
        self._mdi = MdiPositioner(self)
        self._turntable = records.settings.modulo_axis
        super().__init__(records, self._mdi, Mode.POSITION.value, modulo=self._turntable)
        self._turn_bits = dict.fromkeys(Direction, 0)
        """Controlword bits for the direction of a turntable."""
        self._scaling: TaskScaling | None = None
        self._active = False
        """MDI was active in the last step without homing."""
        self._resumed_at = 0
        """Position of the axis at the end of an intermediate stop."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        self._mode.rebase(base_mode(drive, modulo=self._turntable))
        turntable = drive.quirks.turntable
        if turntable is not None:
            bits = {Direction.SHORTEST: turntable.shortest, Direction.NEGATIVE: turntable.ccw}
            self._turn_bits = self._turn_bits | bits
        super().set_drive(drive, homing_method)
        scaling = self._scaling = TaskScaling.of(drive)
        window = drive.position_window
        if window is None:
            window = int(drive.scaling.reference(Quantity.POSITION) * self.settings.standstill_window)
        self._window = window
        self._mdi.set_drive(scaling.only_velocity, None if self._turntable else window, self._ring.size)

    def refuse(self) -> Report:
        self._active = False
        return super().refuse()

    def step(self) -> Report:
        scaling, reason = self._scaling, self.interlock.reason
        if scaling is None:
            return self.report.fill_motion(reason)
        self._cycle()
        mdi = self._mdi
        request, homes = mdi.request, mdi.state is _HOMING
        flags = Flag.STANDING if self.inputs.standstill else 0
        if self._seen.bits & Seen.OPERATING:
            reason = self.outputs.reason or mdi.course.warning
            waits = (
                mdi.state is _IDLE and self.inputs.standstill and (not self._halt.continued or self._halt.axis_stopped)
            )
            if waits or (homes and self._seen.homing is HomingResult.ATTAINED):
                flags |= Flag.REACHED
                reason = reason or mdi.reason_of_ignored()
        if self._stop_reached(request):
            flags |= Flag.REACHED
        if mdi.home_set:
            flags |= Flag.HOME_SET
        if not homes:
            if self._handshake.acknowledged and self._handshake.shown and not mdi.course.waits:
                flags |= Flag.TASK_ACKNOWLEDGED
            enabled = self.interlock.cell.action in _ENABLED
            self._active = enabled and self._asked.connected and request.commands & _MDI_SELECTED != 0
        active = self.homing.method & _ACTUAL_METHOD | (_MDI_ACTIVE if self._active else 0)
        return self.report.fill_motion(
            reason, flags, position=scaling.position.to_wire(self.feedback.position_actual), active=active
        )

    # -- requests of the positioner --------------------------------------------------------------------------------------

    def require_homing(self, *, edge: bool) -> bool:
        """A method that the drive lacks starts nothing and sets the warning until homing is no longer requested."""
        request, outputs = self._mdi.request, self.outputs
        if not request.commands & Command.START_HOMING:
            if self._mdi.state is _IDLE:
                outputs.end_warnings(TASK_WARNINGS)
        elif edge:
            return self.homing.require_method(request.number)
        elif outputs.warned & TASK_WARNINGS:
            outputs.reason = Reason.HOMING_METHOD
        return False

    def converted(self, request: PositionerRequest) -> Goal:
        """Convert a task to the drive's units."""
        scaling, limited = self._scaling, self.limited
        assert scaling is not None, "tasks start in operation, which needs the drive"
        absolute = request.commands & Command.ABSOLUTE != 0
        target = limited(scaling.position if absolute else scaling.relative, request.target)
        velocity = limited(scaling.velocity, request.velocity)
        acceleration = limited(scaling.acceleration, request.acceleration)
        deceleration = limited(scaling.deceleration, request.deceleration)
        if scaling.one_ramp:
            acceleration = min(acceleration, deceleration)
        return Goal(
            MotionKind.POSITION,
            target + (self._ring.base if absolute else self._seen.position),
            None if absolute else target,
            *(velocity, acceleration, deceleration),
            direction=request.direction,
            relative=not absolute,
        )

    # -- state of the drive ---------------------------------------------------------------------------------------------

    def _read_state(self) -> int:
        seen, handshake = self._seen, self._handshake
        seen.position = self._ring.follow(self.feedback.position_actual)
        stopped = Seen.STOPPED if self._halt.may_fall else 0
        if handshake.raised_at >= 0 and seen.taken != seen.given and handshake.read():
            handshake.executes()
        return stopped | self._read_arrival(executes=seen.taken == seen.given)

    def _execute(self, before: State, reason: Reason | None) -> int:
        mode, outputs, course, state = self._mode, self.outputs, self._mdi.course, self._mdi.state
        motion, goal, handshake, halt = course.motion, course.goal, self._handshake, self._halt
        if before is _BRAKING or reason is not None:
            outputs.reason = reason
        if state is _HOMING:
            return self._home_as_asked(motion)
        if state is _BRAKING:
            handshake.end()
            return halt.begin()
        if before is _HOMING:
            if self._seen.homing is not HomingResult.RUNNING:
                outputs.end_warnings(TASK_WARNINGS)
            handshake.end()
            mode.abandon()
        if state is _IDLE and (before is _IDLE or mode.halted) and halt.rest():
            return HALT
        if goal is not None and motion.kind is MotionKind.STAND:
            return HALT | self._interrupted(goal)
        if mode.halted:
            # Reset Halt alone; a new setpoint or a mode together with it is not allowed.
            self._resumed_at = self._seen.position
            handshake.end()
        else:
            self._shake_hands(motion, goal)
        if state is _IDLE and before is not _BRAKING and mode.mode != mode.base:
            mode.request(mode.base)
        return handshake.bits

    def _interrupted(self, goal: Goal) -> int:
        """An intermediate stop: the handshake ends; one of a goal that is replaced is over."""
        handshake = self._handshake
        if self._mdi.course.waits:
            handshake.announce(self._bits_of(goal))
        elif self._may_fall():
            handshake.fall()
        return handshake.bits

    def _may_fall(self) -> bool:
        """CW.4 stays until the drive has taken the task and STW1.6 falls, or another task waits."""
        request = self._mdi.request
        return self._seen.taken == self._seen.given and (not request.commands & _ACTIVATE or self._mdi.course.waits)

    def _shake_hands(self, motion: Motion, goal: Goal | None) -> None:
        """CW.4 falls, or rises for a task that waits once the drive took the last one back."""
        handshake = self._handshake
        if handshake.raised_at >= 0:
            if self._may_fall():
                handshake.fall()
            elif handshake.is_replaced(motion, self._seen.given):
                handshake.fall()
                self.outputs.end_warnings(TASK_WARNINGS)
        elif goal is not None and self._mdi.course.waits:
            handshake.blocked = 0 if handshake.free else goal.velocity
            if not handshake.blocked and self._mode.request(self._mode.base):
                self._send_setpoint(motion, goal)

    def _send_setpoint(self, motion: Motion, goal: Goal) -> None:
        command = self.command
        command.profile_acceleration, command.profile_deceleration = goal.acceleration, goal.deceleration
        target = goal.target if goal.distance is None else goal.distance
        if goal.distance is None and self._is_relative(goal):
            target -= self._resumed_at
        elif goal.distance is None and (self._turntable or self._positions.ends is None):
            target = self._ring.shown(target)
        self._set_point(target, goal.velocity, self._bits_of(goal))
        self._seen.given = motion.serial

    def _is_relative(self, goal: Goal) -> bool:
        """Whether the drive gets a way: that of a relative task, and its rest on a turntable or over a wrap."""
        first, last = self._ring.turn
        over = self._positions.ends is None and not first <= goal.target <= last
        return goal.distance is not None or (goal.relative and (self._turntable or over))

    def _bits_of(self, goal: Goal) -> int:
        """Controlword bits 5 and 6, and those of a turntable."""
        if self._is_relative(goal):
            return ControlBit.CHANGE_IMMEDIATELY | ControlBit.RELATIVE
        return ControlBit.CHANGE_IMMEDIATELY | (self._turn_bits[goal.direction] if self._turntable else 0)

    def _begin_homing(self, motion: Motion) -> None:
        super()._begin_homing(motion)
        self.positioner.forget_home()

    def _homing_ends(self, result: HomingResult) -> None:
        super()._homing_ends(result)
        if result is HomingResult.ATTAINED:
            self._mdi.homed()

    def _home_as_asked(self, motion: Motion) -> int:
        """Homing with method and velocity of its edge; CW.4 stays after its end until STW1.11 falls."""
        seen, homing, scaling = self._seen, self._mdi.homing, self._scaling
        if seen.given != motion.serial and homing is not None and scaling is not None:
            self._handshake.end()
            method, velocity = homing
            return self._home(motion, method, self.limited(scaling.velocity, velocity))
        if seen.homing is HomingResult.RUNNING:
            if self._halt.keeps_mode:
                self._mode.request(Mode.HOMING)
                return HALT
            return self._home(motion, 0, None)
        if seen.homing is HomingResult.ATTAINED:
            return NEW_SETPOINT
        self.outputs.reason = self.homing.failure
        return self._halt.before_homing()
