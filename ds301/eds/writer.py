"""Electronic data sheets written from object declarations.

Source: CiA 306 V1.3. Left out: dummy usage, object links and module descriptions.
"""

from __future__ import annotations

from collections.abc import Sequence
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


MANDATORY = (DEVICE_TYPE, ERROR_REGISTER, IDENTITY)


def _default(entry: Entry) -> str:
    if entry.default is None:
        return ""
    if isinstance(entry.default, int) and not isinstance(entry.default, bool):
        if (is_communication_parameter(entry.index) and entry.subindex == 1) or entry.index == EMCY_COB_ID:
            return f"$NODEID+0x{entry.default:X}"
        return str(entry.default) if entry.default < 0 else f"0x{entry.default:X}"
    return str(entry.default)


def _variable(section: str, entry: Entry) -> list[str]:
    lines = [
        f"[{section}]",
        f"ParameterName={entry.name}",
        "ObjectType=0x7",
        f"DataType=0x{entry.type.code:04X}",
        f"AccessType={entry.access.value}",
        f"DefaultValue={_default(entry)}",
        f"PDOMapping={int(entry.pdo)}",
    ]
    if entry.low is not None:
        lines.append(f"LowLimit={entry.low}")
    if entry.high is not None:
        lines.append(f"HighLimit={entry.high}")
    return [*lines, ""]


def _object(spec: ObjectSpec) -> list[str]:
    if spec.kind is ObjectKind.VAR:
        return _variable(f"{spec.index:04X}", spec.entries[0])
    lines = [
        f"[{spec.index:04X}]",
        f"ParameterName={spec.name}",
        f"ObjectType=0x{spec.kind.value:X}",
        f"SubNumber={len(spec.entries)}",
        "",
    ]
    for entry in spec.entries:
        lines += _variable(f"{spec.index:04X}sub{entry.subindex:X}", entry)
    return lines


def _list(section: str, indices: Sequence[int]) -> list[str]:
    lines = [f"[{section}]", f"SupportedObjects={len(indices)}"]
    return [*lines, *(f"{number}=0x{index:04X}" for number, index in enumerate(indices, 1)), ""]


def write_eds(info: DeviceInfo, objects: Sequence[ObjectSpec]) -> str:
    """The EDS text of a device."""
    ordered = sorted(objects, key=lambda spec: spec.index)
    indices = [spec.index for spec in ordered]
    pdos = [index for index in indices if is_communication_parameter(index)]
    rpdos = sum(index < PdoDirection.TPDO.communication_index for index in pdos)
    lines = [
        "[FileInfo]",
        "FileVersion=1",
        "FileRevision=1",
        "EDSVersion=4.0",
        f"Description={info.product_name}",
        "CreatedBy=profidrive-gateway",
        "",
        "[DeviceInfo]",
        f"VendorName={info.vendor_name}",
        f"VendorNumber=0x{info.vendor_id:X}",
        f"ProductName={info.product_name}",
        f"ProductNumber=0x{info.product_code:X}",
        f"RevisionNumber=0x{info.revision:X}",
        *(f"BaudRate_{rate}=1" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
        "SimpleBootUpMaster=0",
        "SimpleBootUpSlave=1",
        "Granularity=8",
        "DynamicChannelsSupported=0",
        "GroupMessaging=0",
        f"NrOfRXPDO={rpdos}",
        f"NrOfTXPDO={len(pdos) - rpdos}",
        "LSS_Supported=0",
        "",
    ]
    lines += _list("MandatoryObjects", [i for i in indices if i in MANDATORY])
    lines += _list("OptionalObjects", [i for i in indices if i not in MANDATORY and i not in MANUFACTURER_AREA])
    lines += _list("ManufacturerObjects", [i for i in indices if i in MANUFACTURER_AREA])
    for spec in ordered:
        lines += _object(spec)
    return "\n".join(lines)
