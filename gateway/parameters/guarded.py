"""Objects that must not change while an axis is powered: what stops it, guards it, or says what its values mean.

A write over the parameter channel would take the brake away under a turning axis. They are refused then; written while the axis
is off, what the gateway knows of them is checked again before it may be switched on.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from pdgw.ds301.communication import RESTORE_PARAMETERS, STORE_PARAMETERS


class Check(enum.Enum):
    """What has to follow a write, before the axis may be switched on again."""

    NOTHING = "nothing: the gateway has no copy of it"
    REFERENCES = "the references are read again"
    CONFIGURATION = "the node is brought up again: identity, PDOs, guarding, references"


@dataclass(frozen=True, slots=True)
class GuardedRange:
    """Objects ``first`` to ``last``, and why they are guarded."""

    first: int
    last: int
    reason: str
    check: Check


GUARDED: tuple[GuardedRange, ...] = (
    GuardedRange(0x1005, 0x1007, "SYNC: TPDOs that wait for it would stop", Check.CONFIGURATION),
    GuardedRange(
        STORE_PARAMETERS, STORE_PARAMETERS, "storing keeps a drive busy: it may not answer its stop", Check.NOTHING
    ),
    GuardedRange(RESTORE_PARAMETERS, RESTORE_PARAMETERS, "restoring changes everything below", Check.CONFIGURATION),
    GuardedRange(0x1014, 0x1017, "EMCY and heartbeats: faults untold, a dead gateway unnoticed", Check.CONFIGURATION),
    GuardedRange(0x1029, 0x1029, "what the node does in an error: its PDOs may end", Check.NOTHING),
    GuardedRange(0x1200, 0x127F, "SDO servers: the gateway would lose its access", Check.CONFIGURATION),
    GuardedRange(0x1280, 0x13FF, "SDO clients: the drive would write to others", Check.CONFIGURATION),
    GuardedRange(
        0x1400, 0x1BFF, "PDOs: the drive would not get its stop, or the gateway not see it", Check.CONFIGURATION
    ),
    GuardedRange(0x1F80, 0x1F80, "NMT start-up: the drive would start by itself", Check.CONFIGURATION),
    GuardedRange(0x6007, 0x6007, "what the drive does when the gateway dies", Check.CONFIGURATION),
    GuardedRange(0x605A, 0x605E, "what quick stop, shutdown, disable, Halt and faults do", Check.NOTHING),
    GuardedRange(0x607E, 0x607E, "polarity: which way every value goes", Check.NOTHING),
    GuardedRange(0x607F, 0x6080, "speed limits: what 100 % is", Check.REFERENCES),
    GuardedRange(
        0x6084, 0x6086, "deceleration, quick stop deceleration and ramp type: how it brakes", Check.REFERENCES
    ),
    GuardedRange(0x608F, 0x6097, "resolutions, ratios and factors: what every value means", Check.REFERENCES),
    GuardedRange(0x60A8, 0x60A9, "units of position and velocity: what every value means", Check.REFERENCES),
    GuardedRange(0x60C6, 0x60C6, "maximum deceleration: how it brakes", Check.REFERENCES),
)
"""In the order of their indices; everything else may be written at any time."""


def guard_of(index: int) -> GuardedRange | None:
    """The range an object is in, None for an object that is not guarded."""
    return next((item for item in GUARDED if item.first <= index <= item.last), None)
