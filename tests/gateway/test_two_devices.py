"""Two devices with one node-ID are refused with their reason; a healthy node on a busy or disturbed bus is not."""

from __future__ import annotations

import pytest

from pdgw.ds301.communication import ERROR_CONTROL, SDO_REQUEST, NmtState
from pdgw.durations import MS, SECOND
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.drive import SimulatedDrive
from tests.support.gateways.daemon import OFF, ON, Plc, axis, configuration, drive_of, running, until, world_of

REFUSED = "two devices? SDO requests are answered twice"


def _second(daemon: Daemon, *, powered: bool = True) -> SimulatedDrive:
    return world_of(daemon).drive("world", 1, powered=powered, serial_number=2)


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


def test_a_second_heartbeat_ends_the_operation() -> None:
    """Of a device that answers no SDO."""
    with running(configuration(axis(1))) as daemon:
        client, world = daemon.axes[0].drive, world_of(daemon)
        until(daemon, lambda: client.generation, "online")
        member = world.bus("world").join("another device")
        begin = world.loop.now()

        def beat() -> None:
            member.send(ERROR_CONTROL + 1, bytes((NmtState.OPERATIONAL,)))
            world.loop.call_later(client.settings.heartbeat_ms * MS, beat)

        world.loop.call_later(30 * MS, beat)
        texts: list[str] = []
        until(daemon, lambda: texts.append(client.status_text) or "heartbeats come more often" in texts[-1], "found")  # type: ignore[func-returns-value]
        assert world.loop.now() - begin < 10 * client.settings.heartbeat_ms * MS
        assert "'two devices? heartbeats come more often than every 100 ms'" in texts[-1]


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


def test_another_tool_that_reads_the_same_objects_is_no_second_device() -> None:
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
def test_late_answers_to_repeated_requests_are_no_second_device(delay_ms: int) -> None:
    """The first requests are repeated after 50 ms."""
    with running(configuration(axis(1))) as daemon:
        client = daemon.axes[0].drive
        drive_of(daemon).do(lambda node: node.misbehave("slow-sdo", delay_ms=delay_ms))
        until(daemon, lambda: client.generation, "online", 120 * SECOND)
        assert FaultNumber.NODE_REFUSED not in {fault.number for fault in daemon.axes[0].faults}


def test_restarts_of_a_node_and_of_the_bus_are_no_second_device() -> None:
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
