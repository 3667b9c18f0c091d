"""P979, the sensor format: how the position values of up to six sensors are to be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from pdgw.profidrive.errors import ProfidriveError

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
