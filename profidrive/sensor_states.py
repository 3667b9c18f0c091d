"""The sensor interface as tables: error codes in G1_XIST2, states and events, transitions, and G1_ZSW of each state.

Source: PROFIdrive encoder profile 4.1 (3.162), PROFIdrive profile 4.1 chapter 6.3.6 (sensor interface).

| state | G1_ZSW | entered by | left by |
| --- | --- | --- | --- |
| NORMAL | .13 while an absolute value is shown | start, acknowledge, end of parking or of a preset | |
| PRESETTING | as NORMAL | rising edge of G1_STW.12 | the owner's answer |
| PRESET_DONE | .12 | the preset is done | G1_STW.12 = 0 |
| PARKED | .14 | G1_STW.14 = 1, from every state | G1_STW.14 = 0 |
| ERROR | .15, code in G1_XIST2 | an error | rising edge of G1_STW.15 |
| ACKNOWLEDGING | .15 and .11 | the acknowledge | G1_STW.15 = 0 |
"""

from __future__ import annotations

import enum
from types import MappingProxyType

from pdgw.profidrive.measuring import Refusal
from pdgw.profidrive.signals import signal

_G1_ZSW = signal("G1_ZSW")


class SensorError(enum.IntEnum):
    """Error codes in G1_XIST2."""

    SENSOR_GROUP = 0x0001
    REFERENCE_ABORTED = 0x0004
    NO_REFERENCE_VALUE = 0x0005
    MEASUREMENT_ABORTED = 0x0006
    NO_MEASURED_VALUE = 0x0007
    MEMORY = 0x1001
    COMMAND_NOT_SUPPORTED = 0x0F01
    CONTROLLER_SIGN_OF_LIFE = 0x0F02
    SYNCHRONISATION = 0x0F04


SENSOR_ERROR_TEXTS: MappingProxyType[int, str] = MappingProxyType(
    {
        SensorError.SENSOR_GROUP: "the position is wrong or missing",
        SensorError.REFERENCE_ABORTED: "the device does not carry out the reference mark search",
        SensorError.NO_REFERENCE_VALUE: "there is no value of a reference mark to read",
        SensorError.MEASUREMENT_ABORTED: "the device does not carry out the measurement on the fly",
        SensorError.NO_MEASURED_VALUE: "there is no measured value to read",
        SensorError.MEMORY: "offset or preset could not be stored or read",
        SensorError.COMMAND_NOT_SUPPORTED: "G1_STW has a command that the sensor does not have, or a preset out of range",
        SensorError.CONTROLLER_SIGN_OF_LIFE: "the PLC's sign of life failed more often than P925 tolerates",
        SensorError.SYNCHRONISATION: "the device is not synchronous with the cycle of the PLC",
    }
)
"""Meaning of each error code."""


class SensorState(enum.Enum):
    """States of the sensor interface."""

    NORMAL = "normal"
    PRESETTING = "presetting"
    PRESET_DONE = "preset done"
    PARKED = "parked"
    ERROR = "error"
    ACKNOWLEDGING = "acknowledging"


class SensorEvent(enum.Enum):
    """Events of a cycle; several are processed in this order."""

    DONE = "preset done"
    FAILED = "preset failed"
    PARK = "G1_STW.14 = 1"
    UNPARK = "G1_STW.14 = 0"
    ACKNOWLEDGE = "rising edge of G1_STW.15"
    ACKNOWLEDGE_END = "G1_STW.15 = 0"
    FAULT = "an error is present"
    PRESET = "rising edge of G1_STW.12"
    PRESET_END = "G1_STW.12 = 0"


REFUSAL_ERRORS: MappingProxyType[tuple[Refusal, bool], SensorError] = MappingProxyType(
    {
        (Refusal.NOT_SUPPORTED, False): SensorError.COMMAND_NOT_SUPPORTED,
        (Refusal.NOT_SUPPORTED, True): SensorError.COMMAND_NOT_SUPPORTED,
        (Refusal.NO_VALUE, False): SensorError.NO_REFERENCE_VALUE,
        (Refusal.NO_VALUE, True): SensorError.NO_MEASURED_VALUE,
        (Refusal.REFUSED, False): SensorError.REFERENCE_ABORTED,
        (Refusal.REFUSED, True): SensorError.MEASUREMENT_ABORTED,
    }
)
"""Error by cause, and whether it is a measurement on the fly."""
_S, _E = SensorState, SensorEvent
TRANSITIONS: MappingProxyType[tuple[SensorState, SensorEvent], SensorState] = MappingProxyType(
    {
        (_S.NORMAL, _E.PARK): _S.PARKED,
        (_S.NORMAL, _E.FAULT): _S.ERROR,
        (_S.NORMAL, _E.PRESET): _S.PRESETTING,
        (_S.PRESETTING, _E.DONE): _S.PRESET_DONE,
        (_S.PRESETTING, _E.FAILED): _S.ERROR,
        (_S.PRESETTING, _E.PARK): _S.PARKED,
        (_S.PRESETTING, _E.FAULT): _S.ERROR,
        (_S.PRESET_DONE, _E.PARK): _S.PARKED,
        (_S.PRESET_DONE, _E.FAULT): _S.ERROR,
        (_S.PRESET_DONE, _E.PRESET_END): _S.NORMAL,
        (_S.PARKED, _E.UNPARK): _S.NORMAL,
        (_S.ERROR, _E.PARK): _S.PARKED,
        (_S.ERROR, _E.ACKNOWLEDGE): _S.ACKNOWLEDGING,
        (_S.ACKNOWLEDGING, _E.PARK): _S.PARKED,
        (_S.ACKNOWLEDGING, _E.ACKNOWLEDGE_END): _S.NORMAL,
    }
)
"""Every transition; an event a state does not name changes nothing."""

SENSOR_STATUS: MappingProxyType[SensorState, int] = MappingProxyType(
    {
        state: sum(_G1_ZSW.bit(name).mask for name in names)
        for state, names in {
            _S.NORMAL: (),
            _S.PRESETTING: (),
            _S.PRESET_DONE: ("PRESET_DONE",),
            _S.PARKED: ("PARKED",),
            _S.ERROR: ("ERROR",),
            _S.ACKNOWLEDGING: ("ERROR", "ERROR_ACKNOWLEDGED"),
        }.items()
    }
)
"""G1_ZSW of each state, without the absolute value's bit."""
MEASURING = frozenset((_S.NORMAL, _S.PRESETTING, _S.PRESET_DONE))
"""States with a reference mark search or a measurement, and an absolute value."""
IN_ERROR = frozenset((_S.ERROR, _S.ACKNOWLEDGING))
"""States in which G1_XIST2 has the error code."""
