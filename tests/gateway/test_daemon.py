"""The daemon with PLCs and simulated drives, in virtual time; what needs the machine's own ports is marked."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import NMT, NmtCommand, NmtState
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.dsp402.drive.client import DriveStatus
from pdgw.dsp402.states import State
from pdgw.gateway.axis.orders import Brake
from pdgw.gateway.axis.values import Outputs
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.udp import UdpSocket
from pdgw.gateway.configuration.file import simulated
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.link import UdpLink
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.service import status_client
from pdgw.gateway.service import status_port as port_module
from pdgw.gateway.service.status_client import fetch, fetch_faults
from pdgw.gateway.service.status_port import StatusServer
from pdgw.peers.world import World
from tests.support.buses import PATIENCE_S, wait_for
from tests.support.gateways import machine
from tests.support.gateways.daemon import (
    OFF,
    ON,
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    online,
    operating,
    running,
    until,
    world_of,
)
from tests.support.gateways.fault_display import drive_state
from tests.support.gateways.socket_plc import SocketPlc
from tests.support.processes import free_tcp_port


def endpoint_of(daemon: Daemon) -> CyclicEndpoint:
    """The gateway's end of the cyclic relationship."""
    assert isinstance(daemon.link, UdpLink)
    return daemon.link.endpoint


def test_two_buses_carry_nodes_of_the_same_number() -> None:
    can = "".join(f'[[can]]\nname = "{name}"\ninterface = "virtual"\nchannel = "{name}"\n' for name in ("l", "r"))
    axes = "".join(
        f'[[axis]]\ndo_id = {n}\nnode_id = 5\ntelegram = 1\ncan = "{bus}"\nsimulate = true\n'
        for n, bus in ((1, "l"), (2, "r"))
    )
    with running(configuration(axes, can=can)) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(1, {"STW1": OFF, "NSOLL_A": 0x1000})
        plc.enable(1)
        plc.until(lambda: plc.value("NIST_A", 1) == 0x1000, "750 rpm")
        assert plc.value("NIST_A", 0) == 0
        assert drive_of(daemon, 5, "l").model.state is State.SWITCH_ON_DISABLED
        assert drive_of(daemon, 5, "r").model.state is State.OPERATION_ENABLED


def test_two_axes_as_simulated_with_telegram_9_are_tasked_each_for_itself() -> None:
    with running(simulated([9] * 2)) as daemon:
        plc = Plc(daemon, [9, 9])
        for index in (0, 1):
            plc.endpoint.set(index, {"STW1": OFF & ~0x40})
            plc.until(lambda index=index: plc.state(index) == 0x01, "ready")  # type: ignore[misc]
            plc.endpoint.set(index, {"STW1": (OFF & ~0x40) | 1})
            plc.until(lambda index=index: plc.state(index) == 0x07, "operation")  # type: ignore[misc]
        target = 0x0100_0000
        plc.endpoint.set(
            1,
            {"SATZANW": 0x8000, "MDI_TARPOS": target, "MDI_VELOCITY": 1 << 30, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14}
            | {"MDI_MOD": 1, "STW1": 0x047F},
        )
        plc.until(lambda: plc.value("ZSW1", 1) & 0x1000, "task acknowledged")
        plc.endpoint.set(1, {"STW1": 0x043F})
        plc.until(lambda: plc.value("ZSW1", 1) & 0x0400 and abs(plc.value("XIST_A", 1) - target) < 4000, "target")
        assert plc.value("XIST_A", 0) == 0, "the other axis stands"


def test_a_withheld_heartbeat_stops_the_drives_of_that_bus_and_no_others() -> None:
    """The last means against a drive that ignores all commands is its own guarding of the gateway."""
    can = "".join(f'[[can]]\nname = "{name}"\ninterface = "virtual"\nchannel = "{name}"\n' for name in ("l", "r"))
    axes = "".join(
        f'[[axis]]\ndo_id = {n}\nnode_id = 5\ntelegram = 1\ncan = "{bus}"\nsimulate = true\n'
        for n, bus in ((1, "l"), (2, "r"))
    )
    with running(configuration(axes, can=can)) as daemon:
        plc = Plc(daemon, [1, 1])
        for index in (0, 1):
            plc.endpoint.set(index, {"NSOLL_A": 0x1000})
            plc.enable(index)
        left, right = (drive_of(daemon, 5, bus).model for bus in ("l", "r"))
        disobeyed = daemon.axes[0]
        disobeyed.machine.outputs.brake = disobeyed._brake = Brake.WITHHOLD_HEARTBEAT  # the brake before was of no use
        plc.until(lambda: left.state is not State.OPERATION_ENABLED, "the drive's own stop")
        assert right.state is State.OPERATION_ENABLED


@pytest.mark.parametrize("more", ["", "sync = true"])
def test_a_very_long_cycle_keeps_the_drive_guarded_and_online(more: str) -> None:
    """Heartbeats and TPDOs do not depend on the cycle of the PLC."""
    config = configuration(axis(1, more=f"simulate = true\n{more}"), transport="cycle_time_ms = 400")
    with operating(config) as (daemon, plc):
        plc.exchange(3)
        assert plc.state() == 0x07
        assert [fault.text for fault in daemon.axes[0].faults] == []


def test_a_silent_plc_can_watch_the_axis_stop_and_a_standing_on_does_not_restart_it() -> None:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        plc.silent = True
        plc.until(lambda: plc.state() == 0x40 and plc.value("NIST_A") == 0, "stopped")
        assert not plc.endpoint.setpoints_used[0]
        assert [fault.number for fault in daemon.axes[0].faults] == [103]
        plc.silent = False
        plc.until(lambda: endpoint_of(daemon).connected and plc.endpoint.setpoints_used[0], "connected again")
        plc.exchange(10)
        assert plc.state() == 0x40
        plc.enable()


def test_a_gateway_without_a_plc_steps_every_20_ms_until_a_drive_has_power() -> None:
    """A drive that another master enables, and a PLC, have every cycle at once."""
    with running(configuration(axis(1), transport="cycle_time_ms = 4")) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        loop = world_of(daemon).loop

        def steps() -> int:
            before = daemon.cycles
            loop.run_for(SECOND)
            return daemon.cycles - before

        assert steps() == 50
        plc = Plc(daemon, [1])
        with exchanging(plc):
            plc.endpoint.set(0, {"STW1": OFF})
            until(daemon, lambda: plc.state() == 0x01, "ready")
            assert steps() == 250
            plc.endpoint.set(0, {"STW1": ON, "NSOLL_A": 0x1000})
            until(daemon, lambda: plc.value("NIST_A") == 0x1000, "750 rpm")
        before = daemon.cycles
        until(daemon, lambda: not daemon.axes[0].may_have_power, "the end of the stop")
        assert daemon.cycles - before > 20, "without the PLC, each cycle of the stop"
        assert steps() == pytest.approx(50, abs=1)


def test_tasks_and_checks_without_a_plc_have_the_time_until_the_next_step() -> None:
    """A step wakes the loop once. The accesses to a node need not wait for it: each would take 20 ms."""
    with running(configuration(axis(1), transport="cycle_time_ms = 1")) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        loop = world_of(daemon).loop
        looks: list[int] = []
        daemon.networks["can"].checks.add(looks.append)
        steps = []
        for _ in range(10):
            expected, before = loop.expected, daemon.cycles
            loop.run_until(expected - 1)
            assert daemon.cycles == before
            loop.run_until(expected)
            assert daemon.cycles == before + 1
            steps.append(expected)
        assert looks == steps


def test_another_controller_takes_over_only_after_the_loss_of_the_first() -> None:
    with running(configuration(axis(1))) as daemon:
        first, second = Plc(daemon, [1]), Plc(daemon, [1])
        first.enable()
        for _ in range(5):
            second.send()
            first.exchange()
        assert endpoint_of(daemon).counts.frames[Verdict.FOREIGN_SENDER] == 5
        assert first.state() == 0x07
        second.until(lambda: second.endpoint.setpoints_used[0], "taken")


def test_a_node_that_does_not_answer_is_reported_and_stops_no_other() -> None:
    with running(configuration(axis(1) + axis(2, more="sdo_timeout_ms = 20"))) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.enable(0)
        plc.until(lambda: "no answer from node 2" in daemon.axes[1].drive.status_text, "reported")
        plc.exchange()
        assert plc.endpoint.actuals[1] is None, "IOPS BAD"
        assert plc.state(0) == 0x07


def test_a_flood_of_datagrams_delays_no_cycle() -> None:
    with operating() as (daemon, plc):
        world = world_of(daemon)
        intruder = world.network.open("intruder", 0, "flood")
        flooding = True

        def flood() -> None:
            for _ in range(50):
                intruder.send(b"flood", daemon.address)
            if flooding:
                world.loop.call_later(MS // 2, flood)

        flood()
        cycles, begin = daemon.cycles, world.loop.now()
        plc.until(lambda: daemon.cycles > cycles + 50, "cycles go on")
        flooding = False
        assert world.loop.now() - begin < 60 * daemon.cycle_ns
        assert daemon.axes[0].drive.generation == 1, "the drive never missed its heartbeat"


def test_stop_brings_a_turning_drive_to_rest_then_pre_operational() -> None:
    with operating(configuration(axis(1, more='simulate = true\non_plc_loss = "ramp"'))) as (daemon, plc):
        plc.turn(0x2000)
        model = drive_of(daemon).model
        plc.silent = True
        daemon.stop()
        plc.until(lambda: model.state is State.SWITCH_ON_DISABLED or model.state is State.READY_TO_SWITCH_ON, "off")
        assert model.emcy == []
    assert daemon.axes[0].drive.status_text == "stopped"
    assert not daemon.axes[0].powered


@pytest.mark.parametrize(
    ("word", "controlword"),
    [(ON & ~0x2, 0x0), (ON & ~0x4, 0x2), (0x0000, 0x0), (0x636A, 0x2)],
    ids=["OFF2", "OFF3", "zeros", "OFF3 without control"],
)
def test_off2_and_off3_end_the_ramp_of_a_gateway_that_stops(word: int, controlword: int) -> None:
    with operating(configuration(axis(1, more='simulate = true\non_plc_loss = "ramp"'))) as (daemon, plc):
        plc.turn(0x2000)
        command = daemon.axes[0].machine.outputs.command
        daemon.stop()
        plc.exchange()
        plc.exchange()
        assert (command.controlword & 0xF, command.target_velocity) == (0xF, 0), "the ramp of the loss reaction"
        assert endpoint_of(daemon).setpoints == [None], "IOCS is BAD"
        plc.endpoint.set(0, {"STW1": word})
        plc.send()
        plc.endpoint.set(0, {"STW1": ON})
        plc.exchange()
        plc.exchange()
        assert command.controlword & 0xF == controlword, "one frame is enough"
        plc.silent = True
        plc.exchange()
        assert command.controlword & 0xF == controlword, "the stop stays in force without frames"


def test_an_encoder_ignores_the_plc_while_the_gateway_stops() -> None:
    axes = (
        axis(1, more='simulate = true\non_plc_loss = "ramp"')
        + "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    )
    with running(configuration(axes)) as daemon:
        plc = Plc(daemon, [1, 81])
        plc.enable()
        plc.turn(0x2000)
        inputs = daemon.encoders[0].machine.inputs
        assert inputs.setpoints is not None
        daemon.stop()
        for _ in range(3):
            plc.exchange()
            assert inputs.setpoints is None
        assert not daemon.stopped.is_set(), "axis 1 still ramps"


def test_off_and_on_start_nothing_while_the_gateway_stops() -> None:
    axes = axis(1, more='simulate = true\non_plc_loss = "ramp"') + axis(2)
    with running(configuration(axes)) as daemon:
        plc = Plc(daemon, [1, 1])
        plc.endpoint.set(0, {"NSOLL_A": 0x2000})
        plc.enable()
        plc.endpoint.set(1, {"STW1": OFF})
        plc.until(lambda: plc.value("NIST_A") == 0x2000 and plc.state(1) == 0x01, "1500 rpm, axis 2 ready")
        daemon.stop()
        model = drive_of(daemon, 2).model
        for word in (OFF, OFF, ON, ON, ON):
            plc.endpoint.set(1, {"STW1": word})
            plc.exchange()
            assert daemon.axes[1].machine.outputs.command.controlword & 0xF in {0x0, 0x2}
            assert model.state not in {State.SWITCHED_ON, State.OPERATION_ENABLED}
        assert not daemon.stopped.is_set(), "axis 1 still ramps"


def _lose(daemon: Daemon, plc: Plc) -> None:
    """Cut the wire of the bus until the drive is lost."""
    world_of(daemon).gateway_port("world").connect(False)
    plc.until(lambda: daemon.axes[0].drive.status is DriveStatus.LOST, "lost")


def test_a_gateway_that_stops_stops_a_lost_drive_before_it_ends() -> None:
    with operating() as (daemon, plc):
        plc.turn(0x2000)
        model = drive_of(daemon).model
        _lose(daemon, plc)
        daemon.stop()
        plc.exchange(200)
        assert not daemon.stopped.is_set(), "the drive may still turn"
        assert daemon.axes[0].machine.outputs.command.controlword & 0xF == 0x2
        world_of(daemon).gateway_port("world").connect(True)
        until(daemon, daemon.stopped.is_set, "the end")
        assert model.velocity_actual == 0
        assert model.state is not State.OPERATION_ENABLED


def test_a_drive_that_stays_lost_delays_the_end_by_five_seconds() -> None:
    with operating() as (daemon, plc):
        _lose(daemon, plc)
        daemon.stop()
        since = plc.loop.now()
        until(daemon, daemon.stopped.is_set, "the end")
        assert 5 * SECOND <= plc.loop.now() - since < 6 * SECOND


def test_a_drive_that_was_off_when_it_was_lost_does_not_delay_the_end() -> None:
    with running(configuration(axis(1))) as daemon:
        plc = Plc(daemon, [1])
        plc.until(lambda: daemon.axes[0].good, "online")
        _lose(daemon, plc)
        daemon.stop()
        since = plc.loop.now()
        until(daemon, daemon.stopped.is_set, "the end")
        assert plc.loop.now() - since < SECOND


def test_another_telegram_is_selected_only_out_of_operation() -> None:
    with operating() as (daemon, plc):
        with pytest.raises(GatewayError, match="the telegram cannot be changed: the axis is in operation"):
            daemon.change_telegram(daemon.axes[0], 2)
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "off")
        sent = endpoint_of(daemon).counts.sent
        daemon.change_telegram(daemon.axes[0], 2)
        other = Plc(daemon, [2])
        other.enable()
        assert endpoint_of(daemon).counts.sent > sent, "counts go on"
        assert daemon.axes[0].drive.generation == 2


@pytest.mark.planted
def test_telegram_is_not_changed_while_enable_operation_is_on_its_way() -> None:
    """No RPDO is sent until the drive is configured for the other telegram: nothing would stop it."""
    with running(configuration(axis(1))) as daemon:
        plc, item = Plc(daemon, [1]), daemon.axes[0]
        plc.endpoint.set(0, {"STW1": OFF})
        plc.until(lambda: plc.state() == 0x01, "ready")
        plc.endpoint.set(0, {"STW1": ON})
        plc.until(lambda: item.outputs.command.controlword == 0x07, "Switch On")
        step, refused = item.step, []

        def changed(setpoints: Sequence[int] | None, now: int) -> Outputs:
            outputs = step(setpoints, now)
            if outputs.command.controlword == 0x0F and not refused:
                assert item.drive.feedback.statusword & 0x6F == 0x23, "still Switched On"
                with pytest.raises(GatewayError, match="the telegram cannot be changed") as error:
                    daemon.change_telegram(item, 2)
                refused.append(error)
            return outputs

        item.step = changed  # type: ignore[method-assign]
        plc.until(lambda: plc.state() == 0x07, "operation")
        item.step = step  # type: ignore[method-assign]
        assert refused


def test_a_service_that_cannot_start_ends_the_daemon_and_gives_everything_back() -> None:
    class Broken:
        def start(self) -> None:
            raise GatewayError("port in use")

        def stop(self) -> None:
            """Releases what it opened when it was made."""

    world = World()
    daemon = build_gateway(configuration(axis(1)), world)
    daemon.services.append(Broken())
    with pytest.raises(GatewayError, match="port in use"):
        daemon.run()
    assert daemon.stopped.is_set()
    assert world.bus("world").members == [], "the interface is released"
    world.network.open(*daemon.address, "the same port")


def test_a_service_that_cannot_be_stopped_keeps_no_drive_in_operation() -> None:
    class Stuck:
        def start(self) -> None:
            """Runs."""

        def stop(self) -> None:
            raise OSError("disk full")

    world, config = World(), configuration(axis(1))
    world.simulate(config)
    daemon = build_gateway(config, world)
    daemon.services.append(Stuck())
    daemon.start()
    until(daemon, lambda: daemon.axes[0].good, "online")
    frames: list[tuple[int, bytes]] = []
    daemon.networks["can"].listeners.append(lambda frame: frames.append((frame.arbitration_id, bytes(frame.data))))
    daemon.stop()
    with pytest.raises(OSError, match="disk full"):
        until(daemon, daemon.stopped.is_set, "the end")
    assert frames[-1] == (NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
    assert daemon.stopped.is_set()
    world.network.open(*daemon.address, "the same port")


def test_the_nodes_of_a_full_bus_are_pre_operational_after_the_end_of_the_gateway() -> None:
    nodes = range(1, 7)
    config = configuration("".join(axis(number) for number in nodes))
    with running(config) as daemon:
        world = world_of(daemon)
        online(daemon)
        drives = [drive_of(daemon, number) for number in nodes]
        assert {drive.node.state for drive in drives} == {NmtState.OPERATIONAL}
        # Frames that the bus still transmits when the gateway closes it.
        for _ in nodes:
            daemon.networks["can"].send(0x7E5, bytes(8))
        daemon.stop()
        until(daemon, daemon.stopped.is_set, "the end")
        world.loop.run_for(10 * MS)
        assert {drive.node.state for drive in drives} == {NmtState.PRE_OPERATIONAL}


def test_what_was_opened_is_closed_when_a_bus_is_missing() -> None:
    loop = SystemLoop()
    taken = UdpSocket(loop, "127.0.0.1", 0, "test")
    port = taken.address[1]
    taken.close()
    config = configuration(axis(1, more=""), can='[can]\ninterface = "socketcan"\nchannel = "nocan9"\n')
    config = config.model_copy(update={"transport": config.transport.model_copy(update={"cyclic_port": port})})
    with pytest.raises(CanopenError, match="nocan9"):
        build_gateway(config)
    UdpSocket(loop, "127.0.0.1", port, "test").close()
    loop.close()


def test_another_program_on_the_status_port_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(1)
                connection.sendall(b"SSH-2.0\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(GatewayError, match="the answer does not come from a gateway"):
            fetch(server.getsockname()[1], PATIENCE_S)
        thread.join()


@pytest.mark.parametrize(
    ("longest", "expected"), [(1000, "does not come from a gateway"), (1 << 30, "no gateway answers")]
)
def test_an_endless_answer_of_the_status_port_is_cut(
    longest: int, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status_client, "_LONGEST", longest)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection, suppress(OSError):
                while True:
                    connection.sendall(b"x")

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(GatewayError, match=expected):
            fetch(server.getsockname()[1], PATIENCE_S if longest == 1000 else 0.1)
        thread.join()


@pytest.mark.e2e
def test_the_status_port_sends_axes_and_counters_to_several_clients(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(port_module, "_PATIENCE_NS", 3600 * SECOND)
    port = free_tcp_port()
    config = machine.configuration()
    with machine.running(config, lambda d: d.services.append(StatusServer(d, port))) as daemon:
        plc = SocketPlc(daemon.address, [1])
        plc.until(lambda: drive_state(plc.value("ZSW1")) == 0x40, "online")
        # A client that connects and disconnects does not disturb the others.
        socket.create_connection(("127.0.0.1", port)).close()
        document = fetch(port, PATIENCE_S)
        assert document["schema"] == 2
        assert document["plc"]["frames"]["accepted"] > 0
        entry = document["axes"][0]
        assert (entry["telegram"], entry["drive"], entry["drive_state"]) == (1, "online", "Switch On Disabled")
        assert "STW1.10" in entry["reason"]
        assert fetch_faults(port, 1, PATIENCE_S) == []
        with pytest.raises(GatewayError, match="do_id 9: unknown drive object, allowed: 1"):
            fetch_faults(port, 9, PATIENCE_S)

        def connect() -> socket.socket:
            return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)

        # The gateway neither waits for the end of an endless line nor reads more of it.
        with connect() as endless:
            endless.sendall(b"x" * 64)
            assert b"allowed" in endless.recv(1000)
        # Some may ask nothing; the oldest of them ends for one more.
        with ExitStack() as opened:
            silent = [opened.enter_context(connect()) for _ in range(port_module._CONNECTIONS)]
            wait_for(lambda: served(daemon) == port_module._CONNECTIONS, "all are being served")
            assert fetch(port, PATIENCE_S)["schema"] == 2
            assert silent[0].recv(1) == b""
        wait_for(lambda: served(daemon) == 0, "they have gone")
        # Who asks nothing for long is sent away.
        monkeypatch.setattr(port_module, "_PATIENCE_NS", 10 * MS)
        with connect() as one:
            assert one.recv(1) == b""


def served(daemon: Daemon) -> int:
    """Connections to the status port that have not been answered yet."""
    return sum(task.name == "status" for task in tuple(daemon.loop.tasks))
