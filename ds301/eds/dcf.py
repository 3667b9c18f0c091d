"""The values of a DCF: what a device must have, and a DCF of what a device has.

Source: CiA 306 V1.3 (ParameterValue, [DeviceComissioning]). A value is a ParameterValue of an object that can be written, not a
DefaultValue. Not here: DOMAIN objects, which have files of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from pdgw.ds301.communication import VERIFY_CONFIGURATION
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.pdos import variable, variables
from pdgw.ds301.eds.text import EdsError, Problem
from pdgw.ds301.objects import CanType
from pdgw.ds301.values import DeviceValue, DeviceValues

_BLANK: Final = ("0x", "0X")
"""Numbers without a digit, which tools write for an object without a value."""


def read_dcf(path: Path, node_id: int, owned: Callable[[int], bool]) -> DeviceValues:
    """The values of a DCF without those of ``owned`` objects, which are counted. EdsError names each that is none of its type."""
    imported = import_eds(path, node_id)
    wrong = [
        Problem(item.line, item.section, item.key, item.found, "not a value of the data type of its object")
        for item in imported.repairs
        if item.key.lower() == "parametervalue" and not (item.used or item.found in _BLANK)
        if not owned(int(item.section[:4], 16))
    ]
    if wrong:
        raise EdsError(*wrong)
    dictionary = imported.dictionary
    given = [item for item in variables(dictionary) if item.value is not None and item.writable]
    items = tuple(
        DeviceValue(item.index, item.subindex, item.value, path.name, item.data_type)
        for item in given
        if not owned(item.index) and item.data_type != CanType.DOMAIN.code
    )
    days, milliseconds = (variable(dictionary, VERIFY_CONFIGURATION, subindex) for subindex in (1, 2))
    date = (0, 0)
    if days is not None and milliseconds is not None:
        date = days.value or 0, milliseconds.value or 0
    information = dictionary.device_information
    identity = information.vendor_number or 0, information.product_number or 0
    return DeviceValues(items, path.name, len(given) - len(items), date, identity)
