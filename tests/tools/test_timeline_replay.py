"""``pdgw timeline`` and ``pdgw replay`` as a user runs them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import typer

from pdgw.decoder.capture.errors import CaptureError
from pdgw.decoder.timeline.axis import NO_CONTROLWORD
from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.recording.recordings import known_from
from pdgw.tools.commands.capture.replay import replay
from pdgw.tools.commands.capture.timeline import timeline
from tests.decoder.replay.test_replay import reducing_torque, speed, without_begin
from tests.support.axis.recorded import BEGIN_NS
from tests.support.axis.rig import NODE
from tests.support.cli import pdgw
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
    assert text[on + 1].endswith("-> executed")
    # Before or after it: the offset of the clocks is known only to a part of a cycle.
    assert any("Controlword     0006h -> 0007h [Switch On] +SWITCH_ON" in line for line in (text[on - 1], text[on + 2]))
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


def test_an_equal_recording_ends_without_error(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    replay(files, telegram=[1], node=["1=5"])
    assert lines(capsys)[-1].endswith("steps compared, all equal")


def test_a_difference_is_shown_with_its_context_and_exit_status_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = speed()
    moment = rig.frames.change_can(0x200 + NODE, 6, lambda data: (77).to_bytes(4, "little") + data[4:])
    files = rig.frames.write(tmp_path)
    with pytest.raises(typer.Exit) as left:
        replay(files, config=configuration(tmp_path), offset=0.0)
    assert left.value.exit_code == 1
    text = lines(capsys)
    seconds = (moment - rig.frames.plc[0][0]) / 1e9
    assert text[1].startswith("axis 7 (telegram 1, node 5): ")
    assert text[1].endswith(f"then RPDO1 differs at {seconds:.6f} s")
    assert text[2].startswith("  Target Velocity: recorded 77 (004Dh), today ")
    with pytest.raises(typer.Exit):
        replay(files, telegram=[1], node=NODES, as_json=True)
    (document,) = (json.loads(line) for line in lines(capsys))
    assert document["equal"] is False
    assert document["axes"][0]["first_difference"]["names"] == ["Target Velocity"]


def test_replay_names_a_limit_that_it_does_not_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = reducing_torque()
    without_begin(rig)
    files = rig.frames.write(tmp_path)
    replay(files, telegram=[102], node=NODES, offset=0.0)
    who = "axis 1 (telegram 102, node 5)"
    assert (
        f"{who}: Max Torque is not compared: the recording begins in operation, without the drive's own value"
        in lines(capsys)
    )
    replay(files, telegram=[102], node=NODES, offset=0.0, as_json=True)
    assert json.loads(lines(capsys)[0])["axes"][0]["not_compared"] == ["Max Torque"]


def test_choices_of_the_configuration_reach_the_machines(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replay(files, config=configuration(tmp_path))
    known = known_from(configuration(tmp_path, 'setpoint_enable = "profidrive"\n'), [], [])
    assert known.choices[7].setpoint_enable.value == "profidrive"
    assert (known.cycle_ns, known.watchdog_factor) == (4 * MS, 3)


def test_telegrams_are_inferred_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = speed().frames.write(tmp_path)
    replay(files)  # the node-ID is not that of the axis: nothing of CAN belongs to it, the answers still compare
    captured = capsys.readouterr()
    assert "note: inferred from length and status bytes: axis 1 telegram 1" in captured.err


def test_both_buses_in_one_file_have_one_clock(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = speed()
    packets = [(BEGIN_NS + now, captures.ETHERNET, b"\0" * 12 + b"\x88\x92" + data) for now, data in rig.frames.plc]
    packets += [
        (BEGIN_NS + now, captures.ETHERNET, b"\0" * 12 + b"\x88\x92" + data) for now, data in rig.frames.answers
    ]
    packets += [
        (BEGIN_NS + now, captures.SOCKETCAN, captures.socketcan_packet(cob_id, data))
        for now, cob_id, data in rig.frames.can
    ]
    path = tmp_path / "both.pcapng"
    path.write_bytes(captures.pcapng(sorted(packets)))
    replay([str(path)], telegram=[1], node=NODES)
    text = lines(capsys)
    assert text[0] == "clocks: one clock"
    assert text[-1].endswith("all equal")


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


def test_recording_of_the_plc_alone_suggests_no_off(files: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    timeline(files[:1], telegram=[1], node=NODES)
    text = lines(capsys)
    on = next(i for i, line in enumerate(text) if "047Eh -> 047Fh +ON" in line)
    assert text[on + 1].endswith(f"-> {NO_CONTROLWORD}")


def test_a_node_that_never_answered_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = speed()
    rig.frames.can = [frame for frame in rig.frames.can if frame[1] & ~0x7F in {0, 0x200, 0x600}]
    timeline(rig.frames.write(tmp_path), telegram=[1], node=NODES, offset=0.0)
    assert any(line.endswith(f"axis 1  missing: no frame from node {NODE}") for line in lines(capsys))
    timeline(speed().frames.write(tmp_path), telegram=[1], node=NODES)
    assert not any("missing:" in line for line in lines(capsys))


def test_unusable_input_is_one_error(files: list[str], tmp_path: Path) -> None:
    plc, can = files
    empty = tmp_path / "empty.log"
    empty.write_text("")
    for given, match in (
        ([can], "the frames do not show the telegrams; give --telegram and --node, or --config"),
        ([plc, "-"], "read more than once"),
    ):
        with pytest.raises(GatewayError, match=match):
            timeline(given)
    for given, match in (([plc], "no CAN frames; a replay compares"), ([can], "no cyclic frames; a replay compares")):
        with pytest.raises(GatewayError, match=match):
            replay(given, telegram=[1])
    with pytest.raises(CaptureError, match="is empty"):
        replay([plc, str(empty)], telegram=[1])
    with pytest.raises(GatewayError, match="the capture has no drive telegram"):
        replay(files, telegram=[81])
    for node, match in (
        ("200", "node-ID 1..127"),
        ("2=5", "there is no axis 2, expected one of 1"),
        ("x", "expected NODE or AXIS=NODE"),
    ):
        with pytest.raises(GatewayError, match=match):
            replay(files, telegram=[1], node=[node])
    with pytest.raises(GatewayError, match="--node: give --telegram"):
        replay(files, node=["5"])
    with pytest.raises(GatewayError, match="--offset nan"):
        timeline(files, telegram=[1], offset=float("nan"))


def test_the_commands_with_exit_status_and_one_line(files: list[str]) -> None:
    equal = pdgw("replay", *files, "--telegram", "1", "--node", str(NODE))
    assert (equal.returncode, equal.stderr) == (0, "")
    bad = pdgw("replay", files[0], "--telegram", "1")
    assert bad.returncode == 1
    assert bad.stderr.startswith("error: ")
    assert len(bad.stderr.splitlines()) == 1
