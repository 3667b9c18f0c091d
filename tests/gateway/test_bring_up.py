"""Nodes that are switched on: many at once, two with one node-ID or COB-ID, and failed SDOs with node, object and meaning."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import NMT, SDO_REQUEST, SDO_RESPONSE, NmtCommand
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.node.node import NodeStatus
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.dsp402.objects import CONTROLWORD
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode
from pdgw.peers.node.node import Value
from pdgw.peers.world import Member, World
from tests.support.gateways.daemon import OFF, ON, Plc, axis, configuration, drive_of, online, running, until, world_of

# -- each comes online at its first attempt -----------------------------------------------------------------------


ABORT = 0x80
TIMED_OUT = (0x0504_0000).to_bytes(4, "little")
QUIET = "tpdo_event_ms = 1000\nheartbeat_ms = 1000\n"
"""Few frames beside the SDOs: what takes long here is to simulate that every node hears every frame."""


def _plant(buses: int, nodes: int, bitrate: int) -> GatewayConfig:
    can = "".join(
        f'[[can]]\nname = "{bus}"\ninterface = "virtual"\nchannel = "{bus}"\nbitrate = {bitrate}\n'
        for bus in range(buses)
    )
    axes = "".join(
        f'[[axis]]\ndo_id = {bus * nodes + node}\nnode_id = {node}\ntelegram = 1\ncan = "{bus}"\nsimulate = true\n{QUIET}'
        for bus in range(buses)
        for node in range(1, nodes + 1)
    )
    return configuration(axes, can=can, transport="cycle_time_ms = 200\nwatchdog_factor = 30\n")


@pytest.mark.parametrize(
    ("buses", "nodes", "bitrate", "limit_s"), [(1, 24, 1_000_000, 4), (8, 4, 1_000_000, 5), (1, 16, 125_000, 20)]
)
def test_every_node_is_online_at_its_first_attempt(buses: int, nodes: int, bitrate: int, limit_s: int) -> None:
    timed_out: list[int] = []

    def hear(_now: int, _member: Member, can_id: int, data: bytes) -> None:
        if can_id & ~0x7F == SDO_REQUEST and data[0] == ABORT and data[4:] == TIMED_OUT:
            timed_out.append(can_id - SDO_REQUEST)

    def before(daemon: Daemon) -> None:
        world: World = world_of(daemon)
        for bus in range(buses):
            world.bus(str(bus)).taps.append(hear)

    with running(_plant(buses, nodes, bitrate), before) as daemon:
        online(daemon, limit_s * SECOND)
        world_of(daemon).loop.run_for(SECOND)
        assert timed_out == []
        assert {client.generation for client in daemon.clients} == {1}
        assert [record.text for item in daemon.objects for record in item.faults] == []


# -- two devices with one node-ID; a healthy node on a disturbed bus is not refused -------------------------------


REFUSED = "two devices? SDO requests are answered twice"


def _second(daemon: Daemon) -> SimulatedDrive:
    return world_of(daemon).drive("world", 1, serial_number=2)


def _run(plc: Plc, seconds: float) -> None:
    end = plc.loop.now() + int(seconds * SECOND)
    while plc.loop.now() < end:
        plc.exchange()


def test_two_drives_with_one_node_id_are_refused_before_they_move() -> None:
    seconds: list[SimulatedDrive] = []
    with running(configuration(axis(1)), lambda daemon: seconds.append(_second(daemon))) as daemon:
        client = daemon.axes[0].drive
        until(daemon, lambda: REFUSED in client.status_text, "refused")
        assert "node-ID 1" in client.status_text
        assert "set another node-ID there" in client.status_text
        assert client.generation == 0
        plc = Plc(daemon, [1])
        for word in (OFF, ON):
            plc.endpoint.set(0, {"STW1": word, "NSOLL_A": 0x1000})
            _run(plc, 6)
        assert [drive.model.ramp.speed for drive in (drive_of(daemon), seconds[0])] == [0, 0]
        assert {fault.number for fault in daemon.axes[0].faults} == {FaultNumber.NODE_REFUSED}


def test_a_second_drive_that_is_connected_stops_the_axis_until_it_is_removed() -> None:
    with running(configuration(axis(1))) as daemon:
        client, first = daemon.axes[0].drive, drive_of(daemon)
        until(daemon, lambda: client.generation, "online")
        plc = Plc(daemon, [1])
        plc.enable()
        plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": 0x1000})
        plc.until(lambda: first.model.ramp.speed > 100, "turning")
        second = _second(daemon)
        plc.until(lambda: REFUSED in client.status_text, "refused")
        _run(plc, 2)
        assert [drive.model.ramp.speed for drive in (first, second)] == [0, 0]
        second.do(lambda node: node.power_off())
        plc.until(lambda: client.generation == 2, "online again")
        _run(plc, 2)
        assert first.model.ramp.speed == 0, "the PLC has not given OFF and ON"


def test_a_second_tpdo_for_each_sync_ends_the_operation() -> None:
    with running(configuration(axis(1, more="simulate = true\nsync = true"))) as daemon:
        client, world = daemon.axes[0].drive, world_of(daemon)
        plc = Plc(daemon, [1])
        plc.until(lambda: client.generation, "online")
        _run(plc, 2)
        assert client.generation == 1
        member = world.bus("world").join("another device")
        world.bus("world").taps.append(
            lambda _now, sender, can_id, data: (
                member.send(0x181, data) if can_id == 0x181 and sender is not member else None
            )
        )
        plc.until(lambda: "TPDO1 more often than SYNC" in client.status_text, "found")


def test_another_tool_that_reads_the_same_objects_is_not_a_second_device() -> None:
    with running(configuration(axis(1))) as daemon:
        client, world = daemon.axes[0].drive, world_of(daemon)
        tool = world.bus("world").join("another tool")

        def repeat(_now: int, _sender: object, can_id: int, data: bytes) -> None:
            if can_id == SDO_REQUEST + 1 and _sender is not tool and data[0] == 0x40:
                tool.send(can_id, data)

        world.bus("world").taps.append(repeat)
        until(daemon, lambda: client.generation, "online")
        world.loop.run_for(5 * SECOND)
        assert client.generation == 1


@pytest.mark.parametrize("delay_ms", [60, 170, 300])
def test_late_answers_to_repeated_requests_are_not_a_second_device(delay_ms: int) -> None:
    """The first requests are repeated after 50 ms."""
    with running(configuration(axis(1))) as daemon:
        client = daemon.axes[0].drive
        drive_of(daemon).do(lambda node: node.start_fault("slow-sdo", delay_ms=delay_ms))
        until(daemon, lambda: client.generation, "online", 120 * SECOND)
        assert FaultNumber.NODE_REFUSED not in {fault.number for fault in daemon.axes[0].faults}


def test_restarts_of_a_node_and_of_the_bus_are_not_a_second_device() -> None:
    with running(configuration(axis(1))) as daemon:
        client, drive, world = daemon.axes[0].drive, drive_of(daemon), world_of(daemon)
        for online in (1, 3, 5, 7):
            until(daemon, lambda online=online: client.generation == online, "online")
            drive.do(lambda node: node.start(world.loop.now()))
            until(daemon, lambda online=online: client.generation == online + 1, "online after a restart")
            world.unplug("world")
            world.loop.run_for(SECOND)
            world.unplug("world", False)
        until(daemon, lambda: client.generation == 9, "online")
        assert not {FaultNumber.NODE_REFUSED} & {fault.number for fault in daemon.axes[0].faults}


# -- two nodes with one COB-ID ------------------------------------------------------------------------------------


FIRST, HIGHER = 1, 65
"""RPDO5 of the first has the COB-ID of RPDO1 of the other, 241h."""


def test_fifth_rpdo_of_a_node_commands_no_node_that_is_64_higher() -> None:
    """Telegram 100 sends outputs and their mask in RPDO5, as many bytes as Target Velocity and Controlword."""
    with running(configuration(axis(FIRST, telegram_number=100) + axis(HIGHER))) as daemon:
        other = drive_of(daemon, HIGHER)
        states: list[State] = []
        plc = Plc(daemon, [100, 1])
        until(daemon, lambda: daemon.axes[1].drive.generation, "node 65 online")
        plc.endpoint.set(1, {"STW1": OFF})
        plc.until(lambda: other.model.state is State.READY_TO_SWITCH_ON, "ready")
        for mask in (0x07, 0x0F) * 20:
            plc.endpoint.set(0, {"Digital Outputs": 1000, "Digital Outputs Mask": mask})
            plc.exchange()
            plc.exchange()
            states.append(other.model.state)
        assert State.OPERATION_ENABLED not in states
        assert other.model.velocity_actual == 0
        refused = daemon.axes[0].drive
        assert refused.status is NodeStatus.REFUSED
        assert "RPDO5" in refused.status_text
        assert "node 65" in refused.status_text


@pytest.mark.parametrize("left", [0x245, 0x8000_0245])
def test_rpdo_left_by_another_master_takes_no_commands_of_another_node(left: int) -> None:
    """Above node-ID 63 the gateway has no COB-ID for RPDO5; in the drive it still has that of RPDO1 of node 69."""

    def left_mapped(daemon: Daemon) -> None:
        def write(node: SimulatedDriveNode) -> None:
            node.values |= {(0x1604, 0): 2, (0x1604, 1): 0x60FF_0020, (0x1604, 2): 0x6040_0010, (0x1404, 1): left}
            node.pdos.map()

        drive_of(daemon, 70).do(write)

    with running(configuration(axis(69) + axis(70)), before=left_mapped) as daemon:
        until(daemon, lambda: all(item.good for item in daemon.axes), "online")
        plc, other = Plc(daemon, [1, 1]), drive_of(daemon, 70).model
        plc.endpoint.set(0, {"NSOLL_A": 0x1000})
        plc.endpoint.set(1, {"STW1": OFF})
        plc.enable()
        states = set()
        for _ in range(200):
            plc.exchange()
            states.add(other.state)
        assert State.OPERATION_ENABLED not in states
        assert other.velocity_actual == 0
        assert drive_of(daemon, 70).node.values[0x1404, 1] & 0x8000_0000


def _fixed(daemon: Daemon, node_id: int, cob_id: int) -> None:
    """RPDO5 of a drive keeps this COB-ID."""

    def write(node: SimulatedDriveNode) -> None:
        node.entries = {**node.entries, (0x1404, 1): Entry(0x1404, 1, "COB-ID", CanType.U32, Access.RO)}
        node.values[0x1404, 1] = cob_id

    drive_of(daemon, node_id).do(write)


def test_equal_drives_may_keep_a_cob_id_that_is_not_sent() -> None:
    def fixed(daemon: Daemon) -> None:
        _fixed(daemon, 69, 0x6FF)
        _fixed(daemon, 70, 0x6FF)

    with running(configuration(axis(69) + axis(70)), before=fixed) as daemon:
        until(daemon, lambda: all(item.good for item in daemon.axes), "online")


def test_drive_that_keeps_the_cob_id_of_another_node_is_refused() -> None:
    with running(configuration(axis(69) + axis(70)), before=lambda daemon: _fixed(daemon, 70, 0x245)) as daemon:
        until(daemon, lambda: daemon.axes[1].drive.status is NodeStatus.REFUSED, "refused")
        assert "RPDO5 unused" in daemon.axes[1].drive.status_text


# -- a failed SDO is reported with node, object and meaning of the abort code -------------------------------------


def _failure(daemon: Daemon, index: int, subindex: int = 0, data: bytes = b"") -> str:
    def access(node: NodeClient) -> None:  # type: ignore[type-arg]
        if data:
            node.sdo.write(index, subindex, data)
        else:
            node.sdo.read(index, subindex)

    future = daemon.axes[0].drive.submit(access)
    until(daemon, future.done, "an end of the access")
    return str(future.exception())


@pytest.mark.parametrize(
    ("index", "subindex", "data", "text"),
    [
        (0x5FFF, 0, b"", "node 1 object 5FFFh/0: 0602 0000h: object does not exist"),
        (0x6094, 9, b"", "node 1 object 6094h/9: 0609 0011h: sub-index does not exist"),
        (0x6041, 0, b"\0\0", "node 1 object 6041h/0: 0601 0002h: attempt to write a read-only object"),
    ],
)
def test_abort_names_node_object_and_text(index: int, subindex: int, data: bytes, text: str) -> None:
    with running(configuration(axis(1))) as daemon:
        online(daemon)
        assert _failure(daemon, index, subindex, data) == text


def test_missing_answer_names_node_and_object() -> None:
    with running(configuration(axis(1))) as daemon:
        online(daemon)
        drive_of(daemon).do(lambda node: node.start_fault("slow-sdo", delay_ms=5000))
        assert _failure(daemon, 0x6080) == "node 1 object 6080h/0: No SDO response received"


def test_refused_configuration_names_node_object_and_text() -> None:
    with running(configuration(axis(1))) as daemon:
        drive_of(daemon).do(lambda node: node.entries.pop((0x6060, 0)))
        until(daemon, lambda: daemon.axes[0].drive.status.value == "refused", "refused")
        told = daemon.axes[0].drive.status_text
        assert told.startswith("node 1 mode of operation (6060h/0 := 3h): '0609 0011h: sub-index does not exist'")


def test_fault_without_emcy_is_reported_although_its_number_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(configuration(axis(1))) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        plc, drive = Plc(daemon, [1]), drive_of(daemon)
        plc.enable()
        monkeypatch.setattr(drive.node, "send_emcy", lambda *_: None)
        drive.do(lambda node: node.start_fault("sdo-timeout"))
        drive.do(lambda node: node.start_fault("drive-fault", number=10))
        plc.until(lambda: plc.value("ZSW1") & 1 << 3, "fault in ZSW1")
        plc.until(lambda: daemon.axes[0].faults, "fault in P947")
        assert daemon.axes[0].faults[0].text.endswith("shows a fault (no EMCY)")


def test_fault_of_before_the_start_says_that_its_time_is_not_its_own() -> None:
    with running(configuration(axis(1)), lambda daemon: drive_of(daemon).inject(7)) as daemon:
        until(daemon, lambda: daemon.axes[0].faults, "the fault")
        (fault,) = snapshot(daemon)["axes"][0]["faults"]
        assert fault["text"] == "over-current (older than the connection)"
        assert snapshot(daemon)["axes"][0]["sentence"].startswith("Fault: over-current (older than the connection). ")
        drive_of(daemon).clear()
        plc = Plc(daemon, [1])
        plc.endpoint.set(0, {"STW1": OFF})
        plc.exchange(5)
        plc.endpoint.set(0, {"STW1": OFF | 0x80})
        plc.until(lambda: daemon.axes[0].fault_log.acknowledged, "acknowledged")
        plc.endpoint.set(0, {"STW1": OFF})
        plc.exchange(100)
        drive_of(daemon).inject(8)
        plc.until(lambda: not daemon.axes[0].fault_log.acknowledged, "another fault")
        assert "connection" not in daemon.axes[0].faults[-1].text


def test_drive_that_answers_late_is_lost_once() -> None:
    """That its SDO time-out grows is a line of the log, no other loss."""
    with running(configuration(axis(1))) as daemon:
        made = daemon.axes[0]
        until(daemon, lambda: made.drive.generation, "online")
        drive_of(daemon).do(lambda node: node.start_fault("slow-sdo", delay_ms=700))
        world_of(daemon).bus("world").join("another tool").send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        until(daemon, lambda: made.drive.generation > 1, "online again", 300 * SECOND)
        assert [fault.number for fault in made.faults].count(FaultNumber.NODE_LOST) == 1


def test_quick_stop_that_is_rejected_by_sdo_names_its_object(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "gateway")

    def refuse(entry: Entry, _value: Value) -> None:
        if entry.address == CONTROLWORD:
            raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)

    with running(configuration(axis(1))) as daemon:
        Plc(daemon, [1]).enable()
        drive_of(daemon).do(lambda node: node.start_fault("turns-in-pre-operational"))
        drive_of(daemon).do(lambda node: setattr(node, "on_written", refuse))
        world_of(daemon).bus("world").join("another tool").send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        until(daemon, lambda: "rejects Quick Stop by SDO" in caplog.text, "a rejection")
        assert "rejects Quick Stop by SDO: node 1 object 6040h/0: 0800 0022h" in caplog.text


def test_answers_to_another_tool_do_not_lengthen_the_sdo_timeout(caplog: pytest.LogCaptureFixture) -> None:
    """The drive answers the tool, and does not answer the gateway for a while."""
    caplog.set_level("INFO", "gateway")
    with running(configuration(axis(1))) as daemon:
        made, node = daemon.axes[0], drive_of(daemon).node
        until(daemon, lambda: made.drive.generation, "online")
        other = world_of(daemon).bus("world").join("another tool")
        send = node.send

        def only_to_the_tool(can_id: int, data: bytes) -> None:
            if can_id != SDO_RESPONSE + 1 or data[1:3] == b"\x00\x20":
                send(can_id, data)

        node.send = only_to_the_tool
        other.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
        for _ in range(300):
            other.send(SDO_REQUEST + 1, b"\x40\x00\x20\x00\0\0\0\0")
            world_of(daemon).loop.run_for(10 * MS)
        node.send = send
        until(daemon, lambda: made.drive.generation > 1, "online again")
        assert "answers SDO late" not in caplog.text
