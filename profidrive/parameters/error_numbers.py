"""Error numbers of the parameter channel, once."""

from __future__ import annotations

import enum

from pdgw.profidrive.errors import ProfidriveError


class ParameterErrorNumber(enum.IntEnum):
    """Error numbers of a failed parameter access."""

    IMPERMISSIBLE_PNU = 0x00
    VALUE_CANNOT_BE_CHANGED = 0x01
    LIMIT_EXCEEDED = 0x02
    FAULTY_SUBINDEX = 0x03
    NO_ARRAY = 0x04
    INCORRECT_DATA_TYPE = 0x05
    SETTING_NOT_PERMITTED = 0x06
    DESCRIPTION_CANNOT_BE_CHANGED = 0x07
    DESCRIPTION_NOT_AVAILABLE = 0x09
    NO_OPERATION_PRIORITY = 0x0B
    NO_TEXT_ARRAY = 0x0F
    NOT_EXECUTABLE_IN_STATE = 0x11
    VALUE_IMPERMISSIBLE = 0x14
    RESPONSE_TOO_LONG = 0x15
    ADDRESS_IMPERMISSIBLE = 0x16
    ILLEGAL_FORMAT = 0x17
    NUMBER_OF_VALUES_INCONSISTENT = 0x18
    DO_DOES_NOT_EXIST = 0x19
    TEXT_CANNOT_BE_CHANGED = 0x20
    SERVICE_NOT_SUPPORTED = 0x21
    MULTI_PARAMETER_NOT_ALLOWED = 0x23
    MANUFACTURER = 0x65


ERROR_TEXTS: dict[int, str] = {
    ParameterErrorNumber.IMPERMISSIBLE_PNU: "impermissible parameter number",
    ParameterErrorNumber.VALUE_CANNOT_BE_CHANGED: "parameter value cannot be changed",
    ParameterErrorNumber.LIMIT_EXCEEDED: "low or high limit exceeded",
    ParameterErrorNumber.FAULTY_SUBINDEX: "faulty subindex",
    ParameterErrorNumber.NO_ARRAY: "no array",
    ParameterErrorNumber.INCORRECT_DATA_TYPE: "incorrect data type",
    ParameterErrorNumber.SETTING_NOT_PERMITTED: "setting not permitted, only resetting",
    ParameterErrorNumber.DESCRIPTION_CANNOT_BE_CHANGED: "description element cannot be changed",
    ParameterErrorNumber.DESCRIPTION_NOT_AVAILABLE: "no description data available",
    ParameterErrorNumber.NO_OPERATION_PRIORITY: "no operation priority",
    ParameterErrorNumber.NO_TEXT_ARRAY: "no text array available",
    ParameterErrorNumber.NOT_EXECUTABLE_IN_STATE: "request cannot be executed in this state",
    ParameterErrorNumber.VALUE_IMPERMISSIBLE: "value impermissible",
    ParameterErrorNumber.RESPONSE_TOO_LONG: "response too long",
    ParameterErrorNumber.ADDRESS_IMPERMISSIBLE: "parameter address impermissible",
    ParameterErrorNumber.ILLEGAL_FORMAT: "illegal format",
    ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT: "number of values inconsistent",
    ParameterErrorNumber.DO_DOES_NOT_EXIST: "axis or DO does not exist",
    ParameterErrorNumber.TEXT_CANNOT_BE_CHANGED: "parameter text cannot be changed",
    ParameterErrorNumber.SERVICE_NOT_SUPPORTED: "service not supported",
    ParameterErrorNumber.MULTI_PARAMETER_NOT_ALLOWED: "multi-parameter access not allowed",
    ParameterErrorNumber.MANUFACTURER: "error of the device, see its log",
}
"""Text of each number."""


def error_text(number: int) -> str:
    """The text of an error number; unknown ones say so."""
    if number in ERROR_TEXTS:
        return ERROR_TEXTS[number]
    return "manufacturer specific" if number >= ParameterErrorNumber.MANUFACTURER else "unknown error number"


class ParameterRefused(ProfidriveError):  # noqa: N818 (an answer, not a fault of the program)
    """One parameter of a request failed: becomes its error value in the response.

    ``subindex`` is the element that failed, where one did.
    """

    def __init__(self, number: ParameterErrorNumber | int, subindex: int | None = None) -> None:
        self.number = int(number)
        self.subindex = subindex
        super().__init__("parameter", f"error {self.number:02X}h", error_text(self.number))
