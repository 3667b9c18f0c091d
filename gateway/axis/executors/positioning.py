"""Profile position: traversing tasks (6060h = 1, -5 on a modulo axis), and homing between them.

Source: docs/translation.md "Positioning, telegram 9 (MDI)"; the manufacturer's guide 5.2 and 6.7-6.14. Sub-states, as in the
positioning diagram of the guide; each is a method that returns Controlword bits 4-12:

| sub-state | left when |
| --- | --- |
| IDLE | a task's edge, a homing's edge |
| TASK | target reached, reject, intermediate stop, homing |
| INTERMEDIATE | the intermediate stop ends (it resumes; after a limit switch only with an edge), reject, homing |
| BRAKING | standstill: Halt is cleared, then IDLE or homing |
| HOMING_SETUP | the drive took method and speeds, and confirmed mode 6 |
| HOMING | attained, error, or no longer asked for |
| HOMED, HOMING_FAILED | homing is no longer asked for |
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, replace

from pdgw.ds301.objects import CanType
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, StatusBit
from pdgw.gateway.axis.demand_report import STATE_MASK, Flag, Task
from pdgw.gateway.axis.executors.base import OPERATION_ENABLED, AxisCycle, Executor, LimitWatch
from pdgw.gateway.axis.executors.homing import Homing, Progress
from pdgw.gateway.axis.executors.mode import ModeSwitch
from pdgw.gateway.axis.executors.task_scaling import TaskScaling, base_mode
from pdgw.gateway.axis.power_table import Action
from pdgw.gateway.motion.modulo import Direction
from pdgw.gateway.reasons import Reason

_HALT = ControlBit.HALT
_NEW_SETPOINT = ControlBit.NEW_SETPOINT
_ACKNOWLEDGED, _TARGET_REACHED = StatusBit.MODE_12, StatusBit.TARGET_REACHED
_ENABLE_OPERATION, _RAMP, _RAMP_END = Action.ENABLE_OPERATION, Action.RAMP, Action.RAMP_END
_STANDING, _REACHED = Flag.STANDING, Flag.REACHED
_HOME_SET, _TASK_ACKNOWLEDGED = Flag.HOME_SET, Flag.TASK_ACKNOWLEDGED


class SubState(enum.Enum):
    """See the module's table."""

    IDLE = "MDI idle"
    TASK = "traversing task active"
    INTERMEDIATE = "intermediate stop"
    BRAKING = "braking"
    HOMING_SETUP = "homing being prepared"
    HOMING = "homing running"
    HOMED = "homing finished"
    HOMING_FAILED = "homing failed"


_IDLE, _TASK = SubState.IDLE, SubState.TASK
_IN_HOMING = (SubState.HOMING_SETUP, SubState.HOMING, SubState.HOMED, SubState.HOMING_FAILED)
_SHOWS_REACHED = (SubState.IDLE, SubState.HOMED)


@dataclass(frozen=True, slots=True)
class DriveTask:
    """A traversing task in the drive's units, taken with its edge."""

    target: int
    velocity: int
    acceleration: int
    deceleration: int
    bits: int
    """Controlword bits 5 and 6, and those of a turntable."""
    absolute_target: int | None
    """Where the task ends, for the resume; None for a relative task that was not given to the drive yet."""


@dataclass(frozen=True, slots=True)
class _Homing:
    """A homing with the data of its edge, the velocity as a fraction."""

    method: int
    velocity: int


class PositioningExecutor(Executor):
    """Tasks to profile position mode, homing to homing mode, with the hand-shakes of both sides."""

    def __init__(self, cycle: AxisCycle) -> None:
        super().__init__(cycle)
        self.sub_state = SubState.IDLE
        self._turntable = self.settings.modulo_axis
        self._turn_bits = dict.fromkeys(Direction, 0)
        """Of the Controlword, for the direction of a turntable."""
        self._mode = ModeSwitch(cycle, Mode.POSITION.value)
        self.homing = Homing(cycle, self._mode)
        self.command.modes_of_operation = self._mode.mode
        self._scaling: TaskScaling | None = None
        self._positions = CanType.I32.integer_range
        """What 607Ah can hold."""
        self._task: DriveTask | None = None
        self._taken = False
        """The drive has acknowledged the task (SW.12)."""
        self._pending: DriveTask | None = None
        self._setpoint_bit = False
        self._next_homing: _Homing | None = None
        """What follows the standstill."""
        self._braking_reason: Reason | None = None
        self._limit = LimitWatch()
        self._refused: Reason | None = None
        """Why the last edge started nothing; until the next one, a reject, or the end of operation."""
        self._at_limit = False
        """The intermediate stop is not the PLC's: a limit of the drive stopped the task."""

    def set_drive(self, drive: DriveType, homing_method: int) -> None:
        self._mode.rebase(base_mode(drive, modulo=self._turntable))
        turntable = drive.quirks.turntable
        if turntable is not None:
            self._turn_bits[Direction.SHORTEST] = turntable.shortest
            self._turn_bits[Direction.NEGATIVE] = turntable.ccw
        self.homing.method = homing_method
        self.homing.methods = frozenset(drive.homing_methods)
        self._positions = drive.limits("target_position")
        self._scaling = TaskScaling.of(drive)

    def restarted(self) -> None:
        self.homing.home_set = False

    def lost(self) -> None:
        self.homing.home_set = False

    def recall(self, *, home_set: bool) -> None:
        self.homing.home_set = home_set

    def refuse(self) -> None:
        self.command.controlword = self.cycle.controlword
        report = self.report
        report.position = report.homing_method = 0
        report.tasks_active = False

    def sdo_done(self, error: str | None) -> None:
        self.homing.answered(error)

    def step(self) -> Reason | None:
        cycle, scaling = self.cycle, self._scaling
        reason = cycle.reason
        if scaling is None:
            return reason
        action, demand, feedback = cycle.action, cycle.demand, cycle.feedback
        statusword = feedback.statusword
        mode = self._mode
        extra = 0
        flags = _STANDING if cycle.standstill else 0
        operates = action is _ENABLE_OPERATION
        if operates and OPERATION_ENABLED[statusword & STATE_MASK]:
            self.notes.forget()
            extra = self._operate(scaling)
            reason = self.notes.reason
            if self._refused is not None:
                if demand.reject and self._refused is not Reason.REJECTED:
                    self._refused = None
                elif reason is None or reason is Reason.MDI_OFF:
                    reason = self._refused
            if self.sub_state in _SHOWS_REACHED:
                flags |= _REACHED
            mode.halted = extra & _HALT != 0
        elif action is _RAMP or action is _RAMP_END:
            mode.halted = True  # the mode stays what it is while Halt is set
            self._drop()
            extra = _HALT
        else:
            self._drop()
            mode.halted = False
        command = self.command
        command.controlword = cycle.controlword | extra
        command.modes_of_operation = mode.mode
        report = self.report
        if self.homing.home_set:
            flags |= _HOME_SET
        if self.sub_state not in _IN_HOMING:
            if statusword & _ACKNOWLEDGED and mode.shows_base():
                flags |= _TASK_ACKNOWLEDGED
            enabled = operates or action is _RAMP
            report.tasks_active = enabled and demand.connected and demand.tasks_selected
        report.flags = flags
        report.homing_method = self.homing.method
        report.position = scaling.position.to_wire(feedback.position_actual)
        return reason

    def _operate(self, scaling: TaskScaling) -> int:
        sub_state = self.sub_state
        if sub_state is _TASK:
            return self._traversing(scaling)
        if sub_state is _IDLE:
            return self._idle(scaling)
        if sub_state is SubState.INTERMEDIATE:
            return self._intermediate(scaling)
        if sub_state is SubState.BRAKING:
            return self._braking(scaling)
        if sub_state is SubState.HOMING_SETUP:
            return self._homing_setup()
        if sub_state is SubState.HOMING:
            return self._homing()
        return self._homing_over(scaling)

    def _drop(self) -> None:
        """Not in operation: task, handshake and homing are over; the next edge starts anew."""
        self.sub_state = _IDLE
        self._forget_tasks()
        self._refused = None
        self.homing.give_up()
        self._mode.give_up()

    def _forget_tasks(self) -> None:
        self._task = self._pending = None
        self._setpoint_bit = False
        self._limit.reset()

    # -- traversing tasks -----------------------------------------------------------------------------------------

    def _convert(self, task: Task, scaling: TaskScaling) -> DriveTask:
        limited = self.notes.limited
        bits = ControlBit.CHANGE_IMMEDIATELY
        if task.relative:
            bits |= ControlBit.RELATIVE
            target = limited(scaling.relative, task.target)
        else:
            target = limited(scaling.position, task.target)
            if self._turntable:
                bits |= self._turn_bits[task.direction]
        velocity = limited(scaling.velocity, task.velocity)
        acceleration = limited(scaling.acceleration, task.acceleration)
        deceleration = limited(scaling.deceleration, task.deceleration)
        return DriveTask(
            target,
            velocity,
            min(acceleration, deceleration) if scaling.one_ramp else acceleration,
            deceleration,
            bits,
            None if task.relative else target,
        )

    def _latch(self, scaling: TaskScaling) -> None:
        """The edge of a task with everything else given becomes a task with the data of its frame; any other starts nothing."""
        demand = self.cycle.demand
        task = demand.task
        if task is None:
            return
        if not demand.tasks_selected:
            self._refused = Reason.MDI_OFF
        elif demand.reject:
            self._refused = Reason.REJECTED
        elif demand.intermediate_stop and self.sub_state is not SubState.INTERMEDIATE:
            self._refused = Reason.INTERMEDIATE_STOP
        else:
            self._capture(task, scaling)

    def _capture(self, task: Task, scaling: TaskScaling) -> None:
        """A task with a speed replaces what waits."""
        converted = self._convert(task, scaling)
        if converted.velocity:
            self._pending = converted
            self._refused = None
        else:
            self._refused = Reason.TASK_SPEED_ZERO

    def _handshake(self) -> None:
        """CW.4: raised for a pending task once the drive took the last one back, lowered when its wish has fallen."""
        feedback = self.cycle.feedback
        acknowledged = feedback.statusword & _ACKNOWLEDGED != 0 and self._mode.shows_base()
        if self._setpoint_bit:
            if acknowledged:
                self._taken = True
            if self._taken and (not self.cycle.demand.activate or self._pending is not None):
                self._setpoint_bit = False
            return
        pending = self._pending
        if pending is None or acknowledged or self._mode.halted:
            return
        if not self._mode.confirmed(self._mode.base):
            return
        if pending.absolute_target is None:
            target = self._in_range(feedback.position_actual + pending.target)
            pending = replace(pending, absolute_target=target)
        self._pending = None
        self._task = pending
        self._taken = False
        self._setpoint_bit = True
        command = self.command
        command.target_position = pending.target
        command.profile_velocity = pending.velocity
        command.profile_acceleration = pending.acceleration
        command.profile_deceleration = pending.deceleration

    def _in_range(self, position: int) -> int:
        """A computed position as an object can hold it: a modulo axis turns on past the end, any other ends there."""
        lowest, highest = self._positions
        if self._turntable:
            return (position - lowest) % (highest - lowest + 1) + lowest
        return min(max(position, lowest), highest)

    def _bits(self) -> int:
        """Controlword bits 4-6, and those of a turntable, of the task in force."""
        task = self._task
        return (task.bits if task is not None else 0) | (_NEW_SETPOINT if self._setpoint_bit else 0)

    def _idle(self, scaling: TaskScaling) -> int:
        homing = self._homing_asked()
        if homing is not None:
            return self._begin_homing(homing, scaling)
        self._latch(scaling)
        if not self.cycle.demand.tasks_selected:
            self.notes.reason = Reason.MDI_OFF
        self._handshake()
        untaken = self._setpoint_bit and not self._taken
        if untaken or self._pending is not None:
            self.sub_state = SubState.TASK
        elif self._mode.mode != self._mode.base:
            self._mode.confirmed(self._mode.base)
        return self._bits()

    def _ends(self) -> bool:
        """Whether tasks are rejected, or not selected any more; the reason is noted."""
        demand = self.cycle.demand
        if demand.reject:
            self.notes.reason = Reason.REJECTED
        elif not demand.tasks_selected:
            self.notes.reason = Reason.MDI_OFF
        else:
            return False
        return True

    def _traversing(self, scaling: TaskScaling) -> int:
        cycle = self.cycle
        if self._ends():
            return self._brake(None)
        homing = self._homing_asked()
        if homing is not None:
            return self._brake(homing)
        if cycle.demand.intermediate_stop:
            return self._interrupt(scaling)
        self._latch(scaling)
        before = self._task
        self._handshake()
        finished = self._taken and self._pending is None
        if finished and cycle.feedback.statusword & _TARGET_REACHED:
            self.sub_state = SubState.IDLE
        elif self._limit.step(self._pending is None and self._task is before, cycle):
            self._at_limit = True
            return self._interrupt(scaling)
        return self._bits()

    def _interrupt(self, scaling: TaskScaling) -> int:
        self.sub_state = SubState.INTERMEDIATE
        self._keep_newest()
        return self._intermediate(scaling)

    def _keep_newest(self) -> None:
        """A task the drive has not taken is the one to resume with; its own Controlword edge never comes."""
        if self._pending is not None:
            self._task, self._pending = self._pending, None
            self._setpoint_bit = False

    def _intermediate(self, scaling: TaskScaling) -> int:
        demand = self.cycle.demand
        if self._ends():
            return self._brake(None)
        homing = self._homing_asked()
        if homing is not None:
            return self._brake(homing)
        self._handshake()
        if demand.intermediate_stop:
            self._at_limit = False
            self._latch(scaling)
            self._keep_newest()
            self.notes.reason = Reason.INTERMEDIATE_STOP
            return _HALT | self._bits()
        self._latch(scaling)
        task, new = self._task, self._pending
        if self._at_limit and new is None:
            self.notes.reason = Reason.TASK_AT_LIMIT
            return _HALT | self._bits()
        # Halt and CW.4 fall in this Controlword, CW.4 rises in a later one: the two together are not allowed.
        self._forget_tasks()
        self._pending = self._resumed(task) if new is None and task is not None else new
        self.sub_state = SubState.TASK
        return 0

    def _resumed(self, task: DriveTask) -> DriveTask:
        """The rest of an interrupted task: to its original target, absolute where the axis has no modulo."""
        end = task.absolute_target
        if end is None:
            return task
        if task.bits & ControlBit.RELATIVE and self._turntable:
            return replace(task, target=self._in_range(end - self.cycle.feedback.position_actual))
        return replace(task, target=end, bits=task.bits & ~ControlBit.RELATIVE)

    def _brake(self, then: _Homing | None) -> int:
        self.sub_state = SubState.BRAKING
        self._forget_tasks()
        self._next_homing = then
        self._braking_reason = self.notes.reason
        return _HALT

    def _braking(self, scaling: TaskScaling) -> int:
        """Halt is kept to standstill and then cleared without a restart."""
        demand = self.cycle.demand
        self._next_homing = self._homing_asked() or (self._next_homing if demand.homing else None)
        self.notes.reason = self._braking_reason
        self._latch(scaling)
        if demand.reject or not demand.tasks_selected:
            self._pending = None
        if not self.cycle.stopped:
            return _HALT
        if self._next_homing is not None:
            return self._begin_homing(self._next_homing, scaling)
        self.sub_state = SubState.IDLE if self._pending is None else SubState.TASK
        return 0

    # -- homing ---------------------------------------------------------------------------------------------------

    def _homing_asked(self) -> _Homing | None:
        """The edge of a homing with a supported method; anything else raises the warning and starts nothing."""
        demand, notes = self.cycle.demand, self.notes
        if not demand.homing:
            if self.sub_state is SubState.IDLE:
                notes.warning = False
        elif demand.homing_edge:
            if self.homing.supported(demand.homing_method):
                return _Homing(demand.homing_method, demand.homing_velocity)
        elif notes.warning:
            notes.reason = Reason.HOMING_METHOD
        return None

    def _begin_homing(self, wanted: _Homing, scaling: TaskScaling) -> int:
        self.sub_state = SubState.HOMING_SETUP
        self.homing.begin(wanted.method, self.notes.limited(scaling.velocity, wanted.velocity))
        return 0

    def _homing_setup(self) -> int:
        if not self.cycle.demand.homing:
            self._drop()
            return 0
        progress = self.homing.prepare()
        if progress is Progress.FAILED:
            self.sub_state = SubState.HOMING_FAILED
        elif progress is Progress.READY:
            self.sub_state = SubState.HOMING
            return _NEW_SETPOINT
        return 0

    def _homing(self) -> int:
        if not self.cycle.demand.homing:
            self.notes.reason = Reason.HOMING_STOPPED
            return self._brake(None)
        progress = self.homing.run()
        if progress is Progress.FAILED:
            self.sub_state = SubState.HOMING_FAILED
            return 0
        if progress is Progress.ATTAINED:
            self.sub_state = SubState.HOMED
        return _NEW_SETPOINT

    def _homing_over(self, scaling: TaskScaling) -> int:
        if self.cycle.demand.homing:
            if self.sub_state is SubState.HOMED:
                return _NEW_SETPOINT
            self.notes.reason = Reason.HOMING_ERROR
            return 0
        self._drop()
        return self._idle(scaling)
