"""Modes of operation (6060h/6061h) and homing methods (6098h).

Source: the manufacturer's guide chapters 4.1, 6.7 and 7.3; CiA DSP 402 V2.0.
"""

from __future__ import annotations

import enum
from typing import Final


class Mode(enum.IntEnum):
    """Values of 6060h the drive knows."""

    TURNTABLE = -5
    CURRENT_CONTROL = -4
    """Current control with dynamic speed limitation (2003h)."""
    SPEED_CONTROL = -3
    """Speed control with dynamic current limitation (2004h)."""
    POSITION = 1
    VELOCITY = 3
    TORQUE = 4
    HOMING = 6


HOMING_METHODS: Final = {
    1: "negative limit switch and index pulse",
    2: "positive limit switch and index pulse",
    17: "negative limit switch",
    18: "positive limit switch",
    35: "current position",
    -17: "mechanical stop in negative direction",
    -18: "mechanical stop in positive direction",
}
"""The methods the guide allows."""
