"""Basic positioner of telegrams 7, 110 and 111: computes the motion from the request and the state of the axis.

Source: basic positioners of public drive manuals (docs/motion.md). Sans-I/O: one ``step`` per cycle, values and monotonic
nanoseconds in, the motion of its course and the reason why nothing moves out. ``states.TRANSITIONS`` has the states. Not here:
cams, homing direction, and handshakes and mode changes of the drive (executors).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import BlockTable
from pdgw.gateway.motion.chain import BlockChain
from pdgw.gateway.motion.function_orders import Jogs, Stage
from pdgw.gateway.motion.modulo import Direction
from pdgw.gateway.motion.passive_homing import PassiveHoming, Progress
from pdgw.gateway.motion.positioner import ACTIVATE, HOME, RISING, SELECTABLE, Positioner
from pdgw.gateway.motion.positioner_task import Acknowledge, Task, captured
from pdgw.gateway.motion.positioner_words import (
    FUNCTION_BITS,
    HOMING_SHOWN,
    OUTPUT_1,
    PASSIVE_HOMING_SHOWN,
    RUNNING_BITS,
    limit_bits,
    second_word,
)
from pdgw.gateway.motion.requests import (
    FULL,
    Command,
    HomingResult,
    PositionerChoices,
    PositionerFeedback,
    PositionerRequest,
    Seen,
)
from pdgw.gateway.motion.states import JOG_STATES, JOGS, TASK_STATES, TRANSITIONS, Action, Event, State
from pdgw.gateway.motion.user_course import UserCourse

SHOWN_NS: Final = 100 * MS
"""Minimum time of POS_ZSW1.11 = 1 for homing and a set reference point, because masters poll it."""
_DO_NOT_REJECT, _MDI_SELECTED, _ABSOLUTE = Command.DO_NOT_REJECT, Command.MDI, Command.ABSOLUTE
_NO_INTERMEDIATE_STOP, _SETTING_UP_SELECTED = Command.NO_INTERMEDIATE_STOP, Command.SETTING_UP
_JOG_INCREMENTAL, _TRACKS = Command.JOG_INCREMENTAL, Command.TRACKING
_SOFTWARE_LIMITS, _HARDWARE_LIMITS = Command.SOFTWARE_LIMITS, Command.HARDWARE_LIMITS
_PASSIVE_HOMING: Final = Command.PASSIVE_HOMING
_REFER: Final = Command.SET_REFERENCE_POINT
_UNDER_ORDERS: Final = Seen.OPERATING | Seen.ASKED
_UPDATES: Final = Command.CONTINUOUS_UPDATE | ACTIVATE
_KEPT = frozenset({State.MDI, State.SETTING_UP, State.BLOCK})
"""Functions an intermediate stop keeps, and an edge during it replaces."""
_STANDSTILL, _WAITS = Seen.STANDSTILL, Stage.WAITS
_FUNCTION = {Event.MDI: State.MDI, Event.SETTING_UP: State.SETTING_UP, Event.BLOCK: State.BLOCK}
_OFF, _IDLE, _MDI, _SETTING_UP = State.OFF, State.IDLE, State.MDI, State.SETTING_UP
_HOMING, _TRACKING = State.HOMING, State.TRACKING
_BLOCK_TASK = Event.BLOCK
_WITHOUT_MOTION = (State.OFF, State.IDLE, State.TRACKING)
"""Nothing moves the axis: its reference point may be set."""
_WITHOUT_REFERENCE: Final = (Reason.REFERENCE_POINT_MOVING, Reason.PASSIVE_HOMING_NOT_SUPPORTED)
"""Warnings of an order for a reference point; the next one that is carried out ends them."""
_NOT_OWED, _SHOWN = Acknowledge.NONE, Acknowledge.SHOWN
_NOT_PASSIVE, _ARMED = Progress.OFF, Progress.ARMED


class BasicPositioner(Positioner):
    """One axis' positioner with blocks, setting up, jog and the user's coordinates."""

    def __init__(self, choices: PositionerChoices) -> None:
        self.choices = choices
        course = self.travel = UserCourse(PositionerFeedback(), choices.position_window, choices=choices)
        """The course. The executor sets what it knows of the drive: its velocity, positions, distances and turn."""
        self._chain = BlockChain(BlockTable(choices.blocks), course)
        self._now = 0
        """Time of this step, monotonic ns."""
        self._task: Task | None = None
        """The task that runs."""
        self._shown = State.OFF
        """The function in POS_ZSW1: also that of a finished task until STW1.6 falls; IDLE for none."""
        self._acknowledge = Acknowledge.NONE
        self._homing_until = 0
        """End of POS_ZSW1.11 = 1, monotonic ns; 0: it has ended."""
        self._passive_homing = PassiveHoming()
        super().__init__(course, TRANSITIONS)
        jogs = self._jogs = Jogs()
        self._orders += (jogs.first, jogs.second)

    def _events(self) -> dict[Event, Callable[[], int]]:
        return {
            **super()._events(),
            Event.OPERATING: lambda: self.seen.bits & Seen.OPERATING,
            Event.TASK_REFUSED: lambda: (task := self._activate.task) is not None and task.refusal is not None,
            **{event: partial(self._waits_for, event) for event in _FUNCTION},
            Event.CHANGED: self._changed,
            Event.REACHED: self._finished,
            Event.BLOCK_DONE: lambda: self._chain.done(self._now) and self._chain.follower() is not None,
            Event.CHAIN_DONE: lambda: self._chain.done(self._now) and self._chain.follower() is None,
            Event.JOG: lambda: not self.request.commands & _JOG_INCREMENTAL and self._jogs.wait(self.request.commands),
            Event.JOG_INCREMENTAL: lambda: (
                self.request.commands & _JOG_INCREMENTAL and self._jogs.wait(self.request.commands)
            ),
            Event.JOG_RELEASED: lambda: self._jogs.released(self.request.commands),
            Event.HOMING: lambda: self._home.stage & _WAITS,
            Event.HOMING_ATTAINED: lambda: self._homing_is(HomingResult.ATTAINED),
            Event.HOMING_FAILED: lambda: self._homing_is(HomingResult.FAILED),
            Event.TRACKING: lambda: self.request.commands & _TRACKS,
            Event.TRACKING_OFF: lambda: not self.request.commands & _TRACKS,
            Event.STANDING: lambda: self.seen.bits & _STANDSTILL,
        }

    def _actions(self) -> dict[Action, Callable[[], None]]:
        return {
            **super()._actions(),
            Action.CLEAR: self._clear,
            Action.REFUSE: self._refuse,
            Action.REFUSE_AND_BRAKE: self._refuse_and_brake,
            Action.UPDATE: self._update,
            Action.FOLLOW: lambda: self._chain.follow(self._now),
            Action.FINISH: self._end,
            Action.JOG: self._start_jog,
            Action.JOG_DISTANCE: self._start_jog,
            Action.HOMED: self._homed,
            Action.HOMING_ERROR: lambda: self.warn(Reason.HOMING_ERROR),
        }

    def latch(self, probe: int | Reason | None) -> None:
        """Set the position at the edge of the armed probe, or why there is none; None: not yet."""
        self._passive_homing.probe = probe

    @property
    def armed(self) -> bool:
        """The probe is to be armed: passive homing."""
        return self._passive_homing.progress is _ARMED

    @property
    def acknowledged(self) -> bool:
        """The task is acknowledged."""
        return self._acknowledge is _SHOWN

    @property
    def reached(self) -> bool:
        """The axis has ended its function, or there is none."""
        state = self.state
        if state is _MDI:
            return self.travel.arrived()
        rests = (state is _IDLE or state is _TRACKING) and self.seen.bits & _STANDSTILL != 0
        return rests and self._activate.task is None and not self._home.stage & _WAITS

    def forget_home(self) -> None:
        super().forget_home()
        self.travel.offset = 0

    def step(self, request: PositionerRequest, now: int) -> Reason | None:
        self.request, self._now = request, now
        course, commands, operating = self.travel, request.commands, self.seen.bits & Seen.OPERATING != 0
        if self._acknowledge is not _NOT_OWED:
            self._acknowledge_task()
        course.watch_limits(commands & _SOFTWARE_LIMITS != 0 and self.home_set)
        course.look()
        if commands != self._commands or operating is (self.state is _OFF):
            self._read_request()
        if (commands & HOME or self._passive_homing.progress is not _NOT_PASSIVE) and self.state is not _OFF:
            self._home_on_the_fly()
        calm = operating and commands & _DO_NOT_REJECT != 0 and self._activate.task is None
        self._take_transition(calm)
        if self._chain.block is not None:
            self._chain.look_ahead()
        state = self.state
        if state is _IDLE and course.warning is Reason.FUNCTION_RUNS:
            self.warn(None)  # it has ended
        if state is not _HOMING:
            course.follow(request, now)
        if (state is _IDLE or state is _TRACKING) and (not commands & ACTIVATE or self._shown is _OFF):
            self._shown = _IDLE
        if self._homing_until and now >= self._homing_until:
            self._homing_until = 0
        return self._reason(commands)

    def _reason(self, commands: int) -> Reason | None:
        """Why nothing moves just now."""
        reason = self.travel.held or (None if commands & _DO_NOT_REJECT else Reason.REJECTED) or self.travel.warning
        if reason is not None:
            return reason
        if self.state is _IDLE or self.state is _TRACKING:
            return self.reason_of_ignored()
        return Reason.AT_SOFTWARE_LIMIT if self.travel.rests_at_limit else None

    @property
    def taken(self) -> int:
        return 0 if self._passive_homing.progress is _NOT_PASSIVE else HOME

    # -- inputs ---------------------------------------------------------------------------------------------------------

    def _read_request(self) -> None:
        """Evaluate changed bits before the table: edges, and the words they belong to."""
        operating, commands, edges = self.seen.bits & Seen.OPERATING != 0, self.request.commands, self._edges
        jogs = self._jogs
        waited = jogs.are(Stage.WAITS)
        self._follow_bits(operating=operating)
        if self._commands & ~commands & (HOME | JOGS) and self.travel.warning is Reason.FUNCTION_RUNS:
            self.warn(None)  # this order is withdrawn
        self._commands = commands if operating else commands & ~RISING
        if not self.seen.bits & _UNDER_ORDERS:
            self._commands |= _REFER
        accepts = commands & _DO_NOT_REJECT != 0
        if not accepts:
            self._withdraw()
        if edges & _REFER:
            self._set_reference_point()
        if self.state is _OFF:
            return
        if edges & jogs.are(Stage.WAITS) and self.state not in JOG_STATES:
            jogs.refuse(edges)
            self.warn(Reason.FUNCTION_RUNS)
        self._note_lacking(edges | waited & ~jogs.are(Stage.READY))
        if edges & ACTIVATE:
            self._take_task(accepts)
        if edges & HOME and not commands & _PASSIVE_HOMING and accepts:
            self._take_homing()
        if edges & Command.EXTERNAL_BLOCK_CHANGE:
            self._chain.external = True

    def _take_task(self, accepts: bool) -> None:
        """An edge of STW1.6: its task waits for the table, or a warning is set."""
        if not accepts:
            self.warn(Reason.LOST_EDGE)
        elif self.state not in TASK_STATES:
            self.warn(Reason.FUNCTION_RUNS)
        elif self.request.commands & _NO_INTERMEDIATE_STOP or self.state in _KEPT:
            self._activate.wait(captured(self.request, self._chain, self.travel))
        else:
            self.warn(Reason.LOST_EDGE)

    def _take_homing(self) -> None:
        """An edge of STW1.11 that may start a homing."""
        if self.state is _IDLE or self.state is State.BRAKING:
            self._home.wait()
        else:
            self.warn(Reason.FUNCTION_RUNS)

    def _waits_for(self, event: Event) -> bool:
        """The newest edge is one of these tasks."""
        task = self._activate.task
        return task is not None and task.event is event

    def _changed(self) -> bool:
        """Continuous update: values other than those in force, while STW1.6 = 1."""
        request, task, commands = self.request, self._task, self.request.commands
        if commands & _UPDATES != _UPDATES or not commands & _MDI_SELECTED or task is None:
            return False
        if task.is_of(request) or (commands & _SETTING_UP_SELECTED != 0) is not (self.state is _SETTING_UP):
            return False
        if self.state is _MDI and not commands & task.request.commands & _ABSOLUTE:
            self.warn(Reason.UPDATE_RELATIVE)
            return False
        return True

    def _finished(self) -> bool:
        if self.state is _MDI and self.request.commands & _UPDATES == _UPDATES:
            return False
        return self.travel.arrived() or (self.travel.goal is None and self.seen.bits & _STANDSTILL != 0)

    # -- functions ------------------------------------------------------------------------------------------------------

    def _clear(self) -> None:
        """Operation begins, or a reject without a function. An edge that started nothing stays named until operation, and the
        edge of a reference point that was not set until its bit falls."""
        warning = self.travel.warning
        if self.state is not _OFF:
            kept = warning is Reason.LOST_EDGE
        else:
            kept = warning is Reason.REFERENCE_POINT_MOVING and self.request.commands & _REFER != 0
        if not kept:
            self.warn(None)

    def _forget(self) -> None:
        super()._forget()
        self._task = None
        self._withdraw()
        self._jogs.end()
        self._chain.drop()

    def _withdraw(self) -> None:
        """Edges that wait start nothing any more."""
        self._activate.withdraw(self.request.commands)
        self._home.withdraw(self.request.commands)

    def _end(self) -> None:
        """The function has ended; an endless block only at a software limit."""
        rests = self.travel.rests_at_limit
        self._forget()
        if rests:
            self.warn(Reason.AT_SOFTWARE_LIMIT)

    def _begin(self) -> None:
        """A function other than a task begins."""
        self._forget()
        self.warn(None)
        self._shown = _IDLE

    def _drop(self) -> None:
        self._forget()
        self._passive_homing.drop()
        self._acknowledge = _NOT_OWED
        self._shown = _OFF
        self._chain.outputs = 0

    def _brake(self) -> None:
        self._forget()
        if not self.request.commands & _DO_NOT_REJECT:
            self.warn(None)
        self._shown = _IDLE

    def _refuse(self) -> None:
        task = self._activate.task
        self._activate.withdraw(self.request.commands)
        self.warn((task and task.refusal) or Reason.FUNCTION_RUNS)

    def _refuse_and_brake(self) -> None:
        self._refuse()
        self._brake()

    def _start(self) -> None:
        task = self._activate.task
        assert task is not None, "the rows with a start follow an edge"
        homing_waits = self._home.stage & _WAITS
        self._forget()
        self.warn(Reason.FUNCTION_RUNS if homing_waits else None)
        self._task = task
        self._activate.start(self.request.commands)
        self._acknowledge = Acknowledge.OWED
        self._shown = _FUNCTION[task.event]
        if task.event is _BLOCK_TASK:
            self._chain.run(task.request.number, self._now)
        else:
            self._pursue(task)

    def _update(self) -> None:
        task = self._task = captured(self.request, self._chain, self.travel)
        refusal = self.travel.warning = task.refusal
        if refusal is None:
            self._pursue(task)
        else:
            self.travel.drop_goal()

    def _pursue(self, task: Task) -> None:
        course, request = self.travel, task.request
        velocity, ramps, direction = request.velocity, (request.acceleration, request.deceleration), request.direction
        if task.event is Event.SETTING_UP:
            course.go(velocity if direction is Direction.POSITIVE else -velocity, *ramps)
        else:
            torque = self.choices.clamping_torque if self.request.to_fixed_stop else None
            course.go_to(request.target, request.commands & _ABSOLUTE != 0, velocity, *ramps, torque, direction)

    def _start_jog(self) -> None:
        self._begin()
        place = self._jogs.start(self.request.commands)
        velocity = self.choices.jog_velocities[place]
        if self.request.commands & _JOG_INCREMENTAL:
            distance = self.choices.jog_distances[place]
            self.travel.go_to(distance if velocity > 0 else -distance, False, abs(velocity), FULL, FULL)
        else:
            self.travel.go(velocity, FULL, FULL, scaled=False)

    # -- homing and the reference point ---------------------------------------------------------------------------------

    def _start_homing(self) -> None:
        """The drive sets a new zero at an unknown moment: the old offset must not be used with it."""
        self._begin()
        self._home.start(self.request.commands)
        self.forget_home()
        self._homing_until = self._now + SHOWN_NS
        self.travel.home()

    def _homed(self) -> None:
        """The drive's position now counts from the home position, which is the reference coordinate."""
        self.travel.offset = self._reference_coordinate()
        self.home_set = True

    def _set_reference_point(self) -> None:
        if self.state in _WITHOUT_MOTION and self.seen.bits & _STANDSTILL:
            self._refer(self.seen.position)
        else:
            self.warn(Reason.REFERENCE_POINT_MOVING)

    def _reference_coordinate(self) -> int:
        request = self.request.reference_coordinate
        return self.choices.reference_coordinate if request is None else request

    def _refer(self, position: int) -> None:
        if self.travel.warning in _WITHOUT_REFERENCE:
            self.warn(None)
        self.travel.refer(self._reference_coordinate(), position)
        self.home_set = True
        self._homing_until = self._now + SHOWN_NS

    def _home_on_the_fly(self) -> None:
        """STW1.11 with POS_STW2.8: the probe gives the offset while anything runs; a task keeps its target in the drive."""
        found = self._passive_homing.step(self.request.commands)
        if isinstance(found, Reason):
            self.warn(found)
        elif found is not None:
            self._refer(found)

    # -- outputs --------------------------------------------------------------------------------------------------------

    @property
    def position(self) -> int:
        """Actual position in the user's coordinates."""
        position, modulo = self.seen.position + self.travel.offset, self.choices.modulo
        return position % modulo if modulo else position

    def words(self, speed: int, *, reached: bool) -> tuple[int, int]:
        """POS_ZSW1 and POS_ZSW2. ``speed``: its sign is the direction of an axis that moves."""
        state, seen, block = self.state, self.seen.bits, self._chain.block
        first = FUNCTION_BITS.get(self._mode(), 0) | RUNNING_BITS.get(state, 0)
        if block is not None:
            first |= block.number
        if state is _HOMING or self._homing_until:
            first |= HOMING_SHOWN
        if self._passive_homing.progress is _ARMED:
            first |= PASSIVE_HOMING_SHOWN
        if self.request.commands & _HARDWARE_LIMITS:
            first |= limit_bits(seen)
        return first, self._chain.outputs << OUTPUT_1 | second_word(self.travel, state, speed, reached=reached)

    def _mode(self) -> State:
        """The active or last function; else the one that an edge of STW1.6 would start."""
        commands = self.request.commands
        if self._shown is not _IDLE or self.state not in SELECTABLE:
            return self._shown
        if not commands & _MDI_SELECTED:
            return State.BLOCK
        return _SETTING_UP if commands & _SETTING_UP_SELECTED else _MDI

    def _acknowledge_task(self) -> None:
        """Show the acknowledgement of a task. The drive acknowledges position tasks, the gateway all others."""
        task, course, block = self._task, self.travel, self._chain.block
        if not self.request.commands & ACTIVATE:
            self._acknowledge = _NOT_OWED
        elif task is not None:
            still = task.event is _BLOCK_TASK and block is not None and not block.task.moves
            if still or course.speed is not None or 0 < course.motion.first <= self.seen.taken:
                self._acknowledge = _SHOWN
