"""The object catalogue of encoders: the profile's table as data, and the objects of one device made from it.

Source: CiA DSP 406 V2.0 chapter 8. 650Ah is given sub-indices 1-3, because CiA 301 keeps sub-index 0 for their number (the
profile counts its fields from 0). 6020h is read-only as the profile's overview says; its detailed table prints rw.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from pdgw.ds301.objects import Access, CanType, Catalogue, Entry, ObjectKind, ObjectSpec, array
from pdgw.dsp406.kinds import LINEAR_TYPES, Alarm, EncoderDevice, EncoderType, Warnings

RO, RW = Access.RO, Access.RW
U8, U16, U32 = CanType.U8, CanType.U16, CanType.U32
I16, I32 = CanType.I16, CanType.I32

CAMS = 8
PROFILE_VERSION = 0x0200
SOFTWARE_VERSION = 0x0100
UNUSED = 0xFFFF_FFFF
"""6508h and 650Bh of a device that does not have them."""
POSITION_UNIT = "measuring units"
OPERATING_PARAMETERS: Final = 0x6000
UNITS_PER_REVOLUTION: Final = 0x6001
TOTAL_RANGE: Final = 0x6002
PRESET: Final = 0x6003
POSITION: Final = 0x6004
MEASURING_STEPS: Final = 0x6005
PRESET_MULTI_SENSOR: Final = 0x6010
POSITION_MULTI_SENSOR: Final = 0x6020
SPEED: Final = 0x6030
CYCLIC_TIMER: Final = 0x6200
CAM_STATE: Final = 0x6300
CAM_LOW_LIMIT: Final = 0x6310
CAM_HIGH_LIMIT: Final = 0x6320
CAM_HYSTERESIS: Final = 0x6330
"""Object of the first cam; the next index belongs to the next cam."""
AREA_STATE: Final = 0x6400
WORK_AREA_LOW: Final = 0x6401
WORK_AREA_HIGH: Final = 0x6402
OPERATING_STATUS: Final = 0x6500
RESOLUTION: Final = 0x6501
REVOLUTIONS: Final = 0x6502
ALARMS: Final = 0x6503
SUPPORTED_ALARMS: Final = 0x6504
WARNINGS: Final = 0x6505
SUPPORTED_WARNINGS: Final = 0x6506
VERSIONS: Final = 0x6507
OPERATING_TIME: Final = 0x6508
OFFSET: Final = 0x6509
MODULE_IDENTIFICATION: Final = 0x650A
SERIAL_NUMBER: Final = 0x650B
"""Indices of objects that are used by name."""


class Category(enum.Enum):
    """Whether a device has to have an object."""

    MANDATORY = "m"
    OPTIONAL = "o"
    NONE = ""


class EncoderClass(enum.Enum):
    """Device classes of the profile: C1 is the basic range of functions, C2 the extended one."""

    C1 = "C1"
    C2 = "C2"


MANDATORY, OPTIONAL, NONE = Category.MANDATORY, Category.OPTIONAL, Category.NONE
_MULTI = frozenset({EncoderType.MULTI_SENSOR})
_ALL = frozenset(EncoderType)
_SINGLE = _ALL - _MULTI


@dataclass(frozen=True, slots=True)
class ProfileObject:
    """One row of the profile's table.

    ``c1`` and ``c2`` hold for encoders of ``types``; for the others ``elsewhere`` (NONE: they do not have it). ``fields`` names
    the sub-indices of a record, ``per_channel`` says one sub-index per channel; otherwise it is a variable. ``attribute``
    is the name in images, with ``_1``, ``_2`` ... for channels.
    """

    index: int
    name: str
    type: CanType
    access: Access
    c1: Category
    c2: Category
    pdo: bool = False
    types: frozenset[EncoderType] = _ALL
    elsewhere: Category = NONE
    fields: tuple[str, ...] = ()
    per_channel: bool = False
    attribute: str = ""
    unit: str = ""

    def category(self, encoder_class: EncoderClass, type_: EncoderType) -> Category:
        """Whether an encoder of this class and type must, may or need not have the object (NONE)."""
        if type_ not in self.types:
            return self.elsewhere
        return self.c1 if encoder_class is EncoderClass.C1 else self.c2


def _channels(
    index: int, name: str, type_: CanType, access: Access, attribute: str = "", *, pdo: bool = False, unit: str = ""
) -> ProfileObject:
    """A row that is optional in both classes, one sub-index per channel."""
    return ProfileObject(
        index, name, type_, access, OPTIONAL, OPTIONAL, pdo=pdo, per_channel=True, attribute=attribute, unit=unit
    )


PROFILE: tuple[ProfileObject, ...] = (
    ProfileObject(OPERATING_PARAMETERS, "Operating parameters", U16, RW, MANDATORY, MANDATORY),
    ProfileObject(UNITS_PER_REVOLUTION, "Measuring units per revolution", U32, RW, NONE, MANDATORY, unit=POSITION_UNIT),
    ProfileObject(
        TOTAL_RANGE, "Total measuring range in measuring units", U32, RW, NONE, MANDATORY, unit=POSITION_UNIT
    ),
    ProfileObject(PRESET, "Preset value", U32, RW, NONE, MANDATORY, types=_SINGLE, unit=POSITION_UNIT),
    ProfileObject(
        POSITION,
        "Position value",
        U32,
        RO,
        MANDATORY,
        MANDATORY,
        pdo=True,
        types=_SINGLE,
        attribute="position_1",
        unit=POSITION_UNIT,
    ),
    ProfileObject(
        MEASURING_STEPS,
        "Linear encoder measuring step settings",
        U32,
        RW,
        NONE,
        MANDATORY,
        types=LINEAR_TYPES,
        fields=("Position measuring step (0.001 mm)", "Speed measuring step (0.01 mm/s)"),
    ),
    ProfileObject(
        PRESET_MULTI_SENSOR,
        "Preset values for multi-sensor devices",
        U32,
        RW,
        NONE,
        MANDATORY,
        types=_MULTI,
        per_channel=True,
        unit=POSITION_UNIT,
    ),
    ProfileObject(
        POSITION_MULTI_SENSOR,
        "Position values for multi-sensor devices",
        I32,
        RO,
        MANDATORY,
        MANDATORY,
        pdo=True,
        types=_MULTI,
        per_channel=True,
        attribute="position",
        unit=POSITION_UNIT,
    ),
    ProfileObject(
        SPEED,
        "Speed value",
        I16,
        RO,
        NONE,
        MANDATORY,
        pdo=True,
        types=_MULTI,
        elsewhere=OPTIONAL,
        per_channel=True,
        attribute="speed",
        unit="measuring units/s (linear: steps of 6005h/2)",
    ),
    ProfileObject(CYCLIC_TIMER, "Cyclic timer", U16, RW, NONE, MANDATORY, unit="ms"),
    _channels(CAM_STATE, "Cam state register", U8, RO, "cam_state", pdo=True),
    _channels(0x6301, "Cam enable register", U8, RW, "cam_enable", pdo=True),
    _channels(0x6302, "Cam polarity register", U8, RW, "cam_polarity", pdo=True),
    *(_channels(CAM_LOW_LIMIT + cam, f"Cam {cam + 1} low limit", I32, RW, unit=POSITION_UNIT) for cam in range(CAMS)),
    *(_channels(CAM_HIGH_LIMIT + cam, f"Cam {cam + 1} high limit", I32, RW, unit=POSITION_UNIT) for cam in range(CAMS)),
    *(_channels(CAM_HYSTERESIS + cam, f"Cam {cam + 1} hysteresis", U16, RW, unit=POSITION_UNIT) for cam in range(CAMS)),
    _channels(AREA_STATE, "Area state register", U8, RO, "area_state", pdo=True),
    _channels(WORK_AREA_LOW, "Work area low limit", I32, RW, unit=POSITION_UNIT),
    _channels(WORK_AREA_HIGH, "Work area high limit", I32, RW, unit=POSITION_UNIT),
    ProfileObject(OPERATING_STATUS, "Operating status", U16, RO, MANDATORY, MANDATORY, attribute="operating_status"),
    ProfileObject(
        RESOLUTION,
        "Single-turn resolution, measuring step",
        U32,
        RO,
        MANDATORY,
        MANDATORY,
        unit="steps, linear: 0.001 mm",
    ),
    ProfileObject(REVOLUTIONS, "Number of distinguishable revolutions", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(ALARMS, "Alarms", U16, RO, MANDATORY, MANDATORY, attribute="alarms"),
    ProfileObject(SUPPORTED_ALARMS, "Supported alarms", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(WARNINGS, "Warnings", U16, RO, MANDATORY, MANDATORY, attribute="warnings"),
    ProfileObject(SUPPORTED_WARNINGS, "Supported warnings", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(VERSIONS, "Profile and software version", U32, RO, NONE, MANDATORY),
    ProfileObject(OPERATING_TIME, "Operating time", U32, RO, NONE, MANDATORY, attribute="operating_time", unit="0.1 h"),
    ProfileObject(OFFSET, "Offset value", I32, RO, NONE, MANDATORY, attribute="offset", unit=POSITION_UNIT),
    ProfileObject(
        MODULE_IDENTIFICATION,
        "Module identification",
        I32,
        RO,
        NONE,
        MANDATORY,
        fields=(
            "Manufacturer offset value",
            "Manufacturer minimum position value",
            "Manufacturer maximum position value",
        ),
        unit="physical steps",
    ),
    ProfileObject(SERIAL_NUMBER, "Serial number", U32, RO, NONE, MANDATORY),
)


def _values(device: EncoderDevice, serial_number: int) -> dict[tuple[int, int], tuple[int, int | None, int | None]]:
    """Defaults and limits of the device by (index, sub-index; 0 for every sub-index); 0 and the type's range elsewhere."""
    steps, resolution = device.steps, device.resolution
    # The finest position step of a linear encoder is 0.001 mm.
    finest = steps * resolution if device.is_linear else steps
    return {
        (UNITS_PER_REVOLUTION, 0): (
            steps if device.is_linear else resolution,
            1,
            None if device.is_linear else resolution,
        ),
        (TOTAL_RANGE, 0): (steps, 1, finest),
        (MEASURING_STEPS, 1): (resolution, 1, None),
        (MEASURING_STEPS, 2): (100, 1, None),
        (WORK_AREA_HIGH, 0): (steps - 1, None, None),
        (RESOLUTION, 0): (resolution, None, None),
        (REVOLUTIONS, 0): (device.turns, None, None),
        (SUPPORTED_ALARMS, 0): (sum(Alarm), None, None),
        (SUPPORTED_WARNINGS, 0): (sum(Warnings), None, None),
        (VERSIONS, 0): (SOFTWARE_VERSION << 16 | PROFILE_VERSION, None, None),
        (OPERATING_TIME, 0): (UNUSED, None, None),
        (MODULE_IDENTIFICATION, 3): (steps - 1, None, None),
        (SERIAL_NUMBER, 0): (serial_number, None, None),
    }


def encoder_catalogue(device: EncoderDevice, serial_number: int = 1) -> Catalogue:
    """The objects 6000h-650Bh of a device: everything the profile knows for its type, in class C2."""
    values = _values(device, serial_number)

    def entry(row: ProfileObject, subindex: int, name: str, attribute: str) -> Entry:
        default, low, high = values.get((row.index, subindex)) or values.get((row.index, 0)) or (0, None, None)
        return Entry(row.index, subindex, name, row.type, row.access, row.pdo, default, low, high, row.unit, attribute)

    def specs() -> Iterator[ObjectSpec]:
        for row in PROFILE:
            if row.category(EncoderClass.C2, device.type) is Category.NONE:
                continue
            if row.per_channel:
                numbers = range(1, device.channels + 1)
                names = (
                    (n, f"{row.name} channel {n}", f"{row.attribute}_{n}" if row.attribute else "") for n in numbers
                )
                yield array(row.index, row.name, *(entry(row, *item) for item in names))
            elif row.fields:
                fields = (entry(row, n, name, "") for n, name in enumerate(row.fields, 1))
                yield array(row.index, row.name, *fields, kind=ObjectKind.RECORD)
            else:
                single = entry(row, 0, row.name, row.attribute)
                yield ObjectSpec(row.index, row.name, ObjectKind.VAR, (single,))

    return Catalogue(tuple(specs()))
