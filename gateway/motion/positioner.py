"""Basic positioner of telegrams 7, 110 and 111: computes the motion from the request and the state of the axis.

Source: basic positioners of public drive manuals (docs/motion.md). Sans-I/O: one ``step`` per cycle, values and monotonic
nanoseconds in, one reused ``PositionerResult`` out. ``states.TRANSITIONS`` has the states. Not here: cams, homing direction, and
handshakes and mode changes of the drive (executors).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from pdgw.durations import MS
from pdgw.gateway.motion.blocks import BlockTable
from pdgw.gateway.motion.chain import BlockChain
from pdgw.gateway.motion.requests import (
    DIRECTIONS,
    FULL,
    NOTHING,
    Command,
    HomingResult,
    MotionKind,
    PositionerChoices,
    PositionerFeedback,
    PositionerRequest,
    PositionerResult,
)
from pdgw.gateway.motion.states import TASK_STATES, TRANSITIONS, Action, Event, State, Transition
from pdgw.gateway.motion.travel import Course
from pdgw.gateway.motion.units import Direction
from pdgw.gateway.reasons import Reason

SHOWN_NS: Final = 100 * MS
"""Minimum time of POS_ZSW1.11 = 1 for homing and a set reference point, because masters poll it."""
ACTIVATE, HOME = Command.ACTIVATE_TASK, Command.START_HOMING
_DO_NOT_REJECT, _MDI_SELECTED, _ABSOLUTE = Command.DO_NOT_REJECT, Command.MDI, Command.ABSOLUTE
_NO_INTERMEDIATE_STOP, _SETTING_UP_SELECTED = Command.NO_INTERMEDIATE_STOP, Command.SETTING_UP
_JOG_2, _JOG_INCREMENTAL, _TRACKS = Command.JOG_2_ON, Command.JOG_INCREMENTAL, Command.TRACKING
_SOFTWARE_LIMITS, _HARDWARE_LIMITS = Command.SOFTWARE_LIMITS, Command.HARDWARE_LIMITS
_PASSIVE_HOMING: Final = Command.PASSIVE_HOMING
RISING: Final = ACTIVATE | HOME | Command.EXTERNAL_BLOCK_CHANGE | Command.SET_REFERENCE_POINT
"""Commands whose rising edges count."""
_ON_THE_FLY: Final = HOME | _PASSIVE_HOMING
_UPDATES: Final = Command.CONTINUOUS_UPDATE | ACTIVATE
_JOGS: Final = Command.JOG_1_ON | Command.JOG_2_ON
_KEPT = frozenset({State.MDI, State.SETTING_UP, State.BLOCK})
"""Functions an intermediate stop keeps, and an edge during it replaces."""
_DISTURBANCES = frozenset(
    {Event.NOT_OPERATING, Event.REJECTED, Event.TASK_REFUSED, Event.MDI, Event.SETTING_UP, Event.BLOCK}
)
"""Events that are impossible in a calm step: in operation, not rejected, without the edge of a task."""
_Row = tuple[Callable[[], int], Callable[[], None], Transition]
_FUNCTION = {Event.MDI: State.MDI, Event.SETTING_UP: State.SETTING_UP, Event.BLOCK: State.BLOCK}


_OFF, _IDLE, _MDI, _SETTING_UP = State.OFF, State.IDLE, State.MDI, State.SETTING_UP
_HOMING, _TRACKING = State.HOMING, State.TRACKING
_MDI_TASK, _SETTING_UP_TASK, _BLOCK_TASK = Event.MDI, Event.SETTING_UP, Event.BLOCK
_SHORTEST, _POSITIVE = Direction.SHORTEST, Direction.POSITIVE
_REJECTED = Reason.REJECTED
HELD = {Reason.LOST_EDGE: ACTIVATE, Reason.EARLY_EDGE: ACTIVATE, Reason.LOST_HOMING: HOME}
"""Warnings of an edge that started nothing, with its bit. They end with the next task, with operation, or (all but the first)
with 0 in the bit."""


@dataclass(slots=True, unsafe_hash=True)
class _Task:
    """The data of the frame that brought an edge of STW1.6, or a change under continuous update. Never changed."""

    event: Event
    refusal: Reason | None
    block: int
    how: int
    """Bits of ``Command``: how the position is meant."""
    target: int
    velocity: int
    acceleration: int
    deceleration: int
    direction: Direction
    """Direction of an absolute task of a modulo axis; both bits together are rejected."""

    def is_of(self, request: PositionerRequest) -> bool:
        """Whether the request is unchanged."""
        return (
            request.target == self.target
            and request.velocity == self.velocity
            and request.acceleration == self.acceleration
            and request.deceleration == self.deceleration
            and not (request.commands ^ self.how) & DIRECTIONS
        )


class Positioner:
    """One axis' positioner."""

    def __init__(
        self,
        choices: PositionerChoices,
        transitions: Mapping[State, tuple[Transition, ...]] = TRANSITIONS,
    ) -> None:
        self.choices = choices
        self.result = PositionerResult()
        self._state = self.result.state = next(iter(transitions))
        self.seen = PositionerFeedback()
        """State of the axis, read before each step."""
        self._course = Course(choices, self.result, self.seen, choices.position_window)
        self._chain = BlockChain(BlockTable(choices.blocks), self._course)
        self.request = NOTHING
        """The commands of this step,"""
        self._now = 0
        """and its time, monotonic ns."""
        self._pending: _Task | None = None
        """The task of the newest edge, while it waits for standstill."""
        self._task: _Task | None = None
        """The task that runs."""
        self._owed = False
        """STW1.6 is still 1 after the edge of the task: acknowledge the task."""
        self._armed = 0
        """The bits of the jogs that may start: the bit was 0 in operation, and has started nothing since."""
        self._jog = 0
        """The bit of the one that moves the axis; 0: none."""
        self._homing_until = 0
        """End of POS_ZSW1.11 = 1, monotonic ns; 0: it has ended."""
        self._probe_requested = False
        """Passive homing was requested in the last step."""
        self._commands = 0
        """The commands that were evaluated last; out of operation without those whose edges count."""
        self._edges = 0
        """Those that rose then."""
        self._homing_waits = False
        """An edge of STW1.11 that came while the axis was braking, or now."""
        events, actions = self._events(), self._actions()

        def compiled(rows: Iterable[Transition]) -> tuple[_Row, ...]:
            return tuple((events[row.event], actions[row.action], row) for row in rows)

        self._table = {
            state: (compiled(rows), compiled(row for row in rows if row.event not in _DISTURBANCES))
            for state, rows in transitions.items()
        }
        """The transitions with what finds an event and what does an action: all rows of a state, and those of a calm step."""

    def _events(self) -> dict[Event, Callable[[], int]]:
        """The checks of the events."""
        return {
            Event.NOT_OPERATING: lambda: not self.seen.operating,
            Event.OPERATING: lambda: self.seen.operating,
            Event.REJECTED: lambda: not self.request.commands & _DO_NOT_REJECT,
            Event.TASK_REFUSED: lambda: self._pending is not None and self._pending.refusal is not None,
            Event.MDI: lambda: self._pending is not None and self._pending.event is Event.MDI,
            Event.SETTING_UP: lambda: self._pending is not None and self._pending.event is Event.SETTING_UP,
            Event.BLOCK: lambda: self._pending is not None and self._pending.event is Event.BLOCK,
            Event.CHANGED: self._changed,
            Event.REACHED: self._finished,
            Event.BLOCK_DONE: lambda: self._chain.done(self._now) and self._chain.follower() is not None,
            Event.CHAIN_DONE: lambda: self._chain.done(self._now) and self._chain.follower() is None,
            Event.JOG: lambda: not self.request.commands & _JOG_INCREMENTAL and self._jog_asked(),
            Event.JOG_INCREMENTAL: lambda: self.request.commands & _JOG_INCREMENTAL and self._jog_asked(),
            Event.JOG_RELEASED: lambda: self._jog_bit() != self._jog,
            Event.HOMING: lambda: self._homing_waits,
            Event.HOMING_WITHDRAWN: lambda: not self.request.commands & HOME,
            Event.HOMING_ATTAINED: lambda: self._homing_is(HomingResult.ATTAINED),
            Event.HOMING_FAILED: lambda: self._homing_is(HomingResult.FAILED),
            Event.TRACKING: lambda: self.request.commands & _TRACKS,
            Event.TRACKING_OFF: lambda: not self.request.commands & _TRACKS,
            Event.STANDING: lambda: self.seen.standstill,
        }

    def _actions(self) -> dict[Action, Callable[[], None]]:
        """The functions of the actions."""
        return {
            Action.NOTHING: lambda: None,
            Action.DROP: self._drop,
            Action.CLEAR: self._clear,
            Action.BRAKE: self._brake,
            Action.REFUSE: self._refuse,
            Action.REFUSE_AND_BRAKE: self._refuse_and_brake,
            Action.START: self._start,
            Action.REPLACE: self._start,
            Action.UPDATE: self._update,
            Action.FOLLOW: lambda: self._chain.follow(self._now),
            Action.FINISH: self._forget,
            Action.JOG: self._start_jog,
            Action.JOG_DISTANCE: self._start_jog,
            Action.HOME: self._start_homing,
            Action.HOMED: self._homed,
            Action.HOMING_ERROR: lambda: self._warn(Reason.HOMING_ERROR),
        }

    def set_ranges(self, positions: tuple[int, int], distances: tuple[int, int]) -> None:
        """Set the range of the drive's positions, in its own coordinates, and of one relative task."""
        self._course.positions, self._course.distances = positions, distances

    def require_velocity(self, velocity: int) -> None:
        """Set the only velocity of a task to a position, for a drive without 6081h; 0: any."""
        self._course.only_velocity = velocity

    @property
    def expects_end(self) -> bool:
        """The axis is at standstill, and the end of its motion to a position is due."""
        return self._course.expects_end()

    @property
    def way(self) -> int:
        """Remaining distance to the target, or the speed of a speed task with its sign; 0 without a task."""
        goal = self._course.goal
        if goal is None:
            return 0
        return goal.velocity if goal.kind is MotionKind.SPEED else goal.target - self.seen.position

    def forget_home(self) -> None:
        """The drive has new coordinates: its home position is unknown."""
        self.result.home_set = False
        self._course.offset = 0

    def step(self, request: PositionerRequest, now: int) -> PositionerResult:
        """Run one cycle. ``now``: monotonic nanoseconds."""
        self.request, self._now = request, now
        result, course, commands = self.result, self._course, request.commands
        if self._owed:
            self._show_acknowledge()
        course.look(commands & _SOFTWARE_LIMITS != 0 and result.home_set)
        if commands != self._commands or self.seen.operating is (self._state is _OFF):
            self._read_request()
        if (commands & HOME or self._probe_requested) and self._state is not _OFF:
            self._home_on_the_fly()
        calm = self.seen.operating and commands & _DO_NOT_REJECT != 0 and self._pending is None
        self._take_transition(calm)
        if self._chain.block is not None:
            self._chain.look_ahead()
        if self._state is not _HOMING:
            course.follow(request, now)
        self._show()
        return result

    def _take_transition(self, calm: bool) -> None:
        """Take the first transition whose event is there."""
        for happened, act, row in self._table[self._state][calm]:
            if happened():
                act()
                if row.lost:
                    bits = self._commands if not self._commands & _PASSIVE_HOMING else self._commands & ~HOME
                    self._warn(next((warning for warning in row.lost if bits & HELD[warning]), self.result.warning))
                self._state = self.result.state = row.target
                break

    # -- inputs ---------------------------------------------------------------------------------------------------------

    def _read_request(self) -> None:
        """Evaluate changed bits before the table: edges, and the words they belong to."""
        self._find_edges()
        operating, commands = self.seen.operating, self.request.commands
        if not operating:
            self._commands &= ~RISING
        accepts = commands & _DO_NOT_REJECT
        jogs = commands & _JOGS
        allowed = operating and accepts and jogs != _JOGS
        self._armed = _JOGS & ~jogs | (self._armed if allowed else 0)
        if not accepts:
            self._pending = None
        if not (accepts and commands & HOME):
            self._homing_waits = False
        if self._state is _OFF:
            return
        if self._edges & ACTIVATE:
            if not accepts:
                self._warn(Reason.LOST_EDGE)
            elif self._state not in TASK_STATES:
                self._warn(Reason.FUNCTION_RUNS)
            elif commands & _NO_INTERMEDIATE_STOP or self._state in _KEPT:
                self._pending = self._captured()
            else:
                self._warn(Reason.LOST_EDGE)
        if self._edges & HOME and not commands & _PASSIVE_HOMING:
            if not accepts:
                self._warn(Reason.LOST_HOMING)
            elif self._state is _IDLE or self._state is State.BRAKING:
                self._homing_waits = True
            else:
                self._warn(Reason.FUNCTION_RUNS)
        if self._edges & Command.EXTERNAL_BLOCK_CHANGE:
            self._chain.external = True
        if self._edges & Command.SET_REFERENCE_POINT:
            self._set_reference_point()

    def _find_edges(self) -> None:
        """Rising edges of this step; bits that were 1 before operation are not edges."""
        commands, warning = self.request.commands, self.result.warning
        self._edges = commands & ~self._commands
        self._commands = commands
        if warning in HELD and warning is not Reason.LOST_EDGE and not commands & HELD[warning]:
            self._warn(None)

    def _captured(self) -> _Task:
        """The present request, and why it is impossible."""
        request, commands = self.request, self.request.commands
        target, velocity, absolute = request.target, request.velocity, commands & _ABSOLUTE != 0
        direction = request.direction
        refusal: Reason | None = None
        if not commands & _MDI_SELECTED:
            event = _BLOCK_TASK
            refusal = self._chain.refusal(request.number)
        else:
            event = _SETTING_UP_TASK if commands & _SETTING_UP_SELECTED else _MDI_TASK
            if not velocity:
                refusal = Reason.TASK_SPEED_ZERO
            elif request.acceleration <= 0 or request.deceleration <= 0:
                refusal = Reason.TASK_RAMP_ZERO
            elif event is _SETTING_UP_TASK:
                refusal = Reason.TASK_DIRECTION if direction is _SHORTEST else None
            elif commands & DIRECTIONS == DIRECTIONS and self.choices.modulo and absolute:
                refusal = Reason.TASK_DIRECTION
            elif not self._course.in_range(target, absolute, direction):
                refusal = Reason.TASK_TARGET_RANGE
        how, ramps = commands & (_ABSOLUTE | DIRECTIONS), (request.acceleration, request.deceleration)
        return _Task(event, refusal, request.number, how, target, velocity, *ramps, direction)

    def _changed(self) -> bool:
        """Continuous update: values other than those in force, while STW1.6 = 1."""
        request, task, commands = self.request, self._task, self.request.commands
        if commands & _UPDATES != _UPDATES or not commands & _MDI_SELECTED or task is None:
            return False
        if task.is_of(request) or (commands & _SETTING_UP_SELECTED != 0) is not (self._state is _SETTING_UP):
            return False
        if self._state is _MDI and not commands & task.how & _ABSOLUTE:
            self._warn(Reason.UPDATE_RELATIVE)
            return False
        return True

    def _jog_bit(self) -> int:
        """The bit of a jog if it is the only one, 0 for none or both."""
        jogs = self.request.commands & _JOGS
        return 0 if jogs == _JOGS else jogs

    def _jog_asked(self) -> bool:
        return self._jog_bit() & self._armed != 0

    def _homing_is(self, result: HomingResult) -> bool:
        return self.seen.taken >= self.result.motion.serial and self.seen.homing is result

    def _finished(self) -> bool:
        if self._state is _MDI and self.request.commands & _UPDATES == _UPDATES:
            return False
        return self._course.arrived() or (self._course.goal is None and self.seen.standstill)

    # -- functions ------------------------------------------------------------------------------------------------------

    def _warn(self, reason: Reason | None) -> None:
        self.result.warning = reason

    def _clear(self) -> None:
        """Operation begins, or a reject without a function. An edge that started nothing stays named until operation."""
        if self._state is _OFF or self.result.warning not in HELD:
            self._warn(None)

    def _forget(self) -> None:
        self._pending = self._task = None
        self._homing_waits = False
        self._jog = 0
        self._course.drop()
        self._chain.drop()

    def _begin(self) -> None:
        """A function other than a task begins."""
        self._forget()
        self._warn(None)
        self.result.shown = _IDLE

    def _drop(self) -> None:
        self._forget()
        result = self.result
        result.probe = result.acknowledged = self._owed = False
        result.shown = _OFF
        result.outputs = 0

    def _brake(self) -> None:
        self._forget()
        if not self.request.commands & _DO_NOT_REJECT:
            self._warn(None)
        self.result.shown = _IDLE

    def _refuse(self) -> None:
        pending, self._pending = self._pending, None
        self._warn((pending and pending.refusal) or Reason.FUNCTION_RUNS)

    def _refuse_and_brake(self) -> None:
        self._refuse()
        self._brake()

    def _start(self) -> None:
        task = self._pending
        assert task is not None, "the rows with a start follow an edge"
        homing_waits = self._homing_waits
        self._forget()
        self._warn(Reason.FUNCTION_RUNS if homing_waits else None)
        self._task = task
        self._owed = True
        self.result.acknowledged = False
        self.result.shown = _FUNCTION[task.event]
        if task.event is _BLOCK_TASK:
            self._chain.run(task.block, self._now)
        else:
            self._pursue(task)

    def _update(self) -> None:
        task = self._task = self._captured()
        refusal = self.result.warning = task.refusal
        if refusal is None:
            self._pursue(task)
        else:
            self._course.drop_goal()

    def _pursue(self, task: _Task) -> None:
        velocity, acceleration, deceleration = task.velocity, task.acceleration, task.deceleration
        if task.event is _SETTING_UP_TASK:
            self._course.go(velocity if task.direction is _POSITIVE else -velocity, acceleration, deceleration)
        else:
            torque = self.choices.clamping_torque if self.request.to_fixed_stop else None
            absolute = task.how & _ABSOLUTE != 0
            self._course.go_to(task.target, absolute, velocity, acceleration, deceleration, torque, task.direction)

    def _start_jog(self) -> None:
        self._begin()
        self._jog = self._jog_bit()
        place = self._jog == _JOG_2
        velocity = self.choices.jog_velocities[place]
        if self.request.commands & _JOG_INCREMENTAL:
            self._armed &= ~self._jog
            distance = self.choices.jog_distances[place]
            self._course.go_to(distance if velocity > 0 else -distance, False, abs(velocity), FULL, FULL)
        else:
            self._course.go(velocity, FULL, FULL, scaled=False)

    # -- homing and the reference point ---------------------------------------------------------------------------------

    def _start_homing(self) -> None:
        """The drive sets a new zero at an unknown moment: the old offset must not be used with it."""
        self._begin()
        self.forget_home()
        self._homing_until = self._now + SHOWN_NS
        motion = self.result.motion
        motion.kind = MotionKind.HOMING
        motion.torque = None
        motion.serial += 1

    def _homed(self) -> None:
        """The drive's position now counts from the home position, which is the reference coordinate."""
        self._course.offset = self._reference_coordinate()
        self.result.home_set = True

    def _set_reference_point(self) -> None:
        if (self._state is _IDLE or self._state is _TRACKING) and self.seen.standstill:
            self._refer(self.seen.position)
        else:
            self._warn(Reason.REFERENCE_POINT_MOVING)

    def _reference_coordinate(self) -> int:
        request = self.request.reference_coordinate
        return self.choices.reference_coordinate if request is None else request

    def _refer(self, position: int) -> None:
        self._course.offset = self._reference_coordinate() - position
        self._course.limits_moved = True
        self.result.home_set = True
        self._homing_until = self._now + SHOWN_NS

    def _home_on_the_fly(self) -> None:
        """STW1.11 with POS_STW2.8: the probe gives the offset while anything runs; a task keeps its target in the drive."""
        seen, result = self.seen, self.result
        wanted = self.request.commands & _ON_THE_FLY == _ON_THE_FLY
        before, self._probe_requested = self._probe_requested, wanted
        if not wanted:
            result.probe = False
        elif not before:
            result.probe = True
        elif result.probe and seen.probe_refused:
            result.probe = False
            self._warn(Reason.PASSIVE_HOMING_NOT_SUPPORTED)
        elif result.probe and seen.probe is not None:
            result.probe = False
            self._refer(seen.probe)

    # -- outputs --------------------------------------------------------------------------------------------------------

    def _show(self) -> None:
        result, commands, seen, course = self.result, self.request.commands, self.seen, self._course
        state = self._state
        position = seen.position + course.offset
        modulo = self.choices.modulo
        result.position = position % modulo if modulo else position
        standing = result.standing = seen.standstill
        if state is _MDI:
            result.reached = course.arrived()
        elif state is _IDLE or state is _TRACKING:
            if not commands & ACTIVATE or result.shown is _OFF:
                result.shown = _IDLE
            result.reached = standing and self._pending is None and not self._homing_waits
        else:
            result.reached = False
        block = self._chain.block
        result.block = 0 if block is None else block.number
        if self._now >= self._homing_until:
            self._homing_until = 0
        result.homing = state is _HOMING or self._homing_until > 0
        if commands & _HARDWARE_LIMITS:
            result.negative_limit, result.positive_limit = seen.negative_limit, seen.positive_limit
        else:
            result.negative_limit = result.positive_limit = False
        limits = course.limits
        if standing and limits is not None:
            result.at_minus = position <= limits[0] + self.choices.position_window
            result.at_plus = position >= limits[1] - self.choices.position_window
        else:
            result.at_minus = result.at_plus = False
        result.reason = course.held or (None if commands & _DO_NOT_REJECT else _REJECTED) or result.warning
        jog = commands & _JOGS and not commands & _JOG_INCREMENTAL
        if jog and state is _IDLE and result.reason is None and not self._jog_asked():
            result.reason = Reason.LOST_JOG

    def _show_acknowledge(self) -> None:
        """Show the acknowledgement of a task. The drive acknowledges position tasks, the gateway all others."""
        result, task = self.result, self._task
        if not self.request.commands & ACTIVATE:
            result.acknowledged = self._owed = False
        elif task is not None and not result.acknowledged:
            block = self._chain.block
            still = task.event is _BLOCK_TASK and block is not None and not block.task.moves
            speed = self._course.speed is not None
            result.acknowledged = still or speed or 0 < result.motion.first <= self.seen.taken
