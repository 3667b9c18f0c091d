"""EMCY error codes of encoders.

Source: CiA DSP 406 V2.0 chapter 6.2.
"""

from __future__ import annotations

from types import MappingProxyType

MEMORY_ERROR = 0x5100
"""The error code of a hardware memory error."""

ENCODER_EMCY: MappingProxyType[int, str] = MappingProxyType(
    {
        0x0000: "no error",
        0x1000: "generic error",
        0x2000: "current",
        0x2100: "device input current",
        0x2110: "input current too high",
        0x3000: "voltage",
        0x3100: "device input voltage",
        0x3110: "input voltage out of range",
        0x4000: "temperature inside out of range",
        0x5000: "device hardware",
        MEMORY_ERROR: "hardware memory error",
        0x6000: "device software",
        0x7000: "additional modules",
        0x8000: "monitoring",
        0x9000: "external error",
        0xF000: "additional functions",
        0xFFFF: "device specific",
    }
)
"""Text of each error code of the profile."""
