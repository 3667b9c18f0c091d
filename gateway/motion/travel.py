"""Sequence of setpoints of a positioner, from the goal of the active function; each is sent once.

It handles the kept task of an intermediate stop and override, and decides when a setpoint is new. Goals have
drive coordinates; ``offset`` converts to the user's. Not here: the active function (``positioner``) and the handshake of the
drive (executors).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.modulo import difference
from pdgw.gateway.motion.requests import (
    FULL,
    Command,
    Goal,
    Motion,
    MotionKind,
    PositionerFeedback,
    PositionerRequest,
    Seen,
)

LIMIT_STANDING_NS: Final = 500 * MS
"""If a drive reports an internal limit and is at standstill for this time with a setpoint or task, the limit (a limit switch)
stops it. A drive with a limited speed has left standstill by then.
"""
LIMIT_LEFT_NS: Final = 10 * SECOND
"""The same for a limit that was there before the motion, which may be its way out: as long as a drive may need for its brake."""
ENDLESS: Final = (-(1 << 62), (1 << 62) - 1)
"""Range of a position that continues across the ends of the drive's."""
_STAND, _POSITION = MotionKind.STAND, MotionKind.POSITION
_NO_INTERMEDIATE_STOP: Final = Command.NO_INTERMEDIATE_STOP
_ARRIVED: Final = Seen.REACHED | Seen.STANDSTILL
_STOPPED_AT_LIMIT: Final = Seen.INTERNAL_LIMIT | Seen.STANDSTILL
_MAY_BE_LEFT: Final = Seen.INTERNAL_LIMIT | Seen.TURNS


@dataclass(slots=True, eq=False)
class Stall:
    """An axis at standstill before its motion has ended. Call ``step`` once per cycle.

    Way counts, not speed: a slow task is always inside the standstill window.
    """

    time: int
    """Time without way that is a stall, ns."""
    _since: int = -1
    """When the axis made way last, monotonic ns; -1: nothing is expected."""
    _lowest: int = 0
    """Lowest and"""
    _highest: int = 0
    """highest position since: encoder noise stays between them."""

    def step(self, expects: bool, position: int, now: int) -> bool:
        """One cycle; True for a stalled axis. ``expects``: the axis is at standstill, and its motion has not ended."""
        if not expects:
            self._since, self._lowest, self._highest = -1, 0, 0
        elif self._since < 0:
            self._since, self._lowest, self._highest = now, position, position
        elif not self._lowest <= position <= self._highest:
            self._since = now
            self._lowest, self._highest = min(position, self._lowest), max(position, self._highest)
        return self._since >= 0 and now - self._since >= self.time


@dataclass(slots=True, eq=False)
class Course:
    """The goal of one axis; ``follow`` once per cycle brings ``motion`` in line with it."""

    seen: PositionerFeedback
    window: int | None
    """Largest distance from the target of a task that has ended; None: only the drive knows."""
    only_velocity: int = 0
    """The velocity of all tasks to a position, on a drive without 6081h; 0: each task has its own."""
    period: int = ENDLESS[1]
    """A target at this distance is reached as well: the drive shows the same position there."""
    motion: Motion = field(default_factory=Motion)
    """What the drive has to do."""
    goal: Goal | None = None
    """The present task; None: ramp to standstill."""
    sent: int = 0
    """Serial of the newest setpoint of the goal, 0 while there is none."""
    held: Reason | None = None
    """Why the goal is kept and not pursued."""
    warning: Reason | None = None
    """Active until a reject or the next task."""
    _limit: Stall = field(default_factory=lambda: Stall(LIMIT_STANDING_NS))
    """No way at an internal limit of the drive."""
    _at_limit: bool = False
    """The limit stops the goal, until another one or an intermediate stop."""

    def look(self) -> None:
        """Take the begin of a relative task, before anything is decided."""
        goal = self.goal
        if goal is not None and goal.distance is not None and self.waits:
            self._begin_at(goal, self.seen.position + goal.distance)

    def _begin_at(self, goal: Goal, target: int) -> None:
        """A relative task begins at the present position: ``target`` is its end."""
        self.goal = replace(goal, target=target)

    def drop(self) -> None:
        """No goal any more: ramp to standstill."""
        self.motion.forget()
        self.drop_goal()
        self.held = None
        self.sent = 0
        self._at_limit = False

    def lacks_velocity(self, velocity: int, override: int = FULL) -> bool:
        """Whether a task to a position is slower than the only velocity of the drive."""
        return abs(velocity) * override < self.only_velocity * FULL

    def arrived(self) -> bool:
        """The drive has reached the target of the goal in force, and is at standstill."""
        seen, goal, window = self.seen, self.goal, self.window
        if seen.bits & _ARRIVED != _ARRIVED or not self._executes():
            return False
        if window is None or goal is None or goal.distance is not None:
            return seen.bits & Seen.ANSWERED != 0
        return abs(self.way) <= window

    @property
    def way(self) -> int:
        """Remaining distance to the target; 0 without one."""
        goal = self.goal
        return 0 if goal is None else difference(goal.target, self.seen.position, self.period)

    def _executes(self) -> bool:
        """The drive has taken the setpoint of a position."""
        goal = self.goal
        return goal is not None and goal.kind is _POSITION and 0 < self.sent <= self.seen.taken and not self.held

    def expects_end(self) -> bool:
        """The end of a motion to a position is due at standstill. At a fixed stop the axis is meant to press on."""
        goal = self.goal
        if goal is None or goal.torque is not None or not self.seen.bits & Seen.STANDSTILL:
            return False
        return self._executes() and not self.arrived()

    @property
    def waits(self) -> bool:
        """There is a goal, and the drive was not given it."""
        return self.goal is not None and (not self.sent or self.seen.given < self.sent)

    def aim(self, goal: Goal) -> None:
        """Another goal."""
        self.goal = goal
        self.sent = 0
        self._at_limit = False

    def drop_goal(self) -> None:
        """Keep the function without a goal."""
        self.goal = None

    def home(self) -> None:
        """Another homing."""
        motion = self.motion
        motion.kind = MotionKind.HOMING
        motion.torque = None
        motion.serial += 1

    def follow(self, request: PositionerRequest, now: int) -> None:
        """Adapt the motion to the task: hold, resume, override."""
        motion, goal = self.motion, self.goal
        if self.seen.bits & _MAY_BE_LEFT != Seen.INTERNAL_LIMIT:
            self._limit.time = LIMIT_STANDING_NS
        elif goal is None or self.waits:
            self._limit.time = LIMIT_LEFT_NS
        override = request.override if goal is not None and goal.scaled else FULL
        if goal is not None and goal.kind is _POSITION and self.lacks_velocity(goal.velocity, override):
            self.warning = Reason.TASK_VELOCITY
            self.drop_goal()
            goal = None
        if goal is None:
            motion.kind = _STAND
            motion.torque = self.held = None
            return
        held = self.held
        holds = self.held = self._hold(goal, request, now)
        if holds:
            motion.kind = _STAND
            return
        if self.sent:
            if not held and motion.override == override:
                return
            if goal.distance is not None and self.seen.given >= self.sent:
                goal = self.goal = replace(goal, distance=None)  # only once
        self._send(goal, override)

    def _hold(self, goal: Goal, request: PositionerRequest, now: int) -> Reason | None:
        """Why a task is kept but not executed."""
        if not request.commands & _NO_INTERMEDIATE_STOP:
            self._at_limit = self._limit.step(False, 0, now)
            return Reason.INTERMEDIATE_STOP
        if goal.scaled and request.override == 0:
            self._limit.step(False, 0, now)
            return Reason.OVERRIDE_ZERO
        if not self._at_limit:
            # At a fixed stop the axis is meant to stay at the torque limit. The drive alone knows the end of a relative task.
            ended = goal.distance is not None and self.seen.bits & Seen.REACHED != 0
            moves = not self.waits and goal.torque is None and not ended and not self.arrived()
            self._at_limit = self._limit.step(moves and self._is_at_limit(), self.seen.position, now)
        return Reason.TASK_AT_LIMIT if self._at_limit else None

    def _is_at_limit(self) -> bool:
        return self.seen.bits & _STOPPED_AT_LIMIT == _STOPPED_AT_LIMIT

    def _send(self, goal: Goal, override: int) -> None:
        motion = self.motion
        self.sent = motion.serial = serial = motion.serial + 1
        motion.kind, motion.goal, motion.torque = goal.kind, goal, goal.torque
        motion.override = override
        if not motion.first:
            motion.first = serial
