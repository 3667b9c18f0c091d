"""`pdgw sim encoder`: motions and faults of simulated encoders at run time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.peers.simulation.console import Console
from pdgw.peers.simulation.devices import Simulation, encoder_device
from pdgw.peers.world import World
from tests.support.cli import pdgw


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    world = World()
    simulation = Simulation(world.loop)
    bus = world.bus("a")
    options = {"model": "multi-sensor", "channels": 3, "motion": ("still=2",)}
    simulation.add("encoder", bus.join("node 3"), 3, 3, **options)
    simulation.add("drive", bus.join("node 4"), 4, 4)
    simulation.start()
    assert simulation.status(3)["position"] == [8192, 0, 0]
    yield simulation
    simulation.stop()


def test_motions_start_at_the_present_position(simulation: Simulation, tmp_path: Path) -> None:
    console = Console(simulation, threading.Event())
    assert console.execute("@3 motion sine=1,2") == "ok"
    assert console.execute("@3 Motion still") == "ok"
    channel = simulation.device(3).node.model.channels[1]  # type: ignore[attr-defined]
    assert 1.9 < channel.motion(0) < 2.5
    file = tmp_path / "Recorded.CSV"
    file.write_text("0,7\n")
    assert console.execute(f"@3 motion csv={file} 2") == "ok"
    assert simulation.status(3)["position"][1] == 7 * 4096  # type: ignore[index]
    assert console.execute("@3 motion still=1 9").startswith("error: encoder channel: 9")
    assert console.execute("@3 motion fly").startswith("error: motion: 'fly'")
    assert console.execute("@4 motion still").startswith("error: node: 4 is not allowed, expected an encoder")


def test_an_encoder_sits_on_the_shaft_of_a_drive_of_the_same_bus(simulation: Simulation) -> None:
    drive = simulation.device(4)
    drive.do(lambda node: setattr(node.model, "machine_position", 2.5 * 4096))  # type: ignore[attr-defined]
    simulation.move(3, "shaft=4", 3)
    assert simulation.status(3)["position"][2] == 2.5 * 4096  # type: ignore[index]
    with pytest.raises(
        CanopenError, match=r"node whose shaft turns the encoder: 3 .* a drive simulated beside it: \[4\]"
    ):
        simulation.move(3, "shaft=3", 1)


def test_alarms_and_warnings_by_name(simulation: Simulation) -> None:
    console = Console(simulation, threading.Event())
    assert console.execute("@3 fault position-error") == "ok: position-error"
    assert console.execute("@3 fault light") == "ok: light"
    status = console.execute("@3 status")
    assert "alarms position error" in status
    assert "warnings light control reserve" in status
    assert "misbehaves: position-error light" in status
    assert console.execute("@3 clear light") == "ok"
    assert simulation.status(3)["warnings"] == "none"
    assert console.execute("@3 clear") == "ok"
    assert simulation.status(3)["alarms"] == "none"
    assert console.execute("@4 fault light").startswith("error: fault: 'light'")
    assert console.execute("@3 fault 7").startswith("error: fault: 'drive-fault'")


def test_a_model_that_does_not_exist_is_named() -> None:
    with pytest.raises(CanopenError, match=r"model of encoder: 'x' .* rotary, linear, multi-sensor"):
        encoder_device("x")


def test_invalid_motion_is_reported() -> None:
    result = pdgw("sim", "encoder", "--motion", "fly")
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert "speed=PER_SECOND" in result.stderr
