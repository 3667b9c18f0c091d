"""The byte map and the PLC code made of it, held against the frames that PLC simulator and gateway exchange."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest

from pdgw.gateway.bytemap import Place, counter_step, frame_maps
from pdgw.gateway.config import GatewayConfig
from pdgw.gateway.config_file import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.transport.cyclic import CyclicEndpoint
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.commands.map import Format, map_
from pdgw.tools.plc_code import Dialect, code, identifier

CONFIG = """
[can]
interface = "virtual"
[transport]
cycle_time_ms = 2
[[axis]]
do_id = 1
node_id = 1
telegram = 1
rated_speed_rpm = 2500
[[axis]]
do_id = 7
node_id = 2
telegram = 9
[[axis]]
do_id = 9
node_id = 4
telegram = 100
[[encoder]]
do_id = 3
node_id = 3
telegram = 83
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "gateway.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def config(file: Path) -> GatewayConfig:
    return load_config(file)


def values_of(numbers: list[int], *, setpoints: bool) -> list[dict[str, int]]:
    """Different values for every signal, with every byte different from its neighbours."""
    found = []
    count = 0x11
    for number in numbers:
        half = telegram(number).setpoints if setpoints else telegram(number).actuals
        values = {}
        for signal in half.signals:
            low, _ = signal.type.integer_range
            pattern = int.from_bytes(bytes((count + i) % 100 + 1 for i in range(signal.type.size)), "big")
            values[signal.name] = -pattern if low < 0 else pattern
            count += 7
        found.append(values)
    return found


def raw(place: Place, frame: bytes) -> int:
    signed = place.signal is not None and place.signal.type.integer_range[0] < 0
    return int.from_bytes(frame[place.in_frame : place.in_frame + place.length], "big", signed=signed)


def plc_of(config: GatewayConfig) -> tuple[PlcEndpoint, list[dict[str, int]]]:
    numbers = [item.telegram for item in config.objects]
    plc = PlcEndpoint([telegram(number) for number in numbers], int(config.transport.cycle_time_ms * 1e6))
    values = values_of(numbers, setpoints=True)
    for axis, item in enumerate(values):
        plc.set(axis, item)
    return plc, values


def answer_of(config: GatewayConfig) -> tuple[bytes, list[dict[str, int]]]:
    numbers = [item.telegram for item in config.objects]
    values = values_of(numbers, setpoints=False)
    endpoint = CyclicEndpoint([telegram(number) for number in numbers], cycle_ns=2_000_000)
    return bytes(endpoint.build([tuple(item.values()) for item in values], [True] * len(values))), values


def test_every_value_lies_where_the_map_says(config: GatewayConfig) -> None:
    sending, receiving = frame_maps(config)
    plc, setpoints = plc_of(config)
    answer, actuals = answer_of(config)
    for found, frame, values in ((sending, bytes(plc.build()), setpoints), (receiving, answer, actuals)):
        assert len(frame) == found.size
        for axis, expected in zip(found.axes, values, strict=True):
            assert {p.name: raw(p, frame) for p in axis.places if p.signal is not None} == expected
            assert frame[axis.iops] == 0x80
        used = sorted(
            offset for place in found.places for offset in range(place.in_frame, place.in_frame + place.length)
        )
        assert len(used) == len(set(used))
        assert not any(frame[offset] for offset in set(range(found.size)) - set(used))


def test_what_100_percent_is_comes_from_the_configuration_where_it_says_so(config: GatewayConfig) -> None:
    full = {(p.axis, p.name): p.full for found in frame_maps(config) for p in found.places}
    assert full[1, "NSOLL_A"] == "4000h = 2500 rpm"
    assert full[7, "MDI_TARPOS"] == "40000000h = 100 % of the position"
    assert full[3, "NIST_B"] == "40000000h = 3000 rpm"
    assert full[0, "CycleCounter"] == "step 64"


def as_python(line: str) -> str:
    """One statement of either language as Python."""
    text = line.strip().replace("#frame", "frame").replace("IN := ", "").replace("N := ", "")
    text = re.sub(r"16#([0-9A-F]+)", r"0x\1", text)
    text = re.sub(r"(?<![\w.])#(\w+)", r"\1", text)
    return text.rstrip(";").replace(" AND ", " & ").replace(" OR ", " | ")


class Record(dict[str, int]):
    """A structure of the PLC."""

    __getattr__ = dict.__getitem__

    def __setattr__(self, name: str, value: int) -> None:
        self[name] = value


def signed(bits: int) -> Any:
    return lambda value: (value & ((1 << bits) - 1)) - ((value & 1 << (bits - 1)) << 1)


def cut(bits: int) -> Any:
    return lambda value: value & ((1 << bits) - 1)


CONVERSIONS = {
    f"{source}_TO_{target}": change
    for target, change in {
        "BYTE": cut(8),
        "WORD": cut(16),
        "DWORD": cut(32),
        "USINT": cut(8),
        "UINT": cut(16),
        "UDINT": cut(32),
        "SINT": signed(8),
        "INT": signed(16),
        "DINT": signed(32),
    }.items()
    for source in ("BYTE", "WORD", "DWORD", "USINT", "UINT", "UDINT", "SINT", "INT", "DINT")
} | {"SHL": lambda value, count: value << count, "SHR": lambda value, count: value >> count}


def run(lines: list[str], block: str, variables: dict[str, Any]) -> None:
    """Execute one function block of the code: assignments, and the two forms of IF it has."""
    begin = next(i for i, line in enumerate(lines) if line.startswith("FUNCTION_BLOCK") and block in line)
    end = lines.index("END_FUNCTION_BLOCK", begin)
    start = max(i for i in range(begin, end) if lines[i] == "END_VAR") + 1
    environment = {**CONVERSIONS, **variables}
    for line in lines[start:end]:
        text = as_python(line)
        if text in {"BEGIN", "END_IF"}:
            continue
        whole = re.fullmatch(r"IF (\w+) THEN (.+); ELSE (.+); END_IF", text)
        if whole:
            text = whole[2] if environment[whole[1]] else whole[3]
        elif text.startswith("IF "):
            condition = re.sub(r"(\]|\)) = ", r"\1 == ", text.removeprefix("IF ").removesuffix(" THEN"))
            if not all(eval(part, environment) for part in condition.split(" & ", 2)):
                return
            continue
        target, _, value = text.partition(" := ")
        value = re.sub(r"^\((.+)\) = (\w+)$", r"(\1) == \2", value)
        exec(f"{target} = {value}", environment)
        if re.fullmatch(r"\w+", target):
            variables[target] = environment[target]


@pytest.mark.parametrize("siemens", [False, True])
def test_the_blocks_make_and_read_the_frames(config: GatewayConfig, siemens: bool) -> None:
    lines = list(code(frame_maps(config), counter_step(config), Dialect(siemens=siemens)))
    plc, setpoints = plc_of(config)
    expected = bytes(plc.build())
    ids = [item.do_id for item in config.objects]
    variables: dict[str, Any] = {"frame": bytearray(len(expected)), "counter": 0}
    for do_id, values in zip(ids, setpoints, strict=True):
        variables |= {f"axis_{do_id}": Record({identifier(n): v for n, v in values.items()}), f"good_{do_id}": False}
    run(lines, "PDGW_Build", variables)
    assert bytes(variables["frame"]) == expected
    answer, actuals = answer_of(config)
    read: dict[str, Any] = {"frame": answer} | {f"axis_{do_id}": Record() for do_id in ids}
    run(lines, "PDGW_Read", read)
    for do_id, values in zip(ids, actuals, strict=True):
        assert read[f"axis_{do_id}"] == {identifier(name): value for name, value in values.items()}
        assert (read[f"good_{do_id}"], read[f"used_{do_id}"]) == (True, False)


def test_all_formats_are_written(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    map_(file)
    text = capsys.readouterr().out
    assert "MDI_TARPOS" in text
    assert "…" not in text
    map_(file, Format.CSV)
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    (row,) = [row for row in rows if row["name"] == "NSOLL_A"]
    assert (row["direction"], row["axis"], row["offset"], row["in_submodule"], row["length"]) == (
        "plc-to-gateway",
        "1",
        "4",
        "2",
        "2",
    )
    for format_ in (Format.ST, Format.SCL):
        map_(file, format_, tmp_path / "code.txt")
        assert "PDGW_T9_SET" in (tmp_path / "code.txt").read_text()
    with pytest.raises(GatewayError, match=r"--out .*cannot be written"):
        map_(file, Format.CSV, tmp_path / "no" / "x")


def test_the_device_description_is_written_beside_the_map(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(GatewayError, match=r'--gsdml: .* has type = "udp", expected "profinet"'):
        map_(file, gsdml=tmp_path)
    assert capsys.readouterr().out == ""
    file.write_text(CONFIG.replace("cycle_time_ms = 2", 'type = "profinet"\ninterface = "eth1"\ndevice_id = 22'))
    map_(file, Format.SCL, tmp_path / "pdgw.scl", tmp_path)
    (description,) = tmp_path.glob("GSDML-V2.4-*.xml")
    assert 'DeviceID="0x0016"' in description.read_text()
    assert "PDGW_Profinet" in (tmp_path / "pdgw.scl").read_text()
    assert capsys.readouterr() == ("", f"device description: {description}\n")
    with pytest.raises(GatewayError, match=r"--gsdml .*: GSDML.* cannot be written"):
        map_(file, gsdml=tmp_path / "nowhere")


def test_on_profinet_each_value_is_counted_from_the_first_byte_of_its_submodule(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "gateway.toml"
    path.write_text(
        CONFIG.replace("cycle_time_ms = 2", 'type = "profinet"\ninterface = "eth1"\nstation_name = "press-1"')
    )
    map_(path, Format.TEXT, None)
    text = capsys.readouterr().out
    assert "FrameID" not in text
    assert "UDP" not in text
    map_(path, Format.CSV, None)
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    for item in load_config(path).objects:
        half = telegram(item.telegram).setpoints
        own = [row for row in rows if row["axis"] == str(item.do_id) and row["direction"] == "plc-to-gateway"]
        data = half.encode(range(1, len(half.signals) + 1))
        for number, row in enumerate(own, 1):
            begin = int(row["in_submodule"])
            assert row["offset"] == ""
            assert int.from_bytes(data[begin : begin + int(row["length"])], "big") == number
        assert sum(int(row["length"]) for row in own) == len(data)
