"""Objects of CiA 402 beside those of the catalogue (``dsp402.objects``): velocity mode, factor group, units, homing methods.

Source: CiA 402-2. Types and PDO mapping flags are those of the profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pdgw.ds301.objects import Access, CanType, Entry, ObjectSpec, array, var
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.overlay import entries_of

_RW, _RO = Access.RW, Access.RO
_I8, _I16, _I32 = CanType.I8, CanType.I16, CanType.I32
_U8, _U32 = CanType.U8, CanType.U32
_METHODS = 37


def _ratio(index: int, name: str, first: str, second: str, type_: CanType = _U32) -> ObjectSpec:
    return array(index, name, Entry(index, 1, first, type_, _RW), Entry(index, 2, second, type_, _RW))


FURTHER_OBJECTS: tuple[ObjectSpec, ...] = (
    var(0x6042, "vl target velocity", _I16, _RW, pdo=True, attribute="target_velocity"),
    var(0x6043, "vl velocity demand", _I16, _RO, pdo=True, attribute="velocity_demand"),
    var(0x6044, "vl velocity actual value", _I16, _RO, pdo=True, attribute="velocity_actual"),
    _ratio(0x6046, "vl velocity min max amount", "Minimum", "Maximum"),
    _ratio(0x6048, "vl velocity acceleration", "Delta speed", "Delta time"),
    _ratio(0x6049, "vl velocity deceleration", "Delta speed", "Delta time"),
    _ratio(0x604B, "vl setpoint factor", "Numerator", "Denominator", _I16),
    _ratio(0x604C, "vl dimension factor", "Numerator", "Denominator", _I32),
    _ratio(0x607D, "Software position limit", "Minimum", "Maximum", _I32),
    var(0x6089, "Position notation index", _I8),
    var(0x608A, "Position dimension index", _U8),
    var(0x608B, "Velocity notation index", _I8),
    var(0x608C, "Velocity dimension index", _U8),
    var(0x608D, "Acceleration notation index", _I8),
    var(0x608E, "Acceleration dimension index", _U8),
    _ratio(0x608F, "Position encoder resolution", "Encoder increments", "Motor revolutions"),
    _ratio(0x6090, "Velocity encoder resolution", "Encoder increments per second", "Motor revolutions per second"),
    _ratio(0x6091, "Gear ratio", "Motor revolutions", "Shaft revolutions"),
    _ratio(0x6092, "Feed constant", "Feed", "Shaft revolutions"),
    _ratio(0x6093, "Position factor", "Numerator", "Divisor"),
    _ratio(0x6096, "Velocity factor", "Numerator", "Divisor"),
    _ratio(0x6097, "Acceleration factor", "Numerator", "Divisor"),
    var(0x60A8, "SI unit position", _U32),
    var(0x60A9, "SI unit velocity", _U32),
    var(0x60AA, "SI unit acceleration", _U32),
    array(
        0x60E3,
        "Supported homing methods",
        *(Entry(0x60E3, sub, f"Homing method {sub}", _I8, _RO) for sub in range(1, _METHODS + 1)),
    ),
)
"""Those with an image attribute are velocity mode's (vl): they stand for it in a drive that has no other mode for a speed."""

VL_ENTRIES: Final[Mapping[str, Entry]] = {
    entry.attribute: entry for spec in FURTHER_OBJECTS for entry in spec.entries if entry.attribute
}
"""Of velocity mode (vl), by the image attribute they stand for."""
_OF_VL: Final = {entry.address: entry for entry in VL_ENTRIES.values()}


def image_entry(index: int, subindex: int, families: tuple[str, ...]) -> Entry | None:
    """The object at an address as the images of a drive have it, in whichever mode; None for no such object.

    ``families``: what the drive may be of (``overlay.families_of``).
    """
    address = (index, subindex)
    return DRIVE_OBJECTS.get(index, subindex) or _OF_VL.get(address) or entries_of(families).get(address)
