"""``pdgw param`` against a running gateway, and its pieces."""

from __future__ import annotations

import errno
import json
import re
import socket
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import cast
from unittest.mock import Mock

import pytest

from pdgw.dsp406.device import eds_path
from pdgw.dsp406.kinds import ROTARY
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.address import Target, parse_target, parse_type, parse_value
from pdgw.gateway.client.dump import (
    Dump,
    DumpedElement,
    Restored,
    difference,
    other_origin,
    other_telegram,
    read_all,
    restore,
)
from pdgw.gateway.client.session import Element, Session, full_name, meaning
from pdgw.gateway.client.udp import ParameterClient, read_identification
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import Values
from pdgw.profinet.rpc import identification
from pdgw.tools.command_table import EXAMPLES
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis, configuration, encoder_of, reached, serving, until


@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("P922", Target(922)),
        ("965", Target(965)),
        ("6041h", Target(0x6041)),
        ("0x1018.3", Target(0x1018, 3)),
        ("1018h.1-4", Target(0x1018, 1, 4)),
        ("P947[0..7]", Target(947, 0, 7)),
        ("PNU965", Target(965)),
        ("1018h/2", Target(0x1018, 2)),
    ],
)
def test_addresses_as_users_write_them(text: str, target: Target) -> None:
    assert parse_target(text) == target


LONG = [
    form.format("9" * digits)
    for form in ("{}", "P{}", "{}h", "0x{}", "1018h.{}", "P947[0..{}]")
    for digits in (21, 5000)
]


@pytest.mark.parametrize("text", ["", "abc", "P", "0", "65536", "P947[7..0]", "P1.2.3", "6041h.65535", "-5", *LONG])
def test_invalid_addresses_are_reported(text: str) -> None:
    with pytest.raises(GatewayError, match="expected"):
        parse_target(text)


@pytest.mark.parametrize(
    ("text", "type_name", "values"),
    [
        ("9", "u16", (9,)),
        ("-5", "i8", (-5,)),
        ("0x10,20h", "u32", (16, 32)),
        ("1.5", "f32", (1.5,)),
        ("abc", "string", b"abc"),
        ("01 ff", "octets", b"\x01\xff"),
    ],
)
def test_values_of_all_kinds(text: str, type_name: str, values: object) -> None:
    assert parse_value(text, parse_type(type_name)).values == values


@pytest.mark.parametrize(
    ("text", "type_name"),
    [("70000", "u16"), ("-1", "u8"), ("x", "i32"), ("1.5", "u16"), ("0g", "octets"), ("ü", "string"), ("2", "bool")],
)
def test_values_that_do_not_fit_are_reported(text: str, type_name: str) -> None:
    with pytest.raises(GatewayError, match="expected"):
        parse_value(text, parse_type(type_name))


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[str, int]]:
    """Where a gateway with one simulated axis listens."""
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        until(daemon, lambda: daemon.axes[0].good, "online")
        yield client.address


def option(server: tuple[str, int]) -> tuple[str, str]:
    return "--gateway", f"127.0.0.1:{server[1]}"


def test_read_prints_json_for_values_and_errors(server: tuple[str, int]) -> None:
    result = pdgw("param", "read", "965", "1018h.3", "P947[0..1]", "5000", "1008h", "--json", *option(server))
    assert result.returncode == 1, "one parameter failed"
    rows = json.loads(result.stdout)
    assert [(row["pnu"], row["subindex"], row["value"]) for row in rows] == [
        (965, 0, 0x329),
        (0x1018, 3, 0x3004A),
        (947, 0, 0),
        (947, 1, 0),
        (5000, 0, None),
        (0x1008, 0, "ENGEL HBI"),
    ]
    assert [row["error"] for row in rows].count(None) == 5
    assert rows[4]["error"] == {"number": 0, "text": "impermissible parameter number"}
    assert rows[0]["format"] == "UNSIGNED16"


def test_write_takes_the_type_from_the_device_and_reports_each_failure(server: tuple[str, int]) -> None:
    result = pdgw("param", "write", "6085h", "900", "6041h", "0", "P925", "3", "--json", *option(server))
    assert result.returncode == 1
    rows = json.loads(result.stdout)
    assert [(row["value"], row["error"] and row["error"]["number"]) for row in rows] == [
        (900, None),
        (None, 1),
        (3, None),
    ]
    assert json.loads(pdgw("param", "read", "6085h", "--json", *option(server)).stdout)[0]["value"] == 900
    assert pdgw(*EXAMPLES["param write"].split(), *option(server)).returncode == 0
    assert pdgw("param", "write", "6085h", "--type", "u32", *option(server)).stderr.count("value is missing") == 1


def test_list_and_describe(server: tuple[str, int]) -> None:
    rows = json.loads(pdgw("param", "list", "--json", *option(server)).stdout)
    by_pnu = {row["pnu"]: row for row in rows}
    assert by_pnu[922] == {"pnu": 922, "name": "Telegram", "format": "UNSIGNED16", "elements": None, "writable": True}
    assert by_pnu[0x6041]["name"] == "Statusword"
    # The description has sixteen characters for a name.
    full = {0x1003: "Pre-defined error field", 0x6065: "Following Error Window", 0x605A: "Quick Stop Option Code"}
    assert {pnu: by_pnu[pnu]["name"] for pnu in full} == full
    text = pdgw("param", "list", *option(server)).stdout
    assert all(name in text for name in full.values())
    assert max(map(len, text.splitlines())) <= 80
    (described,) = json.loads(pdgw("param", "describe", "P968", "--json", *option(server)).stdout)
    assert described["texts"][7] == "fault"
    missing = pdgw("param", "describe", "5000", *option(server))
    assert missing.returncode == 1
    assert "1388h" in missing.stderr


def test_identify_shows_the_identification_of_the_device(server: tuple[str, int]) -> None:
    with ParameterClient(server, 0, slot=0) as client:
        client.write_record(identification.INDEX + 1, identification.encode_im(1, (b"press [b]4", b"hall B")))
        client.write_record(identification.INDEX + 4, identification.encode_im(4, (b"\x01\xff",)))
    fields = json.loads(pdgw("param", "identify", "--json", *option(server)).stdout)
    assert (fields["Vendor ID"], fields["Order ID"], fields["IM_Profile_ID"]) == ("FFFFh", "PDGW", "3A00h")
    assert fields["IM_Software_Revision"] == "V" + version("profidrive-gateway")
    assert (fields["IM_Tag_Function"], fields["IM_Tag_Location"]) == ("press [b]4", "hall B")
    assert (fields["IM_Signature"], fields["IM_Date"]) == ("01 ff", "")
    assert "press [b]4" in pdgw("param", "identify", *option(server)).stdout


def test_only_supported_identification_records_are_read() -> None:
    asked = []

    class Client:
        def read_record(self, index: int) -> bytes:
            asked.append(index - identification.INDEX)
            if index > identification.INDEX:
                return identification.encode_im(index - identification.INDEX, (b"2026-11-22 10:00",))
            return identification.encode_im0(identification.Im0(42, "X", "1", 1, ("V", 1, 0, 0), supported=1 << 2))

    fields = read_identification(cast(ParameterClient, Client()))
    assert asked == [0, 2]
    assert fields["IM_Date"] == "2026-11-22 10:00"
    assert "IM_Tag_Function" not in fields


def test_invalid_identification_is_reported_with_its_record() -> None:
    class Client:
        def read_record(self, index: int) -> bytes:
            return b"nothing"

    with pytest.raises(GatewayError, match=r"record AFF0h: I&M0: .7 bytes"):
        read_identification(cast(ParameterClient, Client()))


def test_a_name_is_continued_only_where_one_data_sheet_continues_it() -> None:
    assert full_name(0x605A, "Quick Stop Optio") == "Quick Stop Option Code"
    assert full_name(0x605A, "Schnellhalt-Art ") == "Schnellhalt-Art "
    assert full_name(925, "Sign of life tol") == "Sign of life tol"


def test_tables_name_states_and_units(server: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text = pdgw("param", "read", "6041h", "6081h", "P968", *option(server)).stdout
    for part in ("Statusword", "1670h Switch On Disabled", "velocity units (6094h rpm)", "SWITCHING_ON_INHIBITED"):
        assert part in text


def test_dump_and_restore_bring_the_settings_back(server: tuple[str, int], tmp_path: Path) -> None:
    file = tmp_path / "drive.json"
    where = option(server)
    assert pdgw("param", "dump", str(file), *where).returncode == 0
    before = {(item.pnu, item.subindex): item.value for item in Dump.load(file).parameters}
    assert pdgw("param", "write", "6085h", "555", "6099h.1", "123", "P925", "9", *where).returncode == 0
    shown = pdgw("param", "restore", str(file), "--dry-run", *where).stdout
    for part in ("6085h.0", "6099h.1", "P925.0", "555", "123"):
        assert part in shown
    assert pdgw("param", "restore", str(file), *where, text="n\n").returncode == 1
    done = pdgw("param", "restore", str(file), "--yes", *where)
    assert "3 of 3 settings written" in done.stdout
    assert "nothing differs" in pdgw("param", "restore", str(file), "--yes", *where).stdout
    with ParameterClient(server, 1) as client:
        again, _ = read_all(Session(client))
    after = {(item.pnu, item.subindex): item.value for item in again.parameters}
    changed = {key for key in before if before[key] != after[key]}
    assert all(pnu >= 0x6000 for pnu, _ in changed), "nothing but live values"
    assert (0x6085, 0) not in changed


def test_a_restore_into_a_drive_object_that_does_not_exist_is_refused_before_it_asks(
    server: tuple[str, int], tmp_path: Path
) -> None:
    file = tmp_path / "drive.json"
    assert pdgw("param", "dump", str(file), *option(server)).returncode == 0
    done = pdgw("param", "restore", str(file), "--other", "--do", "9", *option(server), text="y\n")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "error: DO 9 has none of the settings in the file: 19h: axis or DO does not exist\n"


class Device:
    """Settings of a device, some of which it refuses to take."""

    def __init__(self, values: dict[int, int], refused: set[int]) -> None:
        self.values = values
        self.refused = refused
        self.order: list[int] = []

    def read(self, targets: Sequence[Target], _progress: object = None) -> list[Element]:
        return [Element(item.pnu, 0, DataType.UNSIGNED16, self.values[item.pnu]) for item in targets]

    def write(self, writes: Sequence[tuple[Target, Values]], _progress: object = None) -> list[Element]:
        results = []
        for target, values in writes:
            self.order.append(target.pnu)
            refused = target.pnu in self.refused
            if not refused:
                self.values[target.pnu] = int(values.values[0])
            results.append(
                Element(target.pnu, 0, DataType.UNSIGNED16, int(values.values[0]), 0x11 if refused else None)
            )
        return results


def dumped(**values: int) -> Dump:
    elements = [
        DumpedElement(pnu=int(name[1:]), subindex=0, format="UNSIGNED16", value=value, setting=True)
        for name, value in values.items()
    ]
    return Dump(do_id=1, parameters=tuple(elements))


def test_telegram_and_priority_are_written_last() -> None:
    device = Device({922: 1, 925: 5, 927: 1, 930: 2}, set())
    session = cast(Session, device)
    pairs = difference(session, dumped(P927=0, P922=9, P925=6, P930=3))
    assert other_telegram(pairs) == (1, 9)
    assert not restore(session, pairs).failed
    assert device.order == [925, 930, 922, 927]
    assert device.values == {922: 9, 925: 6, 927: 0, 930: 3}


@pytest.mark.parametrize(
    ("do_id", "unit", "origin"),
    [
        (1, (42, 7, 100, 2026, 101, 1), ""),
        (1, (42, 7, 200, 2027, 101, 2), ""),
        (1, (), ""),
        (2, (42, 7, 100, 2026, 101, 1), "DO 2"),
        (1, (42, 8, 100, 2026, 101, 1), "another device (P964 42, 8 instead of 42, 7)"),
        (1, (43, 7, 100, 2026, 101, 1), "another device (P964 43, 7 instead of 42, 7)"),
    ],
)
def test_a_file_of_another_drive_object_or_device_type_is_recognised(
    do_id: int, unit: tuple[int, ...], origin: str
) -> None:
    session = Mock()
    session.client.do_id = 1
    session.read.return_value = [
        Element(964, place, DataType.UNSIGNED16, value) for place, value in enumerate((42, 7, 100, 2026, 101, 1))
    ]
    assert other_origin(session, Dump(do_id=do_id, unit=unit, parameters=())) == origin


def test_the_settings_of_an_offline_drive_are_one_line() -> None:
    session = Mock()
    session.client.do_id = 1
    session.read.return_value = [Element(0x6085 + n, 0, None, None, 0x11) for n in range(2)]
    with pytest.raises(
        GatewayError, match=r"^DO 1: 2 of 2 settings cannot be read \(11h: .*\); check that the device is online"
    ):
        difference(session, dumped(P24709=1, P24710=2))


def test_restore_with_a_rejected_value_changes_nothing() -> None:
    device = Device({922: 1, 925: 5, 930: 2}, {930})
    session = cast(Session, device)
    pairs = difference(session, dumped(P922=9, P925=6, P930=3))
    outcome = restore(session, pairs)
    assert [item.pnu for item in outcome.failed] == [930]
    assert (outcome.taken_back, outcome.stuck) == (True, ())
    assert device.values == {922: 1, 925: 5, 930: 2}
    assert not restore(session, pairs, partial=True).taken_back
    assert device.values == {922: 9, 925: 6, 930: 2}


def test_a_file_of_another_telegram_is_not_written_by_mistake(server: tuple[str, int], tmp_path: Path) -> None:
    file = tmp_path / "other.json"
    saved = dumped(P922=9, P925=7)
    saved.save(file)
    refused = pdgw("param", "restore", str(file), "--yes", *option(server))
    assert refused.returncode == 1
    assert "DO 1 has telegram 1" in refused.stderr
    assert "was saved with telegram 9: nothing was written" in refused.stderr
    (now,) = json.loads(pdgw("param", "read", "P925", "--json", *option(server)).stdout)
    assert now["value"] != 7


def test_an_object_written_as_a_decimal_number_is_recognised() -> None:
    wrong = Element(6041, 0, None, None, 0)
    assert meaning(wrong, encoder=False).endswith("did you mean 6041h?")
    assert "did you mean" not in meaning(Element(5000, 0, None, None, 0), encoder=False)
    assert "did you mean" not in meaning(Element(6041, 0, None, None, 0x11), encoder=False)


def test_gateway_without_a_route_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoRoute(socket.socket):
        def connect(self, _address: object) -> None:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(socket, "socket", NoRoute)
    with pytest.raises(GatewayError, match=r"192\.0\.2\.1:34964: cannot be reached \(Network is unreachable\)"):
        ParameterClient(("192.0.2.1", 34964), 1)


def test_names_are_folded_and_never_cut(server: tuple[str, int]) -> None:
    rows = {row["pnu"]: row["name"] for row in json.loads(pdgw("param", "list", "--json", *option(server)).stdout)}
    text = "".join(pdgw("param", "list", *option(server)).stdout.split())
    assert "…" not in text
    for name in rows.values():
        assert name is None or max(name.split(), key=len, default="") in text


def test_restoring_never_writes_commands_demands_or_the_network() -> None:
    element = DumpedElement(pnu=927, subindex=0, format="UNSIGNED16", value=0, setting=True)
    assert element.values().format is DataType.UNSIGNED16
    with pytest.raises(GatewayError, match="P925"):
        DumpedElement(pnu=925, subindex=0, format="UNSIGNED16", value="x", setting=True).values()


def test_a_dump_of_this_drive_has_only_settings_marked(server: tuple[str, int]) -> None:
    with ParameterClient(server, 1) as client:
        session = Session(client)
        dump, failed = read_all(session)
        assert failed == []
        settings = {item.pnu for item in dump.parameters if item.setting}
        assert {922, 925, 927, 0x6083, 0x6085, 0x6099} <= settings
        assert not settings & {952, 970, 971, 972, 976, 977, 0x6040, 0x6060, 0x60FF, 0x607A, 0x1016, 0x1400, 0x6007}
        assert difference(session, dump) == []
        assert restore(session, []) == Restored([], [])


@pytest.mark.parametrize("content", ["", "{}", '{"version": 2, "do_id": 1, "parameters": []}', "[1]", "\x00"])
def test_invalid_dump_file_is_reported(tmp_path: Path, content: str) -> None:
    file = tmp_path / "bad.json"
    file.write_text(content)
    with pytest.raises(GatewayError, match=r"bad\.json"):
        Dump.load(file)


def test_missing_gateway_is_one_error_line() -> None:
    result = pdgw("param", "read", "965", "--gateway", "127.0.0.1:1")
    assert result.returncode == 1
    assert "no answer on the record channel" in result.stderr
    assert "Traceback" not in result.stderr


def test_objects_of_an_encoder_have_the_encoder_s_names() -> None:
    table = """[[encoder]]
do_id = 2
node_id = 20
telegram = 81
simulate = true
"""
    with serving(configuration(table)) as (daemon, client), reached(daemon):
        where = "--gateway", f"127.0.0.1:{client.address[1]}", "--do", "2"
        text = " ".join(pdgw("param", "read", "6004h", "6502h", *where).stdout.split())
    assert "Position value" in text
    assert "revolutions" in text
    assert "Drive" not in text, "6502h of a drive is another object"


def test_fields_of_650ah_have_their_names_in_the_layout_of_the_profile_too(tmp_path: Path) -> None:
    head, _, rest = eds_path(ROTARY).read_text().partition("[650Asub0]")
    fields = rest.partition("[650Asub1]")[2].replace("[650Asub2]", "[650Asub1]").replace("[650Asub3]", "[650Asub2]")
    sheet = tmp_path / "printed.eds"
    sheet.write_text(f"{head.replace('SubNumber=4', 'SubNumber=3')}[650Asub0]{fields}")
    found = {}
    for title, eds in (("usual", ""), ("printed", f'eds = "{sheet}"\n')):
        table = f"{axis(1)}[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n{eds}"
        with serving(configuration(table)) as (daemon, client), reached(daemon):
            node = encoder_of(daemon).node
            if eds:
                for sub, entry in enumerate([node.entries.pop((0x650A, sub)) for sub in range(4)][1:]):
                    node.entries[0x650A, sub] = replace(entry, subindex=sub)
                    node.values[0x650A, sub] = -300 * (sub + 1)
            where = f"127.0.0.1:{client.address[1]}"
            text = pdgw("param", "read", "650Ah", "--do", "2", "--gateway", where).stdout
            parts = text.split("650Ah.")[1:]
            found[title] = [" ".join(re.findall("UNSIGNED8|offset|minimum|maximum|-\\d+", part)) for part in parts]
    assert found["usual"] == ["UNSIGNED8", "offset", "minimum", "maximum"]
    assert found["printed"] == ["-300 offset", "-600 minimum", "-900 maximum"]
