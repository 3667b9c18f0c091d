"""Tables and sentences that people wrote in the documents and that repeat a declaration say what it says."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

import pytest

from pdgw.decoder.frames.canopen.records import CanRecord
from pdgw.decoder.frames.profinet.records import RelationRecord
from pdgw.decoder.frames.records import Record
from pdgw.ds301.pdo import Pdo
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.identification.overlay import Match, Overlay, Units
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import STATUS_PATTERNS
from pdgw.durations import MS, MS_PER_SECOND, US
from pdgw.gateway.axis.adapters.transparent import ACTUAL_ATTRIBUTES, SETPOINT_ATTRIBUTES
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.configuration.config import AxisConfig
from pdgw.gateway.configuration.example import example
from pdgw.gateway.configuration.tables.defaults import STATUS_PORT, WATCHDOG_FACTOR
from pdgw.gateway.configuration.tables.environment import TraceConfig, TransportConfig
from pdgw.gateway.configuration.tables.web import WebConfig
from pdgw.gateway.motion.blocks import BlockTask
from pdgw.gateway.parameters.profile import MAX_BLOCK
from pdgw.gateway.reasons import Enable
from pdgw.gateway.service.status import SCHEMA
from pdgw.peers.drive.model.shapes import FAMILY
from pdgw.profidrive.frame import (
    C_SDU_MIN,
    COUNTER_UNIT_NS,
    FRAME_ID_MAX,
    FRAME_ID_MIN,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    STATUS_NORMAL,
)
from pdgw.profidrive.parameters.catalogue import ENCODER_IDENTIFICATION, PROFILE_IDENTIFICATION
from pdgw.profidrive.parameters.codec import MAX_ELEMENTS, MAX_PARAMETERS, Attribute, RequestId
from pdgw.profidrive.parameters.faults import FAULTS_PER_SITUATION, SITUATIONS
from pdgw.profidrive.sensor_format import SensorFormat, encode_sensor_format
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import TELEGRAMS, telegram, word_positions
from pdgw.profinet import model
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.records import RECORD_GLOBAL, RECORD_LOCAL, RECORD_MULTIPLE
from pdgw.tools.demo.chapters import CHAPTERS
from pdgw.tools.output.status_check import Health
from pdgw.workshop.bench.stops import VIRTUAL
from pdgw.workshop.soak.watch import SETTLED_NS
from tests.support.documents.written_tables import ROOT, named, number_of, rows

_INDEX = re.compile(r"\b([0-9A-F]{4})h(?:/(\d))?")

PUBLISHED = "../tests/support/documents/published_tables.md"
"""What the guides print, written by hand."""
LAYOUTS = list(rows(PUBLISHED, "telegram | setpoints"))


def test_the_tables_are_found() -> None:
    assert len(LAYOUTS) > 10
    assert len(list(rows(PUBLISHED, "telegram | RPDO"))) == 3
    assert len(list(rows("measured/stops.txt", "what is lost"))) >= len(VIRTUAL)


@pytest.mark.parametrize("row", LAYOUTS, ids=lambda row: row[0])
def test_the_layouts_are_those_of_the_declarations(row: list[str]) -> None:
    declared = telegram(number_of(row[0]))
    for half, signals, words in ((declared.setpoints, row[1], row[2]), (declared.actuals, row[3], row[4])):
        assert int(words) * 2 == half.size
        if signals != "see below":
            assert tuple(re.sub(r"\(\d\)", "", signals).split(", ")) == half.names


@pytest.mark.parametrize("row", list(rows(PUBLISHED, "telegram | RPDO")), ids=lambda row: row[0])
def test_the_pdos_are_those_of_the_declarations(row: list[str]) -> None:
    """Objects that are always written by SDO are listed after the last PDO."""

    def addresses(pdo: Pdo) -> list[tuple[int, int]]:
        return [FAMILY.entries.get(entry.attribute, entry).address for entry in pdo.entries]

    layout = drive_layout(number_of(row[0]))
    for pdos, cell in ((layout.rpdos, row[1]), (layout.tpdos, row[2])):
        told = [part for part in re.split(r"; |, (?=\w+ by SDO)", cell) if not part.endswith("by SDO")]
        assert len(told) == len(pdos)
        for pdo, part in zip(pdos, told, strict=True):
            assert number_of(part) == pdo.number
            assert [(int(index, 16), int(sub or 0)) for index, sub in _INDEX.findall(part)] == addresses(pdo)


def test_the_bounds_of_the_stops_are_those_that_are_measured_against() -> None:
    measured = {row[0]: (row[1], row[5]) for row in rows("measured/stops.txt", "what is lost")}
    text = (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    for stop, _ in VIRTUAL:
        assert measured[stop.cause] == (stop.measured, f"{stop.bound_ms:g} ms: {stop.bound}")
        assert f"`{stop.cause}` {stop.bound_ms:g} ms" in text


def test_the_defaults_in_sentences_are_the_defaults() -> None:
    transport, axis, node = TransportConfig(), AxisConfig(do_id=1, node_id=1, telegram=1), DriveSettings(1)
    defaults = (
        f"cycle {transport.cycle_time_ms:g} ms, watchdog {WATCHDOG_FACTOR} cycles, heartbeats {axis.heartbeat_ms} ms, "
        f"TPDO event timer {axis.tpdo_event_ms} ms, refresh {node.rpdo_refresh_ms} ms; "
        f'`on_plc_loss = "{AxisSettings().on_plc_loss.value}"`'
    )
    assert defaults in (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    assert f"watchdog factor ({WATCHDOG_FACTOR}) x cycle" in (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    assert f"`watchdog_factor = {WATCHDOG_FACTOR}`" in (ROOT / "docs/demo.md").read_text(encoding="utf-8")


SENTENCES = (
    ("transport.md", f"0x{FRAME_ID_MIN:04X}-0x{FRAME_ID_MAX:04X}"),
    ("transport.md", f"PLC -> gateway 0x{FRAME_ID_TO_DEVICE:04X}, gateway -> PLC 0x{FRAME_ID_TO_CONTROLLER:04X}"),
    ("transport.md", f"padded with 0 to at least {C_SDU_MIN}"),
    ("transport.md", f"units of {COUNTER_UNIT_NS / US:g} us"),
    ("transport.md", f"normally 0x{STATUS_NORMAL:02X}"),
    ("parameter-channel.md", f"may have {MAX_BLOCK} bytes"),
    ("parameter-channel.md", f"(`parameter_timeout_ms`, {TransportConfig().parameter_timeout_ms / MS_PER_SECOND:g} s)"),
    ("parameter-channel.md", f"{SITUATIONS} situations of {FAULTS_PER_SITUATION} faults"),
    ("status.md", f"`status_port`, {STATUS_PORT} unless"),
    ("status.md", f"`schema` ({SCHEMA})"),
    ("soak.md", f"nothing has changed for {SETTLED_NS // MS} ms"),
)


@pytest.mark.parametrize(("document", "sentence"), SENTENCES)
def test_a_number_in_a_sentence_is_the_declared_one(document: str, sentence: str) -> None:
    assert sentence in (ROOT / "docs" / document).read_text(encoding="utf-8")


def test_the_keys_of_the_units_are_keys_of_an_axis() -> None:
    keys = [row[0].strip("`") for row in rows("units.md", "key | is")]
    assert len(keys) > 5
    assert {*keys} <= {*AxisConfig.model_fields}


def test_each_word_of_telegram_100_is_the_object_of_its_signal() -> None:
    """``4-5``, ``Target Position 607Ah i32``: place, name, address and type; the mode of operation is a byte of its word."""
    manufacturer = telegram(100)
    entries = {entry.attribute: entry for entry in DRIVE_OBJECTS.entries} | dict(FAMILY.entries)
    told = list(rows(PUBLISHED, "word | setpoint |"))
    for half, attributes, column in (
        (manufacturer.setpoints, SETPOINT_ATTRIBUTES, 0),
        (manufacturer.actuals, ACTUAL_ATTRIBUTES, 2),
    ):
        expected = []
        for item, attribute, word in zip(half.signals, attributes, word_positions(half), strict=True):
            entry = entries[attribute]
            place = f"{word}-{word + item.words - 1}" if item.words > 1 else f"{word}"
            expected.append((place, (entry.index, entry.subindex), entry.type.name.lower()))
        found = []
        for row in told:
            place, text = row[column : column + 2]
            if place:
                match = re.search(r"([0-9A-F]{4})h(?: sub (\d))?(?: \(mask\))? ([iu]\d+)", text)
                assert match is not None, text
                found.append((place, (int(match[1], 16), int(match[2] or 0)), match[3]))
        assert found == expected


def test_a_fraction_of_a_reference_has_the_type_of_its_signal() -> None:
    cells = [row[0] for row in rows("telegrams.md", "signal | object")]
    told = [
        (name, kind)
        for cell in cells
        for names, kind in re.findall(r"([A-Z_, ]+) \((N\d)\)", cell)
        for name in re.findall(r"\w+", names)
    ]
    assert len(told) == 9
    assert told == [(name, signal(name).type.name) for name, _ in told]


def test_the_fields_of_a_parameter_request_are_those_of_the_codec() -> None:
    told = {row[0].rpartition(": ")[2]: row[2] for row in rows("parameter-channel.md", "field | size")}
    assert told["No. of Parameters"] == f"1..{MAX_PARAMETERS}"
    assert told["No. of Values"] == f"0..{MAX_ELEMENTS}"
    assert told["No. of Elements"].startswith(f"0..{MAX_ELEMENTS};")
    assert told["Attribute"] == ", ".join(f"0x{item:02X} {item.name.lower()}" for item in Attribute)
    assert told["Request ID"] == ", ".join(f"{item:02X} {item.name.lower()} parameter" for item in RequestId)


def test_identifications_of_the_profile_are_those_that_are_answered() -> None:
    text = (ROOT / "docs/parameter-channel.md").read_text(encoding="utf-8")
    high, low = ENCODER_IDENTIFICATION.to_bytes(2, "big")
    assert f"an axis {PROFILE_IDENTIFICATION:04X}h (profile 3, version 41)" in text
    assert f"an encoder the octets {high:02X}h, {low:02X}h" in text
    assert f"header {encode_sensor_format([SensorFormat(1)])[0]:04X}h" in text


def test_the_states_have_the_patterns_that_are_read() -> None:
    patterns: dict[str, set[str]] = {}
    for pattern in STATUS_PATTERNS:
        bits = "".join("x" if not pattern.mask >> n & 1 else str(pattern.value >> n & 1) for n in range(7, -1, -1))
        patterns.setdefault(pattern.state.value.lower(), set()).add(f"{bits[:4]} {bits[4:]}")
    table = list(rows(PUBLISHED, "state (PROFIdrive"))
    assert len(table) == len(patterns)
    for name, actual, statusword in table:
        told = statusword if statusword != "same" else actual.removeprefix("xxxx xxxx ")
        assert told in patterns[name.rpartition(" / ")[2]], name


def test_chain_of_enables_is_documented_in_its_order() -> None:
    assert [row[0] for row in rows("axis-does-not-move.md", "link | broken means")] == [item.value for item in Enable]


def test_the_exit_codes_of_a_check_are_those_it_ends_with() -> None:
    codes = [" ".join(row[0].split()) for row in rows("service.md", "exit code | when")]
    assert codes == [f"{item.value} {item.name}" for item in Health]


def test_chapters_of_the_demo_are_documented() -> None:
    assert [name for row in rows("demo.md", "chapter | contents") for name in named(row[0])] == list(CHAPTERS)


def test_telegrams_of_each_application_class_are_documented() -> None:
    for row in rows("motion.md", "class | telegrams"):
        told = {int(number) for number in re.findall(r"\d+", row[1])}
        declared = {n for n, item in TELEGRAMS.items() if number_of(row[0]) in [kind.value for kind in item.classes]}
        assert told == declared, row[0]


def test_tasks_of_a_block_are_documented() -> None:
    told = [name for row in rows("motion.md", "`task` | does") for name in row[0].split(", ")]
    assert told == [task.value for task in BlockTask]


@pytest.mark.parametrize(("section", "model"), [("trace", TraceConfig), ("web", WebConfig)])
def test_the_example_has_every_key_of_a_section_with_its_default(
    section: str, model: type[TraceConfig | WebConfig]
) -> None:
    commented = example().partition(f"# [{section}]")[2].partition("\n\n")[0].partition("\n")[2]
    found = tomllib.loads(re.sub(r"^# ", "", commented, flags=re.MULTILINE))
    assert found.keys() == model.model_fields.keys()
    for key, value in found.items():
        default = model.model_fields[key].default
        if default not in (None, ()):
            assert value == default, key


def test_keys_of_an_overlay_are_documented() -> None:
    table = list(rows("drives.md", "key | holds"))
    told = {section: set[str]() for section in ("", "match", "units")}
    for row in table:
        section = re.match(r"`\[(match|units)\]`", row[0])
        told[section[1] if section else ""] |= {name.strip("[]") for name in re.findall(r"`([^`]+)`", row[0])}
    assert told["match"] - {"match"} == set(Match.model_fields)
    assert told["units"] - {"units"} == set(Units.model_fields)
    assert told[""] == set(Overlay.model_fields) - {"name", "match", "units"}


def test_every_kind_of_record_is_documented() -> None:
    assert issubclass(CanRecord, Record)
    assert issubclass(RelationRecord, Record)
    told = {name for row in rows("decoder-schema.md", "kind of record | further keys") for name in named(row[0])}
    assert told == {kind.kind for kind in (Record, *subclasses(Record))}


def subclasses(kind: type[Record]) -> Iterator[type[Record]]:
    for item in kind.__subclasses__():
        yield item
        yield from subclasses(item)


def numbers_in(text: str) -> list[int]:
    return [int(number, 16) for number in re.findall(r"\b([0-9A-F]{4,8})h", text)]


def test_the_identifications_of_a_device_are_those_of_its_model() -> None:
    device, interface, axis, values = (row[2] for row in rows("profinet.md", "place | API | identification"))
    assert numbers_in(device) == [model.DAP_MODULE_IDENT, model.DAP_IDENT]
    assert numbers_in(interface) == [model.INTERFACE_IDENT, model.PORT_IDENT]
    kinds = [model.ObjectKind.AXIS.ident, model.ObjectKind.ENCODER.ident]
    assert numbers_in(axis) == [*kinds, model.ACCESS_POINT_IDENT]
    assert numbers_in(values) == [model.TELEGRAM_IDENT]


def test_the_records_of_a_device_are_those_it_knows() -> None:
    text = (ROOT / "docs/profinet.md").read_text(encoding="utf-8")
    told = set(numbers_in(text.partition("\n## Records\n")[2].partition("\n## ")[0]))
    diagnosis = {item for item in Index if item.name.startswith(("DIAGNOSIS", "MAINTENANCE"))}
    further = {RECORD_LOCAL, RECORD_GLOBAL, RECORD_MULTIPLE, identification.INDEX, identification.INDEX + 4}
    assert told == {*Index} - diagnosis | further


def names_of_tests(*names: str) -> set[str]:
    """The names of the tests in these files."""
    return {
        found
        for name in names
        for found in re.findall(r"def (test_\w+)", (ROOT / "tests" / name).read_text(encoding="utf-8"))
    }


def test_cases_of_the_tester_and_tests_of_class_a_match() -> None:
    link = "gateway/links/profinet"
    class_a = names_of_tests(f"{link}/test_class_a.py", "profinet/test_class_a_relationship.py")
    named = class_a | names_of_tests(f"{link}/test_snmp.py", "profinet/discovery/test_snmp.py")
    cases = rows("../tests/support/documents/tester_cases.md", "case of the tester")
    told = [name for row in cases for name in re.findall(r"`(test_\w+)`", row[1])]
    assert len(told) >= 20
    assert [name for name in told if not any(test.startswith(name) for test in named)] == []
    assert [test for test in class_a if not test.startswith(tuple(told))] == []
