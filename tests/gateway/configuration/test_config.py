"""The configuration: its fixed keys, and messages that name key, line, value and what is allowed."""

from __future__ import annotations

import enum
import re
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import pytest
from can.interfaces import BACKENDS
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from pdgw.base.durations import SECOND
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.dsp406.device import eds_path
from pdgw.dsp406.kinds import ROTARY
from pdgw.gateway.axis.settings import ControlLost, PlcLossReaction, SetpointEnable
from pdgw.gateway.axis.telegrams import (
    CENTRAL_TELEGRAM_NUMBERS,
    DRIVE_TELEGRAM_NUMBERS,
    DSC_TELEGRAM_NUMBERS,
    ENCODER_TELEGRAM_NUMBERS,
    POSITIONER_TELEGRAM_NUMBERS,
)
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.identity import DEVICE_ID, VENDOR_ID
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.check import references_wrong
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.defaults import example
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.environment import TraceConfig, TransportConfig
from pdgw.gateway.configuration.file import load_config, parse_config, simulated
from pdgw.gateway.configuration.positioner_config import BlockConfig, PositionerConfig
from pdgw.gateway.configuration.web import MqttConfig, WebConfig
from pdgw.peers.drive.objects import EDS_PATH
from pdgw.profidrive.telegrams import TELEGRAMS

BASE = """\
[can]
interface = "socketcan"
channel = "can0"
bitrate = 1000000

[transport]
type = "udp"
listen = "127.0.0.1"
cyclic_port = 34962
acyclic_port = 34964
cycle_time_ms = 4
watchdog_factor = 3
peer = "127.0.0.1"

[[axis]]
do_id = 1
node_id = 3
telegram = 9
on_plc_loss = "ramp"
setpoint_enable = "profidrive"
modulo_axis = true
simulate = true
"""


def test_every_fixed_key_is_taken() -> None:
    config = parse_config(BASE)
    axis = config.axis[0]
    assert (config.can[0].interface, config.can[0].channel, config.can[0].bitrate) == ("socketcan", "can0", 1_000_000)
    assert (config.transport.cyclic_port, config.transport.acyclic_port) == (34962, 34964)
    assert (str(config.transport.peer), config.transport.watchdog_factor) == ("127.0.0.1", 3)
    assert (axis.do_id, axis.node_id, axis.telegram) == (1, 3, 9)
    assert axis.on_plc_loss is PlcLossReaction.RAMP
    assert axis.setpoint_enable is SetpointEnable.PROFIDRIVE
    assert axis.modulo_axis
    assert axis.simulate


def test_defaults_are_those_of_the_documentation() -> None:
    config = parse_config('[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n')
    assert (config.transport.cyclic_port, config.transport.acyclic_port) == (34962, 34964)
    assert config.transport.watchdog_factor == 3
    assert config.axis[0].on_plc_loss is PlcLossReaction.QUICK_STOP
    assert config.axis[0].setpoint_enable is SetpointEnable.PROFIDRIVE
    assert config.axis[0].control_lost is ControlLost.STOP


def keys(model: type[BaseModel]) -> Iterator[str]:
    """The keys of a table and of the tables in it."""
    for key, field in model.model_fields.items():
        yield key
        inner = [field.annotation]
        while inner:
            annotation = inner.pop()
            inner += get_args(annotation)
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                yield from keys(annotation)


def test_the_example_is_valid_and_names_every_key() -> None:
    parse_config(example())
    words = set(re.findall(r"\w+", example()))
    assert [key for key in keys(GatewayConfig) if key not in words] == []


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("telegram = 1                 # one of ", DRIVE_TELEGRAM_NUMBERS),
        ("telegram = 83              # one of ", ENCODER_TELEGRAM_NUMBERS),
        ('# dsc = "position"           # telegrams ', DSC_TELEGRAM_NUMBERS),
        ("# Telegrams ", POSITIONER_TELEGRAM_NUMBERS),
        ("set-points too", [n for n in CENTRAL_TELEGRAM_NUMBERS if n not in DSC_TELEGRAM_NUMBERS]),
    ],
)
def test_the_example_lists_the_telegrams_of_the_declarations(text: str, numbers: Sequence[int]) -> None:
    (line,) = (line for line in example().splitlines() if text in line)
    assert re.search(rf"\b{', '.join(map(str, numbers))}(?!,? ?\d)", line)


def test_the_example_has_the_bit_rate_and_the_identity_of_the_declarations() -> None:
    document = tomllib.loads(example().replace("# vendor_id", "vendor_id").replace("# device_id", "device_id"))
    assert document["can"]["bitrate"] == DEFAULT_BITRATE
    assert (document["transport"]["vendor_id"], document["transport"]["device_id"]) == (VENDOR_ID, DEVICE_ID)
    assert f"{VENDOR_ID} is not assigned" in example()


def test_further_keys_of_can_go_to_the_interface() -> None:
    config = parse_config(BASE.replace("bitrate = 1000000", "bitrate = 500000\nreceive_own_messages = true"))
    assert config.can[0].extra == {"receive_own_messages": True}


def test_several_buses_are_chosen_by_name() -> None:
    text = """
[[can]]
name = "left"
interface = "virtual"
channel = "l"
[[can]]
name = "right"
interface = "virtual"
channel = "r"
[[axis]]
do_id = 1
node_id = 1
telegram = 1
can = "right"
[[axis]]
do_id = 2
node_id = 1
telegram = 1
can = "left"
"""
    config = parse_config(text)
    assert [config.bus_of(axis).name for axis in config.axis] == ["right", "left"]


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("node_id = 3", "node_id = 300", ["x.toml:17", "node_id = 300", "127"]),
        ('on_plc_loss = "ramp"', 'on_plc_loss = "wait"', ["x.toml:19", "'wait'", "'ramp', 'quick-stop' or 'coast'"]),
        ("cycle_time_ms = 4", "cycle_tim_ms = 4", ["x.toml:11", "cycle_tim_ms", "did you mean cycle_time_ms"]),
        (
            "cycle_time_ms = 4",
            "switchover_ms = 300",
            ["x.toml:11: [transport] switchover_ms: was removed in 0.9.0: system redundancy"],
        ),
        (
            "node_id = 3",
            "node_id = 3\nsdo_interval_ms = 5",
            ["x.toml:18: [[axis]] number 1 sdo_interval_ms: was removed in 0.9.0"],
        ),
        ("cycle_time_ms = 4", "cycle_time_ms = 0.01", ["x.toml:11", "cycle_time_ms = 0.01", "0.25"]),
        ('listen = "127.0.0.1"', 'listen = "here"', ["x.toml:8", "'here'", "IPv4"]),
        ("do_id = 1\n", "", ["do_id", "is missing"]),
        ("[[axis]]", "[[axes]]", ["axes", "unknown key", "did you mean axis"]),
        ("simulate = true", "eds = 7", ["eds = 7"]),
        ("bitrate = 1000000", "bitrate = 3", ["x.toml:4", "bitrate = 3"]),
        ("simulate = true", 'can = "other"', ['can = "other"', "allowed: ['can']"]),
        ("[transport]", "[transport", ["not valid TOML", "x.toml:6: [transport"]),
        ("telegram = 9", "telegram = true", ["x.toml:18", "telegram = True", "integer"]),
        ("node_id = 3", 'node_id = "3"', ["x.toml:17", "node_id = '3'", "integer"]),
        ("cycle_time_ms = 4", "cycle_time_ms = nan", ["x.toml:11", "cycle_time_ms = nan"]),
        ("cycle_time_ms = 4", "cycle_time_ms = true", ["x.toml:11", "cycle_time_ms = True"]),
        ("modulo_axis = true", 'modulo_axis = "yes"', ["x.toml:21", "modulo_axis = 'yes'", "boolean"]),
        ('channel = "can0"', 'chanel = "can0"', ["chanel: unknown key", "did you mean channel?"]),
        ("acyclic_port = 34964", "acyclic_port = 34962", ["cyclic_port and acyclic_port are both 34962"]),
        ("[can]", "store = 7\n[can]", ["x.toml:1", "store = 7"]),
        ("[can]", "can = 7\n[cam]", ["can"]),
        (
            'listen = "127.0.0.1"',
            'ip = "192.168.0.2"',
            ["x.toml:8: [transport] ip = '192.168.0.2'", '"192.168.0.2/24"'],
        ),
        ('listen = "127.0.0.1"', 'ip = "here"', ["ip = 'here'", "an IPv4 address with its prefix length"]),
        ('listen = "127.0.0.1"', 'device_name = "a"', ["device_name: unknown key; did you mean station_name?"]),
        (
            "[transport]",
            "[web]\nport = 80\n[transport]",
            ["[web] port: unknown key; did you mean listen with its port"],
        ),
        (
            "[transport]",
            "[web]\nusername = 80\n[transport]",
            ["username: unknown key (allowed: listen, token_file, hosts, tls_cert); did you mean username in [mqtt]?"],
        ),
        ("node_id = 3", "node_id = 3\ninvert = true", ["invert: unknown key; did you mean polarity 607Eh"]),
        ("node_id = 3", "node_id = 3\nxyz = true", ["xyz: unknown key (allowed: do_id, name, node_id, ", "family, "]),
    ],
)
def test_bad_input_is_rejected_with_place_value_and_what_is_allowed(old: str, new: str, parts: list[str]) -> None:
    assert old in BASE
    with pytest.raises(GatewayError) as error:
        parse_config(BASE.replace(old, new, 1), "x.toml")
    for part in parts:
        assert part in str(error.value), str(error.value)


@pytest.mark.parametrize("number", sorted({*TELEGRAMS, 113, 0} - {*DRIVE_TELEGRAM_NUMBERS}))
def test_a_telegram_no_drive_axis_supports_is_refused_however_well_it_can_be_decoded(number: int) -> None:
    with pytest.raises(GatewayError) as error:
        parse_config(BASE.replace("telegram = 9", f"telegram = {number}"), "x.toml")
    assert f"telegram = {number} is not supported, allowed: {list(DRIVE_TELEGRAM_NUMBERS)}" in str(error.value)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("do_id = 1", "do_id: 1 is used twice"),
        ("node_id = 3", r"node_id on bus can: 3 .* further axes of a device \(6800h\)"),
    ],
)
def test_a_number_used_twice_is_refused(key: str, message: str) -> None:
    second = "[[axis]]\ndo_id = 2\nnode_id = 4\ntelegram = 1\n".replace(
        "do_id = 2" if "do" in key else "node_id = 4", key
    )
    with pytest.raises(GatewayError, match=message):
        parse_config(BASE + second)


def test_a_bus_that_cannot_carry_its_axes_is_refused_with_numbers() -> None:
    axes = "".join(f"[[axis]]\ndo_id = {n}\nnode_id = {n}\ntelegram = 100\n" for n in range(1, 13))
    head = BASE.split("[[axis]]", maxsplit=1)[0].replace("cycle_time_ms = 4", "cycle_time_ms = 1")
    with pytest.raises(GatewayError, match=r"worst-case load of bus can.*frames/s"):
        parse_config(head + axes)


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "a = " + "1" * 5000, "\0", "a = 1\na = 2"])
def test_hostile_toml_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(GatewayError, match="not valid TOML"):
        parse_config(text)


def test_one_bus_cannot_be_two() -> None:
    bus = '[[can]]\nname = "{}"\ninterface = "socketcan"\nchannel = "can0"\n'
    axis = '[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\ncan = "a"\n'
    with pytest.raises(GatewayError, match=r"interface and channel.*used twice"):
        parse_config(bus.format("a") + bus.format("b") + axis)


ENCODER = "[[encoder]]\ndo_id = {}\nnode_id = {}\ntelegram = 83\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            BASE.replace("acyclic_port = 34964", "acyclic_port = 34962"),
            "x.toml:10: [transport]: cyclic_port and acyclic_port",
        ),
        (
            "\n\n" + BASE.replace("telegram = 9", "telegram = 1\ng1 = 2") + ENCODER.format(2, 7),
            "x.toml:21: [[axis]] number 1: g1 = 2: telegram 1 has no G1, allowed with telegram [3, 4, 102, 103]",
        ),
        (
            BASE.replace("telegram = 9", 'telegram = 105\ndsc = "speed"\nfollowing_window = 1000\ng1 = 2')
            + ENCODER.format(2, 7),
            "x.toml:21: [[axis]] number 1: g1 = 2: telegram 105 closes its position loop in the drive (DSC), "
            "allowed with telegram [3, 4, 102, 103]",
        ),
        (
            BASE.replace("telegram = 9", "telegram = 3\ng1 = 5") + ENCODER.format(2, 7),
            "x.toml:19: [[axis]] number 1: g1 = 5 is not the do_id of an [[encoder]], allowed: [2]",
        ),
        (
            BASE.replace("telegram = 9", "telegram = 3\ng2 = 2") + ENCODER.format(2, 7),
            "x.toml:19: [[axis]] number 1: g2 = 2: telegram 3 has no G2, allowed with telegram [4, 6, 103, 106]",
        ),
        (
            BASE.replace("telegram = 9", 'telegram = 3\ng2 = "drive"'),
            "x.toml:19: [[axis]] number 1: g2 = drive: telegram 3 has no G2, allowed with telegram [4, 6, 103, 106]",
        ),
        (
            BASE.replace("telegram = 9", "telegram = 4\ng2 = 5") + ENCODER.format(2, 7),
            "x.toml:19: [[axis]] number 1: g2 = 5 is not the do_id of an [[encoder]], allowed: [2]",
        ),
        (
            BASE.replace("telegram = 9", "telegram = 4\ng1 = 2\ng2 = 2") + ENCODER.format(2, 7),
            "x.toml:20: [[axis]] number 1: g2 = 2 is already used by g1; one encoder has one control word: set another encoder",
        ),
        (
            BASE.replace("telegram = 9", 'telegram = 4\ng2 = "motor"'),
            "x.toml:19: [[axis]] number 1 g2 = 'motor': allowed: 'drive'",
        ),
        (BASE + ENCODER.format(1, 7), "x.toml:24: [[encoder]] number 1: do_id: 1 is used twice"),
        (BASE + ENCODER.format(2, 3), "x.toml:25: [[encoder]] number 1: node_id on bus can: 3 is used twice"),
        (
            BASE.replace("node_id = 3", "node_id = 127"),
            "x.toml:17: [[axis]] number 1: node_id = 127 is that of the gateway on bus can; set another [can] node_id",
        ),
        (
            BASE.replace("[can]", "[can]\nnode_id = 7") + ENCODER.format(2, 7),
            "x.toml:26: [[encoder]] number 1: node_id = 7 is that of the gateway on bus can; set another [can] node_id",
        ),
        (BASE.replace("[can]", "[can]\nnode_id = 128"), "x.toml:2: [[can]] number 1 node_id = 128: allowed: 1 to 127"),
        (BASE.replace("simulate = true", 'can = "b"'), 'x.toml:22: [[axis]] number 1: can = "b" is not the name of'),
        (BASE.split("[[axis]]", maxsplit=1)[0], "x.toml: [[axis]] or [[encoder]]: at least one is needed"),
    ],
)
def test_keys_that_contradict_are_rejected_with_their_place(text: str, line: str) -> None:
    with pytest.raises(GatewayError) as error:
        parse_config(text, "x.toml")
    assert str(error.value).startswith(line), str(error.value)


def test_p922_offers_no_dsc_where_g1_is_an_encoder() -> None:
    dsc = BASE.replace("telegram = 9", 'telegram = 3\ndsc = "speed"\nfollowing_window = 1000')
    with_encoder = dsc.replace("telegram = 3", "telegram = 3\ng1 = 2") + ENCODER.format(2, 7)
    alone, together = (parse_config(text).axis[0].telegrams for text in (dsc, with_encoder))
    assert set(alone) - set(together) == {5, 6, 105, 106}
    assert set(together) <= set(alone)


def test_a_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_bytes(b"\xef\xbb\xbf" + BASE.encode())
    assert load_config(path).axis[0].do_id == 1
    path.write_bytes(BASE.encode("utf-16"))
    with pytest.raises(GatewayError, match=r"c\.toml: cannot be read: byte 0 is not UTF-8; save the file as UTF-8"):
        load_config(path)


def test_a_table_that_occurs_twice_is_rejected_with_the_right_syntax() -> None:
    text = BASE.replace("[[axis]]", "[axis]")
    with pytest.raises(GatewayError, match=r"twice.*; write \[\[axis\]\] before each"):
        parse_config(text + text.split("[axis]")[1].join(("[axis]", "")))


def test_the_error_names_the_range_of_a_key() -> None:
    for old, new, told in (
        ("node_id = 3", "node_id = 0", "node_id = 0: allowed: 1 to 127"),
        ("node_id = 3", 'node_id = "x"', "node_id = 'x': expected an integer, allowed: 1 to 127"),
        ("bitrate = 1000000", "bitrate = 7", "bitrate = 7: allowed: 10000 to 1000000"),
        ('on_plc_loss = "ramp"', "on_plc_loss = 1", "on_plc_loss = 1: allowed: 'ramp', 'quick-stop' or 'coast'"),
    ):
        with pytest.raises(GatewayError) as error:
            parse_config(BASE.replace(old, new), "x.toml")
        assert str(error.value).endswith(told)


RUBBISH = "\n".join(["[DeviceInfo]", "VendorName=nobody"])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            '"socketcan"',
            '"soketcan"',
            "c.toml:2: [[can]] number 1 interface = 'soketcan': not an interface of python-can; did",
        ),
        (
            '"socketcan"',
            '"nican"',
            "c.toml:2: [[can]] number 1 interface = 'nican': works only on Windows, with its driver: NI-CAN",
        ),
        ("simulate = true", 'eds = "r.eds"', "c.toml:22: [[axis]] number 1 eds = "),
    ],
)
def test_what_a_configuration_refers_to_is_checked(old: str, new: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "r.eds").write_text(RUBBISH)
    path = tmp_path / "c.toml"
    path.write_text(BASE.replace(old, new))
    (line,) = references_wrong(load_config(path), path)
    assert told in line
    path.write_text(BASE)
    assert references_wrong(load_config(path), path) == []


def test_a_data_sheet_of_another_kind_of_device_is_refused_in_the_words_of_the_start(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    encoder = ENCODER.format(2, 7) + f'eds = "{EDS_PATH}"\n'
    path.write_text(BASE.replace("simulate = true", f'eds = "{eds_path(ROTARY)}"') + encoder)
    drive, other = references_wrong(load_config(path), path)
    assert drive.endswith("is not a data sheet of a drive with object 6040h")
    assert other.endswith("is not a data sheet of an encoder with object 6004h or 6020h")


def test_an_interface_whose_driver_is_not_installed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BACKENDS, "acme", ("acme_can_driver", "AcmeBus"))
    path = tmp_path / "c.toml"
    path.write_text(BASE.replace('"socketcan"', '"acme"'))
    (line,) = references_wrong(load_config(path), path)
    assert "interface = 'acme': the driver cannot be loaded on this machine" in line
    assert "acme_can_driver" in line


def test_the_packages_own_data_sheets_pass(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    encoder = ENCODER.format(2, 7) + f'eds = "{eds_path(ROTARY)}"\n'
    path.write_text(BASE.replace("simulate = true", f'eds = "{EDS_PATH}"') + encoder)
    assert references_wrong(load_config(path), path) == []


def test_every_mistake_has_its_line() -> None:
    text = BASE.replace("node_id = 3", "node_id = 300").replace("cycle_time_ms = 4", "cycle_time_ms = 0")
    with pytest.raises(GatewayError) as error:
        parse_config(text, "x.toml")
    assert [line.split(" ")[0] for line in str(error.value).splitlines()] == ["x.toml:11:", "x.toml:17:"]


def test_relative_files_are_beside_the_configuration(tmp_path: Path) -> None:
    (tmp_path / "drive.eds").write_text("")
    path = tmp_path / "c.toml"
    path.write_text('store = "p.json"\n' + BASE.replace("simulate = true", 'eds = "drive.eds"'))
    config = load_config(path)
    assert config.axis[0].eds == tmp_path / "drive.eds"
    assert config.store == tmp_path / "p.json"


def test_a_long_cycle_does_not_silence_the_drive() -> None:
    """The inhibit time stays below the time after which a silent drive is lost."""
    config = parse_config(BASE.replace("cycle_time_ms = 4", "cycle_time_ms = 512"))
    settings = config.axis[0].drive_settings(9, 512)
    assert settings.tpdo_inhibit_us <= settings.tpdo_event_ms * 1000


@pytest.mark.parametrize(
    ("keys", "expected"), [("", 2000), ("sdo_timeout_ms = 5000", 5000), ("sdo_timeout_ms = 20", 2000)]
)
def test_a_parameter_request_may_last_as_long_as_the_slowest_sdo(keys: str, expected: int) -> None:
    assert parse_config(BASE.replace("simulate = true", keys)).parameter_timeout_ms == expected


def test_missing_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match=r"none\.toml: cannot be read"):
        load_config(tmp_path / "none.toml")
    path = tmp_path / "c.toml"
    path.write_text(BASE.replace("simulate = true", 'eds = "nowhere.eds"'))
    with pytest.raises(GatewayError, match=r"c.toml:22: \[\[axis\]\] number 1 eds = '.*nowhere\.eds': not a file"):
        load_config(path)


def _shown(head: str, further: frozenset[str]) -> dict[str, object]:
    """The keys of one table of the example with their values, also commented ones, up to the next table."""
    part = re.split(rf"\n{re.escape(head)}(?: *#.*)?\n", example())[1].partition("\n[")[0].partition("\n# [")[0]
    lines = (line.removeprefix("# ") for line in part.splitlines() if re.match(r"(# )?[a-z]\w* = ", line))
    return {key: value for line in lines for key, value in tomllib.loads(line).items() if key not in further}


@pytest.mark.parametrize(
    ("head", "section", "further"),
    [
        ("[transport]", TransportConfig, {"vendor_id", "device_id", "listen"}),
        ("[[axis]]", AxisConfig, set()),
        ("# [trace]", TraceConfig, {"keep"}),
        ("# [web]", WebConfig, {"hosts"}),
        ("# [mqtt]", MqttConfig, {"tls"}),
        ("# [axis.positioner]", PositionerConfig, {"modulo_range"}),
        ("# [[axis.block]]", BlockConfig, {"position", "velocity"}),
        ("# [[encoder]]", EncoderConfig, set()),
    ],
)
def test_the_example_shows_a_key_that_has_a_default_with_its_default(
    head: str, section: type[BaseModel], further: set[str]
) -> None:
    """``type`` is in the example twice; a key without a default shows its allowed values."""
    shown = _shown(head, frozenset({*further, "type", "family"}))
    defaults = {key: field.default for key, field in section.model_fields.items()}
    compared = {key: value for key, value in shown.items() if defaults[key] not in {None, "", PydanticUndefined}}
    assert compared
    for key, value in compared.items():
        default = defaults[key]
        default = default.value if isinstance(default, enum.Enum) else default
        default = list(default) if isinstance(default, tuple) else default
        assert value == (default * 100 if key == "standstill_window_percent" else default), key


def test_enter_ms_is_the_time_in_which_a_drive_follows_an_on() -> None:
    for key, seconds in (("", 10), ("enter_ms = 20_000", 20)):
        assert parse_config(BASE + key).axis[0].settings_at(4).enter_ns == seconds * SECOND


@pytest.mark.parametrize("value", ["999", "600_001", "10.5", '"10 s"'])
def test_enter_ms_out_of_range_is_refused_with_its_name(value: str) -> None:
    with pytest.raises(GatewayError, match="enter_ms"):
        parse_config(f"{BASE}enter_ms = {value}\n")


@given(text=st.text(max_size=200))
def test_arbitrary_text_is_refused_with_the_packages_error(text: str) -> None:
    with pytest.raises(GatewayError):
        parse_config(text)


@pytest.mark.parametrize("number", [1, 2, 3, 9, 20, 100])
def test_the_simulated_configuration_has_the_axes_asked_for(number: int) -> None:
    config = simulated([number] * 3)
    assert [axis.telegram for axis in config.axis] == [number] * 3
    assert all(axis.simulate for axis in config.axis)


@pytest.mark.parametrize(
    ("keys", "silence_ms"), [("", 100), ("heartbeat_ms = 500\n", 500), ("tpdo_event_ms = 50\n", 200)]
)
def test_an_encoder_is_silent_after_100_ms_a_heartbeat_or_four_positions(keys: str, silence_ms: int) -> None:
    text = f'[can]\ninterface = "virtual"\n[[encoder]]\ndo_id = 1\nnode_id = 1\ntelegram = 83\n{keys}'
    settings = parse_config(text).encoder[0].settings((1,), 4)
    assert settings.tpdo_event_ms * settings.tpdo_timeout_factor == silence_ms
    assert settings.cycle_ms == 4


def test_simulated_encoders_sit_on_the_shafts_of_the_axes() -> None:
    config = simulated([1] * 2, 3, 84)
    assert [(item.do_id, item.node_id, item.motion) for item in config.encoder] == [
        (3, 3, "shaft=1"),
        (4, 4, "shaft=2"),
        (5, 5, "shaft=1"),
    ]
    assert all(item.simulate and item.telegram == 84 for item in config.encoder)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([113],), "telegram = 113 is not supported, allowed"),
        (([1], 1, 9), "telegram = 9 is not supported, allowed: [81, 82, 83, 84]"),
        (([100] * 32, 32, 84), "1440"),
    ],
)
def test_what_cannot_be_simulated_is_rejected_in_one_line(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(GatewayError) as caught:
        simulated(*arguments)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
