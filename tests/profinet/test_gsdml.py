"""The GSDML file: every reference has its target, nothing is there twice, and it says what the device does."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections import Counter
from datetime import date
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.profinet.station import profinet_model
from pdgw.profidrive.telegrams import Direction, Telegram, telegram
from pdgw.profinet.blocks.alarm import MessageClass
from pdgw.profinet.gsdml import GsdmlWriter, Snmp, file_name
from pdgw.profinet.model import ObjectKind, access_module, object_module
from pdgw.profinet.station import check_name
from pdgw.tools.cli import app
from pdgw.tools.output.data_sheets import write_gsdml
from tests.support.wire.profinet import IDENTITY

NS = "{http://www.profibus.com/GSDML/2003/11/DeviceProfile}"
KINDS = {
    ObjectKind.AXIS: [telegram(number) for number in DRIVE_TELEGRAM_NUMBERS],
    ObjectKind.ENCODER: [telegram(number) for number in ENCODER_TELEGRAM_NUMBERS],
}
ROOT = ElementTree.fromstring(GsdmlWriter(IDENTITY, "pdgw", KINDS).write().encode())


def every(name: str) -> list[ElementTree.Element]:
    return list(ROOT.iter(NS + name))


def test_every_identification_is_there_once() -> None:
    ids = Counter(item.attrib["ID"] for item in ROOT.iter() if "ID" in item.attrib)
    assert [name for name, count in ids.items() if count > 1] == []
    texts = Counter(item.attrib["TextId"] for item in every("Text"))
    assert [name for name, count in texts.items() if count > 1] == []


def test_every_reference_has_its_target_and_every_text_is_used() -> None:
    texts = {item.attrib["TextId"] for item in every("Text")}
    used = {item.attrib["TextId"] for item in ROOT.iter() if "TextId" in item.attrib and item.tag != NS + "Text"}
    assert used == texts
    modules = {item.attrib["ID"] for item in every("ModuleItem")}
    assert {item.attrib["ModuleItemTarget"] for item in every("ModuleItemRef")} == modules
    submodules = {item.attrib["ID"] for item in every("SubmoduleItem")}
    assert {item.attrib["SubmoduleItemTarget"] for item in every("SubmoduleItemRef")} == submodules


def test_submodule_in_one_place_has_one_identification() -> None:
    submodules = {item.attrib["ID"]: number(item, "SubmoduleIdentNumber") for item in every("SubmoduleItem")}
    modules = every("ModuleItem")
    assert len({number(item, "ModuleIdentNumber") for item in [*modules, *every("DeviceAccessPointItem")]}) == 3
    for module in modules:
        plugged = [submodules[item.attrib["SubmoduleItemTarget"]] for item in module.iter(NS + "SubmoduleItemRef")]
        plugged += [number(item, "SubmoduleIdentNumber") for item in module.iter(NS + "VirtualSubmoduleItem")]
        assert len(plugged) == len(set(plugged)), module.attrib["ID"]


def places(text: str) -> set[int]:
    """Of a list of numbers and ranges."""
    found: set[int] = set()
    for part in text.split():
        first, _, last = part.partition("..")
        found |= set(range(int(first), int(last or first) + 1))
    return found


def test_pluggable_modules_fit_existing_slots() -> None:
    (point,) = every("DeviceAccessPointItem")
    slots = places(point.attrib["PhysicalSlots"])
    assert places(point.attrib["FixedInSlots"]) == {0}
    assert {0, 1, 254} <= slots
    for reference in every("ModuleItemRef"):
        assert places(reference.attrib["AllowedInSlots"]) == slots - {0}
    for module in every("ModuleItem"):
        subslots = places(module.attrib["PhysicalSubslots"])
        for item in module.iter(NS + "SubmoduleItemRef"):
            assert places(item.attrib["AllowedInSubslots"]) == {2} <= subslots
        for item in module.iter(NS + "VirtualSubmoduleItem"):
            assert places(item.attrib["FixedInSubslots"]) == {1} <= subslots
    subslot_numbers = [
        int(item.attrib["SubslotNumber"]) for item in every("InterfaceSubmoduleItem") + every("PortSubmoduleItem")
    ]
    assert subslot_numbers == [0x8000, 0x8001]


def test_numbers_have_the_form_and_the_range_of_their_attribute() -> None:
    for item in ROOT.iter():
        for name, digits in {"VendorID": 4, "DeviceID": 4, "ModuleIdentNumber": 8, "SubmoduleIdentNumber": 8}.items():
            if name in item.attrib:
                assert re.fullmatch(rf"0x[0-9A-F]{{{digits}}}", item.attrib[name]), item.attrib
                assert number(item, name) > 0
        assert item.attrib.get("API", "14848") == "14848"
        for name in ("ID", "TextId"):
            assert re.fullmatch(r"[A-Za-z_][\w.-]*", item.attrib.get(name, "X"))
    (timing,) = every("TimingProperties")
    assert places(timing.attrib["ReductionRatio"]) == {1 << power for power in range(10)}
    for item in every("Text"):
        assert 0 < len(item.attrib["Value"]) <= 255


@pytest.mark.parametrize(
    ("cycle_ms", "interval", "clocks"),
    [
        (0.25, 8, "8 16 32"),
        (0.3, 16, "16 32"),
        (0.5, 16, "16 32"),
        (0.75, 32, "32"),
        (1, 32, "32"),
        (4, 32, "32"),
    ],
)
def test_shortest_cycle_is_one_millisecond_or_a_shorter_configured_one(
    cycle_ms: float, interval: int, clocks: str, tmp_path: Path
) -> None:
    transport = TransportConfig(type="profinet", interface="eth1", cycle_time_ms=cycle_ms)
    root = ElementTree.parse(write_gsdml(transport, tmp_path, "--gsdml")).getroot()
    (point,) = root.iter(NS + "DeviceAccessPointItem")
    (timing,) = root.iter(NS + "TimingProperties")
    assert (point.attrib["MinDeviceInterval"], timing.attrib["SendClock"]) == (str(interval), clocks)
    assert profinet_model(transport, bytes(6), [], []).min_device_interval == interval


_OTHERS_READING = """
import json, sys
from profinet.gsdml import load_gsdml
device = load_gsdml(sys.argv[1])
(point,) = device.daps
print(json.dumps({
    "device": [device.vendor_id, device.device_id],
    "slot 0": [[item.subslot, item.submodule_ident] for item in device.build_io_slots({})],
    "modules": {item.id: [item.module_ident, sorted(item.useable_submodules)] for item in device.modules.values()},
    "submodules": {
        item.id: [item.submodule_ident, item.input_length, item.output_length, item.api]
        for item in device.submodule_catalog.values()
    },
}))
"""


@pytest.mark.e2e
def test_an_open_controllers_own_reader_finds_every_module_and_length(tmp_path: Path) -> None:
    if find_spec("construct") is None:
        pytest.skip("the extra controller is not installed")
    file = tmp_path / "device.xml"
    file.write_text(GsdmlWriter(IDENTITY, "pdgw", KINDS).write(), encoding="utf-8")
    # In a process of its own: a folder of this repository has the name of that package.
    command = [sys.executable, "-I", "-c", _OTHERS_READING, str(file)]
    said = json.loads(subprocess.run(command, capture_output=True, check=True, cwd=tmp_path).stdout)
    assert said["device"] == [IDENTITY.vendor_id, IDENTITY.device_id]
    assert said["slot 0"] == [[subslot, item.ident] for subslot, item in access_module().submodules.items()]
    for kind, telegrams in KINDS.items():
        ident, useable = said["modules"][f"MODULE_{kind.name}"]
        assert (ident, useable) == (kind.ident, sorted(f"TELEGRAM_{item.number}" for item in telegrams))
        for item in telegrams:
            plugged = object_module(kind, item).submodules[2]
            assert said["submodules"][f"TELEGRAM_{item.number}"] == [
                plugged.ident,
                plugged.inputs,
                plugged.outputs,
                0x3A00,
            ]


def number(item: ElementTree.Element, name: str) -> int:
    return int(item.attrib[name], 16)


def test_identifications_are_those_the_device_answers_with() -> None:
    (device,) = every("DeviceIdentity")
    assert (number(device, "VendorID"), number(device, "DeviceID")) == (IDENTITY.vendor_id, IDENTITY.device_id)
    (point,) = every("DeviceAccessPointItem")
    assert number(point, "ModuleIdentNumber") == access_module().ident
    check_name(point.attrib["DNS_CompatibleName"])
    system = {
        int(item.attrib["SubslotNumber"]): number(item, "SubmoduleIdentNumber")
        for item in every("InterfaceSubmoduleItem") + every("PortSubmoduleItem")
    }
    virtual = {item.attrib["ID"]: number(item, "SubmoduleIdentNumber") for item in every("VirtualSubmoduleItem")}
    found = {1: virtual["DAP_1"], **system}
    assert found == {subslot: item.ident for subslot, item in access_module().submodules.items()}
    for kind, telegrams in KINDS.items():
        module = next(item for item in every("ModuleItem") if item.attrib["ID"] == f"MODULE_{kind.name}")
        assert number(module, "ModuleIdentNumber") == kind.ident
        references = {item.attrib["SubmoduleItemTarget"] for item in module.iter(NS + "SubmoduleItemRef")}
        assert references == {f"TELEGRAM_{item.number}" for item in telegrams}


def test_head_module_and_access_points_have_writable_identification() -> None:
    """As IM_Supported of their I&M0 and F840h say."""
    writable = {item.get("ID") for item in ROOT.iter() if item.get("Writeable_IM_Records") == "1 2 3 4"}
    assert writable == {"DAP_1", *(f"ACCESS_POINT_{kind.name}" for kind in KINDS)}


SIZES = {f"{sign}{8 * size}": size for sign in ("Integer", "Unsigned") for size in (1, 2, 4, 8)}
EVERY = [item for items in KINDS.values() for item in items]


@pytest.mark.parametrize("chosen", EVERY, ids=lambda item: str(item.number))
def test_each_telegram_has_a_submodule_with_its_signals_and_lengths(chosen: Telegram) -> None:
    (item,) = [item for item in every("SubmoduleItem") if item.attrib["ID"] == f"TELEGRAM_{chosen.number}"]
    plugged = object_module(ObjectKind.AXIS, chosen).submodules[2]
    assert number(item, "SubmoduleIdentNumber") == plugged.ident
    texts = {text.attrib["TextId"]: text.attrib["Value"] for text in every("Text")}
    directions = (("Input", Direction.ACTUAL, plugged.inputs), ("Output", Direction.SETPOINT, plugged.outputs))
    for tag, direction, length in directions:
        (data,) = item.iter(NS + tag)
        items = list(data.iter(NS + "DataItem"))
        assert sum(SIZES[part.attrib["DataType"]] for part in items) == length
        names = [texts[part.attrib["TextId"]] for part in items]
        assert names == [signal.name for signal in chosen.half(direction).signals]
        for part in items:
            offsets = [int(bit.attrib["BitOffset"]) for bit in part.iter(NS + "BitDataItem")]
            assert len(offsets) == len(set(offsets))
            assert all(0 <= offset < 8 * SIZES[part.attrib["DataType"]] for offset in offsets)
            assert bool(offsets) is (part.attrib.get("UseAsBits") == "true")


def test_every_class_of_the_diagnosis_has_a_text() -> None:
    items = every("ProfileChannelDiagItem")
    assert [int(item.attrib["ErrorType"]) for item in items] == list(MessageClass)
    assert {item.attrib["API"] for item in items} == {str(0x3A00)}


def test_the_file_name_has_version_vendor_product_and_day() -> None:
    assert (
        file_name("Some Vendor", "press_drive", date(2026, 1, 2)) == "GSDML-V2.4-Some-Vendor-press-drive-20260102.xml"
    )


def test_the_command_writes_the_file_with_the_numbers_of_the_configuration(tmp_path: Path) -> None:
    config = tmp_path / "gateway.toml"
    config.write_text(
        '[can]\ninterface = "virtual"\n[transport]\ntype = "profinet"\ninterface = "eth1"\nvendor_id = 4660\ndevice_id = 22\n'
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n"
    )
    result = CliRunner().invoke(app, ["map", str(config), "--gsdml", str(tmp_path)])
    assert result.exit_code == 0, result.output
    (file,) = tmp_path.glob("GSDML-V2.4-pdgw-profidrive-gateway-*.xml")
    device = next(ElementTree.parse(file).getroot().iter(NS + "DeviceIdentity"))
    assert (device.attrib["VendorID"], device.attrib["DeviceID"]) == ("0x1234", "0x0016")
    refused = CliRunner().invoke(app, ["map", "--gsdml", str(tmp_path / "nowhere")])
    assert refused.exit_code == 1
    assert "cannot be written" in str(refused.exception)


def test_the_file_is_the_same_each_time_it_is_written() -> None:
    assert GsdmlWriter(IDENTITY, "pdgw", KINDS).write() == GsdmlWriter(IDENTITY, "pdgw", KINDS).write()


ORDER = {
    "ISO15745Profile": "ProfileHeader ProfileBody",
    "ProfileHeader": "ProfileIdentification ProfileRevision ProfileName ProfileSource ProfileClassID ISO15745Reference",
    "ISO15745Reference": "ISO15745Part ISO15745Edition ProfileTechnology",
    "ProfileBody": "DeviceIdentity DeviceFunction ApplicationProcess",
    "DeviceIdentity": "InfoText VendorName",
    "DeviceFunction": "Family",
    "ApplicationProcess": "DeviceAccessPointList ModuleList SubmoduleList ChannelDiagList ExternalTextList",
    "DeviceAccessPointList": "DeviceAccessPointItem",
    "DeviceAccessPointItem": "ModuleInfo CertificationInfo IOConfigData UseableModules VirtualSubmoduleList "
    "SystemDefinedSubmoduleList",
    "ModuleInfo": "Name InfoText VendorName OrderNumber HardwareRelease SoftwareRelease",
    "UseableModules": "ModuleItemRef",
    "VirtualSubmoduleList": "VirtualSubmoduleItem",
    "VirtualSubmoduleItem": "IOData ModuleInfo",
    "SystemDefinedSubmoduleList": "InterfaceSubmoduleItem PortSubmoduleItem",
    "InterfaceSubmoduleItem": "ApplicationRelations",
    "ApplicationRelations": "TimingProperties",
    "PortSubmoduleItem": "MAUTypeList",
    "MAUTypeList": "MAUTypeItem",
    "ModuleList": "ModuleItem",
    "ModuleItem": "ModuleInfo VirtualSubmoduleList UseableSubmodules",
    "UseableSubmodules": "SubmoduleItemRef",
    "SubmoduleList": "SubmoduleItem",
    "SubmoduleItem": "IOData ModuleInfo",
    "IOData": "Input Output",
    "Input": "DataItem",
    "Output": "DataItem",
    "DataItem": "BitDataItem",
    "ChannelDiagList": "ProfileChannelDiagItem",
    "ProfileChannelDiagItem": "Name",
    "ExternalTextList": "PrimaryLanguage",
    "PrimaryLanguage": "Text",
}
"""Children of an element in the order of the schema: tools reject a file with another order."""


def test_elements_have_the_order_of_the_schema() -> None:
    for item in ROOT.iter():
        name = item.tag.removeprefix(NS)
        allowed = ORDER.get(name, "").split()
        ranks = [allowed.index(child.tag.removeprefix(NS)) for child in item]
        assert ranks == sorted(ranks), name


@pytest.mark.parametrize(
    ("keys", "conformance", "protocols"),
    [
        ("", "A", "LLDP"),
        ('snmp_community = "public"', "A", "SNMP;LLDP"),
        ('snmp_community = "public"\nsnmp_write_community = "secret"', "B", "SNMP;LLDP"),
    ],
)
def test_snmp_with_writing_is_declared_as_class_b(keys: str, conformance: str, protocols: str, tmp_path: Path) -> None:
    """Class B is class A with SNMP; p-net's notes on the tester: ConformanceClass "B" and SupportedProtocols "SNMP;LLDP"."""
    config = tmp_path / "gateway.toml"
    config.write_text(
        f'[can]\ninterface = "virtual"\n[transport]\ntype = "profinet"\ninterface = "eth1"\n{keys}\n'
        "[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n"
    )
    assert CliRunner().invoke(app, ["map", str(config), "--gsdml", str(tmp_path)]).exit_code == 0
    (file,) = tmp_path.glob("GSDML*.xml")
    root = ElementTree.parse(file).getroot()
    (certification,) = root.iter(NS + "CertificationInfo")
    assert certification.attrib["ConformanceClass"] == conformance
    (interface,) = root.iter(NS + "InterfaceSubmoduleItem")
    assert interface.attrib["SupportedProtocols"] == protocols


def test_gsdml_meets_requirements_of_tools_beyond_the_schema() -> None:
    (point,) = every("DeviceAccessPointItem")
    assert point.attrib["PNIO_Version"] == "V2.4"
    assert [item.tag for item in point].count(NS + "CertificationInfo") == 1
    for name, value in {
        "LLDP_NoD_Supported": "true",
        "ResetToFactoryModes": "2",
        "CheckDeviceID_Allowed": "true",
        "NameOfStationNotTransferable": "false",
    }.items():
        assert point.attrib[name] == value
    (interface,) = every("InterfaceSubmoduleItem")
    for name in ("PTP_BoundarySupported", "DCP_BoundarySupported"):
        assert interface.attrib[name] == "true"


def test_the_longest_frames_of_a_project_fit_what_the_file_allows() -> None:
    (limits,) = every("IOConfigData")
    # Tools count data with all IOPS and IOCS, not the data alone.
    assert {int(limits.attrib[name]) for name in ("MaxInputLength", "MaxOutputLength")} == {1440}


@pytest.mark.skipif("PDGW_GSDML_SCHEMA" not in os.environ, reason="PDGW_GSDML_SCHEMA names no folder with PI's schema")
@pytest.mark.parametrize("snmp", Snmp)
def test_gsdml_schema_of_pi_accepts_the_file(snmp: Snmp) -> None:
    """PI's schema may not be copied here. TIA Portal has it, and the public repository TINF17C/GSD2AML-Converter."""
    etree = pytest.importorskip("lxml.etree", reason="lxml is not installed")
    (newest, *_) = sorted(Path(os.environ["PDGW_GSDML_SCHEMA"]).glob("GSDML-DeviceProfile-v*.xsd"), reverse=True)
    schema = etree.XMLSchema(etree.parse(str(newest)))
    document = etree.fromstring(GsdmlWriter(IDENTITY, "pdgw", KINDS, snmp=snmp).write().encode())
    schema.assertValid(document)
    # The schema is read, not just any: it refuses what is none.
    document.find(f".//{NS}DeviceAccessPointItem").set("MinDeviceInterval", "soon")
    assert not schema.validate(document)
