"""Drives as values, for tests that need no bus."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import canopen

from pdgw.ds301.communication import IDENTITY_PRODUCT, IDENTITY_VENDOR
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.writer import write_eds
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.identification.describe import OPTIONAL_OBJECTS, answers_of_defaults, describe, questions
from pdgw.dsp402.objects import SUPPORTED_DRIVE_MODES
from pdgw.peers.drive import shape
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.peers.drive.objects import PRODUCT_CODE as ENGEL_PRODUCT
from pdgw.peers.drive.objects import VENDOR_ID as ENGEL_VENDOR


@dataclass(frozen=True, slots=True)
class References:
    """Values of the reference objects of the ENGEL-like drive; 0: the drive lacks the object."""

    max_motor_speed: int = 3000
    velocity_numerator: int = 1
    velocity_denominator: int = 2
    max_profile_velocity: int = 6000
    position_min: int = -500000
    position_max: int = 500000
    max_acceleration: int = 1000
    max_deceleration: int = 1000
    max_torque: int = 3000


REFERENCE_OBJECTS: tuple[tuple[str, int, int], ...] = (
    ("max_motor_speed", 0x6080, 0),
    ("velocity_numerator", 0x6094, 1),
    ("velocity_denominator", 0x6094, 2),
    ("max_profile_velocity", 0x607F, 0),
    ("position_min", 0x607B, 1),
    ("position_max", 0x607B, 2),
    ("max_acceleration", 0x60C5, 0),
    ("max_deceleration", 0x60C6, 0),
    ("max_torque", 0x6072, 0),
)
"""Where each field of ``References`` is."""


@cache
def described(name: str) -> DriveType:
    """A variant of the simulated drive, described by its data sheet and defaults."""
    chosen = shape(name)
    dictionary = import_eds(write_eds(chosen.info, chosen.objects()).encode(), 1).dictionary
    return describe(dictionary, answers_of_defaults(dictionary))


@cache
def engel_dictionary() -> canopen.ObjectDictionary:
    return import_eds(EDS_PATH, 1).dictionary


@cache
def engel(values: References = References()) -> DriveType:
    """The ENGEL-like drive with its defaults, or with other values of its reference objects."""
    dictionary = engel_dictionary()
    answers = {
        IDENTITY_VENDOR: ENGEL_VENDOR,
        IDENTITY_PRODUCT: ENGEL_PRODUCT,
        (SUPPORTED_DRIVE_MODES, 0): dictionary[SUPPORTED_DRIVE_MODES].default,
    }
    answers |= dict.fromkeys(OPTIONAL_OBJECTS & {*questions(dictionary)}, 0)
    answers |= {(index, subindex): getattr(values, name) for name, index, subindex in REFERENCE_OBJECTS}
    return describe(dictionary, answers)
