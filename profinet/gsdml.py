"""The device description for engineering tools, written from the declarations: GSDML V2.4.

Source: GSDML specification V2.4. Modules, submodules, telegrams with their signals and bits, and the texts of diagnosis come from
the same tables as the codec. Left out: graphics, start-up parameters (the parameter channel has all of them).
"""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping, Sequence
from datetime import date
from string import Template
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement
from xml.sax.saxutils import escape

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, Telegram
from pdgw.profinet import model
from pdgw.profinet.blocks.alarm import MESSAGE_CLASS_TEXTS, MessageClass
from pdgw.profinet.station import MAU_100BASE_TX_FULL, MAU_1000BASE_T_FULL, Identity

_NAMESPACE = "http://www.profibus.com/GSDML/2003/11/DeviceProfile"
_SCHEMA = "http://www.w3.org/2001/XMLSchema-instance"
VERSION = "V2.4"
_KIND_TEXTS = {
    model.ObjectKind.AXIS: ("Axis", "A drive with its telegram; parameters by the access point in subslot 1"),
    model.ObjectKind.ENCODER: ("Encoder", "An encoder with its telegram; parameters by the access point in subslot 1"),
}
_MODE_TEXTS = {
    ApplicationMode.VELOCITY: "speed control",
    ApplicationMode.POSITIONING: "positioning",
    ApplicationMode.ENCODER: "encoder",
    ApplicationMode.TRANSPARENT: "transparent",
}


def file_name(vendor: str, product: str, day: date) -> str:
    """As engineering tools insist on it."""
    vendor, product = (re.sub(r"[^A-Za-z0-9-]+", "-", text) for text in (vendor, product))
    return f"GSDML-{VERSION}-{vendor}-{product}-{day:%Y%m%d}.xml"


class Snmp(enum.Enum):
    """Features of the device's SNMP agent."""

    NONE = enum.auto()
    READ = enum.auto()
    WRITE = enum.auto()
    """Also the texts of the system group are written."""


class GsdmlWriter:
    """Write the file of a device with these kinds of drive object and their telegrams.

    ``snmp``: writable SNMP is what conformance class B adds. ``min_device_interval``: shortest cycle in 31.25 us.
    """

    def __init__(
        self,
        identity: Identity,
        vendor: str,
        telegrams: Mapping[model.ObjectKind, Sequence[Telegram]],
        *,
        snmp: Snmp = Snmp.NONE,
        min_device_interval: int = model.SEND_CLOCKS[-1],
    ) -> None:
        prefix, *release = identity.software
        self._values: dict[str, str | int] = {
            "vendor": vendor,
            "vendor_id": f"0x{identity.vendor_id:04X}",
            "device_id": f"0x{identity.device_id:04X}",
            "product": identity.product,
            "order": identity.order_id,
            "hardware": identity.hardware_revision,
            "software": prefix + ".".join(str(number) for number in release),
            "instance": identity.instance,
            "interval": min_device_interval,
            "clocks": " ".join(str(clock) for clock in model.SEND_CLOCKS if clock >= min_device_interval),
            "conformance": "B" if snmp is Snmp.WRITE else "A",
            "protocols": "LLDP" if snmp is Snmp.NONE else "SNMP;LLDP",
        }
        self._telegrams = telegrams

    def write(self) -> str:
        """The whole file."""
        root = _element(_DEVICE, **self._values)
        useable, modules, submodules, diagnosis, language = (
            next(root.iter(name))
            for name in ("UseableModules", "ModuleList", "SubmoduleList", "ChannelDiagList", "PrimaryLanguage")
        )
        for kind, telegrams in self._telegrams.items():
            useable.append(_element(_MODULE_REFERENCE, kind=kind.name))
            modules.append(_module(kind, telegrams))
            submodules.extend([_submodule(telegram) for telegram in telegrams])
        for number in MessageClass:
            diagnosis.append(_element(_MESSAGE_CLASS, number=int(number), text=MESSAGE_CLASS_TEXTS[number]))
        texts: dict[str, str] = {}
        for item in root.iter():
            if text := item.get("TextId"):
                item.set("TextId", texts.setdefault(text, f"T{len(texts) + 1}"))
        for text, identification in texts.items():
            SubElement(language, "Text", TextId=identification, Value=text)
        root.set("xmlns", _NAMESPACE)
        root.set("xmlns:xsi", _SCHEMA)
        root.set("xsi:schemaLocation", f"{_NAMESPACE} ..\\xsd\\GSDML-DeviceProfile-{VERSION}.xsd")
        ElementTree.indent(root, "  ")
        return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _module(kind: model.ObjectKind, telegrams: Sequence[Telegram]) -> Element:
    name, text = _KIND_TEXTS[kind]
    item = _element(_MODULE, kind=kind.name, ident=_ident(kind.ident), name=name, text=text)
    useable = next(item.iter("UseableSubmodules"))
    useable.extend([_element(_SUBMODULE_REFERENCE, number=telegram.number) for telegram in telegrams])
    return item


def _submodule(telegram: Telegram) -> Element:
    item = _element(
        _SUBMODULE,
        number=telegram.number,
        ident=_ident(model.telegram_ident(telegram)),
        outputs=telegram.setpoints.words,
        inputs=telegram.actuals.words,
        mode=_MODE_TEXTS[telegram.mode],
    )
    for name, half in (("Input", telegram.actuals), ("Output", telegram.setpoints)):
        data = next(item.iter(name))
        for signal in half.signals:
            data.append(_data_item(signal, positioning=half.mode is ApplicationMode.POSITIONING))
    return item


def _data_item(signal: Signal, *, positioning: bool) -> Element:
    """With the type that every engineering tool shows as a number: words unsigned, fractions and positions signed."""
    signed = signal.type.char.islower()
    data_type = f"{'Integer' if signed else 'Unsigned'}{8 * signal.type.size}"
    item = Element("DataItem", DataType=data_type, TextId=signal.name)
    if signal.type is DataType.N2:
        return item
    for bit in signal.fields(positioning=positioning):
        item.set("UseAsBits", "true")
        for number in range(bit.width):
            text = f"{bit.name}.{number}" if bit.width > 1 else bit.name
            SubElement(item, "BitDataItem", BitOffset=str(bit.position + number), TextId=text)
    return item


def _ident(number: int) -> str:
    return f"0x{number:08X}"


def _element(template: str, **values: str | int) -> Element:
    """An element of the file from its text; ``TextId`` has the text itself until the list of texts is written."""
    return ElementTree.fromstring(
        Template(template).substitute(
            _CONSTANTS, **{name: escape(str(value), {'"': "&quot;"}) for name, value in values.items()}
        )
    )


_CONSTANTS = {
    "version": VERSION,
    "api": model.API_PROFIDRIVE,
    "slots": model.OBJECTS_MAX,
    "access_point": model.ACCESS_POINT_SUBSLOT,
    "telegram": model.TELEGRAM_SUBSLOT,
    "access_point_ident": _ident(model.ACCESS_POINT_IDENT),
    "dap_slot": model.DAP_SLOT,
    "dap_module": _ident(model.DAP_MODULE_IDENT),
    "dap": _ident(model.DAP_IDENT),
    "interface": _ident(model.INTERFACE_IDENT),
    "interface_subslot": model.INTERFACE_SUBSLOT,
    "port": _ident(model.PORT_IDENT),
    "port_subslot": model.PORT_SUBSLOT,
    "fast_ethernet": MAU_100BASE_TX_FULL,
    "gigabit": MAU_1000BASE_T_FULL,
}
# Engineering tools require both boundaries from PNIO_Version V2.31 on, although a device with one port forwards nothing.
_DEVICE = """<ISO15745Profile>
<ProfileHeader>
<ProfileIdentification>PROFINET Device Profile</ProfileIdentification>
<ProfileRevision>1.00</ProfileRevision>
<ProfileName>Device Profile for PROFINET Devices</ProfileName>
<ProfileSource>PROFIBUS Nutzerorganisation e. V. (PNO)</ProfileSource>
<ProfileClassID>Device</ProfileClassID>
<ISO15745Reference>
<ISO15745Part>4</ISO15745Part>
<ISO15745Edition>1</ISO15745Edition>
<ProfileTechnology>GSDML</ProfileTechnology>
</ISO15745Reference>
</ProfileHeader>
<ProfileBody>
<DeviceIdentity VendorID="$vendor_id" DeviceID="$device_id">
<InfoText TextId="PROFIdrive to CANopen gateway"/>
<VendorName Value="$vendor"/>
</DeviceIdentity>
<DeviceFunction>
<Family MainFamily="Drives" ProductFamily="$product"/>
</DeviceFunction>
<ApplicationProcess>
<DeviceAccessPointList>
<DeviceAccessPointItem ID="DAP" PNIO_Version="$version" PhysicalSlots="$dap_slot..$slots"
  ModuleIdentNumber="$dap_module" MinDeviceInterval="$interval" DNS_CompatibleName="$product"
  FixedInSlots="$dap_slot" ObjectUUID_LocalIndex="$instance" DeviceAccessSupported="true"
  MultipleWriteSupported="true" CheckDeviceID_Allowed="true" NameOfStationNotTransferable="false"
  LLDP_NoD_Supported="true" ResetToFactoryModes="2">
<ModuleInfo>
<Name TextId="$product"/>
<InfoText TextId="PROFIdrive to CANopen gateway: one slot for each drive object"/>
<VendorName Value="$vendor"/>
<OrderNumber Value="$order"/>
<HardwareRelease Value="$hardware"/>
<SoftwareRelease Value="$software"/>
</ModuleInfo>
<CertificationInfo ConformanceClass="$conformance" ApplicationClass="" NetloadClass="I"/>
<IOConfigData MaxInputLength="1440" MaxOutputLength="1440"/>
<UseableModules/>
<VirtualSubmoduleList>
<VirtualSubmoduleItem ID="DAP_1" SubmoduleIdentNumber="$dap" Writeable_IM_Records="1 2 3 4"
  MayIssueProcessAlarm="false">
<IOData/>
<ModuleInfo><Name TextId="$product"/><InfoText TextId="The device itself"/></ModuleInfo>
</VirtualSubmoduleItem>
</VirtualSubmoduleList>
<SystemDefinedSubmoduleList>
<InterfaceSubmoduleItem ID="INTERFACE" SubmoduleIdentNumber="$interface" SubslotNumber="$interface_subslot"
  TextId="Interface" SupportedRT_Classes="RT_CLASS_1" SupportedProtocols="$protocols"
  NetworkComponentDiagnosisSupported="false" PTP_BoundarySupported="true" DCP_BoundarySupported="true">
<ApplicationRelations StartupMode="Legacy;Advanced">
<TimingProperties SendClock="$clocks" ReductionRatio="1 2 4 8 16 32 64 128 256 512"/>
</ApplicationRelations>
</InterfaceSubmoduleItem>
<PortSubmoduleItem ID="PORT_1" SubmoduleIdentNumber="$port" SubslotNumber="$port_subslot" TextId="Port 1"
  MaxPortRxDelay="350" MaxPortTxDelay="160">
<MAUTypeList><MAUTypeItem Value="$fast_ethernet"/><MAUTypeItem Value="$gigabit"/></MAUTypeList>
</PortSubmoduleItem>
</SystemDefinedSubmoduleList>
</DeviceAccessPointItem>
</DeviceAccessPointList>
<ModuleList/>
<SubmoduleList/>
<ChannelDiagList/>
<ExternalTextList><PrimaryLanguage/></ExternalTextList>
</ApplicationProcess>
</ProfileBody>
</ISO15745Profile>
"""
_MODULE_REFERENCE = '<ModuleItemRef ModuleItemTarget="MODULE_$kind" AllowedInSlots="1..$slots"/>'
_MODULE = """<ModuleItem ID="MODULE_$kind" ModuleIdentNumber="$ident" PhysicalSubslots="$access_point..$telegram">
<ModuleInfo><Name TextId="$name"/><InfoText TextId="$text"/></ModuleInfo>
<VirtualSubmoduleList>
<VirtualSubmoduleItem ID="ACCESS_POINT_$kind" SubmoduleIdentNumber="$access_point_ident" API="$api"
  FixedInSubslots="$access_point" Writeable_IM_Records="1 2 3 4" MayIssueProcessAlarm="false">
<IOData/>
<ModuleInfo>
<Name TextId="Module access point"/>
<InfoText TextId="Parameter access (record B02Eh) and diagnosis of the drive object"/>
</ModuleInfo>
</VirtualSubmoduleItem>
</VirtualSubmoduleList>
<UseableSubmodules/>
</ModuleItem>
"""
_SUBMODULE_REFERENCE = '<SubmoduleItemRef SubmoduleItemTarget="TELEGRAM_$number" AllowedInSubslots="$telegram"/>'
_SUBMODULE = """<SubmoduleItem ID="TELEGRAM_$number" SubmoduleIdentNumber="$ident" API="$api"
  MayIssueProcessAlarm="false">
<IOData>
<Input Consistency="All items consistency"/>
<Output Consistency="All items consistency"/>
</IOData>
<ModuleInfo>
<Name TextId="Telegram $number"/>
<InfoText TextId="PROFIdrive telegram $number: $outputs/$inputs words, $mode"/>
</ModuleInfo>
</SubmoduleItem>
"""
_MESSAGE_CLASS = (
    '<ProfileChannelDiagItem API="$api" ErrorType="$number"><Name TextId="$text"/></ProfileChannelDiagItem>'
)
