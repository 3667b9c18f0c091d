"""SDO abort codes with number and text, and the errors of this package. Source: CiA DS 301 V4.02 chapter 7.2.4.3.17."""

from __future__ import annotations

import enum

from pdgw.base.errors import ValueNotAllowedError


class CanopenError(ValueNotAllowedError):
    """A CANopen fault: names the field or object, the offending value and what would have been allowed."""


class Abort(enum.IntEnum):
    """Abort codes this project sends or maps."""

    TOGGLE_NOT_ALTERNATED = 0x05030000
    TIMEOUT = 0x05040000
    INVALID_COMMAND = 0x05040001
    INVALID_BLOCK_SIZE = 0x05040002
    INVALID_SEQUENCE_NUMBER = 0x05040003
    CRC_ERROR = 0x05040004
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_SUCH_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    PARAMETER_INCOMPATIBLE = 0x06040043
    INTERNAL_INCOMPATIBLE = 0x06040047
    HARDWARE_ERROR = 0x06060000
    LENGTH_MISMATCH = 0x06070010
    LENGTH_TOO_HIGH = 0x06070012
    LENGTH_TOO_LOW = 0x06070013
    NO_SUCH_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    VALUE_TOO_HIGH = 0x06090031
    VALUE_TOO_LOW = 0x06090032
    MAXIMUM_BELOW_MINIMUM = 0x06090036
    NO_RESOURCE = 0x060A0023
    GENERAL = 0x08000000
    CANNOT_STORE = 0x08000020
    CANNOT_STORE_LOCAL_CONTROL = 0x08000021
    CANNOT_STORE_DEVICE_STATE = 0x08000022
    NO_OBJECT_DICTIONARY = 0x08000023
    NO_DATA = 0x08000024


NOT_THERE = (Abort.NO_SUCH_OBJECT, Abort.NO_SUCH_SUBINDEX)
"""Aborts for a missing object. With another code the object exists and cannot be read now."""

ABORT_TEXTS: dict[int, str] = {
    Abort.TOGGLE_NOT_ALTERNATED: "toggle bit not alternated",
    Abort.TIMEOUT: "SDO protocol timed out",
    Abort.INVALID_COMMAND: "command specifier not valid or unknown",
    Abort.INVALID_BLOCK_SIZE: "invalid block size",
    Abort.INVALID_SEQUENCE_NUMBER: "invalid sequence number",
    Abort.CRC_ERROR: "CRC error",
    Abort.OUT_OF_MEMORY: "out of memory",
    Abort.UNSUPPORTED_ACCESS: "unsupported access to an object",
    Abort.WRITE_ONLY: "attempt to read a write-only object",
    Abort.READ_ONLY: "attempt to write a read-only object",
    Abort.NO_SUCH_OBJECT: "object does not exist",
    Abort.NOT_MAPPABLE: "object cannot be mapped to the PDO",
    Abort.PDO_LENGTH: "number and length of objects exceed the PDO",
    Abort.PARAMETER_INCOMPATIBLE: "general parameter incompatibility",
    Abort.INTERNAL_INCOMPATIBLE: "general internal incompatibility in the device",
    Abort.HARDWARE_ERROR: "access failed due to a hardware error",
    Abort.LENGTH_MISMATCH: "data type or length does not match",
    Abort.LENGTH_TOO_HIGH: "data type does not match, length too high",
    Abort.LENGTH_TOO_LOW: "data type does not match, length too low",
    Abort.NO_SUCH_SUBINDEX: "sub-index does not exist",
    Abort.VALUE_RANGE: "value range of parameter exceeded",
    Abort.VALUE_TOO_HIGH: "value of parameter too high",
    Abort.VALUE_TOO_LOW: "value of parameter too low",
    Abort.MAXIMUM_BELOW_MINIMUM: "maximum value is less than minimum value",
    Abort.NO_RESOURCE: "resource not available",
    Abort.GENERAL: "general error",
    Abort.CANNOT_STORE: "data cannot be transferred or stored",
    Abort.CANNOT_STORE_LOCAL_CONTROL: "data cannot be stored because of local control",
    Abort.CANNOT_STORE_DEVICE_STATE: "data cannot be stored in the present device state",
    Abort.NO_OBJECT_DICTIONARY: "object dictionary is not present",
    Abort.NO_DATA: "no data available",
}
"""Text of each code."""


def abort_text(code: int) -> str:
    """``0602 0000h: object does not exist``; unknown codes say so."""
    return f"{code >> 16:04X} {code & 0xFFFF:04X}h: {ABORT_TEXTS.get(code, 'unknown abort code')}"


class SdoAbortedError(Exception):
    """An access was aborted by the server. ``where``: node and object, if known."""

    def __init__(self, code: int, where: str = "") -> None:
        super().__init__(code)
        self.code = code
        self.where = where

    def __str__(self) -> str:
        return f"{self.where}: {abort_text(self.code)}" if self.where else abort_text(self.code)


class SdoCommunicationError(Exception):
    """An access without an answer, or with one that breaks the protocol."""
