"""Configuration files that are refused with a message, and those of positioner and PROFINET."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from ipaddress import IPv4Address
from pathlib import Path

import pytest

from pdgw.dsp402.units.mechanics import KEY_LINES, UnitKeys
from pdgw.dsp402.units.scaling import find_scaling
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.commissioning.telegram_check import lacks, missing_lines
from pdgw.gateway.configuration.file import load_config, parse_config
from pdgw.gateway.configuration.toml_file import DEPTH_MAX, FILE_MAX
from pdgw.gateway.motion.blocks import Block, BlockNext
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.station import IpSuite
from tests.support.drives.drive_types import described

# -- files made to exhaust a reader, in bounded time and memory ---------------------------------------------------


LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join([f'*{chr(97 + n)}'] * 10)}]\n" for n in range(12)
)


def is_refused_shortly(load: Callable[[Path], object], path: Path, text: str, message: str) -> None:
    path.write_text(text)
    with pytest.raises(GatewayError, match=message) as refused:
        load(path)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x" * (FILE_MAX + 1), f"longer than {FILE_MAX} bytes"),
        (f"a = {'[' * 50_000}{']' * 50_000}", "not valid TOML"),
        (f"a = {'[' * (DEPTH_MAX + 1)}{']' * (DEPTH_MAX + 1)}", f"nested deeper than {DEPTH_MAX} levels"),
        (f"{'.'.join(['a'] * 2000)} = 1", f"nested deeper than {DEPTH_MAX} levels"),
        (f"a = {'9' * 5000}", "not valid TOML"),
    ],
)
def test_toml_bombs(tmp_path: Path, text: str, message: str) -> None:
    is_refused_shortly(load_config, tmp_path / "bomb.toml", text, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUGHS, "anchors and aliases .* are not allowed"),
        ("a: &a\n  b: *a\n", "anchors and aliases .* are not allowed"),
        ("steps: " + "[" * 1500 + "]" * 1500, "nested too deeply|nested deeper"),
        ("steps: " + "[" * 40 + "]" * 40, "nested deeper than"),
        ("x" * (FILE_MAX + 1), f"longer than {FILE_MAX} bytes"),
    ],
)
def test_yaml_bombs(tmp_path: Path, text: str, message: str) -> None:
    is_refused_shortly(load_scenario, tmp_path / "bomb.yaml", text, message)


# -- keys that a drive lacks, all at once and as lines to paste ---------------------------------------------------


@pytest.mark.parametrize(
    ("number", "keys"),
    [
        (1, ("rated_speed_rpm", "velocity_unit")),
        (9, ("rated_speed_rpm", "velocity_unit", "rated_acceleration_rpm_s", "acceleration_unit")),
        (
            111,
            (
                "rated_speed_rpm",
                "velocity_unit",
                "rated_acceleration_rpm_s",
                "acceleration_unit",
                "counts_per_revolution",
            ),
        ),
    ],
)
def test_all_missing_keys_are_reported_at_once(number: int, keys: tuple[str, ...]) -> None:
    drive = replace(described("rpm"), scaling=find_scaling({}))
    text = lacks(drive, telegram(number))
    assert missing_lines(drive, telegram(number)) == tuple(KEY_LINES[key].text for key in keys)
    for key in keys:
        assert f"{key} = " in text, "fault 104 names it with its line"


def test_lines_to_paste_are_refused_until_they_are_filled_in() -> None:
    for key, line in KEY_LINES.items():
        with pytest.raises(GatewayError, match=key):
            parse_config(f'[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n{line.text}\n')


def test_with_the_reported_keys_nothing_is_missing() -> None:
    keys = UnitKeys(
        rated_speed_rpm=Fraction(3000),
        velocity_unit="rpm",
        counts_per_revolution=Fraction(4096),
        acceleration_unit="rpm/s",
        rated_acceleration=Fraction(3000),
    )
    drive = replace(described("rpm"), scaling=find_scaling({}, keys))
    assert [lacks(drive, telegram(number)) for number in (1, 9, 111)] == ["", "", ""]


# -- PROFINET -----------------------------------------------------------------------------------------------------


AXIS = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'
PROFINET = 'type = "profinet"\ninterface = "eth1"\n'
LABELS = "allowed: labels of 1..63 of a-z, 0-9, inner hyphens, with dots between"


@pytest.mark.parametrize(
    ("transport", "line"),
    [
        ('type = "profinet"', 'interface is missing: type = "profinet" needs it, for example "eth1"'),
        ('interface = "eth1"', 'interface: allowed only with type = "profinet"'),
        ('ip = "192.168.0.2/24"', 'ip: allowed only with type = "profinet"'),
        (PROFINET + 'router = "192.168.0.1"', "router: must be an address in the network of ip"),
        (PROFINET + 'ip = "192.168.0.2/24"\nrouter = "192.168.1.1"', "router: must be an address in the network"),
        (
            PROFINET + 'ip = "192.168.0.300/24"',
            "ip = '192.168.0.300/24': expected an IPv4 address with its prefix length such as",
        ),
        (PROFINET + 'ip = "192.168.0.0/24"', "ip = 192.168.0.0/24: allowed: a host's address below 224.0.0.0"),
        (PROFINET + 'ip = "192.168.0.255/24"', "ip = 192.168.0.255/24: allowed: a host's address below 224.0.0.0"),
        (PROFINET + 'ip = "127.0.0.1/8"', "ip = 127.0.0.1/8: allowed: a host's address below 224.0.0.0"),
        (
            PROFINET + 'ip = "192.168.0.2"\nrouter = "192.168.0.1"',
            """ip = '192.168.0.2': the prefix length is missing, such as "192.168.0.2/24" for the mask 255.255.255.0""",
        ),
        (PROFINET + 'device_name = "press"', "device_name: unknown key; did you mean station_name?"),
        (PROFINET + 'profinet_device_name = "press"', "unknown key; did you mean station_name?"),
        (PROFINET + 'ip_address = "192.168.0.2"', "ip_address: unknown key; did you mean ip?"),
        (PROFINET + 'subnet_mask = "255.255.255.0"', "subnet_mask: unknown key; did you mean ip with its prefix"),
        (PROFINET + 'router_address = "192.168.0.1"', "router_address: unknown key; did you mean router?"),
        (PROFINET + "update_time_ms = 4", "update_time_ms: unknown key; did you mean cycle_time_ms?"),
        (PROFINET + "watchdog_time_ms = 12", "watchdog_time_ms: unknown key; did you mean watchdog_factor, a number"),
        (PROFINET + 'station_name = "Press_1"', f"station_name = 'Press_1': {LABELS}"),
        ('station_name = "press"', 'station_name: allowed only with type = "profinet"'),
        (PROFINET + 'station_name = "."', f"station_name = '.': {LABELS}"),
        (PROFINET + 'station_name = "port-001.press"', "allowed: a first label other than a port name (port-001)"),
        (PROFINET + 'station_name = "10.0.0.1"', "station_name = '10.0.0.1': allowed: no IP address"),
        (PROFINET + f'station_name = "{"a." * 120}a"', "allowed: at most 240"),
    ],
)
def test_a_transport_that_makes_no_sense_is_refused_with_what_is_allowed(transport: str, line: str) -> None:
    with pytest.raises(GatewayError) as error:
        parse_config(f"[transport]\n{transport}\n{AXIS}", "x.toml")
    assert "[transport]" in str(error.value)
    assert line in str(error.value)


def test_a_fixed_address_has_its_mask_and_router() -> None:
    fixed = 'ip = "10.1.2.3/16"\nrouter = "10.1.0.1"\n'
    suite = parse_config(f"[transport]\n{PROFINET}{fixed}{AXIS}").transport.ip_suite
    assert suite == IpSuite(IPv4Address("10.1.2.3"), IPv4Address("255.255.0.0"), IPv4Address("10.1.0.1"))
    assert parse_config(f"[transport]\n{PROFINET}{AXIS}").transport.ip_suite is None


def test_a_station_without_a_name_waits_for_one() -> None:
    assert not parse_config(f'[transport]\n{PROFINET}station_name = ""\n{AXIS}').transport.station_name


# -- positioner ---------------------------------------------------------------------------------------------------


BASE = """\
[can]
interface = "virtual"
channel = "x"
[[axis]]
do_id = 1
node_id = 1
telegram = 111
[axis.positioner]
lu_per_revolution = 10000
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
software_limits = [-5, 9]
homing_method = 35
[[axis.block]]
number = 1
position = 5000
velocity = 300
next = "continue-with-stop"
[[axis.block]]
number = 2
task = "wait"
value = 10
"""


def test_all_keys_reach_the_axis() -> None:
    choices = parse_config(BASE).axis[0].settings_at(4).positioner
    assert choices is not None
    assert (choices.lu_per_revolution, choices.software_limits, choices.homing_method) == (10_000, (-5, 9), 35)
    assert choices.jog_velocities == (-300, 300)
    assert choices.blocks[0] == Block(1, 5000, 300, next=BlockNext.CONTINUE_WITH_STOP)
    assert len(choices.blocks) == 2
    assert choices.modulo == 0
    rotary = parse_config(BASE.replace("software_limits = [-5, 9]", "modulo_range = 360")).axis[0].settings_at(4)
    assert rotary.positioner is not None
    assert rotary.positioner.modulo == 360


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        (
            "lu_per_revolution = 10000\n",
            "",
            ["x.toml:8", "[[axis]] number 1", "positioner.lu_per_revolution", "missing"],
        ),
        ("max_velocity = 30000", "max_velocity = 0", ["x.toml:10", "positioner.max_velocity = 0", "1 to"]),
        ("software_limits = [-5, 9]", "software_limits = [9, 9]", ["software_limits = [9, 9]", "below"]),
        ("value = 10", "value = -1", ["value = -1"]),
        (
            "software_limits = [-5, 9]",
            "software_limits = [-5, 9]\nmodulo_range = 360",
            ["software_limits: not allowed with modulo_range"],
        ),
        (
            "software_limits = [-5, 9]",
            "reference_coordinate = 360\nmodulo_range = 360",
            ["reference_coordinate = 360: allowed 0 to 359"],
        ),
        (
            "homing_method = 35",
            "modulo_correction = true",
            ["positioner.modulo_correction: was removed in 0.9.0: modulo_range"],
        ),
        ("5000\nvelocity = 300", "5000\nvelocity = 0", ["block 1: velocity = 0 is not allowed"]),
        (
            'task = "wait"\nvalue = 10',
            'task = "fixed-stop"\nvalue = 1001\nvelocity = 5',
            ["block 2: value = 1001 is not allowed, expected 1..1000"],
        ),
        ('task = "wait"', 'task = "jump"', ["task = 'jump'", "'position', 'wait', 'goto'"]),
        ("number = 2", "number = 3", ["block 1: continues with block 2, which is missing"]),
        ("position_window", "position_windov", ["position_windov", "did you mean position_window"]),
    ],
)
def test_what_is_wrong_is_reported_with_its_place(old: str, new: str, parts: list[str]) -> None:
    assert old in BASE
    with pytest.raises(GatewayError) as error:
        parse_config(BASE.replace(old, new, 1), "x.toml")
    for part in parts:
        assert part in str(error.value), str(error.value)


@pytest.mark.parametrize("number", [7, 110, 111])
def test_a_positioning_telegram_needs_the_positioner(number: int) -> None:
    text = BASE[: BASE.index("[axis.positioner]")].replace("111", str(number))
    with pytest.raises(GatewayError, match=rf"telegram = {number} needs \[axis.positioner\]"):
        parse_config(text)
