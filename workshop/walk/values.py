"""What enters and leaves one step of the walk: values that hash, so that they are numbered once."""

from __future__ import annotations

import enum
from typing import NamedTuple

from pdgw.gateway.axis.supervision.stop_supervision import Brake


class Life(enum.Enum):
    """What the sign of life of a frame does (STW2 bits 12 to 15)."""

    NONE = ""
    """It is 0."""
    COUNTS = "counts"
    STANDS = "stands"


class Plc(NamedTuple):
    """One frame of the PLC, or none; ``name`` is what a trace prints."""

    name: str
    setpoints: tuple[int, ...] | None
    """Raw values in telegram order; None: silent, provider STOP, IOPS BAD."""
    word: int = 0
    """STW1, or the Controlword of telegram 100."""
    fresh: bool = True
    """It came in this cycle; False: the values of a cycle before."""
    life: Life = Life.NONE


class Shown(NamedTuple):
    """What the drive shows in one cycle."""

    name: str
    statusword: int
    velocity: int = 0
    """606Ch."""
    ok: bool = True
    """False: the drive is lost."""
    restarted: bool = False
    """It booted, or was configured anew."""
    mode: int = 0
    """6061h."""
    position: int = 0
    """6064h."""
    stopped: bool = False
    """Its heartbeat, or its answer to node guarding, says Stopped (NMT)."""
    found_off: bool = False
    """It is lost, and was found without power by SDO."""
    answer: str | None = None
    """To the SDO writes that the machine asks for: empty when they are taken, else why not; None: no answer."""


class Output(NamedTuple):
    """What one step of the machine decided."""

    controlword: int
    velocity: int
    """60FFh."""
    target: int
    """607Ah."""
    mode: int
    """6060h."""
    zsw1: int
    """ZSW1, or the Statusword of telegram 100."""
    reason: str
    """Why the axis does not do what is asked; empty: it does."""
    guarded: bool
    """The guard behind everything had to replace an Enable Operation."""
    brake: Brake = Brake.NONE
    """Only in a walk of the guarding."""
