"""``pdgw timeline`` and ``pdgw replay`` as a user runs them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import typer

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.commands.capture.timeline import replay, timeline
from pdgw.tools.decoder.capture.pcap import CaptureError
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.timeline.builder import NO_STEPS
from tests.support.axis.recorded import speed
from tests.support.axis.rig import NODE
from tests.support.gateways import profinet_daemon
from tests.support.gateways.daemon import Plc, axis
from tests.support.gateways.daemon import configuration as gateway_configuration
from tests.support.gateways.recorded_daemon import recorded, recording
from tests.support.readers import captures

NODES = [str(NODE)]


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    return speed().frames.write(tmp_path, offset_ns=-2_000_000_000)


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


def configuration(folder: Path, more: str = "") -> Path:
    path = folder / "gateway.toml"
    path.write_text(
        '[can]\ninterface = "virtual"\n[transport]\ncycle_time_ms = 4\n'
        f"[[axis]]\ndo_id = 7\nnode_id = {NODE}\ntelegram = 1\n{more}"
    )
    return path


def test_the_timeline_as_text(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    timeline(files, telegram=[1], node=NODES)
    text = lines(capsys)
    on = next(i for i, line in enumerate(text) if "047Eh -> 047Fh +ON" in line)
    assert "->" not in text[on + 1][:30], "a foreign capture has no results"
    assert any(line.endswith(NO_STEPS) for line in text)
    # Before or after it: the offset of the clocks is known only to a part of a cycle.
    assert any("Controlword     0006h -> 0007h [Switch On] +SWITCH_ON" in line for line in (text[on - 1], text[on + 1]))
    assert any("clocks: the CAN clock differs by -" in line and "edges match" in line for line in text)
    assert any(line.startswith("STW1 -> Controlword") for line in text)
    assert text[-1] == "anomalies: none"


def test_the_timeline_as_json(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    timeline(files, telegram=[1], node=NODES, as_json=True)
    documents = [json.loads(line) for line in lines(capsys)]
    assert documents[0]["type"] == "clocks"
    assert abs(documents[0]["offset_ns"] + 2_000_000_000) < 4 * MS
    assert documents[-1]["type"] == "summary"
    edges = [item for item in documents if item["type"] == "edge"]
    assert {item["word"] for item in edges} == {"STW1", "Controlword", "Statusword", "ZSW1"}
    assert all({"set", "cleared", "cause", "latency_ns"} <= item.keys() for item in edges)
    assert {item["type"] for item in documents} <= {"clocks", "edge", "reason", "event", "anomaly", "summary"}


def test_verbose_shows_every_packet_in_the_order_of_one_clock(
    files: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    timeline(files, telegram=[1], node=NODES, verbose=True, begin="0.01", end="0.06")
    packets = [line for line in lines(capsys) if " plc PLC " in line or " can " in line]
    times = [float(line.split()[1]) for line in packets]
    assert times == sorted(times)
    assert min(times) >= 0.01
    assert max(times) <= 0.06
    assert {" can " in line for line in packets} == {True, False}


def test_axis_and_time_select(files: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = configuration(tmp_path)
    timeline(files, config=config, axis=[7], begin="0.03", end="0.05")
    text = lines(capsys)
    assert all("axis 7" in line for line in text if line[:1] == " " and "->" in line and not line.startswith(" " * 13))
    with pytest.raises(GatewayError, match="--axis 1: the recording has no such axis"):
        timeline(files, config=config, axis=[1])


@pytest.mark.parametrize("page", [False, True])
def test_recording_of_one_bus_is_shown_with_what_is_missing(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], *, page: bool
) -> None:
    plc, can = files
    html = tmp_path / "timeline.html" if page else None
    for given, has, lacks in (
        (plc, {"STW1", "ZSW1"}, ["no CAN frame: the recording shows neither"]),
        (can, {"Controlword", "Statusword"}, ["no frame from a PLC", "no frame to a PLC"]),
    ):
        timeline([given], telegram=[1], node=NODES, html=html)
        text = html.read_text() if html is not None else capsys.readouterr().out
        assert all(word in text for word in has)
        assert all(item in text for item in lacks)
        if html is None:
            told = text.splitlines()
            assert {line.split()[3] for line in told if re.search(r"axis 1  \w+ +[0-9A-F]{4}h ->", line)} == has
            assert "clocks: one clock" in told
            assert told[-1] == "anomalies: none"


def test_a_node_that_never_answered_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = speed()
    rig.frames.can = [frame for frame in rig.frames.can if frame[1] & ~0x7F in {0, 0x200, 0x600}]
    timeline(rig.frames.write(tmp_path), telegram=[1], node=NODES, offset=0.0)
    assert any(line.endswith(f"axis 1  missing: no frame from node {NODE}") for line in lines(capsys))
    timeline(speed().frames.write(tmp_path), telegram=[1], node=NODES)
    assert next(line for line in lines(capsys) if "missing:" in line).endswith(NO_STEPS)


def test_telegrams_are_inferred_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    timeline(speed().frames.write(tmp_path))
    captured = capsys.readouterr()
    assert "note: inferred from length and status bytes: axis 1 telegram 1" in captured.err


def test_unusable_input_of_a_timeline_is_one_error(files: list[str], tmp_path: Path) -> None:
    plc, _ = files
    empty = tmp_path / "empty.log"
    empty.write_text("")
    with pytest.raises(GatewayError, match="read more than once"):
        timeline([plc, "-"])
    with pytest.raises(CaptureError, match="is empty"):
        timeline([plc, str(empty)], telegram=[1])
    for node, match in (
        ("200", "node-ID 1..127"),
        ("2=5", "there is no axis 2, expected one of 1"),
        ("x", "expected NODE or AXIS=NODE"),
    ):
        with pytest.raises(GatewayError, match=match):
            timeline(files, telegram=[1], node=[node])
    with pytest.raises(GatewayError, match="--node: give --telegram"):
        timeline(files, node=["5"])
    with pytest.raises(GatewayError, match="--offset nan"):
        timeline(files, telegram=[1], offset=float("nan"))


@pytest.mark.parametrize("cut", [0, 1])
def test_cut_capture_is_shown_to_its_damage(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: int
) -> None:
    timeline(files, telegram=[1], node=NODES, offset=-2.0)
    whole = lines(capsys)
    data = Path(files[cut]).read_bytes()
    given = list(files)
    given[cut] = str(tmp_path / f"cut{Path(files[cut]).suffix}")
    Path(given[cut]).write_bytes(data[: len(data) * 3 // 4 + 5])
    with pytest.raises(CaptureError, match=f"^{given[cut]}: "):
        timeline(given, telegram=[1], node=NODES, offset=-2.0)
    shown = lines(capsys)
    assert len(shown) > 10
    assert shown == whole[: len(shown)]


def test_a_capture_without_drives_shows_its_calls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = profinet_daemon.configuration(axis(1), tmp_path / "store.json")
    with profinet_daemon.plant(config) as site:
        site.connect()
        site.run(50 * MS)
    plc, _ = site.write(tmp_path)
    with open_source(plc) as source:
        calls = [packet for packet in source.packets if packet.data[12:14] == b"\x08\x00"]
    path = tmp_path / "calls.pcap"
    path.write_bytes(
        captures.pcap([(item.time_ns, captures.ETHERNET, item.data) for item in calls[2:]], nanoseconds=True)
    )
    timeline([str(path)], telegram=[])
    text = lines(capsys)
    assert any("  all     PLC: " in line and "control request" in line for line in text)


def test_timeline_of_a_recording_shows_the_age_of_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ends = 'listen = "192.0.2.1"\npeer = "192.0.2.2"\n'
    with recorded(gateway_configuration(axis(1), transport=f"{ends}watchdog_factor = 5\n"), tmp_path) as plc:
        Plc(plc.daemon, [1], host="192.0.2.2").enable()
    timeline([recording(tmp_path)])
    (line,) = (line for line in lines(capsys) if line.startswith("age of "))
    pattern = r"age of \d+ frames of the PLC \(round trip\): p50 (\S+) ms, p99 (\S+) ms, max (\S+) ms, limit 40 ms"
    found = re.fullmatch(pattern, line)
    assert found is not None, line
    assert [float(value) for value in found.groups()] == pytest.approx([4, 4, 4], abs=1)
    timeline([recording(tmp_path)], as_json=True)
    age = json.loads(lines(capsys)[-1])["age"]
    assert (age["limit_ns"], age["max_ns"]) == (40 * MS, float(found[3]) * MS)


def test_replay_prints_its_result_and_differences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with recorded(gateway_configuration(axis(1)), tmp_path) as plc:
        plc.enable()
    file = Path(recording(tmp_path))
    replay([file])
    (line,) = lines(capsys)
    assert re.fullmatch(r"axis 1 \(telegram 1\): \d+ steps compared, all equal", line)
    data = file.read_bytes()
    command = data.rindex(bytes.fromhex("00000201 06000000"))  # an RPDO
    file.write_bytes(data[: command + 8] + b"\x4d" + data[command + 9 :])
    with pytest.raises(typer.Exit) as left:
        replay([file])
    assert left.value.exit_code == 1
    text = lines(capsys)
    assert text[0].endswith("then a difference")
    assert re.search(r"axis 1: target_velocity in the RPDO: recorded \d+, now \d+$", text[1])
    with pytest.raises(typer.Exit):
        replay([file], as_json=True)
    (document,) = json.loads(lines(capsys)[0])
    assert document["differences"][0]["field"] == "target_velocity in the RPDO"
