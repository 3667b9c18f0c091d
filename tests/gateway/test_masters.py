"""Two masters on one bus: the second refuses, the first stops its drives and says why. Another tool that stops one node."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.communication import (
    DEFAULT_GATEWAY_NODE_ID,
    ERROR_CONTROL,
    NMT,
    PRODUCER_HEARTBEAT,
    SDO_REQUEST,
    SYNC,
    SYNC_COB_ID,
    NmtCommand,
)
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.dsp402.objects import POSITIONING_OPTION
from pdgw.dsp402.states import State
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.daemon.masters import LISTEN_NS
from pdgw.gateway.parameters.objects import relies_on
from pdgw.peers.world import World
from tests.support.gateways.daemon import (
    SIMULATED_POSITIONER,
    Plc,
    axis,
    configuration,
    drive_of,
    exchanging,
    operating,
    running,
    until,
    world_of,
)

HEARTBEAT = ERROR_CONTROL + DEFAULT_GATEWAY_NODE_ID
CHANNEL = "world"
OPTION = POSITIONING_OPTION, 0
DSC = 'simulate = true\nfollowing_window = 4096\ndsc = "position"'


def gateway() -> tuple[World, Daemon]:
    world, config = World(), configuration(axis(1))
    world.simulate(config)
    return world, build_gateway(config, world)


@pytest.mark.parametrize("after_ns", [0, LISTEN_NS - MS], ids=["at once", "at the end of listening"])
@pytest.mark.parametrize(
    ("can_id", "data", "what"),
    [(HEARTBEAT, b"\x05", "heartbeat of node 127"), (0x201, bytes(6), "RPDO1 of drive 1")],
)
def test_a_bus_with_another_master_is_left_alone(can_id: int, data: bytes, what: str, after_ns: int) -> None:
    world, daemon = gateway()
    other = world.bus(CHANNEL).join("another gateway")
    sent: list[int] = []
    daemon.networks["can"].listeners.append(lambda m: None if m.is_rx else sent.append(m.arbitration_id))
    world.loop.call_later(after_ns, lambda: other.send(can_id, data))
    world.loop.call_later(10 * SECOND, daemon.stop)
    with pytest.raises(GatewayError, match=what):
        daemon.run()
    assert sent == [], "not one frame"
    assert [fault.number for fault in daemon.axes[0].faults] == [FaultNumber.OTHER_MASTER]


def test_a_master_that_comes_later_ends_the_gateway_after_its_drives_are_stopped() -> None:
    world, daemon = gateway()
    other = world.bus(CHANNEL).join("another gateway")
    daemon.start()
    plc = Plc(daemon, [1])
    plc.enable()
    plc.turn(0x2000)
    with exchanging(plc):
        other.send(HEARTBEAT, b"\x05")
        world.loop.until(daemon.stopped.is_set, "the end of the gateway", 10 * SECOND)
    model = drive_of(daemon).model
    assert model.state in {State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON}
    assert model.velocity_actual == 0
    assert daemon.failure is not None
    assert "sends the heartbeat of node 127 (Operational), which is the node-ID of this gateway" in str(daemon.failure)


def test_a_second_producer_of_sync_ends_the_gateway_after_its_drives_are_stopped() -> None:
    config = configuration(axis(1, telegram_number=105, more=DSC))
    with operating(config) as (daemon, plc):
        other = world_of(daemon).bus(CHANNEL).join("a drive with bit 30 of 1005h")
        with exchanging(plc):
            other.send(SYNC, b"")
            world_of(daemon).loop.until(daemon.stopped.is_set, "the end of the gateway", 10 * SECOND)
        assert drive_of(daemon).model.state is not State.OPERATION_ENABLED
        assert "SYNC" in str(daemon.failure)


PRODUCER, CONSUMER = 0x4000_0080, 0x80
"""1005h with and without bit 30."""


@contextmanager
def sync_after_boot(cob_id: int, daemon: Daemon, *, read_only: bool = False) -> Iterator[Daemon]:
    """The drive boots with this 1005h, and another sender sends SYNC for a moment afterwards."""
    node, world = drive_of(daemon).node, world_of(daemon)
    entry = Entry(SYNC_COB_ID, 0, "COB-ID SYNC", CanType.U32, Access.RO if read_only else Access.RW, default=cob_id)
    node.entries = {**node.entries, (SYNC_COB_ID, 0): entry}
    other = world.bus(CHANNEL).join("the drive itself")
    drive_of(daemon).do(lambda node: node.restart())
    node.values[SYNC_COB_ID, 0] = cob_id
    for delay in (20, 100):
        world.loop.call_later(delay * MS, lambda: other.send(SYNC, b""))
    yield daemon


def test_sync_of_a_node_that_has_booted_is_cleared_and_named(caplog: pytest.LogCaptureFixture) -> None:
    config = configuration(axis(1, telegram_number=105, more=DSC))
    with caplog.at_level("INFO"), operating(config) as (daemon, plc), exchanging(plc):
        with sync_after_boot(PRODUCER, daemon):
            world_of(daemon).loop.run_for(5 * SECOND)
        assert daemon.failure is None
        assert drive_of(daemon).node.values[SYNC_COB_ID, 0] == CONSUMER
        assert daemon.axes[0].good
        assert "axis 1: node 1005h bit 30 cleared: the node has sent SYNC, which the gateway sends" in caplog.text


def test_sync_of_one_of_two_nodes_that_have_booted_is_its_own() -> None:
    both = axis(1, telegram_number=105, more=DSC) + axis(2, telegram_number=105, more=DSC)
    with running(configuration(both)) as daemon:
        until(daemon, lambda: all(item.drive.generation for item in daemon.axes), "both online")
        drive_of(daemon, 2).do(lambda node: node.restart())
        with sync_after_boot(PRODUCER, daemon):
            world_of(daemon).loop.run_for(5 * SECOND)
        assert daemon.failure is None
        assert all(item.drive.generation for item in daemon.axes)


def test_sync_after_the_boot_up_of_a_node_without_bit_30_is_of_another_master() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=DSC))) as (daemon, plc), exchanging(plc):
        with sync_after_boot(CONSUMER, daemon):
            world_of(daemon).loop.until(daemon.stopped.is_set, "the end of the gateway", 5 * SECOND)
        assert "another master sends SYNC" in str(daemon.failure)


def test_sync_long_after_the_boot_up_of_a_producer_is_of_another_master() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=DSC))) as (daemon, plc), exchanging(plc):
        with sync_after_boot(PRODUCER, daemon):
            world_of(daemon).loop.run_for(5 * SECOND)
        world_of(daemon).bus(CHANNEL).join("another").send(SYNC, b"")
        world_of(daemon).loop.until(daemon.stopped.is_set, "the end of the gateway", 5 * SECOND)
        assert "another master sends SYNC" in str(daemon.failure)


def test_node_whose_1005h_keeps_bit_30_is_refused() -> None:
    with operating(configuration(axis(1, telegram_number=105, more=DSC))) as (daemon, plc), exchanging(plc):
        with sync_after_boot(PRODUCER, daemon, read_only=True):
            until(daemon, lambda: daemon.axes[0].drive.refusal, "refused")
        assert "1005h" in daemon.axes[0].drive.status_text


def test_producer_of_sync_keeps_it_where_the_gateway_sends_none() -> None:
    with running(configuration(axis(1))) as daemon, sync_after_boot(PRODUCER, daemon):
        until(daemon, lambda: daemon.axes[0].drive.generation and daemon.axes[0].good, "online")
        assert drive_of(daemon).node.values[SYNC_COB_ID, 0] == PRODUCER


RPDO1 = {(0x1400, 1): 0x3F5, (0x1600, 0): 2, (0x1600, 1): 0x60FF_0020, (0x1600, 2): 0x6040_0010}
"""A drive that keeps mapping and COB-ID."""


@pytest.mark.parametrize(
    ("telegram", "kept", "what"),
    [(100, {}, "RPDO5 of drive 1 (COB-ID 241h)"), (1, RPDO1, "RPDO1 of drive 1 (COB-ID 3F5h)")],
    ids=["RPDO5", "own COB-ID"],
)
def test_master_that_sends_an_rpdo_outside_the_connection_set_ends_the_gateway(
    telegram: int, kept: dict[tuple[int, int], int], what: str
) -> None:
    def before(daemon: Daemon) -> None:
        node = drive_of(daemon).node
        node.entries = {**node.entries, **{at: Entry(*at, "kept", CanType.U32, Access.RO) for at in kept}}
        node.values.update(kept)

    with running(configuration(axis(1, telegram_number=telegram)), before) as daemon:
        until(daemon, lambda: daemon.axes[0].good, "online")
        cob_id = int(what[-5:-2], 16)
        world_of(daemon).bus(CHANNEL).join("another gateway").send(cob_id, bytes(8))
        until(daemon, daemon.stopped.is_set, "the end of the gateway")
        assert f"another master sends {what}" in str(daemon.failure)


def test_torque_reduction_is_of_the_limit_that_the_drive_had_before_it() -> None:
    """Also after restarts of the node with power on, when 6072h shows the reduced limit."""
    with running(configuration(axis(1, telegram_number=102))) as daemon:
        other = world_of(daemon).bus(CHANNEL).join("another tool")
        model, plc = drive_of(daemon).model, Plc(daemon, [102])
        plc.enable()
        own = model.max_torque
        for _ in range(3):
            plc.endpoint.set(0, {"MOMRED": 0x2000})
            plc.until(lambda: model.max_torque == own // 2, "half of the torque")
            other.send(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, 1)))
            plc.until(lambda: not daemon.axes[0].powered, "a lost node")
            plc.enable()
            assert model.max_torque == own // 2
        plc.endpoint.set(0, {"MOMRED": 0})
        plc.until(lambda: model.max_torque == own, "the drive's own torque")


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside another master"])
def test_gateway_that_ends_restores_own_values_only_without_another_master(beside: bool) -> None:
    """The other master may have written them since."""
    with operating(configuration(axis(1, telegram_number=102))) as (daemon, plc):
        written: list[bytes] = []
        daemon.networks["can"].listeners.append(
            lambda m: written.append(bytes(m.data[1:4])) if m.arbitration_id == SDO_REQUEST + 1 else None
        )
        with exchanging(plc):
            if beside:
                world_of(daemon).bus(CHANNEL).join("another gateway").send(HEARTBEAT, b"\x05")
            else:
                daemon.stop()
            world_of(daemon).loop.until(daemon.stopped.is_set, "the end of the gateway", 10 * SECOND)
        max_torque = bytes((0x72, 0x60, 0))
        assert (max_torque in written) is not beside


@pytest.mark.parametrize(
    ("command", "state", "after_ms"),
    [
        (NmtCommand.ENTER_PRE_OPERATIONAL, "Pre-operational", 0),
        (NmtCommand.STOP, "Stopped", 150),
        (NmtCommand.ENTER_PRE_OPERATIONAL, "Pre-operational", 300),
        (NmtCommand.STOP, "Stopped", 450),
        (NmtCommand.STOP, "Stopped", 600),
    ],
)
def test_a_drive_that_another_tool_takes_out_of_operation_is_lost_with_its_next_heartbeat(
    command: NmtCommand, state: str, after_ms: int
) -> None:
    """At any time between two heartbeats: the position comes by SDO, and 606Ch of the last TPDO is old from then on."""
    times = "simulate = true\nheartbeat_ms = 700\ntpdo_event_ms = 2000\n"
    with operating(configuration(axis(1, more=times))) as (daemon, plc):
        plc.turn(0x2000)
        plc.exchange(after_ms * MS // daemon.cycle_ns)
        client = daemon.axes[0].drive
        generation = client.generation
        world_of(daemon).bus(CHANNEL).join("another tool").send(NMT, bytes((command, 1)))
        plc.exchange(800 * MS // daemon.cycle_ns)
        faults = [(fault.number, fault.text) for fault in daemon.axes[0].faults]
        assert [number for number, _ in faults] == [FaultNumber.NODE_LOST]
        assert f"{state}: another master has sent NMT command {command:02X}h" in faults[0][1]
        plc.until(lambda: client.generation > generation, "online again")
        plc.enable()
        plc.until(lambda: plc.value("NIST_A") == 0x2000, "1500 rpm again")


def _download(index: int, subindex: int, data: bytes) -> bytes:
    return bytes((0x23 | (4 - len(data)) << 2, *index.to_bytes(2, "little"), subindex)) + data.ljust(4, b"\0")


MAPPED_AGAIN = (
    _download(0x1400, 1, (0x8000_0201).to_bytes(4, "little")),
    _download(0x1600, 0, b"\0"),
    _download(0x1600, 1, (0x6040_0010).to_bytes(4, "little")),
    _download(0x1600, 2, (0x60FF_0020).to_bytes(4, "little")),
    _download(0x1600, 0, b"\2"),
    _download(0x1400, 1, (0x201).to_bytes(4, "little")),
)
"""RPDO1 with the Controlword before Target Velocity."""


@pytest.mark.parametrize(
    ("frames", "what"),
    [
        (MAPPED_AGAIN, "1400h/1"),
        ((_download(0x6060, 0, b"\1"),), "6060h/0"),
        ((_download(0x6040, 0, b"\x0f\0"),), "6040h/0"),
        ((_download(0x6094, 1, bytes((50, 0, 0, 0))),), "6094h/1"),
        ((_download(0x607E, 0, b"\x40"),), "607Eh/0"),
        ((_download(0x607C, 0, bytes((1, 0, 0, 0))),), "607Ch/0"),
        ((_download(0x6075, 0, bytes((1, 0, 0, 0))),), "6075h/0"),
    ],
    ids=["mapping", "mode", "Controlword", "units", "polarity", "home offset", "rated current"],
)
def test_write_of_another_tool_stops_the_drive_and_configures_it_again(frames: tuple[bytes, ...], what: str) -> None:
    with running(configuration(axis(1, more="simulate = true\n"))) as daemon:
        plc, model, client = Plc(daemon, [1]), drive_of(daemon).model, daemon.axes[0].drive
        plc.enable()
        plc.turn(0x2000)
        fastest, generation = model.ramp.speed, client.generation
        other = world_of(daemon).bus(CHANNEL).join("another tool")
        for frame in frames:
            other.send(SDO_REQUEST + 1, frame)
            plc.exchange()
        speeds: list[float] = []

        def online() -> bool:
            speeds.append(model.ramp.speed)
            return client.generation > generation

        plc.until(online, "configured again")
        assert all(-0.01 * fastest <= speed <= 1.05 * fastest for speed in speeds)
        fault = daemon.axes[0].faults[0]
        assert fault.number == FaultNumber.NODE_LOST
        assert f"another tool writes {what}" in fault.text
        assert model.state is not State.OPERATION_ENABLED
        plc.until(lambda: model.ramp.speed == 0, "standstill")
        plc.exchange(50)
        assert (model.ramp.speed, plc.state() & 0x4) == (0, 0), "a standing ON starts nothing"
        assert drive_of(daemon).node.get_data(0x1600, 1) == (0x60FF_0020).to_bytes(4, "little")


def test_write_of_another_tool_stops_the_drive_while_an_answer_is_awaited() -> None:
    """A parameter client reads an object, and the drive does not answer for 200 ms."""
    with running(configuration(axis(1, more="simulate = true\n"))) as daemon:
        plc, model, client = Plc(daemon, [1]), drive_of(daemon).model, daemon.axes[0].drive
        plc.enable()
        plc.turn(0x2000)
        drive_of(daemon).do(lambda node: node.start_fault("slow-sdo", delay_ms=200))
        client.submit(lambda node: node.sdo.read(0x6065))
        plc.exchange()
        world_of(daemon).bus(CHANNEL).join("another tool").send(SDO_REQUEST + 1, _download(0x607E, 0, b"\x40"))
        plc.exchange(10)
        assert model.controlword & 0x4 == 0, "Quick Stop"
        assert plc.value("ZSW1") & 0x8, "a fault"


def test_preset_of_another_tool_makes_the_position_of_an_encoder_invalid() -> None:
    encoder = "[[encoder]]\ndo_id = 2\nnode_id = 20\ntelegram = 81\nsimulate = true\n"
    with running(configuration(encoder)) as daemon:
        made = daemon.encoders[0]
        until(daemon, lambda: made.good, "online")
        world_of(daemon).bus(CHANNEL).join("another tool").send(SDO_REQUEST + 20, _download(0x6003, 0, bytes(4)))
        until(daemon, lambda: not made.good, "not valid")
        until(daemon, lambda: made.good, "configured again")
        assert "another tool writes 6003h/0" in made.faults[0].text


def test_another_tool_may_read_and_write_what_the_gateway_does_not_use() -> None:
    with operating(configuration(axis(1, more="simulate = true\n"))) as (daemon, plc):
        other = world_of(daemon).bus(CHANNEL).join("another tool")
        for frame in (b"\x40\x60\x60\0\0\0\0\0", _download(0x6065, 0, b"\1\0\0\0"), b"\x23", b""):
            other.send(SDO_REQUEST + 1, frame)
            plc.exchange(20)
        assert not daemon.axes[0].faults
        assert plc.state() == 0x07


@pytest.mark.parametrize(
    ("number", "more"), [(1, "simulate = true"), (9, "simulate = true"), (105, DSC), (111, SIMULATED_POSITIONER)]
)
def test_gateway_relies_on_everything_that_it_writes_at_the_start_of_a_drive(number: int, more: str) -> None:
    written: set[tuple[int, int]] = set()

    def note(message: can.Message) -> None:
        data = message.data
        if not message.is_rx and message.arbitration_id == SDO_REQUEST + 1 and data[0] >> 5 == 1:
            written.add((int.from_bytes(data[1:3], "little"), data[3]))

    def before(daemon: Daemon) -> None:
        node = drive_of(daemon).node
        node.entries = {**node.entries, OPTION: Entry(*OPTION, "Positioning option code", CanType.U16, Access.RW)}
        node.values[OPTION] = 0
        daemon.networks["can"].listeners.append(note)

    with running(configuration(axis(1, telegram_number=number, more=more)), before) as daemon:
        until(daemon, lambda: daemon.axes[0].drive.generation, "online")
        assert written
        assert not [(f"{index:04X}h", sub) for index, sub in written if not relies_on(daemon.axes[0], index, sub)]


@pytest.mark.parametrize("two_pdos", [False, True])
def test_tool_that_only_reads_neither_keeps_a_drive_offline_nor_stops_it(two_pdos: bool) -> None:
    """On the same SDO channel: a number, a text, an object that the drive lacks, and one that the gateway reads too."""
    reads = (b"\x40\x60\x60\0", b"\x40\x08\x10\0", b"\x40\x00\x20\0", b"\x40\x41\x60\0")

    def before(daemon: Daemon) -> None:
        if two_pdos:
            drive_of(daemon).do(lambda node: node.start_fault("two-pdos"))

    with running(configuration(axis(1, telegram_number=100)), before) as daemon:
        plc, other, drive = Plc(daemon, [100]), world_of(daemon).bus(CHANNEL).join("another tool"), daemon.axes[0].drive
        for _ in range(100):
            for read in reads:
                other.send(SDO_REQUEST + 1, read.ljust(8, b"\0"))
                plc.exchange()
        assert drive.generation == 1
        assert not daemon.axes[0].faults


def _segment(number: int) -> bytes:
    """Its data could be the begin of a write of 1400h/1."""
    return bytes((number, 0x00, 0x14, 0x01, 0, 0, 0, 0))


@pytest.mark.parametrize("segments", [0, 34, 127])
def test_data_of_a_block_download_does_not_count_as_other_writes(segments: int) -> None:
    with operating() as (daemon, plc):
        other = world_of(daemon).bus(CHANNEL).join("another tool")

        def send(*frames: bytes) -> None:
            for frame in frames:
                other.send(SDO_REQUEST + 1, frame)
                plc.exchange()

        block = [_segment(number) for number in range(1, segments + 1)]
        send(b"\xc2\x00\x20\x00\x00\x04\0\0", *block, *block, _segment(0x81), b"\xc1\x00\x14\x01\0\0\0\0")
        assert not daemon.axes[0].faults
        send(b"\xc2\x00\x20\x00\x00\x04\0\0", *block[:20])  # and the node has aborted it
        send(_download(0x6060, 0, b"\1"))
        plc.until(lambda: daemon.axes[0].faults, "a fault")
        assert "another tool writes 6060h/0" in daemon.axes[0].faults[0].text


def test_block_download_after_one_of_64_segments_is_a_write() -> None:
    """The end of the first one could be its segment 65, the begin of the second one its segment 66."""
    with operating() as (daemon, plc):
        other = world_of(daemon).bus(CHANNEL).join("another tool")
        begin, end = b"\xc2\x00\x20\x00\x00\x04\0\0", b"\xc1\0\0\0\0\0\0\0"
        for frame in (begin, *map(_segment, range(1, 64)), _segment(64 | 0x80), end, b"\xc2\x60\x60\x00\x01\0\0\0"):
            other.send(SDO_REQUEST + 1, frame)
            plc.exchange()
        plc.until(lambda: daemon.axes[0].faults, "a fault")
        assert "another tool writes 6060h/0" in daemon.axes[0].faults[0].text


def test_a_heartbeat_without_an_nmt_state_is_none() -> None:
    with operating(configuration(axis(1, more="simulate = true\n"))) as (daemon, plc):
        other = world_of(daemon).bus(CHANNEL).join("another tool")
        other.send(ERROR_CONTROL + 1, b"\x27")
        plc.exchange(50)
        assert not daemon.axes[0].faults
        drive_of(daemon).do(lambda node: node.values.__setitem__((PRODUCER_HEARTBEAT, 0), 0))
        for _ in range(SECOND // daemon.cycle_ns):
            other.send(ERROR_CONTROL + 1, b"\x27")
            plc.exchange()
        assert [fault.number for fault in daemon.axes[0].faults] == [FaultNumber.NODE_LOST]
