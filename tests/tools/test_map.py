"""The byte map and the PLC code made of it, held against the frames that PLC simulator and gateway exchange."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.byte_map import Place, frame_maps
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.frame import IOPS_GOOD, TICK
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.commands.commissioning.map import Format, map_
from pdgw.tools.plc.code import siemens_scl, structured_text
from pdgw.tools.plc.frame_fields import identifier
from pdgw.tools.plc.sockets import LOST_AFTER
from tests.support.structured_text.compiler import Compiler

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
name = "table"
node_id = 2
telegram = 9
[[axis]]
do_id = 9
name = "axis 1"
node_id = 4
telegram = 100
[[encoder]]
do_id = 3
name = "Line: encoder"
node_id = 3
telegram = 83
[[encoder]]
do_id = 4
name = "3rd"
node_id = 5
telegram = 84
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


def test_every_value_has_the_offset_of_the_map(config: GatewayConfig) -> None:
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


def test_map_shows_configured_100_percent_values(config: GatewayConfig) -> None:
    full = {(p.axis, p.name): p.full for found in frame_maps(config) for p in found.places}
    assert full[1, "NSOLL_A"] == "4000h = 2500 rpm"
    assert full[7, "MDI_TARPOS"] == "40000000h = 100 % of the position"
    assert full[3, "NIST_B"] == "40000000h = 3000 rpm"
    assert full[0, "CycleCounter"] == "step 64"


def test_the_blocks_make_and_read_the_frames(config: GatewayConfig) -> None:
    block = Compiler(lambda: 0, structured_text(config)).units["PDGW_UDP"]
    plc, setpoints = plc_of(config)
    expected = bytearray(plc.build())
    answer, actuals = answer_of(config)
    names = ["AXIS_1", "TABLE", "AXIS_9", "LINE_ENCODER", "AXIS_4"]
    io = block.initial | {"RECEIVED": list(answer)}
    for name, values in zip(names, setpoints, strict=True):
        io[f"{name}_SET"] = {identifier(signal).upper(): value for signal, value in values.items()}
    block.body(io)
    sending, receiving = frame_maps(config)
    for axis in sending.axes:
        expected[axis.iocs] = IOPS_GOOD
    expected[sending.trailer - TICK.size : sending.trailer] = answer[receiving.trailer - TICK.size : receiving.trailer]
    assert bytes(io["SENT"]) == expected
    for name, values in zip(names, actuals, strict=True):
        assert io[f"{name}_ACTUAL"] == {identifier(signal).upper(): value for signal, value in values.items()}
        assert (io[f"{name}_GOOD"], io[f"{name}_USED"]) == (True, False)
    for _ in range(LOST_AFTER):
        block.body(io)
        assert io["AXIS_1_GOOD"], "the same frame again: the gateway may be late"
    for _ in range(3):
        block.body(io)
        assert not io["AXIS_1_GOOD"], "no new frame for too long"
    io["RECEIVED"][receiving.trailer] ^= 1
    block.body(io)
    assert io["AXIS_1_GOOD"], "a new frame"


def test_scl_marks_variables_and_quotes_types(config: GatewayConfig) -> None:
    text = siemens_scl(config)
    for line in (
        '    "axis_1" ',
        "FUNCTION_BLOCK PDGW",
        "//",
    ):
        assert line not in text
    for line in (
        "FUNCTION_BLOCK \"PDGW_Udp\"\n{ S7_Optimized_Access := 'TRUE' }\nVERSION : 0.1\n",
        '    axis_1_set : "PDGW_T1_SET";\n',
        "END_VAR\nBEGIN\n",
        "    #sent[4] := WORD_TO_BYTE(SHR(IN := INT_TO_WORD(#axis_1_set.NSOLL_A), N := 8));\n",
        "    #send(REQ := TRUE, ID := #connection_id, LEN := 0, DATA := #sent, ADDR := #partner);\n",
        "#partner.REM_IP_ADDR := #gateway;\n",
    ):
        assert line in text, line


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
    text = (tmp_path / "pdgw.scl").read_text()
    assert 'FUNCTION_BLOCK "PDGW_Udp"' not in text
    assert (
        "    #result := DPRD_DAT(LADDR := #table_hw, RECORD => #table_actual);\n    #table_good := #result = 0;\n"
        in text
    )
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
