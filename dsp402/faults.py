"""The manufacturer's fault numbers (200Ch) and their channel error types.

Source: the manufacturer's guide chapter 5.1.2; EMCY error codes from CiA DSP 402 V2.0 (unverified for this device).
Number 6 is printed as over-voltage in the guide; it is an under-voltage.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from types import MappingProxyType


class ChannelErrorType(enum.Enum):
    """PROFINET channel error types used for the drive's faults: (number, text)."""

    SHORT_CIRCUIT = (0x0001, "short circuit")
    UNDERVOLTAGE = (0x0002, "undervoltage")
    OVERVOLTAGE = (0x0003, "overvoltage")
    OVER_TEMPERATURE = (0x0005, "over temperature")
    ERROR = (0x0009, "error")

    def __init__(self, code: int, text: str) -> None:
        self.code = code
        self.text = text


@dataclass(frozen=True, slots=True)
class DriveFault:
    """A fault of the drive: its number in 200Ch, EMCY error code (603Fh) and error register bits (1001h)."""

    number: int
    name: str
    error_code: int
    error_register: int
    channel_error: ChannelErrorType


DRIVE_FAULTS: MappingProxyType[int, DriveFault] = MappingProxyType(
    {
        fault.number: fault
        for fault in (
            DriveFault(1, "motor temperature", 0x4310, 0x09, ChannelErrorType.OVER_TEMPERATURE),
            DriveFault(2, "output stage temperature", 0x4210, 0x09, ChannelErrorType.OVER_TEMPERATURE),
            DriveFault(3, "internal auxiliary voltage", 0x5110, 0x05, ChannelErrorType.OVERVOLTAGE),
            DriveFault(4, "over-voltage", 0x3210, 0x05, ChannelErrorType.OVERVOLTAGE),
            DriveFault(5, "motor feedback", 0x7305, 0x21, ChannelErrorType.ERROR),
            DriveFault(6, "under-voltage phase", 0x3220, 0x05, ChannelErrorType.UNDERVOLTAGE),
            DriveFault(7, "over-current", 0x2310, 0x03, ChannelErrorType.SHORT_CIRCUIT),
            DriveFault(8, "EEPROM checksum", 0x5530, 0x01, ChannelErrorType.ERROR),
            DriveFault(9, "parameter checksum", 0x6320, 0x01, ChannelErrorType.ERROR),
            DriveFault(10, "internal", 0x6100, 0x01, ChannelErrorType.ERROR),
            DriveFault(11, "positioning", 0x8611, 0x21, ChannelErrorType.ERROR),
            DriveFault(12, "CANopen", 0x8130, 0x11, ChannelErrorType.ERROR),
        )
    }
)
"""Every fault of the drive by its number."""
