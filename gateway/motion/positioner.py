"""The state machine that both positioners run: a table of transitions, and the bits that start its functions.

``BasicPositioner`` (telegrams 7, 110 and 111) and ``MdiPositioner`` (telegram 9) say what its events and actions are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar, Final

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.step_text import equation
from pdgw.gateway.motion.function_orders import EdgeOrder, Order, Stage
from pdgw.gateway.motion.requests import NOTHING, Command, HomingResult, Lack, MotionKind, PositionerRequest, Seen
from pdgw.gateway.motion.states import FUNCTIONS, JOGS, Action, Event, State, Transition
from pdgw.gateway.motion.travel import Course

ACTIVATE, HOME = Command.ACTIVATE_TASK, Command.START_HOMING
_DO_NOT_REJECT, _NO_INTERMEDIATE_STOP = Command.DO_NOT_REJECT, Command.NO_INTERMEDIATE_STOP
RISING: Final = ACTIVATE | HOME | Command.EXTERNAL_BLOCK_CHANGE
"""Commands whose rising edges count in operation, where that of ``SET_REFERENCE_POINT`` counts as well."""
_DISTURBANCES = frozenset(
    {Event.NOT_OPERATING, Event.REJECTED, Event.TASK_REFUSED, Event.MDI, Event.SETTING_UP, Event.BLOCK}
)
"""Events that are impossible in a calm step: in operation, not rejected, without the edge of a task."""
_Row = tuple[Callable[[], int], Callable[[], None], Transition]
_OFF = State.OFF
_IGNORED: Final = Stage.IGNORED
_EARLY: Final = Stage.EARLY
SELECTABLE = (State.IDLE, State.BRAKING)
"""Nothing else runs: the selected mode is shown."""


class Positioner:
    """The state machine of one axis' positioner: its table, the function that runs, and the commands before this step."""

    FUNCTIONS: ClassVar[int] = FUNCTIONS
    """Bits that start a function."""
    NEEDED: ClassVar[Mapping[int, str]] = {_DO_NOT_REJECT: "STW1.4", _NO_INTERMEDIATE_STOP: "STW1.5"}
    """Commands without which a task does not start, with their names; a homing needs no intermediate stop less."""
    HOLDING: ClassVar[Mapping[State, str]] = {}
    """The bit that keeps a function active as long as it is 1."""

    def __init__(self, course: Course, transitions: Mapping[State, tuple[Transition, ...]]) -> None:
        self.course = course
        self.seen = course.seen
        """State of the axis, read before each step."""
        self.state = next(iter(transitions))
        self.home_set = False
        self.request = NOTHING
        """The commands of this step."""
        self._commands = 0
        """The commands of the step before; out of operation without those whose edges count in it, and without a PLC in control
        with ``SET_REFERENCE_POINT``, because a bit that is 1 in its first frame is not an edge."""
        self._activate = EdgeOrder(ACTIVATE)
        self._home = EdgeOrder(HOME)
        self._orders: tuple[Order, ...] = (self._activate, self._home)
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
            Event.NOT_OPERATING: lambda: not self.seen.bits & Seen.OPERATING,
            Event.REJECTED: lambda: not self.request.commands & _DO_NOT_REJECT,
            Event.HOMING_WITHDRAWN: lambda: not self.request.commands & HOME,
        }

    def _actions(self) -> dict[Action, Callable[[], None]]:
        """The functions of the actions."""
        return {
            Action.NOTHING: lambda: None,
            Action.DROP: self._drop,
            Action.BRAKE: self._brake,
            Action.START: self._start,
            Action.REPLACE: self._start,
            Action.HOME: self._start_homing,
        }

    @property
    def way(self) -> int:
        """Remaining distance to the target, or the speed of a speed task with its sign; 0 without a task."""
        goal = self.course.goal
        if goal is None:
            return 0
        return goal.velocity if goal.kind is MotionKind.SPEED else self.course.way

    def forget_home(self) -> None:
        """The drive has new coordinates: its home position is unknown."""
        self.home_set = False

    def step(self, request: PositionerRequest, now: int) -> Reason | None:
        """Run one cycle; return why nothing moves just now. ``now``: monotonic nanoseconds."""
        raise NotImplementedError

    def warn(self, reason: Reason | None) -> None:
        """Replace the warning; None: end it."""
        self.course.warning = reason

    def _take_transition(self, calm: bool) -> None:
        """Take the first transition whose event is there."""
        for happened, act, row in self._table[self.state][calm]:
            if happened():
                act()
                if row.lost:
                    self._lose(row.lost)
                self.state = row.target
                break

    @property
    def _edges(self) -> int:
        """Rising edges of this step; bits that were 1 before operation are not edges."""
        return self.request.commands & ~self._commands

    def _follow_bits(self, *, operating: bool) -> None:
        """The commands or the operation have changed."""
        for order in self._orders:
            order.follow(self.request.commands, operating=operating)

    def _in(self, stages: int) -> int:
        """The bits of the orders in these stages."""
        bits = 0
        for order in self._orders:
            if order.stage & stages:
                bits |= order.bit
        return bits

    def _lose(self, bits: int) -> None:
        """These bits have lost their effect."""
        for order in self._orders:
            if order.bit & bits:
                order.lose()
        self._note_lacking(bits)

    @property
    def taken(self) -> int:
        """Bits of ``FUNCTIONS`` that have an effect without their order."""
        raise NotImplementedError

    @property
    def ignored(self) -> int:
        """Bits of ``FUNCTIONS`` that are 1 without an effect."""
        commands = self.request.commands
        ignored = ACTIVATE if commands & ACTIVATE and self._activate.stage & _IGNORED else 0
        if commands & HOME and self._home.stage & _IGNORED:
            ignored |= HOME
        if commands & JOGS:
            ignored |= commands & JOGS & self._in(_IGNORED)
        return ignored and ignored & ~self.taken

    def reason_of_ignored(self) -> Reason | None:
        """What the first of them lacks."""
        ignored = self.ignored
        if ignored & ACTIVATE:
            return Reason.EARLY_EDGE if self._activate.stage == _EARLY else Reason.LOST_EDGE
        if ignored & HOME:
            return Reason.LOST_HOMING
        return Reason.LOST_JOG if ignored else None

    def _note_lacking(self, bits: int) -> None:
        """The edge of these bits comes, or their effect ends: keep which commands are 0 now, else which function runs."""
        state = self.state
        runs, holding = Lack(f"{state.value} was active at its edge"), self.HOLDING.get(state, "")
        if holding:
            runs = Lack(f"{holding} = 1 ({state.value}) at its edge", holding=holding)
        elif state in SELECTABLE or state is _OFF:
            runs = Lack("its task was rejected")
        commands = self.request.commands
        for order in self._orders:
            jogs = order.bit & JOGS
            if not bits & (JOGS if jogs else order.bit):
                continue
            zeros = tuple(
                name
                for command, name in self.NEEDED.items()
                if not commands & command and (order is self._activate or command != _NO_INTERMEDIATE_STOP)
            )
            if jogs and commands & JOGS == JOGS:
                order.lack = Lack("both were 1")
            else:
                lack = Lack(f"{equation(zeros, 0)} at its edge or after it", zeros)
                order.lack = lack if zeros else runs

    def lack(self, bits: int) -> Lack:
        """Why the last edge of one of these bits started nothing; with none of them, the function that runs."""
        if not bits:
            return Lack(self.state.value)
        if self._in(_EARLY) & bits:
            return Lack("it was 1 before operation")
        return next(order.lack for order in self._orders if order.bit & bits)

    def _homing_is(self, result: HomingResult) -> bool:
        return self.seen.taken >= self.course.motion.serial and self.seen.homing is result

    def _forget(self) -> None:
        """No function runs."""
        self.course.drop()

    def _drop(self) -> None:
        raise NotImplementedError

    def _brake(self) -> None:
        raise NotImplementedError

    def _start(self) -> None:
        raise NotImplementedError

    def _start_homing(self) -> None:
        raise NotImplementedError
