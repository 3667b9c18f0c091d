"""The chapters of the demo: their files are valid, and their scenarios pass in virtual time."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import typer

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.scenario_file import load_scenario
from pdgw.peers.simulation.config import add_device, parse_bus
from pdgw.peers.simulation.console import Console
from pdgw.peers.simulation.devices import Simulation
from pdgw.profidrive.signals import signal
from pdgw.tools.commands.simulation.demo import ChapterName, demo
from pdgw.tools.demo.chapters import CHAPTERS
from pdgw.tools.demo.links import OnLoopback
from pdgw.tools.demo.plot import plot
from pdgw.tools.demo.sequence import Demo, Outcome
from tests.support.gateways.daemon import Plc, drive_of, running, world_of
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
    config = parse_config(toml_text(chapter.gateway(CAN, FREE_PORTS)))
    bus = parse_bus(toml_text(chapter.devices(CAN, 5000)))
    assert [device.node_id for device in bus.device] == [item.node_id for item in (*config.axis, *config.encoder)]
    scenario = load_scenario(chapter.scenario)
    assert scenario.telegrams == [item.telegram for item in (*config.axis, *config.encoder)]
    notes = [step.note for step in scenario.steps]
    for panel in chapter.panels:
        assert any(note.startswith(f"{panel.notes}: ") for note in notes), panel.title


ELSEWHERE = {"read", "write"}
"""Actions of the parameter channel."""
FOLLOWS = {"the absolute value is the preset"}
"""Expectations that follow from these."""
FOR_PICTURES = {"400 ms", "500 ms", "1 s"}
"""Times of the steps that only extend a curve."""


@pytest.mark.parametrize("name", CHAPTERS)
def test_scenario_of_a_chapter_passes_and_is_replayed_equal(name: str, tmp_path: Path) -> None:
    chapter = CHAPTERS[name]
    scenario = load_scenario(chapter.scenario)
    steps = [
        step
        for step in scenario.steps
        if step.action not in ELSEWHERE and step.note not in FOLLOWS and step.hold not in FOR_PICTURES
    ]
    consoles: list[Console] = []

    def power_on(daemon: Daemon) -> None:
        """The devices of ``pdgw sim bus``, with their console."""
        world = world_of(daemon)
        simulation = Simulation(world.loop)
        for device in parse_bus(toml_text(chapter.devices(CAN, 5000))).device:
            add_device(simulation, device, world.bus(CAN["channel"]).join(f"node {device.node_id}"))
        simulation.start()
        consoles.append(Console(simulation, threading.Event()))

    with recorded(parse_config(toml_text(chapter.gateway(CAN, FREE_PORTS))), tmp_path, power_on) as plc:
        engine = Engine(scenario.model_copy(update={"steps": steps}), plc.endpoint)
        engine.drive = consoles[0].execute
        while not engine.finished:
            engine.step(plc.loop.now())
            plc.silent = engine.muted
            plc.exchange()
    assert engine.passed, [result for result in engine.results if not result.passed]
    assert len(engine.results) > 10
    for panel in chapter.panels:
        values = plc.endpoint.setpoints[panel.axis - 1] | (plc.endpoint.actuals[panel.axis - 1] or {})
        assert all(math.isfinite(curve.value(values)) for curve in panel.curves)
    assert not differences(replay_of(tmp_path))


def test_dsc_scenario_fails_with_a_drive_in_fault() -> None:
    chapter = CHAPTERS["dsc"]
    fault = signal("ZSW1").bit("FAULT")
    scenario = load_scenario(chapter.scenario)
    steps = [step.model_copy(update={"within": "5 s"}) for step in scenario.steps]
    with running(parse_config(toml_text(chapter.gateway(CAN, FREE_PORTS, simulate=True)))) as daemon:
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


def test_interrupted_demo_exits_with_130(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: Demo) -> Outcome:
        raise KeyboardInterrupt

    monkeypatch.setattr(Demo, "run", interrupted)
    with pytest.raises(typer.Exit) as error:
        demo(chapter=[ChapterName("dsc")], out=tmp_path)
    assert error.value.exit_code == 130


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


def dsc_demo(out: Path, kind: type[Scenarios] = Scenarios) -> Scenarios:
    return kind(CHAPTERS["dsc"], out, lambda _: None, OnLoopback())


class Dying(Scenarios):
    """A demo whose gateway is killed while its PLC runs the scenario."""

    def _start(self, channel: str) -> None:
        for name in ("plc", "gateway", "devices"):
            command = ["sh", "-c", 'echo \'{"note": "enable"}\'; exec sleep 600']
            self._processes[name] = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            (self.out / f"{name}.log").write_text(f"last words of {name}")
        self._processes["gateway"].kill()
        self._processes["gateway"].wait()

    _follow, _stop = Demo._follow, Demo._stop


def test_demo_whose_gateway_dies_ends_all_processes_and_reports_why(tmp_path: Path) -> None:
    demo = dsc_demo(tmp_path, Dying)
    (tmp_path / "report.json").write_text('{"passed": true}')  # of an earlier one
    with pytest.raises(GatewayError, match="the gateway process ended with status -9: last words of gateway"):
        demo.run()
    assert all(process.returncode for process in demo._processes.values())
    assert not (tmp_path / "report.json").exists()


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
