"""The node-ID of the gateway: its own on each bus, and another device that has the same."""

from __future__ import annotations

import re
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import (
    CONSUMER_HEARTBEAT,
    DEFAULT_GATEWAY_NODE_ID,
    ERROR_CONTROL,
    SDO_RESPONSE,
    NmtCommand,
    NmtState,
)
from pdgw.ds301.emcy import HEARTBEAT_ERROR
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.daemon.masters import LISTEN_NS
from pdgw.gateway.service.status import snapshot
from pdgw.peers.world.can_bus import Member
from pdgw.tools.output.status_text import status_lines
from pdgw.tools.service import child_processes
from tests.support.gateways.daemon import (
    axis,
    configuration,
    drive_of,
    exchanging,
    online,
    operating,
    running,
    serving,
    world_of,
)
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


# -- a device with the node-ID of the gateway ---------------------------------------------------------------------------------

BOOTED = "CAN bus can: a device with node-ID 127, which is that of the gateway, booted at "
CAUSE = r"follows the boot-up at [\d:]+ of a device with the node-ID of the gateway, 127"
OTHER_ID = "give the device another node-ID, or set another [can] node_id"


def _new_device(daemon: Daemon) -> Member:
    return world_of(daemon).bus("world").join("a new device")


@pytest.mark.parametrize(
    ("cob_id", "data", "did"),
    [(HEARTBEAT, b"\0", "booted"), (SDO_RESPONSE + 127, b"\x43\0\x10\0\x92\x01\2\0", "answered an SDO request")],
    ids=["boot-up", "SDO answer"],
)
def test_device_with_the_node_id_of_the_gateway_is_named_and_stops_nothing(
    cob_id: int, data: bytes, did: str, caplog: pytest.LogCaptureFixture
) -> None:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        _new_device(daemon).send(cob_id, data)
        plc.exchange(100)
        assert (daemon.failure, plc.state(), plc.value("NIST_A")) == (None, 0x07, 0x2000)
        assert not daemon.axes[0].faults
        text = f"CAN bus can: a device with node-ID 127, which is that of the gateway, {did} at "
        (note,) = snapshot(daemon)["notes"]
        assert note.startswith(text)
        assert note.endswith(OTHER_ID)
        assert f"  -> {note}" in list(status_lines(snapshot(daemon), 400))
        assert note in caplog.text
        assert note in [event.text for event in daemon.events.after(0)]


def test_device_that_boots_before_the_start_of_the_gateway_does_not_prevent_it() -> None:
    def before(daemon: Daemon) -> None:
        device = _new_device(daemon)
        daemon.loop.call_later(LISTEN_NS - MS, lambda: device.send(HEARTBEAT, b"\0"))

    with running(configuration(axis(1)), before) as daemon:
        online(daemon)
        assert daemon.notes[0].startswith(BOOTED)


def test_repeated_boot_up_is_one_line_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    with operating() as (daemon, plc):
        device = _new_device(daemon)
        for _ in range(10):
            device.send(HEARTBEAT, b"\0")
            plc.exchange(50)
        assert caplog.text.count(BOOTED) == 1
        world_of(daemon).loop.run_for(11 * SECOND)
        device.send(HEARTBEAT, b"\0")
        plc.exchange(50)
        assert caplog.text.count(BOOTED) == 2
        assert len(daemon.notes) == 1


@pytest.mark.parametrize("state", [NmtState.STOPPED, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL])
@pytest.mark.parametrize("boots", [True, False])
def test_heartbeat_with_the_node_id_of_the_gateway_stops_the_drives(state: NmtState, boots: bool) -> None:
    with operating() as (daemon, plc), exchanging(plc):
        plc.turn(0x2000)
        device = _new_device(daemon)
        if boots:
            device.send(HEARTBEAT, b"\0")
            plc.exchange(100)
        device.send(HEARTBEAT, bytes((state,)))
        world_of(daemon).loop.until(daemon.stopped.is_set, "the end of the gateway", 10 * SECOND)
        assert drive_of(daemon).model.velocity_actual == 0
        text = str(daemon.failure)
        who = "the device that booted at " if boots else "a device with the same node-ID,"
        assert text.startswith(f"CAN bus can: another gateway, or {who}")
        assert f"sends the heartbeat of node 127 ({NmtState.text(state)})" in text
        assert OTHER_ID in text
        assert daemon.axes[0].faults[-1].number == FaultNumber.OTHER_MASTER
        status = daemon.axes[0].enable_status
        assert status.broken is not None
        assert f"sends the heartbeat of node 127 ({NmtState.text(state)})" in status.broken.evidence
        assert OTHER_ID in status.broken.todo


def _reacting(daemon: Daemon) -> None:
    """The heartbeat consumer of the drive reacts to a boot-up of the node that it monitors."""
    drive_of(daemon).do(lambda node: node.on_consumer_expired(127))


def test_drive_whose_heartbeat_consumer_reacts_to_the_boot_up_is_named_with_its_cause() -> None:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        _new_device(daemon).send(HEARTBEAT, b"\0")
        _reacting(daemon)
        plc.exchange(100)
        status = daemon.axes[0].enable_status
        assert re.search(
            rf": {CAUSE}, since [\d:]+\. Its heartbeat .*: {re.escape(OTHER_ID)}; then OFF", status.sentence
        )
        (emergency,) = [fault for fault in daemon.axes[0].faults if fault.code == HEARTBEAT_ERROR]
        assert re.match(f"EMCY 8130h CANopen: {CAUSE}", emergency.text)


def test_drive_that_leaves_operation_without_emcy_after_the_boot_up_is_named_with_its_cause() -> None:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        _new_device(daemon).send(HEARTBEAT, b"\0")
        drive_of(daemon).do(lambda node: node.model.abort_connection())
        plc.exchange(100)
        fault = daemon.axes[0].faults[0]
        assert fault.number == FaultNumber.LEFT_OPERATION
        assert re.search(CAUSE, fault.text)


def test_drive_that_becomes_pre_operational_after_the_boot_up_is_named_with_its_cause() -> None:
    """1029h/1 = 0: the reaction to an error of the communication."""
    with operating() as (daemon, plc):
        _new_device(daemon).send(HEARTBEAT, b"\0")
        drive_of(daemon).do(lambda node: node._nmt(NmtCommand.ENTER_PRE_OPERATIONAL))
        plc.exchange(100)
        fault = daemon.axes[0].faults[0]
        assert fault.number == FaultNumber.NODE_LOST
        assert re.search(CAUSE, fault.text)


@pytest.mark.parametrize("after_s", [0.0, 1.5])
def test_faults_without_a_heartbeat_consumer_or_long_after_the_boot_up_are_not_its_consequence(after_s: float) -> None:
    with operating() as (daemon, plc):
        _new_device(daemon).send(HEARTBEAT, b"\0")
        plc.exchange(int(after_s * SECOND) // daemon.cycle_ns)
        if after_s:
            _reacting(daemon)
        else:
            drive_of(daemon).do(lambda node: node.start_fault("drive-fault"))
        plc.exchange(100)
        assert daemon.axes[0].faults
        assert not [fault for fault in daemon.axes[0].faults if "boot-up" in fault.text]


def test_lost_drive_after_the_boot_up_is_not_its_consequence() -> None:
    with operating() as (daemon, plc):
        _new_device(daemon).send(HEARTBEAT, b"\0")
        drive_of(daemon).do(lambda node: node.power_off())
        plc.until(lambda: daemon.axes[0].faults, "a fault")
        assert "boot-up" not in daemon.axes[0].faults[0].text
