"""``pdgw config check``: with ``--bus`` it shows the 100 % values of the drives that answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from pdgw.peers.drive import SimulatedDrive
from pdgw.tools.commands.commissioning.config import app
from tests.support import buses
from tests.support.drives.data_sheets import SHEETS
from tests.support.gateways.daemon import POSITIONER

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


def _check(tmp_path: Path, telegram: int = 1, keys: str = "") -> tuple[int, str]:
    channel = buses.channel()
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG.format(channel=channel, telegram=telegram, keys=keys))
    drive = SimulatedDrive(buses.bus(channel), 5)
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
    assert result.output.splitlines()[1:3] == [
        "DO 1: Velocity Demand Value 606Bh not available: the bits for ramp completed and speed within tolerance are 0",
        "DO 1: Current Actual Value 6078h not available: the bit for torque below its threshold is 0",
    ]


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
