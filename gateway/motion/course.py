"""The course of a positioner: from the goal of the function that runs to set-points, each given once.

What is kept over an intermediate stop, what override and software limits make of a goal, and when a set-point is a new one.
Positions of a goal are the drive's; ``offset`` leads to the user's. Left out: which function runs (``positioner``), and the
drive's handshake (executors).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pdgw.gateway.motion.wishes import FULL, Asked, Motion, MotionKind, Outcome, PositionerSettings, Seen
from pdgw.gateway.reasons import Reason

MS = 1_000_000
FIXED_STOP_NS = 100 * MS
"""Standing at the torque limit for so long is the fixed stop."""
LIMIT_STANDING_NS = 500 * MS
"""An axis that stands at an internal limit of the drive for so long is held by it."""


@dataclass(slots=True, unsafe_hash=True)
class Goal:
    """What the axis is to do; it outlives intermediate stops. Replaced, never changed.

    Under continuous update there is one in each cycle: a frozen class would take three times as long to make it.
    """

    kind: MotionKind
    target: int
    distance: int | None
    """Relative, as long as no set-point of it was given to the drive."""
    velocity: int
    acceleration: int
    deceleration: int
    scaled: bool = True
    """The override scales the speed."""
    torque: int | None = None


class Course:
    """The goal of one axis; ``follow`` once per cycle brings ``outcome.motion`` in line with it."""

    def __init__(self, settings: PositionerSettings, outcome: Outcome) -> None:
        self.settings = settings
        self.outcome = outcome
        self.offset = 0
        """User's coordinate minus the drive's."""
        self.goal: Goal | None = None
        self.sent = 0
        """Serial of the newest set-point of the goal, 0 while there is none."""
        self.speed: Goal | None = None
        """The goal of a function with a speed as asked for, without software limits."""
        self.held: Reason | None = None
        """Why the goal is kept and not pursued."""
        self.first_serial = 0
        """Of the task that runs, 0 while nothing of it was sent."""
        self.queued = 0
        """Serial of the set-point that waits in the drive, 0 for none."""
        self._limits: tuple[int, int] | None = None
        self._limit_since = -1
        self._at_limit = False
        self._stop_since = -1
        self._seen = Seen()

    def look(self, seen: Seen, limits: bool) -> None:
        """Take what the axis does, and whether the software limits are watched, before anything is decided."""
        self._seen = seen
        self._limits = self.settings.software_limits if limits else None
        goal = self.goal
        if goal is not None and goal.distance is not None and seen.given < self.sent:
            self.goal = replace(goal, target=seen.position + goal.distance)

    def drop(self) -> None:
        """No goal any more: ramp to standstill."""
        self.goal = self.speed = self.held = None
        self.queued = self.first_serial = 0
        self._at_limit = False

    def in_range(self, target: int, absolute: bool) -> bool:
        """Whether the drive can be sent to a position of the user, or by a distance, as far as the software limits let it."""
        low, high = self.settings.position_range
        end = target if absolute else self._seen.position + self.offset + target
        return low <= self._inside(end) - self.offset <= high

    def arrived(self) -> bool:
        """The drive has reached the target of the goal in force."""
        goal, seen = self.goal, self._seen
        if goal is None or goal.kind is not MotionKind.POSITION or not self.sent or self.held:
            return False
        if not seen.reached or seen.taken < self.sent:
            return False
        return goal.distance is not None or abs(goal.target - seen.position) <= self.settings.position_window

    # -- goals ----------------------------------------------------------------------------------------------------------

    def go(self, velocity: int, acceleration: int, deceleration: int, *, scaled: bool = True) -> None:
        """Move with a signed speed, to the software limit where one is watched."""
        limited = max(-self.settings.max_velocity, min(velocity, self.settings.max_velocity))
        self.outcome.speed_limited = limited != velocity
        self.speed = Goal(MotionKind.SPEED, 0, None, limited, acceleration, deceleration, scaled)
        self._aim_speed()

    def _aim_speed(self) -> None:
        """Make the goal of a function with a speed, anew when software limits begin or cease to be watched."""
        speed = self.speed
        assert speed is not None, "only functions with a speed come here"
        if self._limits is None:
            self._set(speed)
            return
        target = self._limits[speed.velocity > 0] - self.offset
        if (target - self._seen.position) * speed.velocity > 0:
            self._set(replace(speed, kind=MotionKind.POSITION, target=target, velocity=abs(speed.velocity)))
        else:
            self.goal = None
            self.outcome.warning = Reason.SOFTWARE_LIMIT

    def go_to(
        self,
        target: int,
        absolute: bool,
        velocity: int,
        acceleration: int,
        deceleration: int,
        torque: int | None = None,
    ) -> None:
        """Move to a position of the user or by a distance, not beyond a software limit that is watched."""
        self.speed = None
        limited = min(velocity, self.settings.max_velocity)
        self.outcome.speed_limited = limited != velocity
        distance = None if absolute else target
        end = target if absolute else self._seen.position + self.offset + target
        inside = self._inside(end)
        if inside != end:
            end, distance = inside, None
            self.outcome.warning = Reason.SOFTWARE_LIMIT
        target = end - self.offset
        self._set(Goal(MotionKind.POSITION, target, distance, limited, acceleration, deceleration, torque=torque))

    def _inside(self, position: int) -> int:
        """A position of the user, or the software limit it is beyond."""
        return position if self._limits is None else max(self._limits[0], min(position, self._limits[1]))

    def _set(self, goal: Goal) -> None:
        self.goal = goal
        self.sent = 0
        self.queued = 0
        self._at_limit = False
        self._limit_since = self._stop_since = -1
        self.outcome.fixed_stop = False

    def stand(self) -> None:
        """Keep the function without a goal."""
        self.goal = self.speed = None
        self.queued = 0

    # -- set-points -----------------------------------------------------------------------------------------------------

    def follow(self, asked: Asked, now: int) -> None:
        """Bring the motion in line with the goal: hold, resume, override, software limits."""
        motion = self.outcome.motion
        if self.speed is not None and (self.goal is None or self.goal.kind is MotionKind.POSITION) != (
            self._limits is not None
        ):
            self._aim_speed()
        goal = self.goal
        if goal is None:
            motion.kind = MotionKind.STAND
            motion.torque = None
            self.held = None
            self.outcome.to_fixed_stop = self.outcome.fixed_stop = False
            return
        held, self.held = self.held, self._hold(goal, asked, now)
        self._look_for_fixed_stop(goal, now)
        if self.held:
            motion.kind = MotionKind.STAND
            self.queued = 0
            return
        override = asked.override if goal.scaled else FULL
        if self.sent and not held and motion.override == override:
            return
        if self.sent and goal.distance is not None and self._seen.given >= self.sent:
            goal = self.goal = replace(goal, distance=None)  # never a second time
        self._send(motion, goal, override)

    def _hold(self, goal: Goal, asked: Asked, now: int) -> Reason | None:
        """Why a goal is kept and not pursued."""
        seen = self._seen
        if not asked.no_intermediate_stop:
            self._at_limit = False
            self._limit_since = -1
            return Reason.INTERMEDIATE_STOP
        if goal.scaled and asked.override == 0:
            return Reason.OVERRIDE_ZERO
        presses = goal.torque is not None  # the torque limit is what it is to stand at
        if presses or not (seen.standstill and seen.internal_limit and self.sent and not self.arrived()):
            self._limit_since = -1
        elif self._limit_since < 0:
            self._limit_since = now
        elif now - self._limit_since >= LIMIT_STANDING_NS:
            self._at_limit = True
        return Reason.TASK_AT_LIMIT if self._at_limit else None

    def _send(self, motion: Motion, goal: Goal, override: int) -> None:
        motion.serial += 1
        self.sent = motion.serial
        self.queued = 0
        motion.kind, motion.target, motion.distance = goal.kind, goal.target, goal.distance
        motion.velocity, motion.acceleration, motion.deceleration = goal.velocity, goal.acceleration, goal.deceleration
        motion.override, motion.immediate, motion.torque = override, True, goal.torque
        if not self.first_serial:
            self.first_serial = motion.serial

    def queue(self, position: int, absolute: bool, velocity: int, acceleration: int, deceleration: int) -> None:
        """Give a position task that waits in the drive for the end of the goal; not beyond a limit, where it has to stop."""
        goal = self.goal
        if goal is None or self.held or self.queued or self._seen.taken < self.sent:
            return
        target = position - self.offset if absolute else goal.target + position
        end = target + self.offset
        if self._inside(end) != end or not self.in_range(end, True):
            return
        motion = self.outcome.motion
        motion.serial += 1
        motion.target, motion.distance, motion.immediate = target, None, False
        motion.velocity = min(velocity, self.settings.max_velocity)
        motion.acceleration, motion.deceleration = acceleration, deceleration
        self.queued = motion.serial

    def take_queued(self) -> None:
        """The drive has gone over to the set-point that waited: it is the goal now."""
        motion = self.outcome.motion
        self._set(
            Goal(
                MotionKind.POSITION,
                *(motion.target, None, motion.velocity, motion.acceleration, motion.deceleration),
            )
        )
        self.sent = motion.serial

    def _look_for_fixed_stop(self, goal: Goal, now: int) -> None:
        outcome, seen = self.outcome, self._seen
        outcome.to_fixed_stop = goal.torque is not None
        if not outcome.to_fixed_stop:
            outcome.fixed_stop = False
        elif not (seen.standstill and seen.torque_at_limit):
            self._stop_since = -1
        elif self._stop_since < 0:
            self._stop_since = now
        elif now - self._stop_since >= FIXED_STOP_NS:
            outcome.fixed_stop = True
