"""Inputs and outputs of one step of the walk: hashable values, each with one number."""

from __future__ import annotations

import enum
from collections.abc import Hashable
from typing import NamedTuple, TypeVar

from pdgw.gateway.axis.orders import Brake

Item = TypeVar("Item", bound=Hashable)


class Numbered(list[Item]):
    """Items in the order in which they were first seen."""

    def __init__(self) -> None:
        super().__init__()
        self._numbers: dict[Item, int] = {}

    def number(self, item: Item) -> int:
        """The number of an item; a new one gets a new number."""
        number = self._numbers.setdefault(item, len(self))
        if number == len(self):
            self.append(item)
        return number


class Life(enum.Enum):
    """Sign of life of a frame (STW2 bits 12 to 15)."""

    NONE = ""
    """It is 0."""
    COUNTS = "counts"
    CONSTANT = "constant"


class Plc(NamedTuple):
    """One frame of the PLC, or none. ``name``: text in a trace."""

    name: str
    setpoints: tuple[int, ...] | None
    """Raw values in telegram order. None: no frames, provider STOP, or IOPS BAD."""
    word: int = 0
    """STW1, or the Controlword of telegram 100."""
    fresh: bool = True
    """It arrived in this cycle. False: values of an earlier cycle."""
    life: Life = Life.NONE
    target: int = 0
    """607Ah of its task; only in the walk of the handshakes."""
    mdi: bool = True
    """SATZANW.15 of telegram 9; likewise."""
    passive: bool = False
    """The homing is one by the touch probe; likewise."""


class Answered(enum.Enum):
    """The speed of a drive that has it in no TPDO: what comes in one cycle of an answer by SDO."""

    FRESH = ""
    """One to a request just before the cycle."""
    LATE = "late answer"
    """One to a request of one and a half cycles before, if there was none later: it is old in the next cycle."""
    NONE = "no answer"


class Shown(NamedTuple):
    """What the drive reports in one cycle."""

    name: str
    statusword: int
    velocity: int = 0
    """606Ch."""
    ok: bool = True
    """False: the drive is lost."""
    restarted: bool = False
    """It booted, or was configured again."""
    mode: int = 0
    """6061h."""
    position: int = 0
    """6064h."""
    stopped: bool = False
    """Its heartbeat, or its answer to node guarding, says Stopped (NMT)."""
    found_off: bool = False
    """It is lost, and was found without power by SDO."""
    answer: str | None = None
    """Answer to the SDO writes of the machine: empty if accepted, else the reason; None: no answer."""
    after_ns: int | None = None
    """Time since the last cycle; None: the usual one."""
    answered: Answered = Answered.FRESH
    """Of ``velocity``, if it is read by SDO."""
    latched: bool | None = None
    """Answer of the touch probe: a position, or that the drive has none; None: no answer."""


class Output(NamedTuple):
    """Output of one step of the machine."""

    controlword: int
    velocity: int
    """60FFh."""
    mode: int
    """6060h."""
    zsw1: int
    """ZSW1, or the Statusword of telegram 100."""
    reason: str
    """Why the axis does not follow; empty: it follows."""
    guarded: bool
    """The final guard had to replace an Enable Operation."""
    brake: Brake = Brake.NONE
    """Only in a walk of the guarding."""
    target: int = 0
    """607Ah; only in the walk of the handshakes."""
    probe: bool = False
    """The touch probe is armed."""
