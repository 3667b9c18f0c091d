"""Objects of CiA 402 beside those of the catalogue (``dsp402.objects``): velocity mode, factor group, units, homing methods.

Source: CiA 402-2. Types and PDO mapping flags are those of the profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, array, var
from pdgw.dsp402 import objects

_RW, _RO = Access.RW, Access.RO
_I8, _I16, _I32 = CanType.I8, CanType.I16, CanType.I32
_U8, _U32 = CanType.U8, CanType.U32
_METHODS = 37


def _ratio(index: int, name: str, first: str, second: str, type_: CanType = _U32) -> ObjectSpec:
    return array(index, name, Entry(index, 1, first, type_, _RW), Entry(index, 2, second, type_, _RW))


FURTHER_OBJECTS: tuple[ObjectSpec, ...] = (
    var(objects.VL_TARGET_VELOCITY, "vl target velocity", _I16, _RW, pdo=True, attribute="target_velocity"),
    var(0x6043, "vl velocity demand", _I16, _RO, pdo=True, attribute="velocity_demand"),
    var(0x6044, "vl velocity actual value", _I16, _RO, pdo=True, attribute="velocity_actual"),
    _ratio(objects.VL_MIN_MAX, "vl velocity min max amount", "Minimum", "Maximum"),
    _ratio(objects.VL_ACCELERATION, "vl velocity acceleration", "Delta speed", "Delta time"),
    _ratio(objects.VL_DECELERATION, "vl velocity deceleration", "Delta speed", "Delta time"),
    _ratio(objects.VL_SETPOINT_FACTOR, "vl setpoint factor", "Numerator", "Denominator", _I16),
    _ratio(objects.VL_DIMENSION_FACTOR, "vl dimension factor", "Numerator", "Denominator", _I32),
    _ratio(objects.SOFTWARE_POSITION_LIMIT, "Software position limit", "Minimum", "Maximum", _I32),
    var(objects.POLARITY, "Polarity", _U8),
    var(objects.POSITION_NOTATION, "Position notation index", _I8),
    var(objects.POSITION_DIMENSION, "Position dimension index", _U8),
    var(objects.VELOCITY_NOTATION, "Velocity notation index", _I8),
    var(objects.VELOCITY_DIMENSION, "Velocity dimension index", _U8),
    var(objects.ACCELERATION_NOTATION, "Acceleration notation index", _I8),
    var(objects.ACCELERATION_DIMENSION, "Acceleration dimension index", _U8),
    _ratio(
        objects.POSITION_ENCODER_RESOLUTION, "Position encoder resolution", "Encoder increments", "Motor revolutions"
    ),
    _ratio(
        objects.VELOCITY_ENCODER_RESOLUTION,
        "Velocity encoder resolution",
        "Encoder increments per second",
        "Motor revolutions per second",
    ),
    _ratio(objects.GEAR_RATIO, "Gear ratio", "Motor revolutions", "Shaft revolutions"),
    _ratio(objects.FEED_CONSTANT, "Feed constant", "Feed", "Shaft revolutions"),
    _ratio(objects.POSITION_FACTOR, "Position factor", "Numerator", "Divisor"),
    _ratio(objects.VELOCITY_FACTOR, "Velocity factor", "Numerator", "Divisor"),
    _ratio(objects.ACCELERATION_FACTOR, "Acceleration factor", "Numerator", "Divisor"),
    var(objects.SI_UNIT_POSITION, "SI unit position", _U32),
    var(objects.SI_UNIT_VELOCITY, "SI unit velocity", _U32),
    var(objects.SI_UNIT_ACCELERATION, "SI unit acceleration", _U32),
    array(
        objects.SUPPORTED_HOMING_METHODS,
        "Supported homing methods",
        *(
            Entry(objects.SUPPORTED_HOMING_METHODS, sub, f"Homing method {sub}", _I8, _RO)
            for sub in range(1, _METHODS + 1)
        ),
    ),
)
"""Objects with an image attribute belong to velocity mode (vl): they replace it in a drive with no other speed mode."""

VL_ENTRIES: Final[Mapping[str, Entry]] = {
    entry.attribute: entry for spec in FURTHER_OBJECTS for entry in spec.entries if entry.attribute
}
"""Objects of velocity mode (vl), by image attribute."""
