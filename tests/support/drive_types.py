"""Drives as values, for tests that need no bus."""

from __future__ import annotations

from functools import cache

import canopen
from pdgw.ds301.eds_import import import_eds
from pdgw.dsp402.describe import PRODUCT_CODE, SUPPORTED_DRIVE_MODES, VENDOR_ID, describe
from pdgw.dsp402.device import EDS_PATH
from pdgw.dsp402.device import PRODUCT_CODE as ENGEL_PRODUCT
from pdgw.dsp402.device import VENDOR_ID as ENGEL_VENDOR
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.images import REFERENCE_OBJECTS, References


@cache
def engel_dictionary() -> canopen.ObjectDictionary:
    return import_eds(EDS_PATH, 1).dictionary


def engel(references: References | None = None) -> DriveType:
    """The ENGEL-like drive with its defaults, or with other values of its reference objects."""
    values = references or References()
    dictionary = engel_dictionary()
    answers = {
        VENDOR_ID: ENGEL_VENDOR,
        PRODUCT_CODE: ENGEL_PRODUCT,
        SUPPORTED_DRIVE_MODES: dictionary[SUPPORTED_DRIVE_MODES[0]].default,
    }
    answers |= {(index, subindex): getattr(values, name) for name, index, subindex in REFERENCE_OBJECTS}
    return describe(dictionary, answers)
