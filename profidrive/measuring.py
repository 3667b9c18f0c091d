"""Reference marks, measurement on the fly, and P979, the sensor format."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.signals import signal

# P979, the sensor format: how the position values of up to six sensors are to be read.
#
# Source: PROFIdrive profile 4.1 "sensor format" (structure version 1.2), encoder profile; docs/parameter-channel.md P979.


ELEMENTS = 31
"""Unsigned32 elements of P979: a header and six sensors."""
STRUCTURE_VERSION = 0x12
INDICES_PER_SENSOR = 5
SENSORS_MAX = (ELEMENTS - 1) // INDICES_PER_SENSOR
_U32 = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class SensorFormat:
    """The five elements of one sensor."""

    resolution: int
    """Rotary: measuring units per revolution; linear: nm per measuring unit."""
    turns: int = 1
    """Distinguishable revolutions; 1: single-turn, 0: incremental or linear."""
    shift_xist1: int = 0
    """Bits G1_XIST1 is shifted to the left."""
    shift_xist2: int = 0
    """Bits the absolute value in G1_XIST2 is shifted to the left."""
    linear: bool = False
    xist1_absolute: bool = True
    """G1_XIST1 starts with the absolute position."""
    is_64_bit: bool = False
    """Positions in G1_XIST3, 64 bit."""
    is_static: bool = True
    """The description cannot change while the device runs."""
    validity_static: bool = True
    """``valid`` cannot change while the device runs."""
    valid: bool = True


_TYPE_BITS = {"linear": 0, "xist1_absolute": 1, "is_64_bit": 2, "is_static": 29, "validity_static": 30, "valid": 31}
_NUMBERS = tuple(item.name for item in fields(SensorFormat) if item.name not in _TYPE_BITS)


def encode_sensor_format(sensors: Sequence[SensorFormat]) -> tuple[int, ...]:
    """The 31 elements of P979; ProfidriveError for no or too many sensors, or a number outside Unsigned32.

    One sensor gives the header 5112h: five indices per sensor, one sensor, structure version 1.2.
    """
    if not 1 <= len(sensors) <= SENSORS_MAX:
        raise ProfidriveError("P979 sensors", len(sensors), f"1..{SENSORS_MAX}")
    elements = [INDICES_PER_SENSOR << 12 | len(sensors) << 8 | STRUCTURE_VERSION]
    for number, sensor in enumerate(sensors, 1):
        for name in _NUMBERS:
            if not 0 <= getattr(sensor, name) <= _U32:
                raise ProfidriveError(f"P979 sensor {number} {name}", getattr(sensor, name), f"0..{_U32}")
        kind = sum(getattr(sensor, name) << bit for name, bit in _TYPE_BITS.items())
        elements += [kind, sensor.resolution, sensor.shift_xist1, sensor.shift_xist2, sensor.turns]
    return (*elements, *[0] * (ELEMENTS - len(elements)))


# Reference mark search and measurement on the fly: bits 0-7 of G1_STW and 0-7 of G1_ZSW. Sans-I/O.
#
# Source: PROFIdrive profile 4.1 chapter 6.3.6 (sensor interface). Functions 1 to 4 of a measurement are probe 1 rising,
# falling, probe 2 rising, falling; of the reference mark search only function 1, the zero pulse, exists here. Not here: the
# level of the probes (G1_ZSW.8, .9), which no standard object reports. A value is available until it was read; a read shows
# it in G1_XIST2 while its command is set.


_G1_STW = signal("G1_STW")
_G1_ZSW = signal("G1_ZSW")
FUNCTIONS: Final = 4
_SELECTED: Final = (1 << FUNCTIONS) - 1
_COMMAND = _G1_STW.bit("COMMAND")
_ON_THE_FLY = _G1_STW.bit("MODE").mask
_VALUE_1 = _G1_ZSW.bit("VALUE_1").position
_REFERENCE_FUNCTIONS = 1 << 0


class SensorCommand(enum.IntEnum):
    """G1_STW bits 4-6."""

    NONE = 0
    ACTIVATE = 1
    READ = 2
    ABORT = 3


class Refusal(enum.Enum):
    """Why a command is not carried out."""

    NOT_SUPPORTED = "no such function"
    NO_VALUE = "no value to read"
    REFUSED = "not carried out by the device"


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Positions that the device must latch; a new object for each activation. ``functions``: a mask, bit 0 is function 1."""

    on_the_fly: bool
    functions: int


class Measuring:
    """One sensor. Call ``step`` once per cycle. While ``search`` is not None, the owner must search and call ``found``."""

    def __init__(self) -> None:
        self.search: Search | None = None
        self.on_the_fly = False
        """Whether the last command was a measurement on the fly."""
        self.value: int | None = None
        """Value of the present read command."""
        self.refusal: Refusal | None = None
        """Problem in this step."""
        self._values: dict[int, int] = {}
        self._command = SensorCommand.NONE.value
        self._read = -1

    def step(self, word: int) -> int:
        """One cycle: G1_STW (0 without a PLC); returns bits 0-7 of G1_ZSW."""
        self.refusal = None
        command = _COMMAND.of(word)
        if command != self._command:
            self._command = command
            self._end_read()
            self.on_the_fly = word & _ON_THE_FLY != 0
            functions = word & _SELECTED
            if command == SensorCommand.ACTIVATE:
                self._activate(functions)
            elif command == SensorCommand.READ:
                self._begin_read(functions)
            elif command == SensorCommand.ABORT:
                self.search = None
            elif command != SensorCommand.NONE:
                self.refusal = Refusal.NOT_SUPPORTED
        active = 0 if self.search is None else self.search.functions
        for function in self._values:
            active |= 1 << function + _VALUE_1
        return active

    @property
    def busy(self) -> bool:
        """There is something to do or to show, also without a command."""
        return self.search is not None or self._command != SensorCommand.NONE or bool(self._values)

    def cancel(self) -> None:
        """The sensor has another state: abort searches, drop values."""
        self.search = None
        self.value = None
        self._values.clear()

    def found(self, search: Search, values: Mapping[int, int]) -> None:
        """Positions by function (0 to 3); those of a search that is over count for nothing."""
        if search is not self.search:
            return
        self._values |= values
        left = search.functions & ~sum(1 << function for function in values)
        self.search = Search(search.on_the_fly, left) if left else None

    def _activate(self, functions: int) -> None:
        allowed = _SELECTED if self.on_the_fly else _REFERENCE_FUNCTIONS
        if not functions or functions & ~allowed:
            self.refusal = Refusal.NOT_SUPPORTED
            return
        for function in range(FUNCTIONS):
            if functions >> function & 1:
                self._values.pop(function, None)
        self.search = Search(self.on_the_fly, functions)

    def _begin_read(self, functions: int) -> None:
        chosen = functions.bit_length() - 1
        if chosen in self._values and functions == 1 << chosen:
            self._read = chosen
            self.value = self._values[chosen]
        else:
            self.refusal = Refusal.NO_VALUE

    def _end_read(self) -> None:
        self.value = None
        self._values.pop(self._read, None)
        self._read = -1
