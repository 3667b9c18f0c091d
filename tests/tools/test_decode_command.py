"""``pdgw decode`` as a user runs it: outputs, selections, damage, pipes."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.commands.capture.decode import decode
from pdgw.tools.decoder.capture.pcap import CaptureError
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.export.trace_page import States
from pdgw.tools.decoder.frames.engine import Decoder, Settings, given_axes
from tests.support.buses import PATIENCE_S
from tests.support.cli import pdgw
from tests.support.readers import captures
from tests.support.readers.captures import BEGIN_NS

PACKETS = captures.both_buses()


@pytest.fixture
def capture(tmp_path: Path) -> str:
    path = tmp_path / "both.pcapng"
    path.write_bytes(captures.pcapng(PACKETS))
    return str(path)


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    path = tmp_path / "gateway.toml"
    path.write_text(
        '[can]\ninterface = "virtual"\nbitrate = 500000\n'
        "[transport]\ncyclic_port = 40000\n"
        "[[axis]]\ndo_id = 7\nnode_id = 1\ntelegram = 1\n"
    )
    return path


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


def test_text_is_one_plain_line_for_each_packet(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[1])
    text = lines(capsys)
    assert len(text) == len(PACKETS)
    assert text[2] == (
        "     3     0.002000 plc PLC ->  FrameID C001h counter 65532 status 35h | axis 1 T1 STW1 047Fh NSOLL_A 0.610 %"
    )
    assert text[-2].endswith(
        "can 181 n1  TPDO1 | Statusword 0237h [Operation Enabled] Velocity Actual Value 3000 velocity units (6094h rpm)"
    )
    assert not any("\x1b" in line for line in text)


def test_verbose_is_the_tree(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[1], verbose=True)
    text = lines(capsys)
    assert "             ON = 1  (ON (0 = OFF1))" in text
    assert "         cycle_counter: 65500" in text


def test_json_is_one_object_for_each_packet(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[1], as_json=True)
    documents = [json.loads(line) for line in lines(capsys)]
    assert [document["number"] for document in documents] == list(range(1, len(PACKETS) + 1))
    assert [document["time_ns"] for document in documents] == [time_ns for time_ns, _, _ in PACKETS]
    assert all({"number", "time_ns", "bus", "channel", "kind", "units"} <= document.keys() for document in documents)
    assert documents[2]["units"][0]["signals"]["NSOLL_A"] == {
        "raw": 100,
        "value": 100 * 100 / 16384,
        "unit": "%",
        "bits": {},
    }


def test_inferred_telegram_is_reported(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture])
    captured = capsys.readouterr()
    assert "note: inferred from length and status bytes: axis 1 telegram 1" in captured.err
    assert "STW1 047Fh" in captured.out


def test_the_configuration_gives_axes_nodes_ports_and_bitrate(
    capture: str, configuration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    decode([capture], config=configuration, as_json=True)
    documents = [json.loads(line) for line in lines(capsys)]
    units = [unit for document in documents for unit in document["units"]]
    assert {(unit["axis"], unit["node"]) for unit in units} == {(7, 1)}
    assert {document["mapping"] for document in documents if document["kind"] == "pdo"} == {"configuration"}
    decode([capture], config=configuration, stats=True)
    assert any("load at 500000 bit/s" in line for line in lines(capsys))


def test_csv_has_the_chosen_names(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[1], csv="Time, STW1.ON, nsoll_a,AXIS,Statusword.text")
    rows = list(csv.reader(lines(capsys)))
    assert rows[0] == ["time", "axis", "node", "STW1.ON", "nsoll_a", "Statusword.text"]
    assert rows[1] == ["1700000000.123456000", "1", "1", "1", "0.0", ""]
    assert rows[-1][3:] == ["", "", "Operation Enabled"]
    assert len(rows) == 1 + 4 + 1


@pytest.mark.parametrize(
    ("options", "numbers"),
    [
        ({"filter_text": "stw1.on == 1 and axis == 1 and nsoll_a > 1"}, [5, 7]),
        ({"filter_text": "abort != 0"}, [20]),
        ({"filter_text": "nsoll_a > 1 and zsw1.operation_enabled == 1"}, [5, 6, 7, 8]),
        ({"filter_text": "nsoll_a > 1 and iocs == 128 and zsw1.operation_enabled == 1"}, [5, 6, 7, 8]),
        ({"begin": "0.020"}, [21, 22, 23]),
        ({"begin": "0.004", "end": "0.005"}, [5, 6]),
        ({"begin": "2023-11-14T22:13:20.143456+00:00"}, [21, 22, 23]),
        ({"filter_text": "node == 2"}, [17, 18]),
        ({"signal": ["NSOLL_A,Target Velocity"]}, [1, 3, 5, 7, 23]),
        ({"signal": ["abort", "latency_ms"]}, [14, 16, 18, 20]),
        ({"changes_only": True, "signal": ["STW1", "zsw1"]}, [1, 2]),
        ({"filter_text": "kind == 'heartbeat'", "changes_only": True}, [10, 11]),
    ],
)
def test_selections(
    options: dict[str, object], numbers: list[int], capture: str, capsys: pytest.CaptureFixture[str]
) -> None:
    decode([capture], telegram=[1], as_json=True, **options)  # type: ignore[arg-type]
    assert [json.loads(line)["number"] for line in lines(capsys)] == numbers


def test_wrong_telegram_is_reported_once_for_each_direction(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[9], stats=True)
    notes = capsys.readouterr().err.splitlines()
    assert notes == [
        "note: the setpoints do not fit the given telegram 9: their length is the length of telegram 1/7/20/81/82/83/84",
        "note: the actual values do not fit the given telegram 9: their length is the length of telegram 1/7",
    ]
    decode([capture], telegram=[1], stats=True)
    assert not capsys.readouterr().err


def test_few_packets_are_decoded_like_the_whole_file(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture])
    whole = capsys.readouterr()
    decode([capture], end="0")
    first = capsys.readouterr()
    assert first.err == whole.err
    assert first.out == whole.out.splitlines(keepends=True)[0]


def test_times_count_from_the_first_cyclic_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "late.pcapng"
    can = [packet for packet in PACKETS if packet[1] == captures.SOCKETCAN]
    plc = [(now + 50_000_000, link, data) for now, link, data in PACKETS if link == captures.ETHERNET]
    path.write_bytes(captures.pcapng([*can, *plc]))
    decode([str(path)], telegram=[1], begin="0", end="0.0015")
    shown = [line.split()[1] for line in lines(capsys)]
    assert shown == ["0.000000", "0.001000"]


def test_statistics(capture: str, capsys: pytest.CaptureFixture[str]) -> None:
    decode([capture], telegram=[1], stats=True, as_json=True)
    (document,) = map(json.loads, lines(capsys))
    assert document["packets"] == len(PACKETS)
    plc = {stream["identifier"]: stream for stream in document["streams"] if stream["bus"] == "plc"}
    assert plc["C001h"]["packets"] == plc["C000h"]["packets"] == 4
    assert plc["C001h"]["interval_mean_us"] == pytest.approx(2000)
    assert plc["C001h"]["counter_step_us"] == 1000
    decode([capture], telegram=[1], stats=True)
    text = lines(capsys)
    assert text[0] == "23 packets in 0.022000 s"
    assert any(line.startswith("bus load if227:") for line in text)


def test_the_states_of_an_axis_are_spans(capture: str) -> None:
    states = States()
    decoder = Decoder(Settings(given_axes([1])))
    begin = PACKETS[0][0]
    with open_source(capture) as source:
        for packet in source.packets:
            record = decoder.decode(packet)
            for unit in record.units:
                states.add(f"axis {unit.axis}", (record.time_ns - begin) / 1e9, unit)
    (spans,) = states.spans.values()
    assert {state for _, _, state in spans} <= {"operation", "off"}
    assert all(one[1] == other[0] for one, other in pairwise(spans))


def test_parquet_has_the_rows_of_the_table(capture: str, tmp_path: Path) -> None:
    try:
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        with pytest.raises(GatewayError, match="--parquet needs pyarrow"):
            decode([capture], parquet=tmp_path / "out.parquet", signal=["NSOLL_A"])
        return
    decode([capture], telegram=[1], parquet=tmp_path / "out.parquet", signal=["NSOLL_A", "Statusword.text"])
    table = parquet.read_table(tmp_path / "out.parquet").to_pydict()
    assert table["time_ns"][0] == BEGIN_NS
    assert len(table["NSOLL_A"]) == 5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filter_text": "stw9 == 1"}, "name: 'stw9'.*stw1"),
        ({"csv": "STW1,SPEED"}, "name: 'SPEED'"),
        ({"signal": ["nope"]}, "name: 'nope'"),
        ({"begin": "yesterday"}, "--from yesterday: expected seconds or an ISO time"),
        ({"telegram": [8]}, "telegram: 8"),
        ({"eds": ["nowhere.eds"]}, "--eds nowhere.eds: not a file"),
        ({"config": Path("nowhere.toml")}, "nowhere.toml: cannot be read"),
        ({"hex_text": "00"}, "give one of"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], message: str, capture: str) -> None:
    with pytest.raises((GatewayError, ProfidriveError), match=message):
        decode([capture], **options)  # type: ignore[arg-type]


def test_bad_eds_is_reported_before_the_first_packet(
    capture: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.eds"
    bad.write_text("[1000]\nParameterName=x\nObjectType=zz\n")
    with pytest.raises(GatewayError, match=r"bad\.eds"):
        decode([capture], eds=[str(bad)])
    assert not lines(capsys)


def test_request_as_the_guide_prints_it_is_decoded_with_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    decode(hex_text="01 01 01 00 01 10 18 10 00 03")
    shown = capsys.readouterr()
    assert "1018h.3" in shown.out
    assert "swapped, as in the manufacturer's guide; decoded as 01 01 00 01 10 01 10 18 00 03" in shown.err
    decode(hex_text="01 01 00 01 10 01 10 18 00 03")
    assert not capsys.readouterr().err


def test_hex_is_a_packet_with_the_options_of_a_capture(capsys: pytest.CaptureFixture[str]) -> None:
    decode(hex_text="7F04 0010", telegram=[1])
    assert "STW1 7F04h is 047Fh with its bytes swapped" in capsys.readouterr().err
    decode(hex_text="047F 1000", telegram=[1])
    assert not capsys.readouterr().err
    decode(hex_text="0637 2000", telegram=[1])
    assert [line.split(" | ")[1] for line in lines(capsys)] == [
        "axis 1 T1 STW1 0637h NSOLL_A 50.000 %",
        "axis 1 T1 ZSW1 0637h NIST_A 50.000 %",
    ]
    decode(hex_text="0637 2000", telegram=[1], csv="zsw1,nist_a")
    assert lines(capsys)[1:] == ["0.000000000,1,1,1591,50.0"]
    decode(hex_text="0637 2000", telegram=[1], filter_text="zsw1.fault == 1")
    assert not lines(capsys)


def test_damage_ends_with_status_1_after_everything_before(tmp_path: Path) -> None:
    whole = captures.pcapng(PACKETS)
    path = tmp_path / "cut.pcapng"
    path.write_bytes(whole[:-20])
    for options in (["--json"], ["--csv", "kind"], ["--stats"]):
        result = pdgw("decode", str(path), "--telegram", "1", *options)
        assert result.returncode == 1
        assert "cut.pcapng: offset" in result.stderr
        assert "Traceback" not in result.stderr
        found = result.stdout.splitlines()
        if options == ["--json"]:
            assert [json.loads(line)["number"] for line in found] == list(range(1, len(PACKETS)))
        else:
            assert found


@pytest.mark.e2e
def test_closed_output_pipe_ends_decoding_of_standard_input(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pdgw", "decode"]
    result = subprocess.run(
        [*command, "-", "--json"], input=captures.pcapng(PACKETS), capture_output=True, check=False, timeout=PATIENCE_S
    )
    assert (result.returncode, len(result.stdout.splitlines())) == (0, len(PACKETS))
    path = tmp_path / "long.log"
    path.write_bytes(captures.candump(captures.CANOPEN * 2000))
    reader = subprocess.Popen([*command, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert reader.stdout is not None
    assert reader.stderr is not None
    assert b"NMT" in reader.stdout.readline()
    reader.stdout.close()
    assert reader.stderr.read() == b""
    assert reader.wait(PATIENCE_S) == 0
    reader.stderr.close()


def test_an_interruption_ends_a_live_source_in_order(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], capture: str
) -> None:
    original = Decoder.decode

    def interrupted(self: Decoder, packet: Sequence[object]) -> object:
        if packet[0] == 5:
            raise KeyboardInterrupt
        return original(self, packet)  # type: ignore[arg-type]

    monkeypatch.setattr(Decoder, "decode", interrupted)
    decode([capture], as_json=True, telegram=[1])
    assert len(lines(capsys)) == 4


def test_the_error_of_a_missing_file_names_it() -> None:
    with pytest.raises(CaptureError, match="cannot be read"):
        decode(["nowhere.pcap"])
