"""A chain of traversing blocks at work: which block runs, when it is done, what follows.

Source: basic positioners of public drive manuals (docs/motion.md). The gateway runs the chain; only flying blocks give the drive
a second setpoint beside the one that runs.
"""

from __future__ import annotations

from dataclasses import dataclass

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockMode, BlockNext, BlockTable, BlockTask
from pdgw.gateway.motion.requests import FULL, Seen
from pdgw.gateway.motion.user_course import UserCourse


def _fraction(percent: int) -> int:
    return FULL * percent // 100


@dataclass(slots=True, eq=False)
class BlockChain:
    """The blocks of an axis and the one of them that runs."""

    blocks: BlockTable
    _course: UserCourse
    block: Block | None = None
    """The block that runs, None for none."""
    external: bool = False
    """STW1.13 rose since the block began."""
    outputs: int = 0
    """The outputs that blocks have set."""
    _wait_until: int = 0
    """End of the wait that is the block, monotonic ns."""

    def refusal(self, number: int) -> Reason | None:
        """Why a block cannot be done, None when it can."""
        block = self.blocks.get(number)
        if block is None:
            return Reason.TASK_BLOCK_UNKNOWN
        if block.task.moves and not block.mode.direction:
            return self._course.refusal(block.position, block.mode is BlockMode.ABSOLUTE)
        return None

    def drop(self) -> None:
        """No block runs any more."""
        self.block = None
        self._wait_until = 0

    def run(self, number: int, now: int) -> None:
        """Run blocks from a number on, up to the first that moves, waits or ends. The table has no ring without any."""
        block = self.blocks.get(number)
        while block is not None:
            self.block = block
            self.external = False
            self._wait_until = 0
            self._course.drop_goal()
            if block.task is BlockTask.SET_OUTPUT:
                self.outputs |= block.value
            elif block.task is BlockTask.RESET_OUTPUT:
                self.outputs &= ~block.value
            elif block.task is BlockTask.WAIT:
                self._wait_until = now + block.value * MS
                return
            elif block.task.moves:
                self._move(block)
                return
            if block.follower is None:
                return
            block = self.blocks.get(block.follower)

    def _move(self, block: Block) -> None:
        refusal = self.refusal(block.number)
        if refusal is not None:
            self._course.warning = refusal
            return
        acceleration, deceleration = _fraction(block.acceleration), _fraction(block.deceleration)
        if block.mode.direction:
            self._course.go(block.mode.direction * block.velocity, acceleration, deceleration)
        else:
            torque = block.value if block.task is BlockTask.FIXED_STOP else None
            absolute = block.mode is BlockMode.ABSOLUTE
            self._course.go_to(block.position, absolute, block.velocity, acceleration, deceleration, torque)

    def follower(self) -> int | None:
        """The block after this one; None at the end, and after one that could not be done."""
        block = self.block
        if block is None or (block.task.moves and self._course.goal is None):
            return None
        if block.task is BlockTask.FIXED_STOP and not self._course.fixed_stop:
            return None
        return block.follower

    def done(self, now: int) -> bool:
        """Whether the block that runs is done."""
        block, course = self.block, self._course
        if block is None:
            return True
        if course.held:
            return False
        if not block.task.moves:
            return now >= self._wait_until
        if course.goal is None:
            return course.seen.bits & Seen.STANDSTILL != 0
        if block.task is BlockTask.FIXED_STOP:
            return self._pressed(block)
        if block.next is BlockNext.EXTERNAL:
            return self.external
        if course.queued:
            return course.seen.executing >= course.queued
        return course.arrived()

    def _pressed(self, block: Block) -> bool:
        """A fixed stop presses on until it is rejected or the next block may begin."""
        course = self._course
        if course.arrived() and not course.fixed_stop:
            course.warning = Reason.FIXED_STOP_MISSED
            return True
        if block.next is BlockNext.EXTERNAL:
            return course.fixed_stop and self.external
        return course.fixed_stop and block.next is not BlockNext.END

    def follow(self, now: int) -> None:
        """Continue with the next block."""
        follower = self.follower()
        if follower is None:
            return
        if self._course.queued:
            self.block = self.blocks.get(follower)
            self.external = False
            self._course.use_queued()
        else:
            self.run(follower, now)

    def look_ahead(self) -> None:
        """A flying block: the next one waits in the drive for the end of this one."""
        block = self.block
        if block is None or block.next is not BlockNext.FLYING or block.mode.direction:
            return
        follower = self.blocks.get(block.number + 1)
        if follower is None or follower.mode.direction or follower.task is not BlockTask.POSITION:
            return
        # It starts later: the revolution of a modulo axis at that time is not known when it is sent.
        if not self._course.choices.waiting_setpoints or self._course.choices.modulo:
            self._course.warning = Reason.FLYING_NOT_SUPPORTED
            return
        self._course.queue(
            *(follower.position, follower.mode is BlockMode.ABSOLUTE, follower.velocity),
            *(_fraction(follower.acceleration), _fraction(follower.deceleration)),
        )
