"""The object catalogue of encoders: the profile's table as data, and the objects of one device made from it.

Source: CiA DSP 406 V2.0 chapter 8. 650Ah is given sub-indices 1-3, because CiA 301 keeps sub-index 0 for their number (the
profile counts its fields from 0). 6020h is read-only as the profile's overview says; its detailed table prints rw.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass

from pdgw.ds301.objects import Access, CanType, Catalogue, Entry, ObjectKind, ObjectSpec, array
from pdgw.dsp406.kinds import LINEAR_TYPES, EncoderDevice, EncoderType
from pdgw.dsp406.registers import Alarm, Warnings

RO, RW = Access.RO, Access.RW
U8, U16, U32 = CanType.U8, CanType.U16, CanType.U32
I16, I32 = CanType.I16, CanType.I32

CAMS = 8
PROFILE_VERSION = 0x0200
SOFTWARE_VERSION = 0x0100
UNUSED = 0xFFFF_FFFF
"""6508h and 650Bh of a device that does not have them."""
POSITION_UNIT = "measuring units"
PRESET, PRESET_MULTI_SENSOR, CYCLIC_TIMER = 0x6003, 0x6010, 0x6200
"""Objects that others than the catalogue ask for by index."""


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
    ProfileObject(0x6000, "Operating parameters", U16, RW, MANDATORY, MANDATORY),
    ProfileObject(0x6001, "Measuring units per revolution", U32, RW, NONE, MANDATORY, unit=POSITION_UNIT),
    ProfileObject(0x6002, "Total measuring range in measuring units", U32, RW, NONE, MANDATORY, unit=POSITION_UNIT),
    ProfileObject(0x6003, "Preset value", U32, RW, NONE, MANDATORY, types=_SINGLE, unit=POSITION_UNIT),
    ProfileObject(
        0x6004,
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
        0x6005,
        "Linear encoder measuring step settings",
        U32,
        RW,
        NONE,
        MANDATORY,
        types=LINEAR_TYPES,
        fields=("Position measuring step (0.001 mm)", "Speed measuring step (0.01 mm/s)"),
    ),
    ProfileObject(
        0x6010,
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
        0x6020,
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
        0x6030,
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
    ProfileObject(0x6200, "Cyclic timer", U16, RW, NONE, MANDATORY, unit="ms"),
    _channels(0x6300, "Cam state register", U8, RO, "cam_state", pdo=True),
    _channels(0x6301, "Cam enable register", U8, RW, "cam_enable", pdo=True),
    _channels(0x6302, "Cam polarity register", U8, RW, "cam_polarity", pdo=True),
    *(_channels(0x630F + n, f"Cam {n} low limit", I32, RW, unit=POSITION_UNIT) for n in range(1, CAMS + 1)),
    *(_channels(0x631F + n, f"Cam {n} high limit", I32, RW, unit=POSITION_UNIT) for n in range(1, CAMS + 1)),
    *(_channels(0x632F + n, f"Cam {n} hysteresis", U16, RW, unit=POSITION_UNIT) for n in range(1, CAMS + 1)),
    _channels(0x6400, "Area state register", U8, RO, "area_state", pdo=True),
    _channels(0x6401, "Work area low limit", I32, RW, unit=POSITION_UNIT),
    _channels(0x6402, "Work area high limit", I32, RW, unit=POSITION_UNIT),
    ProfileObject(0x6500, "Operating status", U16, RO, MANDATORY, MANDATORY, attribute="operating_status"),
    ProfileObject(
        0x6501, "Single-turn resolution, measuring step", U32, RO, MANDATORY, MANDATORY, unit="steps, linear: 0.001 mm"
    ),
    ProfileObject(0x6502, "Number of distinguishable revolutions", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(0x6503, "Alarms", U16, RO, MANDATORY, MANDATORY, attribute="alarms"),
    ProfileObject(0x6504, "Supported alarms", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(0x6505, "Warnings", U16, RO, MANDATORY, MANDATORY, attribute="warnings"),
    ProfileObject(0x6506, "Supported warnings", U16, RO, MANDATORY, MANDATORY),
    ProfileObject(0x6507, "Profile and software version", U32, RO, NONE, MANDATORY),
    ProfileObject(0x6508, "Operating time", U32, RO, NONE, MANDATORY, attribute="operating_time", unit="0.1 h"),
    ProfileObject(0x6509, "Offset value", I32, RO, NONE, MANDATORY, attribute="offset", unit=POSITION_UNIT),
    ProfileObject(
        0x650A,
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
    ProfileObject(0x650B, "Serial number", U32, RO, NONE, MANDATORY),
)


def _values(device: EncoderDevice, serial_number: int) -> dict[tuple[int, int], tuple[int, int | None, int | None]]:
    """Defaults and limits of the device by (index, sub-index; 0 for every sub-index); 0 and the type's range elsewhere."""
    steps, resolution = device.steps, device.resolution
    # The finest position step of a linear encoder is 0.001 mm.
    finest = steps * resolution if device.is_linear else steps
    return {
        (0x6001, 0): (steps if device.is_linear else resolution, 1, None if device.is_linear else resolution),
        (0x6002, 0): (steps, 1, finest),
        (0x6005, 1): (resolution, 1, None),
        (0x6005, 2): (100, 1, None),
        (0x6402, 0): (steps - 1, None, None),
        (0x6501, 0): (resolution, None, None),
        (0x6502, 0): (device.turns, None, None),
        (0x6504, 0): (sum(Alarm), None, None),
        (0x6506, 0): (sum(Warnings), None, None),
        (0x6507, 0): (SOFTWARE_VERSION << 16 | PROFILE_VERSION, None, None),
        (0x6508, 0): (UNUSED, None, None),
        (0x650A, 3): (steps - 1, None, None),
        (0x650B, 0): (serial_number, None, None),
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
