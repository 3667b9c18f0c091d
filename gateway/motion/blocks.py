"""Traversing blocks: tasks of a positioner by number, alone or as a chain.

Source: basic positioners of public drive manuals (docs/motion.md). A block that continues is followed by the next number. Not
here: conditions on digital inputs, jerk limits.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass

from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import signal

HIGHEST_BLOCK = (1 << signal("POS_STW1").bit("BLOCK").width) - 1
"""Highest block number in POS_STW1; SATZANW reaches half of it."""
PERCENT_MAX = 100
OUTPUTS_MASK = 0b11
"""``value`` of the output tasks: bit 0 output 1, bit 1 output 2 (POS_ZSW2.10, .11)."""
WAIT_MAX_MS = 3_600_000
TORQUE_MAX = 1000
"""``value`` of a fixed stop: clamping torque in 1/1000 of the rated torque."""


class BlockMode(enum.Enum):
    """Meaning of ``position``."""

    ABSOLUTE = "absolute"
    RELATIVE = "relative"
    ENDLESS_POSITIVE = "endless-positive"
    ENDLESS_NEGATIVE = "endless-negative"

    @property
    def direction(self) -> int:
        """1 or -1 of an endless block, 0 of the others."""
        return {BlockMode.ENDLESS_POSITIVE: 1, BlockMode.ENDLESS_NEGATIVE: -1}.get(self, 0)


class BlockTask(enum.Enum):
    """Task of a block."""

    POSITION = "position"
    WAIT = "wait"
    GOTO = "goto"
    SET_OUTPUT = "set-output"
    RESET_OUTPUT = "reset-output"
    FIXED_STOP = "fixed-stop"

    @property
    def moves(self) -> bool:
        """Whether the axis moves."""
        return self in {BlockTask.POSITION, BlockTask.FIXED_STOP}


class BlockNext(enum.Enum):
    """Continuation after a block."""

    END = "end"
    CONTINUE_WITH_STOP = "continue-with-stop"
    FLYING = "flying"
    EXTERNAL = "external"


@dataclass(frozen=True, slots=True)
class Block:
    """One traversing block.

    ``position`` LU; ``velocity`` 1000 LU/min; ``acceleration`` and ``deceleration`` percent of the axis' maxima; ``value`` by
    task: ms of a wait, number of a goto, outputs as a mask, clamping torque in 1/1000. GatewayError names the block and what
    is allowed.
    """

    number: int
    position: int = 0
    velocity: int = 0
    acceleration: int = PERCENT_MAX
    deceleration: int = PERCENT_MAX
    mode: BlockMode = BlockMode.ABSOLUTE
    task: BlockTask = BlockTask.POSITION
    next: BlockNext = BlockNext.END
    value: int = 0

    def __post_init__(self) -> None:
        self._within("number", self.number, 0, HIGHEST_BLOCK)
        self._within("acceleration", self.acceleration, 1, PERCENT_MAX)
        self._within("deceleration", self.deceleration, 1, PERCENT_MAX)
        self._within("position", self.position, *DataType.INTEGER32.integer_range)
        self._within("velocity", self.velocity, 1 if self.task.moves else 0, DataType.UNSIGNED32.integer_range[1])
        low, high = {
            BlockTask.POSITION: (0, 0),
            BlockTask.WAIT: (0, WAIT_MAX_MS),
            BlockTask.GOTO: (0, HIGHEST_BLOCK),
            BlockTask.SET_OUTPUT: (1, OUTPUTS_MASK),
            BlockTask.RESET_OUTPUT: (1, OUTPUTS_MASK),
            BlockTask.FIXED_STOP: (1, TORQUE_MAX),
        }[self.task]
        self._within("value", self.value, low, high)
        if self.task.moves and self.mode.direction and self.next not in {BlockNext.END, BlockNext.EXTERNAL}:
            raise self._error("next", self.next.value, "end or external: an endless block has no end to continue from")
        if not self.task.moves and self.next in {BlockNext.FLYING, BlockNext.EXTERNAL}:
            raise self._error("next", self.next.value, "end or continue-with-stop for a task that does not move")
        if self.task is BlockTask.FIXED_STOP and (self.mode.direction or self.next is BlockNext.FLYING):
            raise self._error(
                "fixed-stop", f"{self.mode.value}, {self.next.value}", "a position, and a stop at its end"
            )

    def _within(self, name: str, value: int, low: int, high: int) -> None:
        if not low <= value <= high:
            raise self._error(name, value, f"{low}..{high}" if low != high else f"{low}")

    def _error(self, name: str, value: object, allowed: str) -> GatewayError:
        return GatewayError(f"block {self.number}: {name} = {value} is not allowed, expected {allowed}")

    @property
    def follower(self) -> int | None:
        """The block that comes after this one; None at the end of a chain."""
        if self.task is BlockTask.GOTO:
            return self.value
        return None if self.next is BlockNext.END else self.number + 1


class BlockTable:
    """The blocks of an axis by number.

    GatewayError for a number twice, a follower that is missing, a ring that never moves or waits.
    """

    def __init__(self, blocks: Iterable[Block] = ()) -> None:
        self._blocks: dict[int, Block] = {}
        for block in blocks:
            if block.number in self._blocks:
                raise GatewayError(f"block {block.number}: defined twice; define each number once")
            self._blocks[block.number] = block
        for block in self._blocks.values():
            if block.follower is not None and block.follower not in self._blocks:
                raise GatewayError(f"block {block.number}: continues with block {block.follower}, which is missing")
        for block in self._blocks.values():
            self._check_ring(block)

    def _check_ring(self, first: Block) -> None:
        seen: set[int] = set()
        block: Block | None = first
        while block is not None and not block.task.moves and not (block.task is BlockTask.WAIT and block.value):
            if block.number in seen:
                raise GatewayError(f"block {first.number}: the chain is a loop without a motion or a wait")
            seen.add(block.number)
            block = None if block.follower is None else self._blocks[block.follower]

    def get(self, number: int) -> Block | None:
        """The block with a number, None where there is none."""
        return self._blocks.get(number)

    def __len__(self) -> int:
        return len(self._blocks)
