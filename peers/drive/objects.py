"""The ENGEL-like drive as a CANopen device: all objects with values and limits, identity, and its EDS.

Modes, homing methods and fault numbers are those of the family's overlay. Source: the manufacturer's guide chapters 5-7.
``python -m pdgw.peers.drive.objects`` rewrites ``dsp402/eds/engel.eds``; a test fails when the file is out of date."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple

from pdgw.ds301.communication import communication_objects, pdo_objects
from pdgw.ds301.eds.writer import DeviceInfo, write_eds
from pdgw.ds301.objects import Catalogue, Entry, ObjectSpec
from pdgw.ds301.pdo import PdoDirection
from pdgw.dsp402.identification.overlay import overlay, with_units
from pdgw.dsp402.modes import STANDARD_HOMING_METHODS
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo.layouts import pdo
from pdgw.peers.drive.option_codes import limits

FAMILY = overlay("engel")
FAMILY_MODES = FAMILY.modes
"""The manufacturer's values of 6060h."""
_NUMBERS = {text: number for number, text in FAMILY_MODES.items()}
_turntable = FAMILY.drive_quirks.turntable
assert _turntable is not None
TURNTABLE: Final = _turntable
"""Its mode, and the bits of the Controlword that set the direction."""
CURRENT_CONTROL = _NUMBERS["current control with dynamic speed limitation"]
SPEED_CONTROL = _NUMBERS["speed control with dynamic current limitation"]
DRIVE_FAULTS = FAMILY.drive_faults
"""Faults by the number in 200Ch."""
HOMING_METHODS = {method: (STANDARD_HOMING_METHODS | FAMILY.homing_texts)[method] for method in FAMILY.homing_methods}
"""Values of 6098h with the switch or mark that they search."""


_sheet, _vendor = FAMILY.eds_path, FAMILY.match.vendor_id
assert _sheet is not None
assert _vendor is not None
EDS_PATH: Final = _sheet

DRIVE_TYPE = 0x0002_0192
"""Profile 402, servo drive."""
VENDOR_ID: Final = _vendor
PRODUCT_CODE = 0x0000_0001
REVISION = 0x0003_004A
DEFAULT_PDOS = (
    pdo(PdoDirection.RPDO, 1, "controlword", "target_velocity"),
    pdo(PdoDirection.TPDO, 1, "statusword", "velocity_actual"),
)
"""The mappings after power-on."""
INFO = DeviceInfo("ENGEL Elektroantriebe GmbH", "Servo drive, DSP402", VENDOR_ID, PRODUCT_CODE, REVISION)
VELOCITY_MAX = 32767
"""Largest velocity of the default encoder factor 1/2: (2^31-1) / (numerator * 2^(17 - log2 denominator))."""


class Value(NamedTuple):
    """Value of an object after power-on, and its limits if they are narrower than its type."""

    default: int
    low: int | None = None
    high: int | None = None


VALUES: Final = {
    (0x2003, 0): Value(0, high=0x7FFF),
    (0x2004, 0): Value(0, high=0x7FFF),
    (0x200C, 0): Value(0),
    (0x6007, 0): Value(0, *limits(0x6007)),
    (0x603F, 0): Value(0),
    (0x6040, 0): Value(0),
    (0x6041, 0): Value(0),
    (0x605A, 0): Value(2, low=0, high=2),
    (0x605B, 0): Value(0, *limits(0x605B)),
    (0x605C, 0): Value(0, *limits(0x605C)),
    (0x605D, 0): Value(1, low=1, high=1),
    (0x605E, 0): Value(2, low=0, high=2),
    (0x6060, 0): Value(1),
    (0x6061, 0): Value(1),
    (0x6064, 0): Value(0),
    (0x6065, 0): Value(0x4000),
    (0x6067, 0): Value(16),
    (0x606B, 0): Value(0),
    (0x606C, 0): Value(0),
    (0x606D, 0): Value(20),
    (0x606F, 0): Value(10),
    (0x6071, 0): Value(0),
    (0x6072, 0): Value(3000),
    (0x6073, 0): Value(2000),
    (0x6075, 0): Value(5000),
    (0x6078, 0): Value(0),
    (0x6079, 0): Value(48000),
    (0x607A, 0): Value(0),
    (0x607B, 1): Value(-500000),
    (0x607B, 2): Value(500000),
    (0x607C, 0): Value(0),
    (0x607F, 0): Value(6000, high=VELOCITY_MAX),
    (0x6080, 0): Value(3000),
    (0x6081, 0): Value(2000, high=VELOCITY_MAX),
    (0x6083, 0): Value(300, low=1, high=0x7FFF),
    (0x6084, 0): Value(300, low=1, high=0x7FFF),
    (0x6085, 0): Value(1000, low=1, high=0x7FFF),
    (0x6086, 0): Value(0, low=0, high=1),
    (0x6094, 1): Value(1, low=1),
    (0x6094, 2): Value(2, low=1),
    (0x6098, 0): Value(35),
    (0x6099, 1): Value(400, high=VELOCITY_MAX),
    (0x6099, 2): Value(100, high=VELOCITY_MAX),
    (0x609A, 0): Value(300, low=1, high=0x7FFF),
    (0x60B1, 0): Value(0),
    (0x60C2, 1): Value(4, low=1),
    (0x60C2, 2): Value(-3, low=-6, high=0),
    (0x60C5, 0): Value(1000, low=1),
    (0x60C6, 0): Value(1000, low=1),
    (0x60E4, 1): Value(0),
    (0x60FD, 0): Value(1 << 16),
    (0x60FE, 1): Value(0),
    (0x60FE, 2): Value(0),
    (0x60FF, 0): Value(0, low=-VELOCITY_MAX, high=VELOCITY_MAX),
    (0x6502, 0): Value(0x0007_002D),
    (0x6C01, 1): Value(0),
    (0x6C01, 2): Value(0),
    (0x7004, 0): Value(0),
}
"""By index and sub-index."""


def _with_value(entry: Entry) -> Entry:
    value = VALUES.get(entry.address)
    return entry if value is None else replace(entry, default=value.default, low=value.low, high=value.high)


_NAMES: Final = {0x6C01: "Read Analogue Input 16-Bit"}
"""Names of the manufacturer's arrays."""
_MANUFACTURER_OBJECTS = tuple(replace(spec, name=_NAMES.get(spec.index, spec.name)) for spec in FAMILY.specs)


def _with_units(spec: ObjectSpec) -> ObjectSpec:
    return replace(spec, entries=with_units(map(_with_value, spec.entries), (FAMILY,)))


OBJECTS: Final = Catalogue(
    tuple(map(_with_units, sorted((*DRIVE_OBJECTS.objects, *_MANUFACTURER_OBJECTS), key=lambda spec: spec.index)))
)
"""The profile and manufacturer areas of the drive."""


@lru_cache(maxsize=8)
def drive_objects(serial_number: int = 1, pdos: int = 5) -> tuple[ObjectSpec, ...]:
    """Every object of the drive. ``pdos``: number of RPDOs and of TPDOs."""
    return (
        *communication_objects(
            DRIVE_TYPE, "ENGEL HBI", (VENDOR_ID, PRODUCT_CODE, REVISION, serial_number), ("1.0", "3.74")
        ),
        *pdo_objects(pdos, pdos, DEFAULT_PDOS),
        *OBJECTS.objects,
    )


if __name__ == "__main__":
    EDS_PATH.write_text(write_eds(INFO, drive_objects()), encoding="ascii")
