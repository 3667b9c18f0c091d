"""Modes of operation (6060h/6061h) and homing methods (6098h).

Source: CiA DSP 402 V2.0, CiA 402-2.
"""

from __future__ import annotations

import enum
from typing import Final

from pdgw.base.durations import SECOND

MODE_CONFIRM_NS: Final = SECOND
"""Longest time until 6061h shows the mode of 6060h; then the mode counts as not confirmed."""


class Mode(enum.IntEnum):
    """Values of 6060h of the profile; those below zero are the manufacturer's, in the overlays (``dsp402/families``)."""

    POSITION = 1
    """Profile position."""
    VL_VELOCITY = 2
    """Velocity mode (6042h), of frequency converters."""
    VELOCITY = 3
    """Profile velocity."""
    TORQUE = 4
    HOMING = 6
    CYCLIC_POSITION = 8
    """Cyclic synchronous position."""
    CYCLIC_VELOCITY = 9
    """Cyclic synchronous velocity."""
    CYCLIC_TORQUE = 10
    """Cyclic synchronous torque."""


STANDARD_HOMING_METHODS: Final = {
    1: "negative limit switch and index pulse",
    2: "positive limit switch and index pulse",
    3: "positive home switch and index pulse, switch off",
    4: "positive home switch and index pulse, switch on",
    5: "negative home switch and index pulse, switch off",
    6: "negative home switch and index pulse, switch on",
    **dict.fromkeys(range(7, 11), "home switch, positive limit switch and index pulse"),
    **dict.fromkeys(range(11, 15), "home switch, negative limit switch and index pulse"),
    17: "negative limit switch",
    18: "positive limit switch",
    19: "positive home switch, switch off",
    20: "positive home switch, switch on",
    21: "negative home switch, switch off",
    22: "negative home switch, switch on",
    **dict.fromkeys(range(23, 27), "home switch and positive limit switch"),
    **dict.fromkeys(range(27, 31), "home switch and negative limit switch"),
    33: "index pulse in negative direction",
    34: "index pulse in positive direction",
    35: "current position",
    37: "current position",
}
"""Values of 6098h of the profile (CiA 402-2; 35 is its older number for 37)."""

SUPPORTED_MODES: Final = {
    0: Mode.POSITION,
    1: Mode.VL_VELOCITY,
    2: Mode.VELOCITY,
    3: Mode.TORQUE,
    5: Mode.HOMING,
    7: Mode.CYCLIC_POSITION,
    8: Mode.CYCLIC_VELOCITY,
    9: Mode.CYCLIC_TORQUE,
}
"""Bits of 6502h and their modes; bits 16 to 31 are the manufacturer's."""

MODE_NAMES: Final = {
    Mode.POSITION: "profile position",
    Mode.VL_VELOCITY: "velocity",
    Mode.VELOCITY: "profile velocity",
    Mode.TORQUE: "profile torque",
    Mode.HOMING: "homing",
    Mode.CYCLIC_POSITION: "cyclic synchronous position",
    Mode.CYCLIC_VELOCITY: "cyclic synchronous velocity",
    Mode.CYCLIC_TORQUE: "cyclic synchronous torque",
}
"""The profile's names of its modes."""
