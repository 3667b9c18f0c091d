"""The node-ID of the gateway: its own on each bus, and another device that has the same."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.communication import CONSUMER_HEARTBEAT, DEFAULT_GATEWAY_NODE_ID, ERROR_CONTROL
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.tools.service import child_processes
from tests.support.gateways.daemon import axis, configuration, drive_of, online, operating, running, serving, world_of
from tests.support.gateways.parameters import number

HEARTBEAT = ERROR_CONTROL + DEFAULT_GATEWAY_NODE_ID
BUS = '[can]\ninterface = "virtual"\nchannel = "world"\n'
TWO_BUSES = """
[[can]]
name = "a"
interface = "virtual"
channel = "a"
node_id = 3
[[can]]
name = "b"
interface = "virtual"
channel = "b"
"""


def _consumed(daemon: Daemon, node_id: int, bus: str = "can") -> int:
    """The node-ID whose heartbeat a drive monitors."""
    data = drive_of(daemon, node_id, bus).node.get_data(CONSUMER_HEARTBEAT, 1)
    return int.from_bytes(data, "little") >> 16


def _senders(daemon: Daemon, bus: str) -> set[int]:
    """Node-IDs with which the gateway sends heartbeats on a bus within a second."""
    sent: set[int] = set()
    network = daemon.networks[bus]
    network.listeners.append(lambda m: None if m.is_rx else sent.add(m.arbitration_id))
    world_of(daemon).loop.run_for(SECOND)
    return {cob_id - ERROR_CONTROL for cob_id in sent if cob_id > ERROR_CONTROL}


def test_each_bus_has_its_own_node_id_of_the_gateway() -> None:
    axes = axis(1, more='can = "a"\nsimulate = true') + axis(2, more='can = "b"\nsimulate = true')
    with running(configuration(axes, can=TWO_BUSES)) as daemon:
        online(daemon)
        assert (_senders(daemon, "a"), _senders(daemon, "b")) == ({3}, {127})
        assert (_consumed(daemon, 1, "a"), _consumed(daemon, 2, "b")) == (3, 127)


def test_drive_may_have_the_default_node_id_if_the_gateway_has_another() -> None:
    drive = axis(1).replace("node_id = 1", "node_id = 127")
    with operating(configuration(drive, can=f"{BUS}node_id = 126\n")) as (daemon, plc):
        plc.turn(0x2000)
        assert not daemon.axes[0].faults
        assert (_senders(daemon, "can"), _consumed(daemon, 127)) == ({126}, 126)


def test_heartbeat_of_the_default_node_id_is_of_any_device_if_the_gateway_has_another() -> None:
    with operating(configuration(axis(1), can=f"{BUS}node_id = 126\n")) as (daemon, plc):
        device = world_of(daemon).bus("world").join("a new device")
        for state in (0, 0x7F, 5):
            device.send(HEARTBEAT, bytes((state,)))
            plc.exchange(20)
        assert not daemon.stopped.is_set()
        assert plc.state() == 0x07
        device.send(ERROR_CONTROL + 126, b"\x05")
        plc.exchange()
        assert "the heartbeat" in str(daemon.failure)
        assert "node 126" in str(daemon.failure)


def test_drives_stop_when_a_gateway_with_another_node_id_dies() -> None:
    """The heartbeat consumer of the drive is set to that node-ID."""
    with operating(configuration(axis(1), can=f"{BUS}node_id = 2\n")) as (daemon, plc):
        plc.turn(0x2000)
        model = drive_of(daemon).model
        daemon.networks["can"].close()
        plc.until(lambda: model.velocity_actual == 0, "standstill")


def test_planned_heartbeat_of_the_gateway_has_its_cob_id() -> None:
    config = parse_config(f"{BUS}node_id = 5\n{axis(1)}")
    frames = {frame.cob_id: frame for frame in config.frames_of(config.can[0])}
    assert frames[0x705].name == "heartbeat 5"
    assert HEARTBEAT not in frames


def test_p918_of_the_device_is_the_node_id_of_the_gateway() -> None:
    with serving(configuration(axis(1) + axis(2), can=f"{BUS}node_id = 9\n"), 0) as (_, client):
        assert number(client, 918) == 9


def test_bus_of_simulated_device_processes_has_the_node_id_of_the_gateway(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = iter(['channel = "served"\n', "drive 1; commands: none\n"])
    started = SimpleNamespace(stdout=lines)
    monkeypatch.setattr(child_processes, "_process", lambda *_: nullcontext(started))
    config = configuration(axis(1), can=f"{BUS}node_id = 9\n")
    with child_processes.device_processes(config) as reached:
        assert (reached.can[0].channel, reached.can[0].node_id) == ("served", 9)
