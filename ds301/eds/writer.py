"""Electronic data sheets written from object declarations.

Source: CiA 306 V1.3. Left out: dummy usage, object links and module descriptions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pdgw.ds301.communication import DEVICE_TYPE, EMCY_COB_ID, ERROR_REGISTER, IDENTITY
from pdgw.ds301.objects import MANUFACTURER_AREA, Entry, ObjectKind, ObjectSpec
from pdgw.ds301.pdo import PdoDirection, is_communication_parameter


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """The [DeviceInfo] section."""

    vendor_name: str
    product_name: str
    vendor_id: int
    product_code: int
    revision: int


_MANDATORY = (DEVICE_TYPE, ERROR_REGISTER, IDENTITY)
Texts = dict[str, dict[str, str]]
"""Keys and values by section."""


def _default(entry: Entry) -> str:
    if entry.default is None:
        return ""
    if isinstance(entry.default, int) and not isinstance(entry.default, bool):
        if (is_communication_parameter(entry.index) and entry.subindex == 1) or entry.index == EMCY_COB_ID:
            return f"$NODEID+0x{entry.default:X}"
        return str(entry.default) if entry.default < 0 else f"0x{entry.default:X}"
    return str(entry.default)


def _variable(entry: Entry) -> dict[str, str]:
    texts = {
        "ParameterName": entry.name,
        "ObjectType": "0x7",
        "DataType": f"0x{entry.type.code:04X}",
        "AccessType": entry.access.value,
        "DefaultValue": _default(entry),
        "PDOMapping": str(int(entry.pdo)),
    }
    limits = {"LowLimit": entry.low, "HighLimit": entry.high}
    return texts | {key: str(limit) for key, limit in limits.items() if limit is not None}


def object_texts(spec: ObjectSpec) -> Texts:
    """The sections of an object."""
    name = f"{spec.index:04X}"
    if spec.kind is ObjectKind.VAR:
        return {name: _variable(spec.entries[0])}
    head = {
        "ParameterName": spec.name,
        "ObjectType": f"0x{spec.kind.value:X}",
        "SubNumber": str(len(spec.entries)),
    }
    return {name: head} | {f"{name}sub{entry.subindex:X}": _variable(entry) for entry in spec.entries}


def object_lists(indices: Sequence[int]) -> Texts:
    """The three lists of objects."""
    lists = {
        "MandatoryObjects": [index for index in indices if index in _MANDATORY],
        "OptionalObjects": [index for index in indices if index not in _MANDATORY and index not in MANUFACTURER_AREA],
        "ManufacturerObjects": [index for index in indices if index in MANUFACTURER_AREA],
    }
    return {
        name: {"SupportedObjects": str(len(listed))}
        | {str(place): f"0x{index:04X}" for place, index in enumerate(listed, 1)}
        for name, listed in lists.items()
    }


def text_of(texts: Mapping[str, Mapping[str, str]]) -> str:
    """Sections as the text of a file."""
    lines: list[str] = []
    for name, entries in texts.items():
        lines += [f"[{name}]", *(f"{key}={value}" for key, value in entries.items()), ""]
    return "\n".join(lines)


def write_eds(info: DeviceInfo, objects: Sequence[ObjectSpec]) -> str:
    """The EDS text of a device."""
    ordered = sorted(objects, key=lambda spec: spec.index)
    indices = [spec.index for spec in ordered]
    pdos = [index for index in indices if is_communication_parameter(index)]
    rpdos = sum(index < PdoDirection.TPDO.communication_index for index in pdos)
    texts: Texts = {
        "FileInfo": {
            "FileVersion": "1",
            "FileRevision": "1",
            "EDSVersion": "4.0",
            "Description": info.product_name,
            "CreatedBy": "profidrive-gateway",
        },
        "DeviceInfo": {
            "VendorName": info.vendor_name,
            "VendorNumber": f"0x{info.vendor_id:X}",
            "ProductName": info.product_name,
            "ProductNumber": f"0x{info.product_code:X}",
            "RevisionNumber": f"0x{info.revision:X}",
            **{f"BaudRate_{rate}": "1" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)},
            "SimpleBootUpMaster": "0",
            "SimpleBootUpSlave": "1",
            "Granularity": "8",
            "DynamicChannelsSupported": "0",
            "GroupMessaging": "0",
            "NrOfRXPDO": str(rpdos),
            "NrOfTXPDO": str(len(pdos) - rpdos),
            "LSS_Supported": "0",
        },
    } | object_lists(indices)
    for spec in ordered:
        texts |= object_texts(spec)
    return text_of(texts)
