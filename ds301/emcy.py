"""EMCY error codes in words.

Source: CiA DS 301 table 21, CiA DSP 402 V2.0 chapter 8.1 (the ranges a drive uses).
"""

from __future__ import annotations

from typing import Final

GENERIC_ERROR: Final = 0x1000
ERROR_PASSIVE: Final = 0x8120
HEARTBEAT_ERROR: Final = 0x8130
BUS_OFF_RECOVERED: Final = 0x8140
PDO_LENGTH_ERROR: Final = 0x8210
"""Codes that the gateway, or a simulated node, sends by itself."""
PDO_ERRORS: Final = range(0x8200, 0x8300)
"""Protocol errors: PDOs that are not processed."""
COMMUNICATION_ERROR: Final = 1 << 0 | 1 << 4
"""Error register 1001h with such a code: generic, communication."""

EMCY_TEXTS: dict[int, str] = {
    0x0000: "error reset or no error",
    GENERIC_ERROR: "generic error",
    0x2110: "current at the input",
    0x2310: "over-current at the output",
    0x3110: "mains over-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4000: "temperature",
    0x4210: "over-temperature of the device",
    0x4310: "over-temperature of the drive",
    0x5100: "device hardware supply or memory",
    0x5110: "low-voltage supply",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6100: "internal software",
    0x6320: "parameter error",
    0x7305: "incremental sensor 1",
    0x8000: "monitoring",
    0x8110: "CAN overrun",
    ERROR_PASSIVE: "CAN error passive",
    HEARTBEAT_ERROR: "life guard or heartbeat error",
    BUS_OFF_RECOVERED: "recovered from bus-off",
    PDO_LENGTH_ERROR: "PDO not processed: length error",
    0x8220: "PDO length exceeded",
    0x8611: "following error",
    0x9000: "external error",
    0xFFFF: "device specific",
}
"""Text of each exact code."""

_CLASSES = {0x1: "generic error", 0x2: "current", 0x3: "voltage", 0x4: "temperature", 0x5: "device hardware"} | {
    0x6: "device software",
    0x7: "additional modules",
    0x8: "monitoring",
    0x9: "external error",
    0xF: "device specific",
}


def emcy_text(code: int) -> str:
    """The text of a code, or of its class."""
    return EMCY_TEXTS.get(code) or _CLASSES.get(code >> 12, "unknown error code")


_REMEDIES: Final = {
    "1": "read the fault at the display of the device or in its tool",
    "2": "check motor, motor cable and load for a short circuit or a blocked axis",
    "21": "check the supply of the device",
    "31": "check the mains supply",
    "32": "check the DC link: supply, braking resistor and deceleration",
    "3220": "check the supply of the power stage",
    "4": "let the device cool down; check cooling and load",
    "43": "let the motor cool down; check load and current limit",
    "5": "check the device and its supply; replace it if the error stays",
    "51": "check the 24 V supply of the device",
    "55": "load or save the parameters of the device again",
    "6": "restart the device; check its firmware",
    "63": "check the parameters of the device",
    "711": "check the braking resistor and its cable",
    "712": "check motor, brake and motor cable",
    "73": "check the encoder cable",
    "81": "check CAN cable, termination and bit rate",
    "82": "compare the PDO mapping of the device with the configuration",
    "83": "check load and torque limit",
    "84": "check load, speed limit and tuning",
    "86": "check mechanics, load and the following error window",
    "9": "check what is wired to the fault input of the device",
}
"""Remedies by the leading digits of an error code; the longest match counts. Classes: CiA DSP 402 V2.0 8.1."""


def emcy_remedy(code: int) -> str:
    """The remedy for an error code (EMCY or 603Fh)."""
    digits = f"{code:04X}"
    found = (_REMEDIES.get(digits[:length]) for length in range(len(digits), 0, -1))
    return next((text for text in found if text is not None), "read the manual of the device for this code")


ERROR_REGISTER_BITS = (
    "generic",
    "current",
    "voltage",
    "temperature",
    "communication",
    "device profile",
    "reserved",
    "manufacturer specific",
)
"""Meaning of the bits of the error register 1001h, bit 0 first (CiA DS 301 table 54)."""


def error_register_text(register: int) -> str:
    """The set bits in words, ``none`` for 0."""
    return ", ".join(name for bit, name in enumerate(ERROR_REGISTER_BITS) if register >> bit & 1) or "none"
