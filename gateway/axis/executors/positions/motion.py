"""A positioner's motions on a drive, as far as all telegrams with tasks have them.

Source: docs/motion.md, docs/translation.md. A motion starts by CW.4, which rises for a setpoint that was not given yet
(``handshake``) and, here, for a homing whose method the drive has taken; never with the fall of Halt, nor before the drive shows
the mode.
"""

from __future__ import annotations

from typing import ClassVar, Final

from pdgw.dsp402.acting import HALT_SWITCHES_OFF, TURNS_ROUND
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.demand_report import STATE_MASK, MotionDemand, Report
from pdgw.gateway.axis.executors.executor import AT_LIMIT, AT_LIMIT_TEXT, OPERATION_ENABLED, AxisRecords, Executor
from pdgw.gateway.axis.executors.positions.drive_positions import DrivePositions
from pdgw.gateway.axis.executors.positions.halt import HALT, Halt
from pdgw.gateway.axis.executors.positions.handshake import NEW_SETPOINT, Handshake
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
_TARGET_REACHED: Final = StatusBit.TARGET_REACHED
_STALLED: Final = warning_bits(FaultNumber.STALLED)


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
        self._seen = positioner.seen
        self._mode = ModeSwitch(self, base)
        self._modulo = modulo
        self.homing = Homing(self, self._mode)
        self._handshake = Handshake(self, self._mode, positioner)
        self._halt = Halt(self, self._mode, self._handshake, positioner)
        self.command.modes_of_operation = self._mode.mode
        self._positions = DrivePositions()
        self._ring = self._positions.ring()
        """Counts the drive's position over its wraps."""
        self._bounded = False
        """The configuration limits the positions."""
        self._window = 0
        """Position units: at this distance from its target a task has ended."""
        self._stall = Stall(self.settings.stall_ns)
        self._homing_since = 0
        """Begin of the last homing, monotonic ns."""
        self._home_lost = 0
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
        before, self._positions = self._positions, DrivePositions.of(drive)
        ring = self._ring_of(self._positions)
        if (ring.low, ring.size) != (self._ring.low, self._ring.size):
            self._ring = ring
            self._forget_home()
        if self._positions.differs(before):
            self._forget_home()
        if self._range_line:
            self.outputs.happened().log_lines.append(self._range_line)

    def _ring_of(self, positions: DrivePositions) -> Ring:
        """The ring for the position of this drive."""
        return positions.ring()

    @property
    def _unconfirmed(self) -> str:
        """That only the profile says that the drive wraps at 607Bh, and it has not done so yet; empty: it is confirmed."""
        return self._positions.unconfirmed(self._ring)

    @property
    def range_note(self) -> str:
        return self._unconfirmed

    @property
    def _range_line(self) -> str:
        """The same for the log, and how far the drive is from the ends of its positions."""
        ends = "" if self._bounded else self._positions.ends_text(self.feedback.position_actual)
        return ends or self._unconfirmed

    @property
    def homes_since(self) -> int:
        return self._homing_since if self.positioner.state is _HOMING else 0

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
        command, mode = self.command, self._mode
        if mode.mode != mode.base:
            return (command.target_velocity, command.target_velocity) if mode.mode == _VELOCITY_MODE else None
        if not self._positions.has_velocity or command.controlword & HALT:
            return None
        highest = self._handshake.highest_velocity()
        return -highest, highest

    def refuse(self) -> Report:
        self._stop()
        self._seen.bits = 0
        self.command.controlword = self.interlock.controlword
        self.positioner.step(NOTHING, self.inputs.now)
        return self.report.fill_motion(self.interlock.reason)

    def sdo_done(self, error: str | None) -> None:
        self.homing.answered(error)

    def _stop_reached(self, request: PositionerRequest) -> bool:
        """An intermediate stop of a traversing task has ended, and is shown so. With setting up, "target reached" may be that of
        its speed."""
        if not self.settings.intermediate_stop_reached:
            return False
        if not self._seen.bits & Seen.OPERATING or request.commands & _NO_STOP_OF_A_TASK:
            return False
        return self._halt.axis_stopped and (self._mode.shows_base() or self.feedback.velocity_actual == 0)

    def _cycle(self) -> Reason | None:
        """Run one cycle: state of the axis, commands, Controlword and mode. Returns why nothing moves just now."""
        interlock, mode, seen, positioner, inputs = self.interlock, self._mode, self._seen, self.positioner, self.inputs
        handshake, halt, outputs = self._handshake, self._halt, self.outputs
        action, before, statusword = interlock.cell.action, positioner.state, self.feedback.statusword
        operates = action is _ENABLE_OPERATION and OPERATION_ENABLED[statusword & STATE_MASK]
        bits = 0
        if operates:
            outputs.reason = None
            bits = _OPERATING
        elif self._asked.connected and self._asked.in_control:
            bits = Seen.ASKED
        mode.read()
        handshake.taking.read(handshake.shown, inputs.now)
        if halt.awaits_reached:
            halt.read_reached()
        if inputs.standstill:
            if inputs.position_follows(self._turned_at):
                bits |= _STANDSTILL
        else:
            self._turned_at = inputs.now
            if not inputs.standstill_unknown:
                bits |= Seen.TURNS
                halt.note_turning()
        if statusword & _INTERNAL_LIMIT:
            bits |= Seen.INTERNAL_LIMIT
        seen.bits = bits | self._read_state()
        reason = positioner.step(self._asked.motion, inputs.now)
        if before is not _HOMING and positioner.state is _HOMING:
            self._homing_since, self._home_lost = inputs.now, 0
        if positioner.course.held is _TASK_AT_LIMIT:
            outputs.warn(FaultNumber.INTERNAL_LIMIT, AT_LIMIT_TEXT)
        elif outputs.warned:
            outputs.end_warnings(AT_LIMIT)
        handshake.blocked = 0
        if operates:
            mode.asked = False
            halt.watch()
            extra = self._execute(before, reason)
            if not mode.asked and mode.since >= 0:
                mode.cease()
            mode.halted = extra & HALT != 0
            self._report_stall()
        else:
            ramps = action in _RAMPS
            mode.halted = mode.halted or ramps  # the mode does not change while Halt is set
            self._stop()
            mode.halted = ramps
            extra = halt.begin() if ramps else 0
            outputs.end_warnings(_STALLED)
        if not handshake.blocked:
            handshake.blocked_at = inputs.now
        if before is _HOMING and positioner.state is not _HOMING:
            self._forget_homing()
        self.command.controlword = interlock.controlword | extra
        self.command.modes_of_operation = mode.mode
        return reason

    def _read_state(self) -> int:
        """Read the state of the drive. Returns bits of ``Seen``."""
        raise NotImplementedError

    def _read_arrival(self, *, executes: bool) -> int:
        """Read "target reached"; ``executes``: the drive works on the newest setpoint. Returns bits of ``Seen``."""
        if not executes or not self._mode.shows_base():
            return 0
        inputs, shown = self.inputs, self.feedback.statusword & _TARGET_REACHED != 0
        if not shown:
            self._reaches_at = inputs.now
        known = inputs.position_follows(self._reaches_at) and not inputs.position_old
        reached = shown and known and not (self._waits_for_motion or self._ends_short())
        bits = Seen.REACHED if reached else 0
        return bits | Seen.ANSWERED if self._handshake.arrival.read(reached, inputs.now) else bits

    @property
    def _waits_for_motion(self) -> bool:
        """A relative setpoint has not moved the axis half of its way yet: what the drive shows can be older than it."""
        course = self.positioner.course
        distance = course.motion.goal.distance
        waits = distance is not None and 2 * abs(course.way) > abs(distance)
        return waits and not self._handshake.arrival.due(self.inputs.now)

    def _ends_short(self) -> bool:
        """The drive is at an end of its positions, and away from its target."""
        limits, inputs = self._positions.scaling.position_range, self.inputs
        if limits is None or not inputs.standstill or (self._positions.ends is None and not self._unconfirmed):
            return False
        (low, high), raw, near, course = limits, self.feedback.position_actual, self._window, self.positioner.course
        return not low + near < raw < high - near and abs(course.way) > (course.window or 0)

    def _report_stall(self) -> None:
        """An axis at standstill before the end of its motion has a reason, and a warning once."""
        inputs, outputs, statusword, handshake = self.inputs, self.outputs, self.feedback.statusword, self._handshake
        reason: Reason | None = None
        if handshake.blocked and handshake.shown and inputs.standstill:
            reason = Reason.SETPOINT_BLOCKED
        elif self._seen.taken == self._seen.given and self.positioner.course.expects_end():
            following_error = statusword & StatusBit.MODE_13 and self._mode.shows_base()
            missing = Reason.FOLLOWING_ERROR if following_error else Reason.NOT_REACHED
            reason = Reason.STANDS_AWAY if statusword & _TARGET_REACHED else missing
        position = self.feedback.position_actual
        if not self._stall.step(reason is not None, position, inputs.now) or reason is None:
            if outputs.warned:
                outputs.end_warnings(_STALLED)
            return
        detail = f"{reason.value}, 6064h = {position}, 607Ah = {self.command.target_position}"
        outputs.warn(FaultNumber.STALLED, ", ".join(filter(None, (detail, self._unconfirmed))))
        if outputs.reason is None:
            outputs.reason = reason

    def _execute(self, before: State, reason: Reason | None) -> int:
        """Controlword bits 4-12 of the requested motion. ``before``: the positioner's state before this step; ``reason``: why
        nothing moves."""
        raise NotImplementedError

    def _stop(self) -> None:
        """Not in operation: the present setpoint is cancelled, and a waiting one is never sent."""
        self._seen.given = self.positioner.course.motion.serial
        self._halt.effect.withdraw()
        self._handshake.end()
        self._halt.end()
        self._mode.abandon()
        self._forget_homing()
        self.command.target_velocity = 0

    def _forget_homing(self) -> None:
        """No homing is running, and none has ended that is still requested."""
        self._seen.homing = HomingResult.RUNNING
        self.homing.abandon()

    def _set_point(self, target: int, velocity: int, bits: int) -> None:
        """The handshake begins with this target; the last unit may end beyond what the object can hold."""
        low, high = self._positions.targets
        self._handshake.begin(max(low, min(target, high)), velocity, bits)
        self._halt.replaced()

    def _home(self, motion: Motion, method: int, speed: int | None) -> int:
        """Controlword bits of a homing: the drive takes method and speeds, confirms the mode, and homes."""
        seen, homing, halt = self._seen, self.homing, self._halt
        self._ring.reset()
        if seen.given != motion.serial:
            self._begin_homing(motion)
            homing.begin(method, speed)
            return halt.before_homing()
        if seen.taken == motion.serial:
            progress = homing.end(self.POSITION_FOLLOWS)
            if progress is not HomingResult.RUNNING:
                self._homing_ends(progress)
            return 0 if progress is HomingResult.FAILED else NEW_SETPOINT
        progress = homing.prepare()
        if progress is HomingResult.FAILED:
            self._homing_ends(progress)
        elif progress is HomingResult.READY:
            seen.taken = seen.executing = motion.serial
            # The drive has left the mode of the stopped setpoint. Halt would end CW.4, whose next rise is a second start.
            halt.end()
            return NEW_SETPOINT
        return halt.before_homing()

    def _begin_homing(self, motion: Motion) -> None:
        self._forget_homing()
        self._seen.given = motion.serial

    def _homing_ends(self, result: HomingResult) -> None:
        seen = self._seen
        seen.homing = result
        seen.taken = seen.executing = seen.given
