"""Sequence of setpoints of a positioner, from the goal of the active function; each is sent once.

It handles the kept task of an intermediate stop, override and software limits, and decides when a setpoint is new. Goals have
drive coordinates; ``offset`` converts to the user's. Not here: the active function (``positioner``) and the handshake of the
drive (executors).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from pdgw.durations import MS
from pdgw.gateway.motion.requests import (
    FULL,
    Command,
    Goal,
    Motion,
    MotionKind,
    PositionerChoices,
    PositionerFeedback,
    PositionerRequest,
    PositionerResult,
)
from pdgw.gateway.motion.units import Direction, way
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.datatypes import DataType

FIXED_STOP_NS: Final = 100 * MS
"""Time at standstill at the torque limit that makes a fixed stop."""
LIMIT_STANDING_NS: Final = 500 * MS
"""If a drive reports an internal limit and is at standstill for this time with a setpoint or task, the limit (a limit switch)
stops it. A drive with a limited speed has left standstill by then.
"""
_STAND, _POSITION, _SPEED = MotionKind.STAND, MotionKind.POSITION, MotionKind.SPEED
_NO_INTERMEDIATE_STOP: Final = Command.NO_INTERMEDIATE_STOP


@dataclass(slots=True, eq=False)
class Course:
    """The goal of one axis; ``follow`` once per cycle brings ``outcome.motion`` in line with it."""

    choices: PositionerChoices
    result: PositionerResult
    seen: PositionerFeedback
    window: int | None
    """Largest distance from the target of a task that has ended; None: only the drive knows."""
    positions: tuple[int, int] = DataType.INTEGER32.integer_range
    """Positions that the drive accepts, and"""
    distances: tuple[int, int] = DataType.INTEGER32.integer_range
    """distances of one relative task; at first all that a telegram can request."""
    offset: int = 0
    """User's coordinate minus the drive's."""
    goal: Goal | None = None
    """The present task; None: ramp to standstill."""
    sent: int = 0
    """Serial of the newest setpoint of the goal, 0 while there is none."""
    speed: Goal | None = None
    """The task of a function with a speed, without software limits."""
    held: Reason | None = None
    """Why the goal is kept and not pursued."""
    queued: int = 0
    """Serial of the setpoint that waits in the drive, 0 for none."""
    only_velocity: int = 0
    """The velocity of all tasks to a position, on a drive without 6081h; 0: each task has its own."""
    limits: tuple[int, int] | None = None
    """The software limits, while they are watched."""
    limits_moved: bool = False
    """They became active or inactive, or their place in the drive's coordinates changed."""
    _limited: bool = False
    """The requested speed was above the maximum."""
    _limit_since: int = -1
    """Since when the drive is at standstill at an internal limit, monotonic ns; -1: it is not."""
    _at_limit: bool = False
    """This limit stops the goal until another one, or an intermediate stop."""
    _stop_since: int = -1
    """Since when the axis is at standstill at its torque limit, monotonic ns; -1: it is not."""

    def look(self, limits: bool) -> None:
        """Take whether the software limits are watched, and the begin of a relative task, before anything is decided."""
        watched = self.choices.software_limits if limits else None
        if watched is not self.limits:
            self.limits, self.limits_moved = watched, True
        goal = self.goal
        if goal is not None and goal.distance is not None and self.waits:
            self._begin_at(goal, self.seen.position + goal.distance)

    def _begin_at(self, goal: Goal, target: int) -> None:
        """A relative task begins at the present position: ``target`` is its end, or the software limit before it."""
        limits = self.limits
        inside = target if limits is None else self._inside(target + self.offset, limits) - self.offset
        if inside == target:
            self.goal = replace(goal, target=target)
        else:
            self.result.warning = Reason.SOFTWARE_LIMIT
            self.aim(replace(goal, target=inside, distance=None))

    def drop(self) -> None:
        """No goal any more: ramp to standstill."""
        self.result.motion.forget()
        self.goal = self.speed = self.held = None
        self.sent = self.queued = 0
        self._at_limit = False

    def _aim_again(self) -> None:
        """The software limits have another place: a target beyond them is replaced, or the axis stops if it is beyond already."""
        goal, limits = self.goal, self.limits
        if self.speed is not None:
            self._aim_speed()
        elif goal is not None and limits is not None:
            target = self._inside(goal.target + self.offset, limits) - self.offset
            if target != goal.target:
                self.result.warning = Reason.SOFTWARE_LIMIT
                position = self.seen.position
                if (target - position) * (goal.target - position) > 0:
                    self.aim(replace(goal, target=target, distance=None))
                else:
                    self.drop_goal()
            elif self.queued:
                self.aim(goal)  # and look again at the setpoint that waits in the drive

    def in_range(self, target: int, absolute: bool, direction: Direction = Direction.SHORTEST) -> bool:
        """Whether the drive can be sent to a position of the user, or by a distance, as far as the software limits let it."""
        low, high = self.positions
        modulo = self.choices.modulo
        if modulo and absolute and not 0 <= target < modulo:
            return False
        shortest, longest = self.distances
        if not absolute and not shortest <= target <= longest:
            return False
        end = self._end(target, absolute, direction)
        if self.limits is not None:
            end = self._inside(end, self.limits)
        return low <= end - self.offset <= high

    def _end(self, target: int, absolute: bool, direction: Direction) -> int:
        """End of a task in the user's coordinates; for a modulo axis across its turns."""
        begin = self.seen.position + self.offset
        if not absolute:
            return begin + target
        modulo = self.choices.modulo
        return begin + way(begin, target, modulo, direction, self.choices.position_window) if modulo else target

    def lacks_velocity(self, velocity: int, override: int = FULL) -> bool:
        """Whether a task to a position is slower than the only velocity of the drive."""
        return abs(velocity) * override < self.only_velocity * FULL

    def arrived(self) -> bool:
        """The drive has reached the target of the goal in force, and is at standstill."""
        seen = self.seen
        if not (seen.reached and seen.standstill and self._executes()):
            return False
        window = self.window
        if window is None or self.goal is None or self.goal.distance is not None:
            return seen.answered
        return abs(self.goal.target - seen.position) <= window

    def _executes(self) -> bool:
        """The drive has taken the setpoint of a position."""
        goal = self.goal
        return goal is not None and goal.kind is _POSITION and 0 < self.sent <= self.seen.taken and not self.held

    def expects_end(self) -> bool:
        """The end of a motion to a position is due at standstill. At a fixed stop the axis is meant to press on."""
        seen, goal = self.seen, self.goal
        return seen.standstill and goal is not None and goal.torque is None and self._executes() and not self.arrived()

    @property
    def waits(self) -> bool:
        """There is a goal, and the drive was not given it."""
        return self.goal is not None and (not self.sent or self.seen.given < self.sent)

    # -- goals ----------------------------------------------------------------------------------------------------------

    def go(self, velocity: int, acceleration: int, deceleration: int, *, scaled: bool = True) -> None:
        """Move with a signed speed, to the software limit where one is watched."""
        limited = max(-self.choices.max_velocity, min(velocity, self.choices.max_velocity))
        self._limited = limited != velocity
        self.speed = Goal(_SPEED, 0, None, limited, acceleration, deceleration, scaled)
        self._aim_speed()

    def _aim_speed(self) -> None:
        """Create the goal of a function with a speed, again when software limits become active or inactive."""
        speed = self.speed
        assert speed is not None, "only functions with a speed come here"
        if self.limits is None:
            self.aim(speed)
            return
        target = self.limits[speed.velocity > 0] - self.offset
        if (target - self.seen.position) * speed.velocity > 0:
            self.aim(replace(speed, kind=_POSITION, target=target, velocity=abs(speed.velocity)))
        else:
            self.goal = None
            self.result.warning = Reason.SOFTWARE_LIMIT

    def go_to(
        self,
        target: int,
        absolute: bool,
        velocity: int,
        acceleration: int,
        deceleration: int,
        torque: int | None = None,
        direction: Direction = Direction.SHORTEST,
    ) -> None:
        """Move to a position of the user or by a distance, not beyond a software limit that is watched."""
        self.speed = None
        highest = self.choices.max_velocity
        limited = velocity if velocity < highest else highest
        self._limited = limited != velocity
        distance = None if absolute else target
        end = self._end(target, absolute, direction)
        if self.limits is not None:
            inside = self._inside(end, self.limits)
            if inside != end:
                end, distance = inside, None
                self.result.warning = Reason.SOFTWARE_LIMIT
        target = end - self.offset
        self.aim(Goal(_POSITION, target, distance, limited, acceleration, deceleration, torque=torque))

    @staticmethod
    def _inside(position: int, limits: tuple[int, int]) -> int:
        """A position of the user, or the software limit it is beyond."""
        return max(limits[0], min(position, limits[1]))

    def aim(self, goal: Goal) -> None:
        """Another goal."""
        result = self.result
        self.goal = goal
        self.sent = self.queued = 0
        self._at_limit = result.fixed_stop = False
        self._limit_since = self._stop_since = -1
        result.to_fixed_stop = goal.torque is not None

    def drop_goal(self) -> None:
        """Keep the function without a goal."""
        self.goal = self.speed = None
        self.queued = 0

    # -- setpoints -----------------------------------------------------------------------------------------------------

    def follow(self, request: PositionerRequest, now: int) -> None:
        """Adapt the motion to the task: hold, resume, override, software limits."""
        motion, goal = self.result.motion, self.goal
        if self.limits_moved:
            self.limits_moved = False
            self._aim_again()
            goal = self.goal
        override = request.override if goal is not None and goal.scaled else FULL
        if goal is not None and goal.kind is _POSITION and self.lacks_velocity(goal.velocity, override):
            self.result.warning = Reason.TASK_VELOCITY
            self.drop_goal()
            goal = None
        if goal is None:
            motion.kind = _STAND
            motion.torque = None
            self.held = None
            self.result.to_fixed_stop = self.result.fixed_stop = False
            return
        held = self.held
        holds = self.held = self._hold(goal, request, now)
        if goal.torque is not None:
            self._detect_fixed_stop(now)
        if holds:
            motion.kind = _STAND
            self.queued = 0
            return
        if self.sent:
            if not held and motion.override == override:
                return
            if goal.distance is not None and self.seen.given >= self.sent:
                goal = self.goal = replace(goal, distance=None)  # only once
        self._send(motion, goal, override)

    def _hold(self, goal: Goal, request: PositionerRequest, now: int) -> Reason | None:
        """Why a task is kept but not executed."""
        seen = self.seen
        if not request.commands & _NO_INTERMEDIATE_STOP:
            self._at_limit = False
            self._limit_since = -1
            return Reason.INTERMEDIATE_STOP
        if goal.scaled and request.override == 0:
            return Reason.OVERRIDE_ZERO
        stands = seen.internal_limit and seen.standstill and self.sent and seen.given >= self.sent
        # At a fixed stop the axis is meant to stay at the torque limit.
        if not stands or goal.torque is not None or self.arrived():
            self._limit_since = -1
        elif self._limit_since < 0:
            self._limit_since = now
        elif now - self._limit_since >= LIMIT_STANDING_NS:
            self._at_limit = True
        return Reason.TASK_AT_LIMIT if self._at_limit else None

    def _send(self, motion: Motion, goal: Goal, override: int) -> None:
        self.sent = motion.serial = serial = motion.serial + 1
        self.queued = 0
        motion.kind, motion.goal, motion.torque = goal.kind, goal, goal.torque
        motion.override, motion.immediate = override, True
        highest = self.choices.max_velocity * FULL
        self.result.speed_limited = self._limited or abs(goal.velocity) * override > highest
        if not motion.first:
            motion.first = serial

    def queue(self, position: int, absolute: bool, velocity: int, acceleration: int, deceleration: int) -> None:
        """Send a position task that waits in the drive for the end of the goal; not beyond a limit, where the axis must stop."""
        goal = self.goal
        if goal is None or self.held or self.queued or self.seen.taken < self.sent:
            return
        if self.lacks_velocity(velocity, self.result.motion.override):
            return
        target = position - self.offset if absolute else goal.target + position
        end = target + self.offset
        if (self.limits is not None and self._inside(end, self.limits) != end) or not self.in_range(end, True):
            return
        motion = self.result.motion
        motion.serial += 1
        motion.goal = Goal(
            _POSITION, target, None, min(velocity, self.choices.max_velocity), acceleration, deceleration
        )
        motion.immediate = False
        self.queued = motion.serial

    def use_queued(self) -> None:
        """The drive has gone over to the setpoint that waited: it is the goal now."""
        motion = self.result.motion
        self.aim(motion.goal)
        self.sent = motion.serial

    def _detect_fixed_stop(self, now: int) -> None:
        seen = self.seen
        if not (seen.standstill and seen.torque_at_limit):
            self._stop_since = -1
        elif self._stop_since < 0:
            self._stop_since = now
        elif now - self._stop_since >= FIXED_STOP_NS:
            self.result.fixed_stop = True
