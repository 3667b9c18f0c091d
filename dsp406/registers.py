"""The bits of the encoder's registers, each with a number once.

Source: CiA DSP 406 V2.0 chapters 8.1.1 (6000h), 8.3.1 (6400h), 8.4.1 (6500h), 8.4.4 (6503h) and 8.4.6 (6505h).
"""

from __future__ import annotations

import enum


class Operating(enum.IntFlag):
    """Operating parameters 6000h; operating status 6500h shows them, but bit 1 there means "diagnostics supported"."""

    COUNTERCLOCKWISE = 1 << 0
    """Code sequence: the position increases when the shaft turns counterclockwise, as seen on the shaft."""
    COMMISSIONING_DIAGNOSTICS = 1 << 1
    SCALING = 1 << 2


OPERATING_RESERVED = 0x0FF8
"""Bits 3-11 of 6000h; 12-15 are the manufacturer's."""


class Alarm(enum.IntFlag):
    """Alarms 6503h: the position may be wrong. 6504h says which are supported."""

    POSITION_ERROR = 1 << 0
    COMMISSIONING_DIAGNOSTICS = 1 << 1


class Warnings(enum.IntFlag):
    """Warnings 6505h: a tolerance is exceeded, the position is right. 6506h says which are supported."""

    FREQUENCY_EXCEEDED = 1 << 0
    LIGHT_CONTROL_RESERVE = 1 << 1
    CPU_WATCHDOG = 1 << 2
    OPERATING_TIME = 1 << 3
    BATTERY_CHARGE = 1 << 4
    REFERENCE_POINT = 1 << 5


class AreaState(enum.IntFlag):
    """Area state register 6400h of a channel."""

    OUT_OF_RANGE = 1 << 0
    """Beyond the manufacturer's minimum or maximum position (650Ah)."""
    OVERFLOW = 1 << 1
    UNDERFLOW = 1 << 2


def names(value: enum.IntFlag) -> str:
    """The set bits in words: ``position error, commissioning diagnostics``; ``none`` without any."""
    return ", ".join((bit.name or "").lower().replace("_", " ") for bit in value) or "none"
