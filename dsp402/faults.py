"""A manufacturer's fault numbers and their channel error types; the tables are in the overlays (``dsp402/families``)."""

from __future__ import annotations

import enum
from dataclasses import dataclass


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
    """A fault of the drive: the manufacturer's number, EMCY error code (603Fh) and error register bits (1001h)."""

    number: int
    name: str
    error_code: int
    error_register: int
    channel_error: ChannelErrorType
