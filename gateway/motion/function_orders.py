"""The orders of a positioner: the bits that start its functions (STW1.6, STW1.11, the jogs), each with what it has caused.

``follow`` is called when a command or the operation has changed, before the positioner evaluates the edges.
"""

from __future__ import annotations

from typing import Final

from pdgw.gateway.motion.positioner_task import Task
from pdgw.gateway.motion.requests import Command, Lack
from pdgw.gateway.motion.states import JOGS

_REJECTED: Final = Lack("its task was rejected")
_DO_NOT_REJECT: Final = Command.DO_NOT_REJECT


class Stage:
    """Stages of an order, and parts that some of them share."""

    READY: Final = 1 << 0
    """Part of LOW and WAITING: its function may still start."""
    WAITS: Final = 1 << 1
    """Part of WAITING: its edge has come."""
    LOW: Final = READY
    """Its bit is 0, and nothing waits."""
    WAITING: Final = READY | WAITS
    """Its function will start, a task also after its bit has fallen."""
    RUNS: Final = 1 << 2
    """Its edge has started a function."""
    DONE: Final = 1 << 3
    """Its function has ended. In this stage and in the next two the bit is 1 and starts nothing before it was 0."""
    LOST: Final = 1 << 4
    """Its edge started nothing, or the function was ended."""
    EARLY: Final = 1 << 5
    """The bit has been 1 since before operation."""
    IGNORED: Final = LOST | EARLY
    """The bit is 1 without an effect."""


class Order:
    """One bit that starts a function."""

    def __init__(self, bit: int, stage: int) -> None:
        self.bit = bit
        self.stage = stage
        """One of ``Stage``."""
        self.lack = _REJECTED
        """What the last edge lacked, or why its effect has ended."""

    def follow(self, commands: int, *, operating: bool) -> None:
        """The commands or the operation have changed."""
        if not commands & self.bit:
            self.stage = Stage.LOW
        elif not operating:
            self.stage = Stage.EARLY
        elif self.stage == Stage.LOW:
            self.stage = Stage.LOST

    def start(self, commands: int) -> None:
        """Its function starts."""
        self.stage = Stage.RUNS if commands & self.bit else Stage.LOW

    def lose(self) -> None:
        """Its function was rejected, or ended by another command."""
        if self.stage & (Stage.RUNS | Stage.DONE):
            self.stage = Stage.LOST


class EdgeOrder(Order):
    """STW1.6 or STW1.11. An edge that is accepted waits, if need be for standstill."""

    def __init__(self, bit: int) -> None:
        super().__init__(bit, Stage.LOW)
        self.task: Task | None = None
        """The request of the edge of STW1.6 that waits; only of the basic positioner."""

    def follow(self, commands: int, *, operating: bool) -> None:
        if self.task is None or commands & self.bit:
            super().follow(commands, operating=operating)

    def wait(self, task: Task | None = None) -> None:
        """The edge is accepted; it starts nothing in the step that ends operation."""
        self.task = task
        if self.stage != Stage.EARLY:
            self.stage = Stage.WAITING

    def withdraw(self, commands: int) -> None:
        """An edge that waits starts nothing any more."""
        if self.stage == Stage.WAITING:
            self.stage = Stage.LOST if commands & self.bit else Stage.LOW
        self.task = None


class JogOrder(Order):
    """STW1.8 or STW1.9. Its edge counts in operation, if the other one is 0; the jog waits for the end of what runs."""

    def __init__(self, bit: int) -> None:
        super().__init__(bit, Stage.EARLY)

    def follow(self, commands: int, *, operating: bool) -> None:
        ready = self.stage & Stage.READY
        super().follow(commands, operating=operating)
        if ready and operating and commands & self.bit:
            allowed = commands & _DO_NOT_REJECT and commands & JOGS != JOGS
            self.stage = Stage.WAITING if allowed else Stage.LOST

    def end(self) -> None:
        """No function runs any more."""
        if self.stage == Stage.RUNS:
            self.stage = Stage.DONE


class Jogs:
    """Jog 1 and jog 2."""

    def __init__(self) -> None:
        self.first = JogOrder(Command.JOG_1_ON)
        self.second = JogOrder(Command.JOG_2_ON)

    def are(self, stages: int) -> int:
        """The bits of those in one of these stages, or in those with this part."""
        first, second = self.first, self.second
        return (first.bit if first.stage & stages else 0) | (second.bit if second.stage & stages else 0)

    @staticmethod
    def alone(commands: int) -> int:
        """The bit of a jog if it is the only one, 0 for none or both."""
        jogs = commands & JOGS
        return 0 if jogs == JOGS else jogs

    def wait(self, commands: int) -> bool:
        """One of them will start: its edge has come, and its bit is the only one."""
        return commands & JOGS != 0 and self.alone(commands) & self.are(Stage.WAITS) != 0

    def released(self, commands: int) -> bool:
        """The bit of the one that runs is 0, or not the only one."""
        return not self.alone(commands) & self.are(Stage.RUNS)

    def start(self, commands: int) -> int:
        """The one whose bit is the only one starts; 0 for the first, 1 for the second."""
        number = int(self.alone(commands) == self.second.bit)
        (self.second if number else self.first).start(commands)
        return number

    def refuse(self, edges: int) -> None:
        """Another function runs: these edges start nothing."""
        for jog in (self.first, self.second):
            if edges & jog.bit:
                jog.stage = Stage.LOST

    def end(self) -> None:
        """No function runs any more."""
        self.first.end()
        self.second.end()
