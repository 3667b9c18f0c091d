"""Mistakes in a good file: each error names line, value and what is allowed, in at most six lines of a terminal."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from math import ceil

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import parse_config

GOOD = """\
name = "press 3"
[can]
interface = "virtual"
channel = "x"
bitrate = 1000000
[transport]
type = "udp"
listen = "192.168.0.2"
peer = "192.168.0.10"
cycle_time_ms = 4
watchdog_factor = 3
[parameters]
write_from = ["192.168.0.10", "192.168.0.64/28"]
[trace]
seconds = 120
keep = ["fault", "stop"]
[web]
listen = "127.0.0.1:8420"
hosts = ["gateway.plant"]
[mqtt]
host = "broker.plant"
topic = "pdgw"
[[axis]]
do_id = 1
name = "feed"
node_id = 1
telegram = 111
on_plc_loss = "ramp"
stop_time_ms = 10000
standstill_window_percent = 1
velocity_unit = "0.1 rpm"
gear = "10/1"
sync = false
[axis.positioner]
lu_per_revolution = 10000
max_velocity = 30000
max_acceleration = 2000
max_deceleration = 2000
position_window = 20
jog_velocities = [-300, 300]
homing_method = 35
[[axis.block]]
number = 1
position = 50000
velocity = 12000
next = "end"
[[axis]]
do_id = 2
node_id = 2
telegram = 1
jog_speeds_rpm = [-100, 100]
[[encoder]]
do_id = 3
node_id = 10
telegram = 83
model = "rotary"
"""
LINES = GOOD.splitlines()
KEYS = [number for number, line in enumerate(LINES) if "=" in line]
WIDTH = 100
FOREIGN = re.compile(r"Input |should (match|have)|Extra inputs|Field required|Invalid literal|at line")
"""Words of pydantic and tomllib."""


def error_of(text: str) -> str:
    """The error of a file; empty if it is valid."""
    try:
        parse_config(text, "g.toml")
    except GatewayError as error:
        return str(error)
    return ""


def with_line(number: int, *lines: str) -> str:
    return "\n".join([*LINES[:number], *lines, *LINES[number + 1 :]]) + "\n"


def misspelt(number: int) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """Two letters exchanged, one left out, one too many."""
    key, _, value = LINES[number].partition(" = ")
    if LINES[number - 1] == "[can]" or key in {"do_id", "ip"}:
        return  # further keys are those of the interface; the name is too short
    for wrong in (key[0] + key[2] + key[1] + key[3:], key[:-1], key + "s"):
        if wrong != key:
            yield with_line(number, f"{wrong} = {value}"), number, (wrong, f"did you mean {key}?")


def misplaced(number: int) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """A key in a table that does not have it."""
    for header, key in (
        ("[transport]", "do_id = 1"),
        ("[web]", "cycle_time_ms = 4"),
        ("[[encoder]]", "max_velocity = 4"),
    ):
        if LINES[number - 1] == header:
            name = key.split(" ")[0]
            where = {
                "do_id": "[axis] or in [encoder]",
                "cycle_time_ms": "[transport]",
                "max_velocity": "[axis.positioner]",
            }
            yield with_line(number, key, LINES[number]), number, (name, f"did you mean {name} in {where[name]}?")


def of_another_kind(number: int) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """A value of another type, beyond its range, or of another form."""
    key, _, value = LINES[number].partition(" = ")
    for wrong in (
        '"?#"',
        "true",
        "-1",
        "1e99",
        "99999999999",
        "nan",
        "[]",
        "[7]",
        '""',
        "{}",
        f"{value[:-1]}x{value[-1]}",
    ):
        yield with_line(number, f"{key} = {wrong}"), number, (key,)


def unquoted(number: int) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """A text without quotation marks."""
    key, _, value = LINES[number].partition(" = ")
    if value.startswith('"'):
        yield with_line(number, f"{key} = {value.strip(chr(34))}"), number, (f"{key} = {value}",)


def not_toml(number: int) -> Iterator[tuple[str, int, tuple[str, ...]]]:
    """What people write who know other formats."""
    key, _, value = LINES[number].partition(" = ")
    if value.isdigit():
        yield with_line(number, f"{key} = 0{value}"), number, (f"{key} = 0{value}", "zero")
        yield with_line(number, f"{key} = {value},5"), number, (f"{key} = {value},5", "point")
    if value == "false":
        yield with_line(number, f"{key} = True"), number, (f"{key} = True", "lower case")
    yield with_line(number, f"{key}: {value}"), number, (f"{key}: {value}", "key = value")
    yield with_line(number, f"{key} = {value}", f"{key} = {value}"), number + 1, (key, "twice")
    yield with_line(number, f"{key} ="), number, (f"{key} =", "value")
    if value[-1] == '"':
        yield with_line(number, f"{key} = {value[:-1]}"), number, (value[:-1], "quotation mark")
        yield with_line(number, f"{key} = {value[1:]}"), number, (value[1:], "quotation mark")
        yield with_line(number, f"{key} = '{value[1:-1]}"), number, (value[1:-1], "quotation mark")


@pytest.mark.parametrize("mutations", [misspelt, misplaced, of_another_kind, unquoted, not_toml])
def test_error_names_line_value_and_what_is_allowed(
    mutations: Callable[[int], Iterator[tuple[str, int, tuple[str, ...]]]],
) -> None:
    assert not error_of(GOOD)
    wrong = []
    seen = 0
    for number in KEYS:
        for text, line, parts in mutations(number):
            error = error_of(text)
            if not error:
                continue
            seen += 1
            lines = sum(ceil(len(item) / WIDTH) for item in error.splitlines())
            if (
                f"g.toml:{line + 1}:" not in error
                or not all(part in error for part in parts)
                or FOREIGN.search(error)
                or lines > 6
            ):
                wrong.append((text.splitlines()[line], error))
    assert seen > 2
    assert not wrong, "\n".join(f"{line} -> {error}" for line, error in wrong)


@pytest.mark.parametrize("table", ["can", "axis", "encoder", "axis.positioner", "axis.block", "mqtt"])
def test_missing_key_is_named_with_the_line_of_its_table(table: str) -> None:
    header = next(number for number, line in enumerate(LINES) if line.strip("[]") == table)
    end = next((n for n in range(header + 1, len(LINES)) if LINES[n].startswith("[")), len(LINES))
    found = 0
    for number in range(header + 1, end):
        error = error_of(with_line(number))
        key = LINES[number].split(" ")[0]
        if "is missing" in error:
            found += 1
            assert error.startswith(f"g.toml:{header + 1}: "), error
            assert key in error
            assert "\n" not in error
        tomllib.loads(with_line(number))
    assert found


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            "jog_velocities = [-300, 300]",
            "jog_1_velocity = 3000\njog_2_velocity = -3000",
            "g.toml:40: [[axis]] number 1 positioner.jog_1_velocity: was removed in 0.9.0: "
            "write jog_velocities = [3000, -3000]",
        ),
        ("jog_velocities = [-300, 300]", "jog_1_velocity = 3000", "write jog_velocities = [3000, 300]"),
        ("jog_velocities = [-300, 300]", "jog_2_distance = 7", "write jog_distances = [0, 7]"),
        ("jog_speeds_rpm = [-100, 100]", "jog_2_speed_rpm = -50", "write jog_speeds_rpm = [0, -50]"),
        (
            'topic = "pdgw"',
            'ca_file = "plant.pem"',
            "g.toml:22: [mqtt] ca_file: was removed in 0.9.0: write tls = 'plant.pem'",
        ),
    ],
)
def test_refusal_of_a_removed_key_has_the_values_of_the_file(old: str, new: str, text: str) -> None:
    assert text in error_of(GOOD.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        (
            'name = "press 3"',
            'name = "press/3"',
            "name = 'press/3': allowed: 1 to 40 characters without / + # and \", no space",
        ),
        ('name = "press 3"', f'name = "{"x" * 41}"', "allowed: 1 to 40 characters without"),
        (
            'topic = "pdgw"',
            'topic = "plant/+"',
            "topic = 'plant/+': allowed: 1 to 200 characters without the wildcards + and #",
        ),
        (
            'hosts = ["gateway.plant"]',
            'hosts = ["http://gateway"]',
            "hosts.1 = 'http://gateway': allowed: a host name without",
        ),
        ('host = "broker.plant"', 'host = ""', "host = '': '' is not a host name or address"),
        ('host = "broker.plant"', 'host = "a..b"', "host = 'a..b': 'a..b' is not a host name or address"),
        (
            'host = "broker.plant"',
            'host = "mqtt://b"',
            "'mqtt://b' is not a host name or address without scheme and port",
        ),
        (
            'type = "udp"',
            'type = "profinet"\ninterface = "eth 1"',
            "interface = 'eth 1': allowed: the name of a network interf",
        ),
        (
            'type = "udp"',
            'snmp_community = "my group"',
            "snmp_community = 'my group': allowed: 1 to 32 letters, digits and",
        ),
    ],
)
def test_form_of_a_text_is_refused_in_words(old: str, new: str, text: str) -> None:
    error = error_of(GOOD.replace(old, new))
    assert text in error
    assert not FOREIGN.search(error)


@pytest.mark.parametrize("line", ['{"can": {"interface": "virtual"}}', "{", "can:", "---", "- can"])
def test_file_of_another_format_is_named(line: str) -> None:
    error = error_of(f"# a comment\n{line}\n")
    assert (
        error
        == f"g.toml:2: {line}: not valid TOML: JSON and YAML are not read; expected TOML: [table], then key = value"
    )


def test_unknown_key_that_is_like_no_other_has_all_of_its_table() -> None:
    error = error_of(GOOD.replace("sync = false", "zzz = 1"))
    assert re.fullmatch(
        r"g\.toml:33: \[\[axis\]\] number 1 zzz: unknown key \(allowed: do_id, (\w+, ){30,}\w+\)", error
    ), error


def test_missing_table_is_named() -> None:
    assert error_of("").startswith("g.toml: [can]: is missing")
