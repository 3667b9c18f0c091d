"""Makes the ``DriveType`` of one device from its object dictionary, its answers and the overlay of its family.

Source: CiA 402 (6502h, 60E3h, 6098h), CiA 301 (1400h-1BFFh), CiA 306 (access, limits and PDO mapping of a data sheet).
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import canopen
from canopen.objectdictionary import ODVariable

from pdgw.ds301.communication import IDENTITY_PRODUCT, IDENTITY_VENDOR
from pdgw.ds301.eds.pdos import pdo_capabilities, variable
from pdgw.ds301.objects import Access, CanType, Entry, ObjectAddress
from pdgw.dsp402.drive_type import DriveType, Quirks
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay
from pdgw.dsp402.modes import MODE_NAMES, STANDARD_HOMING_METHODS, SUPPORTED_MODES, Mode
from pdgw.dsp402.objects import (
    DRIVE_OBJECTS,
    FAMILY_VALUES,
    MAX_TORQUE,
    POSITION_WINDOW,
    SUPPORTED_DRIVE_MODES,
    SUPPORTED_HOMING_METHODS,
    TARGET_POSITION,
    TARGET_TORQUE,
    TARGET_VELOCITY,
    VL_ENTRIES,
    VL_TARGET_VELOCITY,
)
from pdgw.dsp402.pdo.layouts import LAYOUTS
from pdgw.dsp402.units.mechanics import POSITION_OBJECTS, UnitKeys
from pdgw.dsp402.units.scaling import SCALING_OBJECTS, find_scaling

_NO_WINDOW = 0xFFFF_FFFF
"""6067h of a drive that does not use it."""
PROFILE_AREA = range(0x6000, 0x6800)
"""Objects of the first axis; others belong to the manufacturer."""
OPTIONAL_OBJECTS: Final = frozenset(
    entry.address
    for layout in LAYOUTS.values()
    for attribute in layout.optional
    for entry in (DRIVE_OBJECTS.attribute(attribute), VL_ENTRIES.get(attribute))
    if entry is not None
)
"""What operation does not need: the device is asked whether it has them, whatever its data sheet says."""
_TYPES = {item.code: item for item in CanType}
_INTEGERS = {
    (item.bits, item.char.islower()): item
    for item in (CanType.I8, CanType.I16, CanType.I32, CanType.U8, CanType.U16, CanType.U32)
}
"""Data types by number of bits and sign."""
_MODE_OBJECTS = (
    (Mode.POSITION, TARGET_POSITION),
    (Mode.VL_VELOCITY, VL_TARGET_VELOCITY),
    (Mode.VELOCITY, TARGET_VELOCITY),
    (Mode.TORQUE, TARGET_TORQUE),
    (Mode.HOMING, 0x6098),
)
"""The object a mode cannot do without, for a drive whose 6502h is missing or 0."""


def questions(dictionary: canopen.ObjectDictionary) -> tuple[ObjectAddress, ...]:
    """The objects to read from the device for its description, if its data sheet has them."""
    count = variable(dictionary, SUPPORTED_HOMING_METHODS, 0)
    methods = (
        []
        if count is None
        else [(SUPPORTED_HOMING_METHODS, sub) for sub in dictionary[SUPPORTED_HOMING_METHODS] if sub]
    )
    modes = [(SUPPORTED_DRIVE_MODES, 0)] if SUPPORTED_DRIVE_MODES in dictionary else []
    scaling = [address for address in SCALING_OBJECTS if variable(dictionary, *address) is not None]
    others = [address for address in (MAX_TORQUE, (POSITION_WINDOW, 0)) if variable(dictionary, *address) is not None]
    optional = sorted(address for address in OPTIONAL_OBJECTS if variable(dictionary, *address) is not None)
    return (IDENTITY_VENDOR, IDENTITY_PRODUCT, *modes, *methods, *scaling, *others, *optional)


def describe(
    dictionary: canopen.ObjectDictionary,
    answers: Mapping[ObjectAddress, int],
    units: UnitKeys | None = None,
    families: Families = NO_CHOICE,
) -> DriveType:
    """The drive with this data sheet that gave these answers; an object it did not answer is one it does not have.

    ``units`` and ``families``: the configuration's. Dsp402Error for a unit there is not.
    """
    device_name = dictionary.device_information.product_name or ""
    identity = answers.get(IDENTITY_VENDOR, 0), answers.get(IDENTITY_PRODUCT, 0), device_name
    family = families.of(*identity)
    modes = _modes(dictionary, answers, family)
    vl = _uses_vl(modes)
    entries = _entries(dictionary, family, vl=vl)
    entries = {name: entry for name, entry in entries.items() if entry.address not in OPTIONAL_OBJECTS - answers.keys()}
    quirks = family.drive_quirks if family else Quirks()
    window = answers.get((POSITION_WINDOW, 0))
    scaling = find_scaling(
        answers,
        units,
        families.units_of(*identity),
        name=family.name if family else "1018h",
        vl=vl,
        range_is_limit=quirks.range_is_limit,
    )
    return DriveType(
        name=device_name or (family.title if family else "CiA 402 drive"),
        family=family.name if family else "",
        entries=MappingProxyType(entries),
        scaling=scaling,
        modes=MappingProxyType(modes),
        homing_methods=MappingProxyType(_homing_methods(entries, answers, family)),
        pdos=pdo_capabilities(dictionary),
        faults=MappingProxyType(dict(family.drive_faults) if family else {}),
        quirks=quirks,
        max_torque=answers.get(MAX_TORQUE, 0),
        position_window=None if window == _NO_WINDOW else window,
        position_objects=MappingProxyType({key: value for key, value in answers.items() if key[0] in POSITION_OBJECTS}),
        ignored_ranges=tuple(
            f"{entry.index:04X}h: the range {declared.min}..{declared.max} in the data sheet forbids the setpoint 0: ignored, "
            "the range of the data type is used"
            for attribute, entry in entries.items()
            if (declared := variable(dictionary, *entry.address)) is not None and _forbids_stop(declared, attribute)
        ),
    )


def _uses_vl(modes: Mapping[int, str]) -> bool:
    """Whether velocity mode (vl) is all a drive has for a speed."""
    return Mode.VL_VELOCITY in modes and not modes.keys() & {Mode.VELOCITY.value, Mode.CYCLIC_VELOCITY.value}


def answers_of_defaults(dictionary: canopen.ObjectDictionary) -> dict[ObjectAddress, int]:
    """The answers of a device that has the default values of its data sheet and every optional object."""
    found = {address: variable(dictionary, *address) for address in questions(dictionary)}
    present = dict.fromkeys(found.keys() & OPTIONAL_OBJECTS, 0)
    return present | {
        address: item.default for address, item in found.items() if item is not None and isinstance(item.default, int)
    }


def described_by_sheet(
    dictionary: canopen.ObjectDictionary, units: UnitKeys | None = None, families: Families = NO_CHOICE
) -> DriveType:
    """The drive as its data sheet alone describes it; as ``describe``."""
    information = dictionary.device_information
    identity = {IDENTITY_VENDOR: information.vendor_number, IDENTITY_PRODUCT: information.product_number}
    values = {address: value for address, value in identity.items() if value}
    return describe(dictionary, answers_of_defaults(dictionary) | values, units, families)


def signed(dictionary: canopen.ObjectDictionary, address: ObjectAddress) -> bool:
    """Whether the data sheet says that this object is a signed number."""
    declared = variable(dictionary, *address)
    kind = None if declared is None else _TYPES.get(declared.data_type)
    return kind is not None and kind.char.islower()


def _entries(dictionary: canopen.ObjectDictionary, family: Overlay | None, *, vl: bool) -> dict[str, Entry]:
    """The cyclic objects of the profile that the drive has, and the manufacturer's objects in its overlay. ``vl``: speeds are
    those of velocity mode."""
    addresses = {
        entry.attribute: entry.address
        for entry in DRIVE_OBJECTS.entries
        if entry.attribute and entry.index in PROFILE_AREA
    }
    if vl:
        addresses |= {attribute: entry.address for attribute, entry in VL_ENTRIES.items()}
    if family is not None:
        addresses |= {attribute: item.address for attribute, item in family.objects.items()}
    found: dict[str, Entry] = {}
    for attribute, (index, subindex) in addresses.items():
        declared = variable(dictionary, index, subindex)
        kind = None if declared is None else _type_of(attribute, _TYPES.get(declared.data_type))
        if declared is None or kind is None:
            continue
        known = DRIVE_OBJECTS.get(index, subindex)
        low, high = _limits(declared, kind, attribute)
        found[attribute] = Entry(
            index,
            subindex,
            declared.name,
            kind,
            Access(declared.access_type) if declared.access_type in _ACCESSES else Access.RW,
            bool(declared.pdo_mappable),
            default=declared.default if isinstance(declared.default, int) else None,
            low=low,
            high=high,
            unit=(family.unit_of(index, subindex) if family else "") or (known.unit if known is not None else ""),
            attribute=attribute,
        )
    return found


def _forbids_stop(declared: ODVariable, attribute: str) -> bool:
    """Whether a data sheet forbids the setpoint 0, which stops the axis."""
    return attribute in _STOPS_AT_ZERO and ((declared.min or 0) > 0 or (declared.max or 0) < 0)


def _limits(declared: ODVariable, kind: CanType, attribute: str) -> tuple[int | None, int | None]:
    """Limits of the data sheet inside the type; None without one, or where it forbids 0 as a setpoint that must stop."""
    if _forbids_stop(declared, attribute):
        return None, None
    low, high = declared.min, declared.max
    lowest, highest = kind.integer_range
    return None if low is None else max(low, lowest), None if high is None else min(high, highest)


_STOPS_AT_ZERO: Final = ("target_velocity", "target_torque", "velocity_offset")

_ACCESSES = {item.value for item in Access}


def _type_of(attribute: str, declared: CanType | None) -> CanType | None:
    """The type of a value in the images: as long as declared, with the profile's sign, of which data sheets are not sure.

    None for one that the images cannot hold: no integer, or a longer one.
    """
    profile = (FAMILY_VALUES.get(attribute) or DRIVE_OBJECTS.attribute(attribute)).type
    if declared is None or declared not in _INTEGERS.values() or declared.bits > profile.bits:
        return None
    return _INTEGERS[declared.bits, profile.char.islower()]


def _modes(
    dictionary: canopen.ObjectDictionary, answers: Mapping[ObjectAddress, int], family: Overlay | None
) -> dict[int, str]:
    supported = answers.get((SUPPORTED_DRIVE_MODES, 0))
    if not supported:  # missing, or 0: not filled in
        modes = [mode for mode, index in _MODE_OBJECTS if index in dictionary]
    else:
        modes = [mode for bit, mode in SUPPORTED_MODES.items() if supported >> bit & 1]
    return {mode.value: MODE_NAMES[mode] for mode in modes} | (family.modes if family else {})


def _homing_methods(
    entries: Mapping[str, Entry], answers: Mapping[ObjectAddress, int], family: Overlay | None
) -> dict[int, str]:
    """Those of 60E3h; else of the overlay; else all of the profile: the drive itself refuses a method by SDO abort."""
    if "homing_method" not in entries:
        return {}
    texts = STANDARD_HOMING_METHODS | (family.homing_texts if family else {})
    values = [value for (index, sub), value in answers.items() if index == SUPPORTED_HOMING_METHODS and sub and value]
    if not values and family is not None:
        values = list(family.homing_methods)
    low, high = entries["homing_method"].limits
    return {method: texts.get(method, "") for method in values or STANDARD_HOMING_METHODS if low <= method <= high}
