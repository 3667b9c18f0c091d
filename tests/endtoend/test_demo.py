"""The demo as the README starts it, and its evidence read by independent readers."""

from __future__ import annotations

import json
from pathlib import Path

import can
import pytest
from scapy.utils import rdpcap

from profidrive.scapy_layers import ProfidriveCyclic, bind
from tests.endtoend.processes import pdgw
from tests.support import tshark

pytestmark = pytest.mark.e2e


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo")
    result = pdgw("demo", "--out", str(out))
    assert result.returncode == 0, result.stdout + result.stderr
    return out


def test_every_expectation_of_the_story_passed(evidence: Path) -> None:
    report = json.loads((evidence / "report.json").read_text())
    assert report["passed"]
    assert len(report["results"]) >= 50
    assert all(item["passed"] for item in report["results"])
    story = " ".join(note for _, note in report["notes"])
    for chapter in (
        "OFF1",
        "quick stop",
        "over-current",
        "homing",
        "relative",
        "intermediate",
        "rejected",
        "on the fly",
    ):
        assert chapter in story
    assert report["exit_codes"] == {"plc": 0, "gateway": 0, "drives": 0}


def test_the_pcap_shows_the_enable_and_the_speed(evidence: Path) -> None:
    bind([1, 9, 100])
    packets = [p for p in rdpcap(str(evidence / "plc.pcap")) if ProfidriveCyclic in p]
    assert len(packets) > 1000
    setpoints = [p[ProfidriveCyclic].data[0] for p in packets if p.frameID == 0xC001]
    actuals = [p[ProfidriveCyclic].data[0] for p in packets if p.frameID == 0xC000]
    assert any(part.STW1.ON and part.NSOLL_A == 0x2000 for part in setpoints)
    assert any(part.ZSW1.OPERATION_ENABLED and abs(part.NIST_A - 0x2000) < 60 for part in actuals)
    assert any(part.ZSW1.FAULT for part in actuals)
    assert all(p[ProfidriveCyclic].dataStatus.run for p in packets)


@pytest.mark.tshark
@tshark.needs_tshark
def test_tshark_dissects_the_pcap_as_profinet(evidence: Path) -> None:
    rows = tshark.fields(evidence / "plc.pcap", ["pn_rt.frame_id", "pn_rt.ds"])
    assert {int(row["pn_rt.frame_id"], 0) for row in rows} == {0xC000, 0xC001}
    assert {int(row["pn_rt.ds"], 0) for row in rows} == {0x35}


def test_the_can_log_holds_configuration_and_process_data(evidence: Path) -> None:
    messages = list(can.LogReader(evidence / "can.log"))
    identifiers = {message.arbitration_id for message in messages}
    for node in (1, 2, 3):
        assert {0x600 + node, 0x580 + node, 0x200 + node, 0x180 + node, 0x700 + node} <= identifiers
    assert any(message.arbitration_id == 0x81 and bytes(message.data[:2]) == b"\x10\x23" for message in messages)


def test_the_picture_is_there(evidence: Path) -> None:
    assert (evidence / "trace.png").read_bytes().startswith(b"\x89PNG")
