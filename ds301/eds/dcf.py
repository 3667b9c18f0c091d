"""The values of a DCF: what a device must have, and a DCF of what a device has.

Source: CiA 306 V1.3 (ParameterValue, [DeviceComissioning]). A value is a ParameterValue of an object that can be written, not a
DefaultValue. Not here: DOMAIN objects, which have files of their own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import Final

import canopen
from canopen.objectdictionary import ODVariable

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import VERIFY_CONFIGURATION
from pdgw.ds301.eds.importer import import_eds
from pdgw.ds301.eds.pdos import variable, variables
from pdgw.ds301.eds.text import EdsError, Problem
from pdgw.ds301.eds.writer import Texts, object_lists, object_texts, text_of
from pdgw.ds301.objects import CanType, Entry, ObjectAddress, ObjectKind, array
from pdgw.ds301.values import INTEGERS, TEXTS, DeviceValue, DeviceValues

_FIRST_DAY: Final = date(1984, 1, 1)
_VERIFY: Final = array(
    VERIFY_CONFIGURATION,
    "Verify configuration",
    Entry(VERIFY_CONFIGURATION, 1, "Configuration date", CanType.U32),
    Entry(VERIFY_CONFIGURATION, 2, "Configuration time", CanType.U32),
)
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
    dictionary = imported.dictionary
    given = [item for item in variables(dictionary) if item.value is not None and item.writable]
    items = tuple(
        DeviceValue(item.index, item.subindex, item.value, path.name, item.data_type)
        for item in given
        if not owned(item.index) and item.data_type != CanType.DOMAIN.code
    )
    for item in items:
        try:
            item.encoded()
        except CanopenError as error:  # with this node-ID, or letters that the device cannot have
            wrong.append(Problem(0, item.name, "ParameterValue", item.text(), f"expected {error.allowed}"))
    if wrong:
        raise EdsError(*wrong)
    days, milliseconds = (variable(dictionary, VERIFY_CONFIGURATION, subindex) for subindex in (1, 2))
    date = (0, 0)
    if days is not None and milliseconds is not None:
        date = days.value or 0, milliseconds.value or 0
    information = dictionary.device_information
    identity = information.vendor_number or 0, information.product_number or 0
    return DeviceValues(items, path.name, len(given) - len(items), date, identity)


@dataclass(frozen=True, slots=True)
class Commissioning:
    """The device that a DCF was saved from. ``bitrate`` in bit/s."""

    node_id: int
    bitrate: int
    name: str
    identity: tuple[int, int, int, int]
    """1018h."""
    saved: datetime


def stamp_of(time: datetime) -> tuple[int, int]:
    """1020h of a time: days since 1984-01-01, milliseconds since midnight."""
    midnight = time.replace(hour=0, minute=0, second=0, microsecond=0)
    return (time.date() - _FIRST_DAY).days, (time - midnight) // timedelta(milliseconds=1)


def write_dcf(
    dictionary: canopen.ObjectDictionary,
    values: Mapping[ObjectAddress, bytes],
    device: Commissioning,
    comments: Sequence[str] = (),
    *,
    verifies: bool = False,
) -> str:
    """A DCF with the objects of a data sheet, and these values in the bytes of the device.

    ``verifies``: the device has 1020h, which gets the date. ValueError for a text that a DCF cannot have.
    """
    vendor, product, revision, serial = device.identity
    information = dictionary.device_information
    day, time = device.saved.strftime("%m-%d-%Y"), device.saved.strftime("%I:%M%p")
    texts: Texts = {
        "FileInfo": {
            "FileVersion": "1",
            "FileRevision": "1",
            "EDSVersion": "4.0",
            "Description": f"saved from node {device.node_id}",
            "CreationDate": day,
            "CreationTime": time,
            "CreatedBy": "profidrive-gateway",
        },
        "DeviceInfo": {
            "VendorName": information.vendor_name or "",
            "VendorNumber": f"0x{vendor:X}",
            "ProductName": information.product_name or device.name,
            "ProductNumber": f"0x{product:X}",
            "RevisionNumber": f"0x{revision:X}",
            "LSS_Supported": str(int(information.LSS_supported or 0)),
        },
        "DeviceComissioning": {
            "NodeID": str(device.node_id),
            "NodeName": device.name,
            "Baudrate": str(device.bitrate // 1000),
            "LSS_SerialNumber": f"0x{serial:X}",
        },
        "Comments": {"Lines": str(len(comments))} | {f"Line{n}": line for n, line in enumerate(comments, 1)},
    }
    texts |= object_lists(sorted({*dictionary, *((VERIFY_CONFIGURATION,) if verifies else ())}))
    for index in sorted(dictionary):
        item, name = dictionary[index], f"{index:04X}"
        if isinstance(item, ODVariable):
            texts[name] = _entry(item, values)
            continue
        kind = ObjectKind.ARRAY if isinstance(item, canopen.objectdictionary.ODArray) else ObjectKind.RECORD
        head = {"ParameterName": item.name, "ObjectType": f"0x{kind.value:X}", "SubNumber": str(len(item))}
        texts[name] = head
        for subindex in sorted(item.subindices):
            texts[f"{name}sub{subindex:X}"] = _entry(item.subindices[subindex], values)
    if verifies:
        texts |= object_texts(_VERIFY)
        for subindex, number in enumerate(stamp_of(device.saved), 1):
            texts[f"{VERIFY_CONFIGURATION:04X}sub{subindex}"]["ParameterValue"] = str(number)
    return text_of(texts)


def _entry(item: ODVariable, values: Mapping[ObjectAddress, bytes]) -> dict[str, str]:
    address = item.index, item.subindex
    texts = {
        "ParameterName": item.name,
        "ObjectType": f"0x{ObjectKind.VAR.value:X}",
        "DataType": f"0x{item.data_type:04X}",
        "AccessType": item.access_type,
        "PDOMapping": str(int(item.pdo_mappable)),
    }
    if item.default is not None:
        texts["DefaultValue"] = item.default_raw if item.relative else _text(item.default)
    texts |= {key: str(limit) for key, limit in (("LowLimit", item.min), ("HighLimit", item.max)) if limit is not None}
    if address in values:
        texts["ParameterValue"] = value_of(item.data_type, values[address])
    return texts


def _text(value: object) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)


def value_of(data_type: int, data: bytes) -> str:
    """The text of an object's data in a DCF. ValueError for a text that a line of the file cannot have."""
    known = DeviceValue(0, 0, 0 if data_type in INTEGERS else b"", "", data_type)
    if data_type not in TEXTS:
        return known.text(data)
    text = data.decode(TEXTS[data_type]).rstrip("\0")
    if text != text.strip() or not text.isprintable() or re.search(r"\s[;#]", f" {text}"):
        raise ValueError(f"{text!r} cannot be in a line of a DCF")
    return text
