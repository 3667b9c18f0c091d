"""NMT states and commands, once.

Source: CiA DS 301 V4.02 chapters 7.2.8.2 (commands) and 7.2.8.3.2 (states in the heartbeat).
"""

from __future__ import annotations

import enum


class NmtState(enum.IntEnum):
    """NMT states as the heartbeat shows them."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(enum.IntEnum):
    """NMT command specifiers."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130
