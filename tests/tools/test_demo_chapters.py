"""The chapters of the demo: their files are valid, and their scenarios pass in virtual time."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import typer

from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario import Scenario
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.peers.simulation.config import parse_bus
from pdgw.profidrive.signals import signal
from pdgw.tools.commands.simulation.demo import ChapterName, demo
from pdgw.tools.demo.chapters import CHAPTERS
from pdgw.tools.demo.links import OnLoopback
from pdgw.tools.demo.plot import plot
from pdgw.tools.demo.sequence import Demo, Outcome
from tests.support.gateways.daemon import Plc, drive_of, running
from tests.support.gateways.recorded_daemon import differences, recorded, replay_of

CAN = {"interface": "virtual", "channel": "world"}
FREE_PORTS = {"cyclic_port": 0, "acyclic_port": 0}


def test_a_demo_without_matplotlib_has_no_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """From a plain wheel: a chapter of half a minute is not lost at its end."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    plot(next(iter(CHAPTERS.values())), tmp_path / "plc.pcap", tmp_path / "gateway.toml", 0, [], tmp_path / "trace.png")
    assert not (tmp_path / "trace.png").exists()


@pytest.mark.parametrize("name", CHAPTERS)
def test_gateway_devices_and_scenario_of_a_chapter_match(name: str) -> None:
    chapter = CHAPTERS[name]
    config = parse_config(chapter.gateway(CAN, FREE_PORTS))
    bus = parse_bus(chapter.devices(CAN, 5000))
    assert [device.node_id for device in bus.device] == [item.node_id for item in (*config.axis, *config.encoder)]
    scenario = load_scenario(chapter.scenario)
    assert scenario.telegrams == [item.telegram for item in (*config.axis, *config.encoder)]
    notes = [step.note for step in scenario.steps]
    for panel in chapter.panels:
        assert any(note.startswith(f"{panel.notes}: ") for note in notes), panel.title


ELSEWHERE = {"read", "write", "drive", "ack", "mute"}
"""Actions for parameter channel, device console and network."""
FOLLOWS = {
    "fault, power off",
    "does not start by itself",
    "drive 1 stopped",
    "drive 3 stopped",
    "a standing ON does not restart it",
}
"""Expectations that follow from these."""


def movements(name: str) -> Scenario:
    """The part of a chapter's scenario that needs only drives, a scenario engine and frames."""
    scenario = load_scenario(CHAPTERS[name].scenario)
    drives = len(CHAPTERS[name].axes)
    own = [step for step in scenario.steps if step.axis <= drives and step.action not in ELSEWHERE]
    return scenario.model_copy(update={"steps": [step for step in own if step.note not in FOLLOWS]})


@pytest.mark.parametrize("name", CHAPTERS)
def test_scenario_of_a_chapter_passes_and_is_replayed_equal(name: str, tmp_path: Path) -> None:
    chapter = CHAPTERS[name]
    scenario = movements(name)
    with recorded(parse_config(chapter.gateway(CAN, FREE_PORTS, simulate=True)), tmp_path) as plc:
        engine = Engine(scenario, plc.endpoint)
        while not engine.finished:
            engine.step(plc.loop.now())
            plc.exchange()
    assert engine.passed, [result for result in engine.results if not result.passed]
    assert len(engine.results) > 10
    assert not differences(replay_of(tmp_path))


def test_dsc_scenario_fails_with_a_drive_in_fault() -> None:
    chapter = CHAPTERS["dsc"]
    fault = signal("ZSW1").bit("FAULT")
    scenario = load_scenario(chapter.scenario)
    steps = [step.model_copy(update={"within": "5 s"}) for step in scenario.steps]
    with running(parse_config(chapter.gateway(CAN, FREE_PORTS, simulate=True))) as daemon:
        plc = Plc(daemon, [105])
        engine = Engine(scenario.model_copy(update={"steps": steps}), plc.endpoint)
        while engine.passed:
            assert not engine.finished
            engine.step(plc.loop.now())
            plc.exchange()
            if engine.current.endswith("the error is large") and not fault.of(plc.value("ZSW1")):
                drive_of(daemon).node.model.inject(7)
    failed = [result.name for result in engine.results if not result.passed]
    assert "follows a sine" in failed[0]


def test_failed_scenario_exits_with_1_and_names_the_failed_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = {
        "step": 1,
        "axis": 1,
        "name": "turns",
        "passed": False,
        "measured": "NIST_B = 0",
        "time_s": 1.0,
        "waited_s": 1.0,
    }
    report = {
        "passed": False,
        "results": [result],
        "duration_s": 1.0,
        "exit_codes": {"plc": 1, "gateway": -9, "devices": 0},
    }
    monkeypatch.setattr(Demo, "run", lambda _: Outcome(report))
    with pytest.raises(typer.Exit) as error:
        demo(chapter=[ChapterName("dsc")], out=tmp_path)
    assert error.value.exit_code == 1
    told = capsys.readouterr().out
    assert "the gateway process ended with status -9; see" in told
    assert "the plc process" not in told


def test_messages_of_the_plc_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as a gateway that needs long to start."""

    def run(demo: Demo) -> Outcome:
        for document in (
            {"note": "start-up", "time_s": 0.5},
            {"message": "no datagram from a gateway"},
            {"result": {"passed": True}},
        ):
            demo.show(document)
        return Outcome({"passed": True, "results": [], "duration_s": 1.0, "exit_codes": {}})

    monkeypatch.setattr(Demo, "run", run)
    demo(chapter=[ChapterName("dsc")], out=tmp_path)
    assert "start-up\nno datagram from a gateway\n" in capsys.readouterr().out


class Scenarios(Demo):
    """A demo without started processes; its PLC has reported success and ended with ``status``."""

    status = 0

    def _start(self, channel: str) -> None:
        (self.out / "plc.json").write_text('{"passed": true, "results": [], "notes": [], "begin_s": 0}')
        (self.out / "plc.log").write_text("error: --pcap x: cannot be written (No space left on device)")

    def _follow(self) -> None:
        """There is nothing to follow."""

    def _stop(self) -> dict[str, int]:
        return {"plc": self.status, "gateway": 0, "devices": 0}


def dsc_demo(out: Path) -> Scenarios:
    return Scenarios(CHAPTERS["dsc"], out, lambda _: None, OnLoopback())


def test_unwritten_recording_of_the_plc_is_a_failure(tmp_path: Path) -> None:
    demo = dsc_demo(tmp_path)
    demo.status = 1
    with pytest.raises(GatewayError, match="PLC simulator ended with status 1: error: --pcap x: cannot be written"):
        demo.run()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_unwritable_result_file_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pdgw.tools.demo.sequence._EVIDENCE", ())
    (tmp_path / "report.json").symlink_to("/dev/full")
    with pytest.raises(GatewayError, match=r"report\.json: cannot be written \(No space left on device\)"):
        dsc_demo(tmp_path).run()


def test_custom_scenario_needs_a_chapter(tmp_path: Path) -> None:
    with pytest.raises(GatewayError, match=r"--scenario: needs one --chapter too \(basics, positioner, dsc\)"):
        demo(chapter=[ChapterName("basics"), ChapterName("dsc")], out=tmp_path, scenario=tmp_path / "s.yaml")
