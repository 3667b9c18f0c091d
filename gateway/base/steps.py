"""Steps of remedies as data: what the PLC's program or a person has to do. They know neither status nor texts.

A remedy is a sequence of steps; ``step_text.remedy_text`` has the text of all. Bits are named as ``STW1.6``.
"""

from __future__ import annotations

import enum
from typing import Final, NamedTuple


class Wait(NamedTuple):
    """Time has to pass."""

    until: str
    """What follows "wait"; may be empty."""


class Bits(NamedTuple):
    """Bits of the PLC get this level, and keep it."""

    bits: tuple[str, ...]
    level: int = 1


class Edge(NamedTuple):
    """A bit of the PLC is 0 in one frame and 1 in a later one."""

    bits: tuple[str, ...]
    """One of these."""
    needs: tuple[str, ...] = ()
    """Bits that are 1 then."""


class Hindrance(enum.Enum):
    """Why an acknowledge has had no effect."""

    NONE = 0
    PENDING = 1
    """It is sent to the drive."""
    NO_CONTROL = 2
    """The bit of control by PLC is 0."""
    IN_VAIN = 3
    """Its edge came while the cause was there."""
    LEVEL = 4
    """Its bit is 1."""
    UNHEARD = 5
    """Its edge came with control by PLC, or before."""
    UNFINISHED = 6
    """Its bit has to fall."""


class Acknowledge(NamedTuple):
    """The edge that acknowledges a fault, in frames with control."""

    bit: str
    control: str = ""
    """The bit of control by PLC."""
    hindrance: Hindrance = Hindrance.NONE


class Give(NamedTuple):
    """Another setpoint or order of the PLC."""

    what: str
    """The name of its signal or bit, or what has to be different."""
    order: str
    """An imperative."""


Step = str | Wait | Bits | Edge | Acknowledge | Give
"""A text is an imperative for a person, who looks at a place or changes something there: no program of a PLC can do it."""
Remedy = tuple[Step, ...]
OFF_ON: Final = Edge(("STW1.0",), ("STW1.1", "STW1.2"))
STANDSTILL: Final = Wait("for standstill")
NEW_TASK: Final = Edge(("STW1.6",))
ACKNOWLEDGE: Final = Acknowledge("STW1.7", "STW1.10")


def with_on(remedy: Remedy) -> Remedy:
    """A remedy that ends with OFF and ON."""
    return remedy if OFF_ON in remedy else (*remedy, OFF_ON)
