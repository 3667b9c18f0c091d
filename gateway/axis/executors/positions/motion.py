"""A positioner's motions on a drive, as far as all telegrams with tasks have them: everything that may start a motion is here.

Source: docs/motion.md, docs/translation.md. A motion starts by CW.4, which rises here for a setpoint that was not given yet and
for a homing whose method the drive has taken; never with the fall of Halt, nor before the drive shows the mode.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import ClassVar, Final

from pdgw.base.durations import SECOND
from pdgw.ds301.objects import CanType, ObjectAddress
from pdgw.dsp402.acting import HALT_SWITCHES_OFF, TURNS_ROUND
from pdgw.dsp402.drive_type import POSITIONS, DriveType, Scaling
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.gateway.axis.answer import Answer
from pdgw.gateway.axis.demand_report import STATE_MASK, MotionDemand, Report
from pdgw.gateway.axis.executors.executor import AT_LIMIT, AT_LIMIT_TEXT, OPERATION_ENABLED, AxisRecords, Executor
from pdgw.gateway.axis.executors.positions.homing import Homing
from pdgw.gateway.axis.executors.positions.mode import ModeSwitch
from pdgw.gateway.axis.power_states import Action
from pdgw.gateway.base.fault_numbers import FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.modulo import Ring
from pdgw.gateway.motion.positioner import Positioner
from pdgw.gateway.motion.requests import (
    NOTHING,
    Command,
    HomingResult,
    Lack,
    Motion,
    MotionKind,
    PositionerRequest,
    Seen,
)
from pdgw.gateway.motion.states import FUNCTIONS, State
from pdgw.gateway.motion.travel import Stall
from pdgw.profidrive.signals import signal

HALT = ControlBit.HALT
NEW_SETPOINT = ControlBit.NEW_SETPOINT
ACKNOWLEDGED = StatusBit.MODE_12
"""Acknowledge bit of mode 1."""
ACKNOWLEDGE_NS: Final = 2 * SECOND
"""After this time without an acknowledge, a setpoint is reported and another task may replace it.

CiA 402 has no limit. A drive that is free for a setpoint acknowledges it within some milliseconds; before that, the data of the
setpoint may have to be written by SDO. A drive whose buffer is full is given no setpoint.
"""
_NO_STOP_OF_A_TASK: Final = Command.NO_INTERMEDIATE_STOP | Command.JOG_1_ON | Command.JOG_2_ON | Command.START_HOMING
_FUNCTION_BITS: Final = tuple(
    (command, signal("STW1").bit(command.name, positioning=True).mask) for command in Command if command & FUNCTIONS
)
"""Bits of STW1 by command."""
_RAMPS = (Action.RAMP, Action.RAMP_END)
_ENABLE_OPERATION, _HOMING, _TASK_AT_LIMIT = Action.ENABLE_OPERATION, State.HOMING, Reason.TASK_AT_LIMIT
_OPERATING: Final = Seen.OPERATING
_STANDSTILL: Final = Seen.STANDSTILL
_INTERNAL_LIMIT: Final = StatusBit.INTERNAL_LIMIT
_VELOCITY_MODE: Final = Mode.VELOCITY.value
_STALLED: Final = warning_bits(FaultNumber.STALLED)
_MOVES: Final = warning_bits(FaultNumber.MOVES_UNASKED)
_NOT_ACKNOWLEDGED: Final = warning_bits(FaultNumber.NOT_ACKNOWLEDGED)


class _StoppedByHalt(enum.Enum):
    """The setpoint that Halt has stopped, until another one comes."""

    NONE = "none"
    UNMOVED = "it has not moved the axis yet (the brake opens), so the drive may still execute it: Halt stays"
    STOPPED = "the drive may continue it when Halt falls"
    ENDED = 'Halt has fallen, at "target reached"'
    CONTINUED = "the drive turned again, or shows its target as not reached again (its brake opens): Halt stays"


_NONE, _UNMOVED, _STOPPED, _ENDED, _CONTINUED = _StoppedByHalt


class MotionExecutor(Executor):
    """The positioner of one axis, and its drive."""

    POSITION_FOLLOWS: ClassVar[int] = 0
    """Cycles from "homing attained" to the position that counts from the new zero."""

    def __init__(self, records: AxisRecords, positioner: Positioner, base: int, *, modulo: bool) -> None:
        """``base``: mode of the tasks. ``modulo``: the direction to a target is chosen here, not by the drive."""
        super().__init__(records)
        assert isinstance(records.demand, MotionDemand), "the adapter of its telegrams has one"
        self._asked = records.demand
        self.positioner = positioner
        self._mode = ModeSwitch(self, base)
        self._modulo = modulo
        self.homing = Homing(self, self._mode)
        self.command.modes_of_operation = self._mode.mode
        self._seen = positioner.seen
        self._target_range = CanType.I32.integer_range
        """Range of 607Ah."""
        self._ring = Ring(self._target_range[0], POSITIONS)
        """Counts the drive's position over its wraps."""
        self._bounded = False
        """The configuration limits the positions."""
        self._drive_scaling = Scaling()
        self._ends: tuple[int, int] | None = None
        """Between these the drive can be sent; None: it wraps, or has no range."""
        self._window = 0
        """Position units: at this distance from its target a task has ended."""
        self._position_objects: Mapping[ObjectAddress, int] = {}
        """The drive's values of the objects that define the unit and the sign of positions."""
        self._set_at = -1
        """When CW.4 rose for a setpoint, monotonic ns; -1 while it is 0."""
        self._arrival = Answer(self.settings.latency_ns)
        """Target reached, in answer to the setpoint that the drive executes."""
        self._taking = Answer(self.settings.latency_ns)
        """The acknowledge, in answer to the newest setpoint: a drive that has not shown it may still start."""
        self._acknowledged = False
        """The drive has acknowledged a setpoint, and no stop or reject has ended it since."""
        self._effect = Answer(self.settings.latency_ns)
        """Whether the newest setpoint or Halt has had the time to show at the shaft."""
        self._blocked = 0
        """Velocity of a setpoint that waits until the drive is free; 0: none waits."""
        self._blocked_at = 0
        """When none waited last, monotonic ns."""
        self._stall = Stall(self.settings.stall_ns)
        self._stopped_by_halt = _NONE
        self._bits = 0
        """Controlword bits of the setpoint given last, beside CW.4."""
        self._last_velocity = 0
        """6081h before that setpoint."""
        self._has_velocity = False
        """The drive has 6081h: its tasks have the speed that they are given."""
        self._rested = False
        """The axis was at rest without Halt, and no motion has begun since."""
        self._function, self._function_since = positioner.state, 0
        """The active function and its begin, monotonic ns."""
        self._home_lost = 0
        self._attained = 0
        """Cycles since the drive said that it has its zero."""
        self._attained_at = 0
        """When it said so first."""
        self._turned_at = 0
        """When the axis was not at standstill last, monotonic ns."""
        self._reaches_at = 0
        """When the drive did not show "target reached" last, monotonic ns."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        HALT_SWITCHES_OFF.check(drive.acting)
        if not self._modulo:
            TURNS_ROUND.check(drive.acting)
        self.homing.method = homing_method
        self.homing.methods = frozenset(drive.homing_methods)
        self._target_range = drive.limits("target_position")
        self._has_velocity = drive.has("profile_velocity")
        scaling = self._drive_scaling = drive.scaling
        self._ends = None if scaling.position_wraps else scaling.position_range
        ring = self._ring_of(scaling)
        if (ring.low, ring.size) != (self._ring.low, self._ring.size):
            self._ring = ring
            self._forget_home()
        before, now = self._position_objects, drive.position_objects
        self._position_objects = now
        if any(before.get(address, value) != value for address, value in now.items()):
            self._forget_home()
        if self._range_line:
            self.outputs.happened().log_lines.append(self._range_line)

    def _ring_of(self, scaling: Scaling) -> Ring:
        """The ring for the position of this drive."""
        low, _ = (scaling.position_wraps and scaling.position_range) or CanType.I32.integer_range
        return Ring(low, scaling.position_span)

    @property
    def _doubtful(self) -> bool:
        """Only the profile says that the drive wraps at 607Bh, and it has not done so yet."""
        scaling = self._drive_scaling
        return scaling.position_wraps and not scaling.wrap_confirmed and not self._ring.wrapped

    @property
    def range_note(self) -> str:
        return self._drive_scaling.range_text if self._doubtful else ""

    @property
    def _range_line(self) -> str:
        """The same for the log, and how far the drive is from the ends of its positions."""
        ends, text, counts = self._ends, self._drive_scaling.range_text, self._drive_scaling.counts_per_revolution
        if ends is None or self._bounded:
            return text if self._doubtful else ""
        if counts is None:
            return text
        backward, forward = (float(abs(end - self.feedback.position_actual) / counts) for end in ends)
        return f"{text}: {forward:.1f} turns forward, {backward:.1f} turns backward"

    @property
    def homes_since(self) -> int:
        return self._function_since if self._function is State.HOMING else 0

    @property
    def home_lost(self) -> int:
        return 0 if self.positioner.home_set else self._home_lost

    @property
    def needs_home(self) -> bool:
        goal = self.positioner.course.goal
        return goal is not None and goal.kind is MotionKind.POSITION and goal.distance is None and not goal.relative

    @property
    def limit_side(self) -> int:
        way = self.positioner.way
        return (way > 0) - (way < 0)

    @property
    def ignored(self) -> int:
        ignored = self.positioner.ignored if self._seen.bits & Seen.OPERATING else 0
        return sum(mask for command, mask in _FUNCTION_BITS if ignored & command)

    def lack(self, mask: int) -> Lack:
        return self.positioner.lack(sum(command for command, bit in _FUNCTION_BITS if mask & bit))

    def restarted(self) -> None:
        self._forget_home()

    def lost(self) -> None:
        self._forget_home()

    def _forget_home(self) -> None:
        """The drive has new coordinates."""
        self._ring.reset()
        if self.positioner.home_set:
            self._home_lost = self.inputs.now
        self.positioner.forget_home()

    def speeds(self) -> tuple[int, int] | None:
        command, mode, seen = self.command, self._mode, self._seen
        if mode.mode != mode.base:
            return (command.target_velocity, command.target_velocity) if mode.mode == _VELOCITY_MODE else None
        if not self._has_velocity or command.controlword & HALT:
            return None
        highest = command.profile_velocity
        late = self.inputs.now - ACKNOWLEDGE_NS
        if seen.executing != seen.given and not 0 <= self._set_at <= late:
            highest = max(highest, self._last_velocity)  # of a task before, which the drive may still execute
        if self._blocked and self._blocked_at <= late and self._bits & ControlBit.CHANGE_IMMEDIATELY:
            highest = min(highest, self._blocked)  # the drive has no setpoint that could wait, and is not free
        return -highest, highest

    def refuse(self) -> Report:
        self._stop()
        self._seen.bits = 0
        self.command.controlword = self.interlock.controlword
        self.positioner.step(NOTHING, self.inputs.now)
        return self.report.fill_motion(self.interlock.reason)

    def sdo_done(self, error: str | None) -> None:
        self.homing.answered(error)

    @property
    def _halted(self) -> bool:
        """Halt has stopped a setpoint, and none came since."""
        return self._stopped_by_halt is not _NONE

    @property
    def _continued(self) -> bool:
        """The drive continues it."""
        return self._stopped_by_halt is _CONTINUED

    @property
    def _moved(self) -> bool:
        """The axis also left the standstill window."""
        return self.outputs.warned & _MOVES != 0

    @property
    def stopped(self) -> bool:
        """The axis is at standstill, and the drive has ended its ramp."""
        return self.inputs.standstill and (self._shows_reached or self.feedback.velocity_actual == 0)

    @property
    def _turns(self) -> bool:
        """The axis is not at standstill."""
        return not (self.inputs.standstill or self.inputs.standstill_unknown)

    @property
    def _shows_reached(self) -> bool:
        """The drive shows "target reached"."""
        return self.feedback.statusword & StatusBit.TARGET_REACHED != 0

    def _keeps_still(self) -> bool:
        """The drive does not work on the setpoint that Halt has stopped."""
        return self.stopped and (self._shows_reached or self._stopped_by_halt is not _ENDED)

    @property
    def _rests(self) -> bool:
        """The axis has stopped, and no setpoint is on its way that the drive may still start: Halt may fall.

        Without "target reached", a speed of 0 can be older than the start of the setpoint, or than Halt.
        """
        now = self.inputs.now
        return (self._shows_reached or self._effect.due(now)) and self.stopped and self._taking.due(now)

    def _stop_reached(self, request: PositionerRequest) -> bool:
        """An intermediate stop of a traversing task has ended, and is shown so. With setting up, "target reached" may be that of
        its speed."""
        if not self.settings.intermediate_stop_reached:
            return False
        if not self._seen.bits & Seen.OPERATING or request.commands & _NO_STOP_OF_A_TASK:
            return False
        return self.stopped and (self._mode.shows_base() or self.feedback.velocity_actual == 0)

    def _cycle(self) -> Reason | None:
        """Run one cycle: state of the axis, commands, Controlword and mode. Returns why nothing moves just now."""
        interlock, mode, seen, positioner, inputs = self.interlock, self._mode, self._seen, self.positioner, self.inputs
        action, before, statusword = interlock.cell.action, positioner.state, self.feedback.statusword
        operates = action is _ENABLE_OPERATION and OPERATION_ENABLED[statusword & STATE_MASK]
        bits = 0
        if operates:
            self.outputs.reason = None
            bits = _OPERATING
        elif self._asked.connected and self._asked.in_control:
            bits = Seen.ASKED
        mode.read()
        self._taking.read(self._acknowledges, inputs.now)
        if inputs.standstill:
            if self._position_follows(self._turned_at):
                bits |= _STANDSTILL
        else:
            self._turned_at = inputs.now
            if not inputs.standstill_unknown:
                bits |= Seen.TURNS
                self._effect.withdraw()
                if self._stopped_by_halt is _UNMOVED:
                    self._stopped_by_halt = _STOPPED
        if statusword & _INTERNAL_LIMIT:
            bits |= Seen.INTERNAL_LIMIT
        seen.bits = bits | self._read_state()
        reason = positioner.step(self._asked.motion, inputs.now)
        if positioner.state is not self._function:
            self._note_function(positioner.state)
        if positioner.course.held is _TASK_AT_LIMIT:
            self.outputs.warn(FaultNumber.INTERNAL_LIMIT, AT_LIMIT_TEXT)
        else:
            self.outputs.end_warnings(AT_LIMIT)
        self._blocked = 0
        if operates:
            mode.asked = False
            if self._released() and not self._keeps_still() and not inputs.standstill_unknown:
                self._stopped_by_halt = _CONTINUED
            extra = self._execute(before, reason)
            if not mode.asked:
                mode.cease()
            mode.halted = extra & HALT != 0
            self._report_stall()
        else:
            ramps = action in _RAMPS
            mode.halted = mode.halted or ramps  # the mode does not change while Halt is set
            self._stop()
            mode.halted = ramps
            extra = self._halt() if ramps else 0
            self.outputs.end_warnings(_STALLED)
        if not self._blocked:
            self._blocked_at = inputs.now
        if before is _HOMING and positioner.state is not _HOMING:
            self._forget_homing()
        self.command.controlword = interlock.controlword | extra
        self.command.modes_of_operation = mode.mode
        return reason

    def _note_function(self, function: State) -> None:
        """Another function runs from now on."""
        self._function, self._function_since = function, self.inputs.now
        if function is _HOMING:
            self._home_lost = 0

    def _read_state(self) -> int:
        """Read the state of the drive. Returns bits of ``Seen``."""
        raise NotImplementedError

    def _read_arrival(self, *, executes: bool) -> int:
        """Read "target reached"; ``executes``: the drive works on the newest setpoint. Returns bits of ``Seen``."""
        if not executes or not self._mode.shows_base():
            return 0
        if not self._shows_reached:
            self._reaches_at = self.inputs.now
        known = self._position_follows(self._reaches_at) and not self.inputs.position_old
        reached = self._shows_reached and known and not (self._waits_for_motion or self._ends_short())
        bits = Seen.REACHED if reached else 0
        return bits | Seen.ANSWERED if self._arrival.read(reached, self.inputs.now) else bits

    @property
    def _waits_for_motion(self) -> bool:
        """A relative setpoint has not moved the axis half of its way yet: what the drive shows can be older than it."""
        course = self.positioner.course
        distance = course.motion.goal.distance
        return distance is not None and 2 * abs(course.way) > abs(distance) and not self._effect.due(self.inputs.now)

    def _ends_short(self) -> bool:
        """The drive is at an end of its positions, and away from its target."""
        limits, inputs = self._drive_scaling.position_range, self.inputs
        if limits is None or not inputs.standstill or (self._ends is None and not self._doubtful):
            return False
        (low, high), raw, near, course = limits, self.feedback.position_actual, self._window, self.positioner.course
        return not low + near < raw < high - near and abs(course.way) > (course.window or 0)

    def _executes_next(self) -> None:
        """The drive begins to execute the setpoint that it has taken."""
        self._seen.executing = self._seen.taken
        self._arrival.command(self.inputs.now)

    def _report_stall(self) -> None:
        """An axis at standstill before the end of its motion has a reason, and a warning once."""
        inputs, outputs, statusword = self.inputs, self.outputs, self.feedback.statusword
        reason: Reason | None = None
        if self._blocked and self._acknowledges and inputs.standstill:
            reason = Reason.SETPOINT_BLOCKED
        elif self._seen.taken == self._seen.given and self.positioner.course.expects_end():
            following_error = statusword & StatusBit.MODE_13 and self._mode.shows_base()
            reached = statusword & StatusBit.TARGET_REACHED
            missing = Reason.FOLLOWING_ERROR if following_error else Reason.NOT_REACHED
            reason = Reason.STANDS_AWAY if reached else missing
        position = self.feedback.position_actual
        if not self._stall.step(reason is not None, position, inputs.now) or reason is None:
            outputs.end_warnings(_STALLED)
            return
        detail = f"{reason.value}, 6064h = {position}, 607Ah = {self.command.target_position}"
        if self._doubtful:
            detail += f", {self._drive_scaling.range_text}"
        outputs.warn(FaultNumber.STALLED, detail)
        if outputs.reason is None:
            outputs.reason = reason

    def _rest(self) -> int:
        """Without a function: Halt while the axis turns, and until the next function if it turns again without Halt."""
        if self._rested and self._turns and self._mode.shows_base():
            self._stopped_by_halt = _CONTINUED
        if not self._stays_halted() and self._rests:
            if self._halted and self._shows_reached:
                self._stopped_by_halt = _ENDED
            self._rested = True
            return 0
        return self._halt()

    def _halt(self) -> int:
        """Halt stops the setpoint."""
        effect, mode = self._effect, self._mode
        if self._stopped_by_halt is _NONE:
            self._stopped_by_halt = _UNMOVED if effect.awaited and mode.shows_base() else _STOPPED
        if not mode.halted:
            effect.command(self.inputs.now)
        return HALT

    def _execute(self, before: State, reason: Reason | None) -> int:
        """Controlword bits 4-12 of the requested motion. ``before``: the positioner's state before this step; ``reason``: why
        nothing moves."""
        raise NotImplementedError

    def _stop(self) -> None:
        """Not in operation: the present setpoint is cancelled, and a waiting one is never sent."""
        self._seen.given = self.positioner.course.motion.serial
        self._effect.withdraw()
        self._end_set_point()
        self._end_stopped_setpoint()
        self._mode.abandon()
        self._forget_homing()
        self.command.target_velocity = 0

    def _forget_homing(self) -> None:
        """No homing is running, and none has ended that is still requested."""
        self._attained = 0
        self._seen.homing = HomingResult.RUNNING
        self.homing.abandon()

    def _end_set_point(self) -> None:
        """The handshake is over: whether the drive has acknowledged makes no more difference."""
        seen = self._seen
        seen.taken = seen.executing = seen.given
        self._set_at = -1
        self._acknowledged = False
        self._bits = 0
        self._arrival.command(self.inputs.now)

    def _set_point(self, target: int, velocity: int, bits: int) -> None:
        """The handshake begins with this target; the last unit may end beyond what the object can hold."""
        self._last_velocity = self.command.profile_velocity
        self.command.profile_velocity = velocity
        low, high = self._target_range
        self.command.target_position = max(low, min(target, high))
        self._bits = bits
        self._set_at = self.inputs.now
        self._effect.command(self.inputs.now)
        self._taking.command(self.inputs.now, level=True)
        self._end_stopped_setpoint()

    @property
    def _acknowledges(self) -> bool:
        """The drive shows the acknowledge of a setpoint."""
        return self.feedback.statusword & ACKNOWLEDGED != 0 and self._mode.shows_base()

    @property
    def _free(self) -> bool:
        """The drive takes a setpoint: it has cleared the last acknowledge, and none can come for a cancelled one."""
        return not self._acknowledges and self._taking.due(self.inputs.now)

    def _read_acknowledge(self) -> bool:
        """Read whether the drive has taken the setpoint."""
        if not self._acknowledges:
            self._await_acknowledge()
            return False
        self._seen.taken = self._seen.given
        self._acknowledged = True
        positioner = self.positioner
        if positioner.course.warning is Reason.NOT_ACKNOWLEDGED:
            positioner.warn(None)
            self.outputs.end_warnings(_NOT_ACKNOWLEDGED)
        return True

    def _end_stopped_setpoint(self) -> None:
        """The drive has no stopped setpoint any more."""
        self._stopped_by_halt = _NONE
        self._rested = False
        self.outputs.end_warnings(_MOVES)

    def _stays_halted(self) -> bool:
        """Without a function: whether the drive continues what Halt has stopped, with a warning."""
        positioner, outputs = self.positioner, self.outputs
        if self._continued and not self._moved and self._turns:
            positioner.warn(None)
            outputs.warn(FaultNumber.MOVES_UNASKED, f"speed {self.feedback.velocity_actual}")
        if self._moved and positioner.course.warning is None:
            positioner.warn(Reason.MOVES_UNASKED)
        return self._continued or self._stopped_by_halt is _UNMOVED

    def _released(self) -> bool:
        """Halt has stopped a setpoint and has fallen: a drive that continues gets the next setpoint or mode at once."""
        return self._halted and not self._mode.halted and self._mode.shows_base()

    def _continues_in_base_mode(self) -> bool:
        """The drive does not take another mode, and continues what Halt has stopped: Halt stays until it takes the mode."""
        mode = self._mode
        other_asked = self._halted and mode.mode != mode.base
        return other_asked and mode.shows_base() and (mode.halted or not self.stopped)

    def _await_acknowledge(self) -> None:
        """The drive has not taken the setpoint: a warning after ``ACKNOWLEDGE_NS``."""
        statusword, positioner, inputs = self.feedback.statusword, self.positioner, self.inputs
        waits = not self._bits & ControlBit.CHANGE_IMMEDIATELY and not statusword & StatusBit.TARGET_REACHED
        if waits or self._mode.halted:
            self._set_at = inputs.now  # a drive may take it at the end of the motion (one buffer), or of Halt
        elif (
            inputs.now - self._set_at >= ACKNOWLEDGE_NS
            and positioner.course.warning is not Reason.NOT_ACKNOWLEDGED
            and not inputs.set_point_refused
        ):
            positioner.warn(Reason.NOT_ACKNOWLEDGED)
            detail = f"607Ah = {self.command.target_position}, Statusword {statusword:04X}h, "
            detail += f"6061h = {self.feedback.modes_of_operation_display} after {ACKNOWLEDGE_NS / SECOND:g} s"
            self.outputs.warn(FaultNumber.NOT_ACKNOWLEDGED, detail)

    def _replaces(self, motion: Motion, given: int) -> bool:
        """Another task than that of the setpoint ``given`` waits, and the drive does not take this setpoint any more.

        A new setpoint of the same task does not count: its edge would be a second one.
        """
        if motion.first <= given:
            return False
        return self.inputs.now - self._set_at >= ACKNOWLEDGE_NS or self.inputs.set_point_refused

    def _home(self, motion: Motion, method: int, speed: int | None) -> int:
        """Controlword bits of a homing: the drive takes method and speeds, confirms the mode, and homes."""
        seen, homing = self._seen, self.homing
        self._ring.reset()
        if seen.given != motion.serial:
            self._begin_homing(motion)
            homing.begin(method, speed)
            return self._halt_before_homing()
        if seen.taken == motion.serial:
            progress = homing.run()
            if progress is HomingResult.ATTAINED:
                self._attained += 1
                if self._attained == 1:
                    self._attained_at = self.inputs.now
                if self._attained > self.POSITION_FOLLOWS and self._position_follows(self._attained_at):
                    self._homing_ends(HomingResult.ATTAINED)
            elif progress is HomingResult.FAILED:
                self._homing_ends(HomingResult.FAILED)
                return 0
            return NEW_SETPOINT
        progress = homing.prepare()
        if progress is HomingResult.FAILED:
            self._homing_ends(progress)
        elif progress is HomingResult.READY:
            seen.taken = seen.executing = motion.serial
            # The drive has left the mode of the stopped setpoint. Halt would end CW.4, whose next rise is a second start.
            self._end_stopped_setpoint()
            return NEW_SETPOINT
        return self._halt_before_homing()

    def _position_follows(self, time: int) -> bool:
        """The position was requested after ``time`` (monotonic ns), as far as it is read by SDO."""
        asked = self.inputs.position_asked_ns
        return not asked or asked > time

    def _halt_before_homing(self) -> int:
        """Halt stays until the mode has to change, and rises again if the drive continues what Halt has stopped."""
        mode = self._mode
        return self._halt() if self._halted and (mode.halted or self._continued) and not mode.asked else 0

    def _begin_homing(self, motion: Motion) -> None:
        self._forget_homing()
        self._seen.given = motion.serial

    def _homing_ends(self, result: HomingResult) -> None:
        seen = self._seen
        seen.homing = result
        seen.taken = seen.executing = seen.given
