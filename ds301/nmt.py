"""NMT states and commands, once.

Source: CiA DS 301 V4.02 chapters 7.2.8.2 (commands) and 7.2.8.3.2 (states in the heartbeat).
"""

from __future__ import annotations

import enum
from typing import Final

HEARTBEAT_STATE: Final = 0x7F
"""The bits of a heartbeat that hold the state."""
GUARD_TOGGLE: Final = 0x80
"""Bit 7 of a heartbeat is reserved, and alternates in the answers of node guarding."""


class NmtState(enum.IntEnum):
    """NMT states as the heartbeat shows them."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @staticmethod
    def text(state: int) -> str:
        """Name of a state in a heartbeat, such as "Pre-operational"; its number for one that the standard does not have."""
        return NmtState(state).name.replace("_", "-").capitalize() if state in NMT_STATES else f"{state:02X}h"


NMT_STATES: Final = frozenset(NmtState)


class NmtCommand(enum.IntEnum):
    """NMT command specifiers."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130
