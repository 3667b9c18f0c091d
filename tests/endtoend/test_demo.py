"""The demo as the README starts it, and its evidence read by independent readers."""

from __future__ import annotations

import json
import shutil
from itertools import islice
from pathlib import Path

import pytest
import yaml
from scapy.layers.l2 import Ether
from scapy.utils import RawPcapReader

from pdgw.profidrive.scapy_layers import ProfidriveCyclic, bind
from pdgw.tools.demo.chapters import CHAPTERS
from pdgw.tools.demo.links import RECORD
from pdgw.tools.recording.recorder import CAPTURE
from tests.support.processes import demo_undisturbed
from tests.support.readers import tshark
from tests.support.readers.captures import can_frames
from tests.tools.test_demo_chapters import FOR_PICTURES

pytestmark = pytest.mark.e2e


def check_report(out: Path) -> None:
    """Every expectation passed; the encoder and the parameters are part of it."""
    report = json.loads((out / "report.json").read_text())
    assert report["passed"]
    assert len(report["results"]) >= 40
    assert all(item["passed"] for item in report["results"])
    notes = " ".join(note for _, note in report["notes"])
    assert all(part in notes for part in ("OFF1", "quick stop", "over-current", "homing"))
    assert report["exit_codes"] == {"plc": 0, "gateway": 0, "devices": 0}
    results = [(item["axis"], item["name"], item["measured"]) for item in report["results"]]

    def measured(axis: int, text: str) -> list[str]:
        found = [value for number, name, value in results if number == axis and text in name]
        assert found, text
        return found

    assert measured(4, "agrees: NIST_B 1500 rpm")
    assert measured(4, "G1_XIST2 100000") == ["G1_XIST2 = 100000"]
    assert measured(4, "alarm, position may be wrong")
    assert measured(4, "measuring again")
    assert measured(1, "P965 0329h") == ["809"]
    assert measured(4, "P965") == ["3d 2a"]
    assert measured(1, "P947.0 7") == ["7"]
    assert measured(1, "P947.8 7") == ["7"]
    assert measured(1, "6083h 250") == ["250"]
    assert measured(1, "60FFh := 0 refused") == ["0Bh: no operation priority"]


EACH = 9
"""Frames from one that scapy reads to the next, odd for both directions: it needs 2.5 ms for one. tshark reads all of them."""


def frames_of_the_plc(out: Path) -> None:
    """scapy finds the enable and the speed."""
    bind([1, 9, 100, 83])
    read = (Ether(data) for data, _ in islice(RawPcapReader(str(out / "plc.pcap")), 0, None, EACH))
    packets = [packet for packet in read if ProfidriveCyclic in packet]
    setpoints = [p[ProfidriveCyclic].data[0] for p in packets if p.frameID == 0xC001]
    actuals = [p[ProfidriveCyclic].data[0] for p in packets if p.frameID == 0xC000]
    assert any(part.STW1.ON and part.NSOLL_A == 0x2000 for part in setpoints)
    assert any(part.ZSW1.OPERATION_ENABLED and abs(part.NIST_A - 0x2000) < 60 for part in actuals)
    assert any(part.ZSW1.FAULT for part in actuals)
    assert all(p[ProfidriveCyclic].dataStatus.run for p in packets)


def frames_on_can(out: Path) -> None:
    """Configuration and process data of every node, and the fault."""
    frames = can_frames(out / RECORD / CAPTURE)
    identifiers = {identifier for identifier, _ in frames}
    for node in (1, 2, 3):
        assert {0x600 + node, 0x580 + node, 0x200 + node, 0x180 + node, 0x700 + node} <= identifiers
    assert {0x604, 0x584, 0x184, 0x704, 0x84} <= identifiers
    assert any(identifier == 0x81 and data[:2] == b"\x10\x23" for identifier, data in frames)


def pictures(out: Path) -> None:
    assert (out / "trace.png").read_bytes().startswith(b"\x89PNG")
    page = (out / "trace.html").read_text()
    assert "EMCY: node 1: 2310h" in page
    assert "MDI_TARPOS" in page


def dissected(out: Path) -> None:
    """tshark finds PROFINET, the parameters, and nothing malformed."""
    pnu = "pn_io.profidrive.parameter.number"
    rows = tshark.fields(out / "plc.pcap", ["pn_rt.frame_id", "pn_rt.ds", "udp.dstport", pnu, "_ws.malformed"])
    cyclic = [row for row in rows if row["pn_rt.frame_id"]]
    acyclic = [row for row in rows if not row["pn_rt.frame_id"]]
    assert {int(row["pn_rt.frame_id"], 0) for row in cyclic} == {0xC000, 0xC001}
    assert {int(row["pn_rt.ds"], 0) for row in cyclic} == {0x35}
    requests = [row for row in acyclic if row["udp.dstport"] == "34964"]
    assert len(acyclic) > len(requests) > 20
    assert {965, 947, 0x6083} <= {int(row[pnu], 0) for row in requests if row[pnu]}
    assert not [row for row in rows if row["_ws.malformed"]]


PASSING = {
    "ramping with power on": {"ZSW1.READY_TO_OPERATE", "NIST_A"},
    "quick stop active": {"ZSW1.NO_QUICK_STOP"},
}
"""What holds for a moment only, by the note of the expectation: a process that is held up does not see it."""


ONLY_IN_VIRTUAL_TIME = ("telegram 9: absolute move to 60000", "speed follows")
"""Notes of the first and of the last step that are left out: moves of telegram 9, torque and speed of telegram 100."""


def without_passing_moments(chapter: str) -> str:
    """The scenario of a chapter with time for a busy machine; test_demo_chapters.py runs all of it in virtual time."""
    document = yaml.safe_load(CHAPTERS[chapter].scenario.read_text(encoding="utf-8"))
    steps = document["steps"]
    notes = [step.get("note") for step in steps]
    first, last = map(notes.index, ONLY_IN_VIRTUAL_TIME)
    del steps[first : last + 1]
    for step in steps:
        passing = PASSING.get(step.get("note", ""), set())
        if passing:
            step["expect"] = {name: value for name, value in step["expect"].items() if name not in passing}
    document["steps"] = [step for step in steps if step.get("hold") not in FOR_PICTURES]
    return yaml.safe_dump(document | {"within": "30 s"}, sort_keys=False)


def test_demo_scenario_passes_and_independent_readers_confirm_it(tmp_path: Path) -> None:
    out = tmp_path / "basics"
    scenario = tmp_path / "story.yaml"
    scenario.write_text(without_passing_moments("basics"), encoding="utf-8")
    words = ("--chapter", "basics", "--scenario", str(scenario), "--out", str(tmp_path))
    result = demo_undisturbed(*words, log=out / "gateway.log", losses=1)
    assert result.returncode == 0, result.stdout + result.stderr
    check_report(out)
    frames_of_the_plc(out)
    frames_on_can(out)
    pictures(out)
    if shutil.which("tshark") is None:
        pytest.skip("tshark is not installed; what the others read is there")
    dissected(out)
