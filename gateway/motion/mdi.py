"""The positioner of telegram 9: MDI tasks and homing, by ``states.MDI_TRANSITIONS``.

Source: docs/translation.md "Positioning, telegram 9 (MDI)"; the manufacturer's guide 5.2 and 6.7-6.14. Goals are in the drive's
units: the executor converts a task with the data of its edge, and finds the way of a turntable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar, Protocol

from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.positioner import ACTIVATE, HOME, Positioner
from pdgw.gateway.motion.requests import (
    Command,
    Goal,
    HomingResult,
    PositionerFeedback,
    PositionerRequest,
    Seen,
)
from pdgw.gateway.motion.states import MDI_TRANSITIONS, Action, Event, State
from pdgw.gateway.motion.travel import Course

_IDLE, _MDI, _BRAKING, _HOMING = State.IDLE, State.MDI, State.BRAKING, State.HOMING
_DO_NOT_REJECT, _NO_INTERMEDIATE_STOP, _MDI_SELECTED = Command.DO_NOT_REJECT, Command.NO_INTERMEDIATE_STOP, Command.MDI
_SELECTED = _DO_NOT_REJECT | _MDI_SELECTED
_HOMES = _DO_NOT_REJECT | HOME
_FUNCTIONS = ACTIVATE | HOME
_STOPPED = Seen.STOPPED


class MdiDrive(Protocol):
    """The positioner's interface to its executor."""

    def require_homing(self, *, edge: bool) -> bool:
        """Whether the requested homing with this ``edge`` may start."""

    def converted(self, request: PositionerRequest) -> Goal:
        """The requested task."""


class MdiPositioner(Positioner):
    """One axis' positioner, without jogs."""

    FUNCTIONS: ClassVar[int] = _FUNCTIONS
    NEEDED: ClassVar[Mapping[int, str]] = {**Positioner.NEEDED, _MDI_SELECTED: "SATZANW.15"}
    HOLDING: ClassVar[Mapping[State, str]] = {_HOMING: "STW1.11"}

    def __init__(self, drive: MdiDrive) -> None:
        self._drive = drive
        self.homing: tuple[int, int] | None = None
        """Method, and velocity as a fraction, of the homing that runs or waits for standstill: those of its edge."""
        self._waiting: Goal | None = None
        """The task of the newest edge, waiting to start."""
        self._braking_reason: Reason | None = None
        super().__init__(Course(PositionerFeedback(), None), MDI_TRANSITIONS)

    def set_drive(self, velocity: int, window: int | None, period: int) -> None:
        """Set the only velocity of a task, for a drive without 6081h (0: any), the largest distance from the target of a task
        that has ended (None: only the drive knows), and the number of positions that the drive shows."""
        course = self.course
        course.only_velocity, course.window, course.period = velocity, window, period

    def homed(self) -> None:
        """The drive's position now counts from its home position."""
        self.home_set = True

    def step(self, request: PositionerRequest, now: int) -> Reason | None:
        self.request = request
        course, before, operating = self.course, self.state, self.seen.bits & Seen.OPERATING != 0
        course.look()
        if request.commands != self._commands or not operating:
            self._follow_bits(operating=operating)
            self._note_lacking(self._edges)
        if before is _BRAKING and operating:
            self._take_while_braking(request)
        accepts = request.commands & _DO_NOT_REJECT != 0
        self._take_transition(operating and accepts and not self._edges)
        state = self.state
        if state is not _HOMING:
            course.follow(request, now)
        if not accepts and course.warning is not Reason.LOST_EDGE:
            self.warn(None)
        reason = self._reason(request, before)
        if state is not _BRAKING:
            self._braking_reason = None
        self._commands = request.commands
        return reason

    def _reason(self, request: PositionerRequest, before: State) -> Reason | None:
        """Why the axis does not follow."""
        state = self.state
        if state is _BRAKING or before is _BRAKING:
            return self._braking_reason
        idle = before is _IDLE or (before is _HOMING and self.seen.homing is not HomingResult.RUNNING)
        warning = self.course.warning
        if state is _IDLE and idle and (warning is None or warning is Reason.LOST_EDGE):
            lost = warning or self.reason_of_ignored()
            if lost is not None and not request.commands & _DO_NOT_REJECT:
                return Reason.REJECTED
            if not request.commands & _MDI_SELECTED:
                return Reason.MDI_OFF
            if lost is Reason.LOST_EDGE and not request.commands & _NO_INTERMEDIATE_STOP:
                return Reason.INTERMEDIATE_STOP
        return self.course.held

    @property
    def taken(self) -> int:
        return (ACTIVATE if self._waiting is not None else 0) | (HOME if self.homing is not None else 0)

    def _events(self) -> dict[Event, Callable[[], int]]:
        return {
            **super()._events(),
            Event.DESELECTED: lambda: not self.request.commands & _MDI_SELECTED,
            Event.HOMING: self._take_homing,
            Event.HOMING_LOST: lambda: self._edges & HOME and self.request.commands & _SELECTED != _SELECTED,
            Event.HOMING_OVER: lambda: not self.request.commands & HOME and not self._homes(),
            Event.MDI: self._take_edge,
            Event.REACHED: lambda: self.request.commands & _NO_INTERMEDIATE_STOP and self.course.arrived(),
            Event.STANDING: lambda: self.seen.bits & _STOPPED,
            Event.STANDING_HOMING: lambda: self.seen.bits & _STOPPED and self.homing is not None,
            Event.STANDING_TASK: lambda: self.seen.bits & _STOPPED and self._waiting is not None,
            Event.TASK_AFTER_HOMING: self._take_task_after_homing,
        }

    def _actions(self) -> dict[Action, Callable[[], None]]:
        return {**super()._actions(), Action.BRAKE_TO_HOME: self._brake_to_home, Action.FINISH: self._finish}

    # -- edges ----------------------------------------------------------------------------------------------------------

    def _take_homing(self) -> bool:
        """The edge of a homing that the drive has."""
        request, edge = self.request, self._edges & HOME != 0
        accepts = request.commands & _DO_NOT_REJECT != 0
        if not self._drive.require_homing(edge=edge and accepts):
            return False
        self.homing = (request.number, request.velocity)
        return True

    def _homes(self) -> bool:
        """The drive homes."""
        return self._homing_is(HomingResult.RUNNING)

    def _take_edge(self) -> bool:
        self._take_task()
        return self._waiting is not None

    def _take_task_after_homing(self) -> bool:
        """During a homing an edge starts nothing, but in the frame that ends one that is done or that the drive has not begun."""
        if self.request.commands & HOME or self._homes():
            return False
        self.warn(None)
        return self._take_edge()

    def _take_task(self) -> None:
        """An edge with everything else given is a task with the data of its frame, in place of one that waits."""
        request = self.request
        if not self._edges & ACTIVATE:
            return
        refusal: Reason | None = None
        selected = request.commands & _SELECTED == _SELECTED
        if not (selected and (request.commands & _NO_INTERMEDIATE_STOP or self.state is _MDI)):
            refusal = Reason.LOST_EDGE
        elif not (goal := self._drive.converted(request)).velocity:
            refusal = Reason.TASK_SPEED_ZERO
        elif self.course.lacks_velocity(goal.velocity):
            refusal = Reason.TASK_VELOCITY
        elif request.acceleration <= 0 or request.deceleration <= 0:
            refusal = Reason.TASK_RAMP_ZERO
        else:
            self._waiting = goal
        self.warn(refusal)

    def _take_while_braking(self, request: PositionerRequest) -> None:
        if self._take_homing():
            self._waiting = None
        elif request.commands & _HOMES != _HOMES:
            self.homing = None
        self._take_task()
        if request.commands & _SELECTED != _SELECTED:
            self._waiting = None

    # -- functions ------------------------------------------------------------------------------------------------------

    def _forget(self) -> None:
        super()._forget()
        self._waiting = None

    def _finish(self) -> None:
        self._forget()
        self.homing = None

    def _drop(self) -> None:
        self._finish()
        self.warn(None)

    def _brake(self) -> None:
        self._finish()
        request, homes = self.request, self.state is _HOMING
        if homes:
            self._take_while_braking(request)
        stopped = Reason.HOMING_STOPPED if homes else Reason.MDI_OFF
        self._braking_reason = stopped if request.commands & _DO_NOT_REJECT else Reason.REJECTED

    def _brake_to_home(self) -> None:
        self._braking_reason = None
        self._forget()

    def _start(self) -> None:
        goal = self._waiting
        assert goal is not None, "the rows with a start follow an edge"
        self._finish()
        self._activate.start(self.request.commands)
        self.course.aim(goal)

    def _start_homing(self) -> None:
        self._forget()
        self._home.start(self.request.commands)
        self.warn(None)
        self.course.home()
