"""Commands that ask the devices of a bus: ``pdgw bus scan``, and ``pdgw config check --bus``, which shows their 100 % values."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from typer.testing import CliRunner

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.eds.writer import write_eds
from pdgw.ds301.objects import Access, Entry
from pdgw.dsp402.objects import HALT_OPTION
from pdgw.dsp406.device import device_info, encoder_objects
from pdgw.dsp406.kinds import ROTARY
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.drive.objects import INFO, drive_objects
from pdgw.tools.commands.commissioning.config import app
from tests.support import buses
from tests.support.cli import pdgw
from tests.support.drives.data_sheets import SHEETS
from tests.support.gateways.daemon import POSITIONER

_QUICK = ("--listen-s", "0.05", "--timeout-ms", "200")
_WHOLE = "usable with telegrams: 1, 2, 3,"
"""Said of a drive that has answered everything in time."""


def test_loopback_bus_is_scanned_with_text_and_json_output() -> None:
    with ServedBus(0) as hub:
        place = ("--interface", INTERFACE, "--channel", hub.channel)
        with SimulatedDrive(open_bus(INTERFACE, hub.channel), 5):

            def scan(told: str, *more: str) -> CompletedProcess[str]:
                """With the times of a quiet machine, on another one again and longer."""
                for timeout_ms in (500, 3000, 30_000):
                    words = ("--listen-s", "0.05", "--timeout-ms", str(timeout_ms), *more)
                    result = pdgw("bus", "scan", *place, *words)
                    if told in result.stdout:
                        break
                return result

            text = scan(_WHOLE)
            document = json.loads(scan('"1": ""', "--json").stdout)
    assert text.returncode == 0, text.stderr
    assert "node 5: drive 'ENGEL HBI'" in text.stdout
    assert _WHOLE in text.stdout
    (bus,) = document
    (node,) = bus["nodes"]
    assert (node["node_id"], node["profile"], node["family"], node["telegrams"]["1"]) == (5, 402, "engel", "")


def test_scan_of_a_configuration_reports_missing_nodes(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    channel = buses.channel()
    file.write_text(
        f'[can]\ninterface = "virtual"\nchannel = "{channel}"\n[[axis]]\ndo_id = 3\nnode_id = 9\ntelegram = 1\n'
    )
    result = pdgw("bus", "scan", str(file), *_QUICK)
    assert result.returncode == 0, result.stderr
    assert "node 9" in result.stdout
    assert "DO 3 of the configuration is missing" in result.stdout


def test_a_written_configuration_replaces_no_file(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with ServedBus(0) as hub, SimulatedDrive(open_bus(INTERFACE, hub.channel), 5):
        words = ("bus", "scan", "--interface", INTERFACE, "--channel", hub.channel, "--write", str(file))
        result = pdgw(*words)
        again = pdgw(*words)
    assert result.returncode == 0, result.stderr
    assert result.stderr == f"{file}: written; next: pdgw config check {file}\n"
    assert "node_id = 5\ntelegram = 1\n" in file.read_text()
    assert (again.returncode, again.stderr) == (1, f"error: --write {file}: the file exists; name a new one\n")
    refused = pdgw("bus", "scan", str(file), "--write", str(tmp_path / "other.toml"))
    assert "describes the buses already; scan without a configuration" in refused.stderr


def test_an_interface_that_is_not_there_is_named() -> None:
    result = pdgw("bus", "scan", "--interface", "socketcan", "--channel", "can77", *_QUICK)
    assert result.returncode == 1
    assert "CAN interface: 'socketcan channel can77'" in result.stderr


CONFIG = """
[can]
interface = "virtual"
channel = "{channel}"

[[axis]]
do_id = 1
node_id = 5
telegram = {telegram}
sdo_timeout_ms = 60000
{keys}
"""


def _check(tmp_path: Path, telegram: int = 1, keys: str = "", halt_option: int = 1) -> tuple[int, str]:
    channel = buses.channel()
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel=channel, telegram=telegram, keys=keys))
    drive = SimulatedDrive(buses.bus(channel), 5)
    drive.node.values[HALT_OPTION, 0] = halt_option
    drive.start()
    try:
        result = CliRunner().invoke(app, ["check", "--bus", str(file)])
    finally:
        drive.stop()
    return result.exit_code, result.output


def test_units_are_read_from_the_drive_on_the_bus(tmp_path: Path) -> None:
    status, output = _check(tmp_path, telegram=9)
    assert status == 0
    assert "speed: 100 % = 3000 rpm = 60FFh 6000 (from 6080h, 6094h: 1/2 rpm)" in output
    assert "acceleration: 100 % = 6083h 1000 (from 60C5h)" in output
    assert "position: 100 % = 607Ah 500000 (from 607Bh/2)" in output
    assert "stops of the drive: Quick Stop Option Code 605Ah = 2, " in output


def test_option_of_the_drive_against_the_telegram_is_rejected_with_the_remedy(tmp_path: Path) -> None:
    status, output = _check(tmp_path, telegram=9, halt_option=0)
    assert status == 1
    assert "telegram 9 is rejected: Halt Option Code 605Dh: 0 is not allowed, expected 1 (pdgw param write" in output


def test_keys_of_the_configuration_come_first(tmp_path: Path) -> None:
    status, output = _check(
        tmp_path, keys='rated_speed_rpm = 1500\nvelocity_unit = "0.1 rpm"\nignored_unit_objects = ["6094h"]'
    )
    assert status == 0
    assert "100 % = 1500 rpm = 60FFh 15000 (from rated_speed_rpm, velocity_unit = 0.1 rpm)" in output


def test_a_node_that_does_not_answer_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    status, output = _check(tmp_path, keys="[[axis]]\ndo_id = 2\nnode_id = 9\ntelegram = 1\nsdo_timeout_ms = 10")
    assert status == 1
    assert "DO 2: node 9: " in output, "the node is named once"
    assert "a drive that answers SDO" in output
    assert "DO 1, node 5: Servo drive" in output
    assert [item.getMessage() for item in caplog.records if item.name.startswith("canopen")] == []


def test_invalid_unit_is_rejected_with_its_key(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel="x", telegram=1, keys='velocity_unit = "knots"'))
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == 1
    assert "velocity_unit: 'knots'" in str(result.exception)


@pytest.mark.parametrize("objects", ["60A9", "6041h", "x"])
def test_ignored_object_without_a_unit_is_rejected(tmp_path: Path, objects: str) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel="x", telegram=1, keys=f'ignored_unit_objects = ["{objects}"]'))
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == 1
    assert "ignored_unit_objects" in str(result.exception)
    assert "608Fh" in str(result.exception), "what is allowed"


def test_an_object_missing_from_the_data_sheet_is_named_without_the_bus(tmp_path: Path) -> None:
    sheet = SHEETS["Trinamic TMCM-1230"]
    (tmp_path / "drive.eds").write_text(sheet.eds, encoding="ascii")
    keys = f'eds = "{tmp_path}/drive.eds"\n{sheet.keys}{POSITIONER}'
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel="bus", telegram=111, keys=keys))
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == 0, result.output
    assert [line for line in result.output.splitlines() if "not available" in line] == [
        "DO 1: Velocity Demand Value 606Bh not available: the bits for ramp completed and speed within tolerance are 0",
        "DO 1: Current Actual Value 6078h not available: the bit for torque below its threshold is 0",
    ]


def test_pdos_of_an_encoder_are_those_of_its_data_sheet(tmp_path: Path) -> None:
    objects = [
        replace(spec, entries=tuple(replace(item, access=Access.RO) for item in spec.entries))
        if spec.index in (0x1800, 0x1A00, 0x1A02)
        else spec
        for spec in encoder_objects(ROTARY)
    ]
    (tmp_path / "encoder.eds").write_text(write_eds(device_info(ROTARY), objects), encoding="ascii")
    file = tmp_path / "gateway.toml"
    table = f'[[encoder]]\ndo_id = 1\nnode_id = 5\ntelegram = 83\neds = "{tmp_path}/encoder.eds"\n'
    file.write_text(CONFIG.format(channel="bus", telegram=1, keys="").split("[[axis]]")[0] + table)
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == 0, result.output
    assert [line for line in result.output.splitlines() if line.startswith("DO")] == [
        "DO 1: TPDO1 185h: Position value 6004h; on change and by event timer; its own mapping; its own COB-ID",
        "DO 1: Speed value 6030h/1 not available in a PDO: the speed is the mean speed of the position",
    ]


@pytest.mark.parametrize(
    ("type_", "status", "said"),
    [
        (1, 0, "DO 1: TPDO1 185h: Statusword 6041h, Velocity Actual Value 606Ch; on SYNC"),
        (253, 1, "DO 1: telegram 1 is rejected: PDOs of the drive: 'no TPDO for Statusword 6041h' is not allowed"),
    ],
)
def test_drive_is_rejected_if_its_data_sheet_permits_no_plan(
    tmp_path: Path, type_: int, status: int, said: str
) -> None:
    tpdos = range(0x1800, 0x1805)
    objects = [
        replace(spec, entries=tuple(_fixed(item, type_) for item in spec.entries)) if spec.index in tpdos else spec
        for spec in drive_objects()
    ]
    (tmp_path / "drive.eds").write_text(write_eds(INFO, objects), encoding="ascii")
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel="bus", telegram=1, keys=f'eds = "{tmp_path}/drive.eds"'))
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == status, result.output
    assert any(line.startswith(said) for line in result.output.splitlines()), result.output


def _fixed(entry: Entry, type_: int) -> Entry:
    """A transmission type that cannot be written."""
    return replace(entry, access=Access.RO, default=type_) if entry.subindex == 2 else entry


@pytest.mark.parametrize(
    ("cycle_ms", "keys", "said"),
    [
        (8, "", ""),
        (4, "", "needs real-time priority on a busy machine (docs/operation.md); the log shows whether it is granted"),
    ],
)
def test_requirements_of_a_cycle_below_8_ms_are_printed(tmp_path: Path, cycle_ms: int, keys: str, said: str) -> None:
    file = tmp_path / "gateway.toml"
    head = f"{keys}[transport]\ncycle_time_ms = {cycle_ms}\n"
    file.write_text(head + CONFIG.format(channel=buses.channel(), telegram=1, keys=""))
    result = CliRunner().invoke(app, ["check", str(file)])
    assert result.exit_code == 0
    assert ("real-time" in result.output or "priority" in result.output) is bool(said)
    assert said in result.output
