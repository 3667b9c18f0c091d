"""The sequence of setpoints in the user's coordinates: speeds, software limits, fixed stops, and what waits in the drive.

``travel`` has what all positioners need of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.modulo import Direction, way
from pdgw.gateway.motion.requests import (
    FULL,
    Goal,
    MotionKind,
    PositionerChoices,
    PositionerRequest,
    Seen,
)
from pdgw.gateway.motion.travel import ENDLESS, Course
from pdgw.profidrive.datatypes import DataType

FIXED_STOP_NS: Final = 100 * MS
"""Time at standstill at the torque limit that makes a fixed stop."""
_POSITION, _SPEED = MotionKind.POSITION, MotionKind.SPEED
_OUT_OF_RANGE: Final = (Reason.TASK_TARGET_RANGE, Reason.TASK_DRIVE_RANGE)
_PRESSES: Final = Seen.STANDSTILL | Seen.TORQUE_AT_LIMIT


@dataclass(slots=True, eq=False)
class UserCourse(Course):
    """The same in the user's coordinates: with speeds, software limits, fixed stops, and a setpoint that waits in the drive.

    It names its base, because ``super`` does not find that of a class that ``dataclass`` made again for its slots.
    """

    choices: PositionerChoices = field(kw_only=True)
    positions: tuple[int, int] = ENDLESS
    """Positions that the drive accepts,"""
    ends: str = ""
    """and the objects that limit them."""
    turn: tuple[int, int] = ENDLESS
    """Positions that the drive reaches without a wrap."""
    distances: tuple[int, int] = DataType.INTEGER32.integer_range
    """Distances of one relative task."""
    why: str = ""
    """Values of the last task that was refused: what is out of range, and whose range it is."""
    offset: int = 0
    """User's coordinate minus the drive's."""
    speed: Goal | None = None
    """The task of a function with a speed, without software limits."""
    queued: int = 0
    """Serial of the setpoint that waits in the drive for the end of the one that runs, 0 for none."""
    limits: tuple[int, int] | None = None
    """The software limits, while they are watched."""
    limits_moved: bool = False
    """They became active or inactive, or their place in the drive's coordinates changed."""
    speed_limited: bool = False
    """The speed of the newest setpoint is the maximum, because more was requested."""
    _limited: bool = False
    """The requested speed was above the maximum."""
    _stop_since: int = -1
    """Since when the axis is at standstill at its torque limit, monotonic ns; -1: it is not; 0: that is a fixed stop."""

    @property
    def fixed_stop(self) -> bool:
        """The axis has reached the fixed stop of its task."""
        return self._stop_since == 0

    @property
    def rests_at_limit(self) -> bool:
        """A function with a speed has led the axis to a software limit, and it is at standstill there."""
        goal = self.goal
        return self.speed is not None and goal is not None and goal.kind is _POSITION and self.arrived()

    def watch_limits(self, watched: bool) -> None:
        """Take whether the software limits are watched, before anything is decided."""
        limits = self.choices.software_limits if watched else None
        if limits is not self.limits:
            self.limits, self.limits_moved = limits, True

    def refer(self, coordinate: int, position: int) -> None:
        """A position of the drive has this coordinate of the user."""
        self.offset = coordinate - position
        self.limits_moved = True

    def _begin_at(self, goal: Goal, target: int) -> None:
        """``target`` is its end, or the software limit before it."""
        limits = self.limits
        inside = target if limits is None else self._inside(target + self.offset, limits) - self.offset
        if inside == target:
            Course._begin_at(self, goal, target)
        else:
            self.warning = Reason.SOFTWARE_LIMIT
            self.aim(replace(goal, target=inside, distance=None))

    def _aim_again(self) -> None:
        """The software limits have another place: a target beyond them is replaced, or the axis stops if it is beyond already."""
        goal, limits = self.goal, self.limits
        if self.speed is not None:
            self._aim_speed()
        elif goal is not None and limits is not None:
            target = self._inside(goal.target + self.offset, limits) - self.offset
            if target != goal.target:
                self.warning = Reason.SOFTWARE_LIMIT
                position = self.seen.position
                if (target - position) * (goal.target - position) > 0:
                    self.aim(replace(goal, target=target, distance=None))
                else:
                    self.drop_goal()
            elif self.queued:
                self.aim(goal)  # and look again at the setpoint that waits in the drive

    def refusal(self, target: int, absolute: bool, direction: Direction = Direction.SHORTEST) -> Reason | None:
        """Why the drive cannot be sent to a position of the user, or by a distance, as far as the software limits let it."""
        modulo, offset = self.choices.modulo, self.offset
        if modulo and absolute and self._outside("target", target, (0, modulo - 1), "modulo_range"):
            return Reason.TASK_TARGET_RANGE
        end = self._end(target, absolute, direction)
        distance = end - offset - self.seen.position
        if self.limits is not None:
            end = self._inside(end, self.limits)
        numbers = DataType.INTEGER32.integer_range
        if not modulo and self._outside("end of the task", end, numbers, "32 bits of a position"):
            return Reason.TASK_TARGET_RANGE
        low, high = self.positions
        if self._outside("end of the task", end, (low + offset, high + offset), f"{self.ends} of the drive"):
            return Reason.TASK_DRIVE_RANGE
        first, last = self.turn
        if not (absolute and first <= end - offset <= last) and self._outside(
            "distance", distance, self.distances, "607Ah of the drive"
        ):
            return Reason.TASK_TARGET_RANGE
        return None

    @property
    def evidence(self) -> str:
        """Values of the warning that is active, where it has some."""
        limits = self.choices.software_limits
        if self.warning is Reason.SOFTWARE_LIMIT and limits is not None:
            return "software_limits {} to {} LU of the configuration".format(*limits)
        return self.why if self.warning in _OUT_OF_RANGE else ""

    def _outside(self, what: str, value: int, allowed: tuple[int, int], whose: str) -> bool:
        low, high = allowed
        if low <= value <= high:
            return False
        self.why = f"{what} {value} LU, allowed {low} to {high} ({whose})"
        return True

    def _end(self, target: int, absolute: bool, direction: Direction) -> int:
        """End of a task in the user's coordinates; for a modulo axis across its turns."""
        begin = self.seen.position + self.offset
        if not absolute:
            return begin + target
        modulo = self.choices.modulo
        return begin + way(begin, target, modulo, direction, self.choices.position_window) if modulo else target

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
            self.warning = Reason.SOFTWARE_LIMIT

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
                self.warning = Reason.SOFTWARE_LIMIT
        target = end - self.offset
        self.aim(Goal(_POSITION, target, distance, limited, acceleration, deceleration, torque=torque))

    @staticmethod
    def _inside(position: int, limits: tuple[int, int]) -> int:
        """A position of the user, or the software limit it is beyond."""
        return max(limits[0], min(position, limits[1]))

    def aim(self, goal: Goal) -> None:
        Course.aim(self, goal)
        self.queued = 0
        self._stop_since = -1

    def drop_goal(self) -> None:
        Course.drop_goal(self)
        self.speed = None
        self.queued = 0

    def follow(self, request: PositionerRequest, now: int) -> None:
        """The same, with software limits and fixed stop."""
        if self.limits_moved:
            self.limits_moved = False
            self._aim_again()
        Course.follow(self, request, now)
        goal = self.goal
        if goal is None:
            self._stop_since = -1
            return
        if goal.torque is not None:
            self._detect_fixed_stop(now)
        if self.held:
            self.queued = 0

    def _send(self, goal: Goal, override: int) -> None:
        Course._send(self, goal, override)
        self.queued = 0
        highest = self.choices.max_velocity * FULL
        self.speed_limited = self._limited or abs(goal.velocity) * override > highest

    def queue(self, position: int, absolute: bool, velocity: int, acceleration: int, deceleration: int) -> None:
        """Send a position task that waits in the drive for the end of the goal; not beyond a limit, where the axis must stop."""
        goal = self.goal
        if goal is None or self.held or self.queued or self.seen.taken < self.sent:
            return
        if self.lacks_velocity(velocity, self.motion.override):
            return
        target = position - self.offset if absolute else goal.target + position
        end = target + self.offset
        if self.limits is not None and self._inside(end, self.limits) != end:
            return
        if self.refusal(end, True) is not None or not self.turn[0] <= target <= self.turn[1]:
            return
        motion = self.motion
        motion.serial += 1
        motion.goal = Goal(
            _POSITION, target, None, min(velocity, self.choices.max_velocity), acceleration, deceleration
        )
        self.queued = motion.serial

    def use_queued(self) -> None:
        """The drive has gone over to the setpoint that waited: it is the goal now."""
        self.aim(self.motion.goal)
        self.sent = self.motion.serial

    def _detect_fixed_stop(self, now: int) -> None:
        since = self._stop_since
        if not since:
            return
        if self.seen.bits & _PRESSES != _PRESSES:
            self._stop_since = -1
        elif since < 0:
            self._stop_since = now
        elif now - since >= FIXED_STOP_NS:
            self._stop_since = 0
