"""The device description for engineering tools, written from the declarations: GSDML V2.4.

Source: GSDML specification V2.4. Modules, submodules, telegrams with their signals and bits, and the texts of diagnosis come from
the same tables as the codec. Left out: graphics, start-up parameters (the parameter channel has all of them).
"""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping, Sequence
from datetime import date
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, Direction, Telegram, TelegramHalf
from pdgw.profinet import model
from pdgw.profinet.blocks.alarm import MESSAGE_CLASS_TEXTS, MessageClass
from pdgw.profinet.station import MAU_100BASE_TX_FULL, MAU_1000BASE_T_FULL, Identity

_NAMESPACE = "http://www.profibus.com/GSDML/2003/11/DeviceProfile"
_SCHEMA = "http://www.w3.org/2001/XMLSchema-instance"
VERSION = "V2.4"
_RATIOS = "1 2 4 8 16 32 64 128 256 512"
_DATA_MAX = 1440
_HEADER = (
    ("ProfileIdentification", "PROFINET Device Profile"),
    ("ProfileRevision", "1.00"),
    ("ProfileName", "Device Profile for PROFINET Devices"),
    ("ProfileSource", "PROFIBUS Nutzerorganisation e. V. (PNO)"),
    ("ProfileClassID", "Device"),
)
_REFERENCE = (("ISO15745Part", "4"), ("ISO15745Edition", "1"), ("ProfileTechnology", "GSDML"))
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


class _Texts:
    """The texts of the file; the same text has one identification."""

    def __init__(self) -> None:
        self._ids: dict[str, str] = {}

    def id(self, text: str) -> str:
        return self._ids.setdefault(text, f"T{len(self._ids) + 1}")

    def write(self, parent: Element) -> None:
        primary = SubElement(SubElement(parent, "ExternalTextList"), "PrimaryLanguage")
        for text, identification in self._ids.items():
            SubElement(primary, "Text", TextId=identification, Value=text)


def _hex(value: int, digits: int = 8) -> str:
    return f"0x{value:0{digits}X}"


def _data_type(signal: Signal) -> str:
    """The type that every engineering tool shows as a number: words unsigned, fractions and positions signed."""
    signed = signal.type.char.islower()
    return f"{'Integer' if signed else 'Unsigned'}{8 * signal.type.size}"


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
        self._snmp = snmp
        self._min_device_interval = min_device_interval
        self._identity = identity
        self._vendor = vendor
        self._telegrams = telegrams
        self._texts = _Texts()

    def write(self) -> str:
        """The whole file."""
        root = Element(
            "ISO15745Profile",
            {
                "xmlns": _NAMESPACE,
                "xmlns:xsi": _SCHEMA,
                "xsi:schemaLocation": f"{_NAMESPACE} ..\\xsd\\GSDML-DeviceProfile-{VERSION}.xsd",
            },
        )
        header = SubElement(root, "ProfileHeader")
        for name, text in _HEADER:
            SubElement(header, name).text = text
        reference = SubElement(header, "ISO15745Reference")
        for name, text in _REFERENCE:
            SubElement(reference, name).text = text
        self._body(SubElement(root, "ProfileBody"))
        ElementTree.indent(root, "  ")
        return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"

    def _body(self, body: Element) -> None:
        identity = self._identity
        ids = {"VendorID": _hex(identity.vendor_id, 4), "DeviceID": _hex(identity.device_id, 4)}
        device = SubElement(body, "DeviceIdentity", ids)
        SubElement(device, "InfoText", TextId=self._texts.id("PROFIdrive to CANopen gateway"))
        SubElement(device, "VendorName", Value=self._vendor)
        function = SubElement(body, "DeviceFunction")
        SubElement(function, "Family", MainFamily="Drives", ProductFamily=identity.product)
        process = SubElement(body, "ApplicationProcess")
        self._access_point(SubElement(process, "DeviceAccessPointList"))
        modules = SubElement(process, "ModuleList")
        submodules = SubElement(process, "SubmoduleList")
        for kind, telegrams in self._telegrams.items():
            self._module(modules, kind, telegrams)
            for telegram in telegrams:
                self._submodule(submodules, telegram)
        diagnosis = SubElement(process, "ChannelDiagList")
        for number in MessageClass:
            item = SubElement(
                diagnosis, "ProfileChannelDiagItem", API=str(model.API_PROFIDRIVE), ErrorType=str(int(number))
            )
            SubElement(item, "Name", TextId=self._texts.id(MESSAGE_CLASS_TEXTS[number]))
        self._texts.write(process)

    def _info(self, parent: Element, name: str, text: str) -> Element:
        info = SubElement(parent, "ModuleInfo")
        SubElement(info, "Name", TextId=self._texts.id(name))
        SubElement(info, "InfoText", TextId=self._texts.id(text))
        return info

    # -- slot 0 -------------------------------------------------------------------------------------------------------

    def _access_point(self, parent: Element) -> None:
        identity = self._identity
        prefix, *release = identity.software
        item = SubElement(
            parent,
            "DeviceAccessPointItem",
            ID="DAP",
            PNIO_Version=VERSION,
            PhysicalSlots=f"{model.DAP_SLOT}..{model.OBJECTS_MAX}",
            ModuleIdentNumber=_hex(model.DAP_MODULE_IDENT),
            MinDeviceInterval=str(self._min_device_interval),
            DNS_CompatibleName=identity.product,
            FixedInSlots=str(model.DAP_SLOT),
            ObjectUUID_LocalIndex=str(identity.instance),
            DeviceAccessSupported="true",
            MultipleWriteSupported="true",
            CheckDeviceID_Allowed="true",
            NameOfStationNotTransferable="false",
            LLDP_NoD_Supported="true",
            ResetToFactoryModes="2",
        )
        info = self._info(item, identity.product, "PROFIdrive to CANopen gateway: one slot for each drive object")
        SubElement(info, "VendorName", Value=self._vendor)
        SubElement(info, "OrderNumber", Value=identity.order_id)
        SubElement(info, "HardwareRelease", Value=str(identity.hardware_revision))
        SubElement(info, "SoftwareRelease", Value=prefix + ".".join(str(number) for number in release))
        conformance = "B" if self._snmp is Snmp.WRITE else "A"
        SubElement(item, "CertificationInfo", ConformanceClass=conformance, ApplicationClass="", NetloadClass="I")
        SubElement(item, "IOConfigData", MaxInputLength=str(_DATA_MAX), MaxOutputLength=str(_DATA_MAX))
        useable = SubElement(item, "UseableModules")
        for kind in self._telegrams:
            SubElement(
                useable, "ModuleItemRef", ModuleItemTarget=_module_id(kind), AllowedInSlots=f"1..{model.OBJECTS_MAX}"
            )
        virtual = SubElement(item, "VirtualSubmoduleList")
        point = SubElement(
            virtual,
            "VirtualSubmoduleItem",
            ID="DAP_1",
            SubmoduleIdentNumber=_hex(model.DAP_IDENT),
            Writeable_IM_Records="1 2 3 4",
            MayIssueProcessAlarm="false",
        )
        SubElement(point, "IOData")
        self._info(point, identity.product, "The device itself")
        self._interface(SubElement(item, "SystemDefinedSubmoduleList"))

    def _interface(self, parent: Element) -> None:
        interface = SubElement(
            parent,
            "InterfaceSubmoduleItem",
            ID="INTERFACE",
            SubmoduleIdentNumber=_hex(model.INTERFACE_IDENT),
            SubslotNumber=str(model.INTERFACE_SUBSLOT),
            TextId=self._texts.id("Interface"),
            SupportedRT_Classes="RT_CLASS_1",
            SupportedProtocols="LLDP" if self._snmp is Snmp.NONE else "SNMP;LLDP",
            NetworkComponentDiagnosisSupported="false",
            # Engineering tools require both from PNIO_Version V2.31 on, although a device with one port forwards nothing.
            PTP_BoundarySupported="true",
            DCP_BoundarySupported="true",
        )
        relations = SubElement(interface, "ApplicationRelations", StartupMode="Legacy;Advanced")
        clocks = " ".join(str(clock) for clock in model.SEND_CLOCKS if clock >= self._min_device_interval)
        SubElement(relations, "TimingProperties", SendClock=clocks, ReductionRatio=_RATIOS)
        port = SubElement(
            parent,
            "PortSubmoduleItem",
            ID="PORT_1",
            SubmoduleIdentNumber=_hex(model.PORT_IDENT),
            SubslotNumber=str(model.PORT_SUBSLOT),
            TextId=self._texts.id("Port 1"),
            MaxPortRxDelay="350",
            MaxPortTxDelay="160",
        )
        mau_types = SubElement(port, "MAUTypeList")
        for mau_type in (MAU_100BASE_TX_FULL, MAU_1000BASE_T_FULL):
            SubElement(mau_types, "MAUTypeItem", Value=str(mau_type))

    # -- drive objects ------------------------------------------------------------------------------------------------

    def _module(self, parent: Element, kind: model.ObjectKind, telegrams: Sequence[Telegram]) -> None:
        name, text = _KIND_TEXTS[kind]
        item = SubElement(
            parent,
            "ModuleItem",
            ID=_module_id(kind),
            ModuleIdentNumber=_hex(kind.ident),
            PhysicalSubslots=f"{model.ACCESS_POINT_SUBSLOT}..{model.TELEGRAM_SUBSLOT}",
        )
        self._info(item, name, text)
        virtual = SubElement(item, "VirtualSubmoduleList")
        point = SubElement(
            virtual,
            "VirtualSubmoduleItem",
            ID=f"ACCESS_POINT_{kind.name}",
            SubmoduleIdentNumber=_hex(model.ACCESS_POINT_IDENT),
            API=str(model.API_PROFIDRIVE),
            FixedInSubslots=str(model.ACCESS_POINT_SUBSLOT),
            MayIssueProcessAlarm="false",
        )
        SubElement(point, "IOData")
        self._info(point, "Module access point", "Parameter access (record B02Eh) and diagnosis of the drive object")
        useable = SubElement(item, "UseableSubmodules")
        for telegram in telegrams:
            SubElement(
                useable,
                "SubmoduleItemRef",
                SubmoduleItemTarget=_submodule_id(telegram),
                AllowedInSubslots=str(model.TELEGRAM_SUBSLOT),
            )

    def _submodule(self, parent: Element, telegram: Telegram) -> None:
        item = SubElement(
            parent,
            "SubmoduleItem",
            ID=_submodule_id(telegram),
            SubmoduleIdentNumber=_hex(model.telegram_ident(telegram)),
            API=str(model.API_PROFIDRIVE),
            MayIssueProcessAlarm="false",
        )
        data = SubElement(item, "IOData")
        for name, direction in (("Input", Direction.ACTUAL), ("Output", Direction.SETPOINT)):
            self._direction(SubElement(data, name, Consistency="All items consistency"), telegram.half(direction))
        words = f"{telegram.setpoints.words}/{telegram.actuals.words} words, {_MODE_TEXTS[telegram.mode]}"
        self._info(item, f"Telegram {telegram.number}", f"PROFIdrive telegram {telegram.number}: {words}")

    def _direction(self, parent: Element, half: TelegramHalf) -> None:
        positioning = half.mode is ApplicationMode.POSITIONING
        for signal in half.signals:
            item = SubElement(parent, "DataItem", DataType=_data_type(signal), TextId=self._texts.id(signal.name))
            bits = list(signal.fields(positioning=positioning))
            if not bits or signal.type is DataType.N2:
                continue
            item.set("UseAsBits", "true")
            for bit in bits:
                for number in range(bit.width):
                    text = f"{bit.name}.{number}" if bit.width > 1 else bit.name
                    offset = str(bit.position + number)
                    SubElement(item, "BitDataItem", BitOffset=offset, TextId=self._texts.id(text))


def _module_id(kind: model.ObjectKind) -> str:
    return f"MODULE_{kind.name}"


def _submodule_id(telegram: Telegram) -> str:
    return f"TELEGRAM_{telegram.number}"
