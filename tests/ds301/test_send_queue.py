"""The send queue of a bus in virtual time: a turn for every axis, a stop first; turns of tasks; the load of a bus."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import CyclicFrames, bus_load, check_load, frame_bits, sdo_gap_ns
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.bus.send_queue import FrameQueue, SendQueue
from pdgw.ds301.communication import ERROR_CONTROL, NMT, SDO_REQUEST, SYNC
from pdgw.ds301.loop.jobs import Turns
from pdgw.ds301.loop.loop import Task
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.ds301.node.plan import PdoPlan
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.identification.generic import generic_dictionary
from pdgw.dsp402.states import Command
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.world import Member, World
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.mapping import straight_plan

FRAME = frame_bits(8) * SECOND // 1_000_000
"""Nanoseconds of the longest frame."""
CYCLE = 20 * MS
OPERATION, QUICK_STOP = Command.ENABLE_OPERATION.word, Command.QUICK_STOP.word
PASSED_ON = 11
"""The first Controlword bit without a meaning of the profile: tests count in it."""


class Axes:
    """``nodes`` drive clients in operation; the gateway's interface has room for ``places`` frames; no node answers."""

    def __init__(self, nodes: int, number: int, places: int) -> None:
        self.world = World()
        self.world.gateway_places = places
        self.loop = self.world.loop
        self.world.bus("a").join("listener")
        config = CanConfig(interface="virtual", channel="a")
        self.network = CanNetwork(self.loop, lambda: self.world.open_can(config))
        self.network.start()
        self.world.bus("a").taps.append(self._hear)
        self.plans: dict[int, PdoPlan] = {}
        self.clients: dict[int, DriveClient] = {}
        self.commands: dict[int, DriveCommand] = defaultdict(DriveCommand)
        self.frames: list[tuple[int, int, bytes]] = []
        """Time, COB-ID and data of each frame on the wire."""
        for node_id in range(1, nodes + 1):
            layout = drive_layout(telegram(number))
            # The fifth RPDO has a COB-ID of the pre-defined connection set for node-IDs up to 3Fh only.
            available = {pdo.communication_index for pdo in layout.rpdos if node_id <= 0x3F or pdo.number <= 4}
            plan = self.plans[node_id] = straight_plan(layout, node_id, available)
            client = DriveClient(self.network, DriveSettings(node_id), layout, lambda _: None)
            client.rpdos.use_plan(plan, SECOND, client.settings.rpdo_refresh_ms * MS)
            client.operation.sends = True
            self.clients[node_id] = client

    @property
    def round(self) -> int:
        """Frames of all axes together."""
        return sum(len(plan.rpdos) for plan in self.plans.values())

    def _hear(self, now: int, _sender: Member, can_id: int, data: bytes) -> None:
        self.frames.append((now, can_id, data))

    def cycle(self, count: int) -> None:
        """Change every value of every axis, and send."""
        for node_id, client in self.clients.items():
            command = self.commands[node_id]
            for planned in self.plans[node_id].rpdos:
                for attribute in planned.pdo.attributes:
                    setattr(command, attribute, count)
            command.controlword = OPERATION | count << PASSED_ON
            client.send(command, self.loop.now())

    def stop(self, node_id: int) -> None:
        """Quick Stop for one axis."""
        command = self.commands[node_id]
        command.controlword = QUICK_STOP
        self.clients[node_id].send(command, self.loop.now(), stop=True)


def control_id(axes: Axes, node_id: int) -> int:
    return axes.plans[node_id].rpdos[-1].cob_id


PLACES = [1, 2, 10, 16]
NODES = [1, 20, 127]
TELEGRAMS = [1, 9, 100, 111]
CASES = [(nodes, number, places) for nodes in NODES[:-1] for number in TELEGRAMS for places in PLACES]
CASES += [(NODES[-1], number, places) for number, places in zip(TELEGRAMS, PLACES, strict=True)]
"""Of the longest bus each telegram and each number of places once."""


@pytest.fixture(autouse=True, scope="module")
def one_dictionary() -> Iterator[None]:
    """Hundreds of clients share the object dictionary: making it takes longer than what is tested."""
    shared = generic_dictionary()
    with patch("pdgw.dsp402.drive.client.generic_dictionary", lambda: shared):
        yield


def assert_turns(nodes: int, number: int, places: int) -> None:
    """Every value of every axis changes in every cycle; each axis sends once in a cycle, or in a round of an overloaded bus."""
    axes = Axes(nodes, number, places)
    bound = max(CYCLE, (axes.round + places) * FRAME) + CYCLE
    begin, cycles = axes.loop.now(), 3 + 2 * axes.round * FRAME // CYCLE
    for count in range(1, cycles + 1):
        axes.cycle(count % 31)
        axes.loop.run_until(begin + count * CYCLE)
    sent: dict[int, list[int]] = {control_id(axes, node_id): [begin] for node_id in axes.clients}
    for time, can_id, _ in axes.frames:
        if can_id in sent:
            sent[can_id].append(time)
    for node_id in axes.clients:
        longest = max(after - before for before, after in pairwise([*sent[control_id(axes, node_id)], axes.loop.now()]))
        assert longest <= bound, f"node {node_id} waits {longest / MS} ms, bound {bound / MS} ms"


@pytest.mark.parametrize(("nodes", "number", "places"), CASES)
def test_every_axis_has_its_turn_within_one_round_of_the_bus(nodes: int, number: int, places: int) -> None:
    assert_turns(nodes, number, places)


def test_every_axis_has_its_turn_for_any_number_of_nodes() -> None:
    for nodes in range(3, 127, 20):
        assert_turns(nodes, 1, PLACES[nodes % len(PLACES)])


@pytest.mark.parametrize(("nodes", "number", "places"), CASES)
def test_a_stop_waits_for_frames_of_the_interface_and_its_own_data_only(nodes: int, number: int, places: int) -> None:
    axes = Axes(nodes, number, places)
    for count in range(1, 4):
        axes.cycle(count)
        axes.loop.run_for(CYCLE)
    axes.cycle(4)
    axes.loop.run_for(CYCLE // 7)
    axes.frames.clear()
    begin = axes.loop.now()
    axes.stop(nodes)
    control = axes.plans[nodes].rpdos[-1]
    axes.loop.run_for((places + len(axes.plans[nodes].rpdos)) * FRAME)
    stops = [time for time, can_id, data in axes.frames if can_id == control.cob_id and data[-2:] == b"\x02\x00"]
    assert stops, f"no stop after {(axes.loop.now() - begin) / MS} ms"


@pytest.mark.parametrize("places", PLACES)
@pytest.mark.parametrize("number", TELEGRAMS)
def test_a_controlword_follows_the_newest_data_of_its_axis(number: int, places: int) -> None:
    axes = Axes(64, number, places)
    for count in range(1, 12):
        axes.cycle(count)
        axes.loop.run_for(CYCLE // 3)
    nodes = {control_id(axes, node_id): node_id for node_id in axes.plans}
    seen: dict[int, bytes] = {}
    checked = 0
    for _, can_id, data in axes.frames:
        seen[can_id] = data
        node_id = nodes.get(can_id)
        if node_id is not None:
            counts = {seen[planned.cob_id][0] for planned in axes.plans[node_id].rpdos}
            assert counts == {data[0]}
            assert data[-1] >> 3 == data[0], "Controlword and data of one cycle"
            checked += 1
    assert checked >= 64


def test_stops_precede_setpoints_in_order_of_arrival() -> None:
    axes = Axes(20, 1, places=2)
    axes.cycle(1)
    for node_id in (20, 3, 12):
        axes.stop(node_id)
    axes.loop.run_for(CYCLE)
    order = [can_id - 0x200 for _, can_id, _ in axes.frames]
    assert order[2:5] == [20, 3, 12]
    assert sorted(order) == list(range(1, 21)), "nobody sends twice: the newest value counts"


def test_nmt_and_heartbeat_are_sent_before_setpoints_and_sync_is_not() -> None:
    axes = Axes(8, 1, places=2)
    axes.cycle(1)
    axes.network.send_sync()
    axes.network.send_heartbeat()
    axes.network.send(NMT, b"\x02\x05")
    axes.loop.run_for(CYCLE)
    order = [can_id for _, can_id, _ in axes.frames]
    assert order[2:4] == [ERROR_CONTROL + 127, NMT]
    assert order[-1] == SYNC


def test_queued_frames_are_neither_lost_nor_duplicated() -> None:
    axes = Axes(1, 1, places=1)
    for number in range(1, 30):
        axes.network.send(SDO_REQUEST + number, bytes(8))
        axes.network.send_sync()
        axes.network.send_heartbeat()
    axes.network.send(NMT, b"\x01\x05")
    axes.network.send(NMT, b"\x02\x05")
    axes.network.send(NMT, b"\x01\x05")
    axes.loop.run_for(SECOND)
    sent = [(can_id, data) for _, can_id, data in axes.frames]
    assert [can_id for can_id, _ in sent if can_id > 0x7F and can_id < 0x700 and can_id != SYNC] == [
        SDO_REQUEST + number for number in range(1, 30)
    ]
    assert sum(can_id == SYNC for can_id, _ in sent) == 1
    assert [data[0] for can_id, data in sent if can_id == NMT] == [1, 2, 1], "an order is not shortened"
    assert axes.network.send_errors == 0


def test_lost_interface_drops_its_queue() -> None:
    axes = Axes(4, 1, places=1)
    axes.cycle(1)
    assert axes.network.waiting
    axes.world.unplug("a")
    assert not axes.network.waiting
    axes.world.unplug("a", False)
    axes.loop.run_for(SECOND)
    axes.frames.clear()
    axes.cycle(2)
    axes.loop.run_for(CYCLE)
    assert len(axes.frames) == 4


def test_sender_without_a_room_report_tries_again() -> None:
    axes = Axes(4, 1, places=1)
    port = axes.world.gateway_port("a")
    axes.cycle(1)
    port._refused = False  # the report is lost
    axes.loop.run_for(CYCLE)
    assert len(axes.frames) == 1
    for count in range(2, 6):
        axes.cycle(count)
        axes.loop.run_for(CYCLE)
    assert {can_id for _, can_id, _ in axes.frames} == {0x201, 0x202, 0x203, 0x204}


def test_a_frame_queue_takes_a_bounded_number_of_frames() -> None:
    frames = FrameQueue(lambda _can_id, _data: False)
    assert sum(frames.add(0x601, number.to_bytes(2, "little")) for number in range(1000)) == 256
    queue = SendQueue()
    queue.add(frames, stop=False)
    assert not queue.flush()


# -- turns of tasks and SDO requests ----------------------------------------------------------------------------------


class Workers:
    """Tasks that each work for 10 ms when they have a turn."""

    def __init__(self, limit: int, count: int) -> None:
        self.loop = VirtualLoop()
        self.turns = Turns(self.loop, limit)
        self.began: list[int] = []
        self.most = self._busy = 0
        self.tasks: list[Task] = [self.loop.spawn(lambda n=n: self._work(n), str(n)) for n in range(count)]  # type: ignore[misc]

    def _work(self, number: int) -> None:
        with self.turns:
            self.began.append(number)
            self._busy += 1
            self.most = max(self.most, self._busy)
            try:
                self.loop.sleep(10 * MS)
            finally:
                self._busy -= 1


def test_tasks_have_their_turn_in_order_and_a_limited_number_at_a_time() -> None:
    workers = Workers(3, 10)
    workers.loop.run_for(SECOND)
    assert (workers.began, workers.most) == (list(range(10)), 3)


def test_a_turn_of_a_task_that_is_ended_goes_to_the_next() -> None:
    workers = Workers(1, 5)
    workers.loop.run_for(5 * MS)
    for number in (0, 1, 3):
        workers.tasks[number].kill()
    workers.loop.run_for(SECOND)
    assert workers.began == [0, 2, 4]
    workers.loop.spawn(lambda: workers._work(9), "late")
    workers.loop.run_for(SECOND)
    assert workers.began[-1] == 9


def test_sdo_requests_and_answers_take_half_of_what_the_load_leaves() -> None:
    exchange = 2 * frame_bits(8)
    assert sdo_gap_ns(0.6, 1_000_000) == exchange * 5_000
    assert sdo_gap_ns(0.0, 125_000) == exchange * 16_000
    assert sdo_gap_ns(1.5, 1_000_000) == exchange * 10_000, "a tenth at least"


def test_sdo_requests_keep_their_gap_and_an_urgent_one_does_not_wait() -> None:
    world = World()
    world.bus("a").join("listener")
    config = CanConfig(interface="virtual", channel="a")
    network = CanNetwork(world.loop, lambda: world.open_can(config))
    network.start()
    network.leave_room(MS, 100 * MS)
    assert network.bring_ups.limit == 25, "each waits a quarter of its time at most"
    seen: list[tuple[int, int]] = []
    begin = world.loop.now()
    world.bus("a").taps.append(lambda now, _member, can_id, _data: seen.append(((now - begin) // MS, can_id)))
    for node_id in range(1, 6):
        network.send_acyclic(SDO_REQUEST + node_id, bytes(8))
        network.send_acyclic(SDO_REQUEST + node_id, bytes(8))
    network.send_first(SDO_REQUEST + 9, bytes(8))
    world.loop.run_for(SECOND)
    repeated, once = [(0, 0x601), (0, 0x609), (1, 0x601)], [(2, 0x602), (3, 0x603), (4, 0x604), (5, 0x605)]
    assert seen == repeated + once, "a request that still waits is not sent twice"
    network.close()


# -- bus load ---------------------------------------------------------------------------------------------------------


def test_an_8_byte_frame_takes_111_to_135_bit_times() -> None:
    assert (frame_bits(8, worst=False), frame_bits(8)) == (111, 135)


@pytest.mark.parametrize(("worst", "rate"), [(True, 7407), (False, 9009)])
def test_frames_per_second_at_1_mbit(worst: bool, rate: int) -> None:
    assert 1_000_000 // frame_bits(8, worst=worst) == rate


@given(size=st.integers(0, 7))
def test_longer_frames_take_longer(size: int) -> None:
    assert frame_bits(size) < frame_bits(size + 1)


def test_a_full_bus_is_refused_with_its_numbers() -> None:
    fits = [CyclicFrames("TPDO1", 8, 7407)]
    assert bus_load(fits, 1_000_000) == pytest.approx(1, abs=0.001)
    assert check_load("can", fits, 1_000_000) <= 1
    with pytest.raises(CanopenError, match=r"bus can.*7500 frames/s at 1000000 bit/s"):
        check_load("can", [CyclicFrames("TPDO1", 8, 7500)], 1_000_000)


@pytest.mark.parametrize("size", [-1, 9])
def test_impossible_frame_length_is_rejected(size: int) -> None:
    with pytest.raises(CanopenError, match=r"0\.\.8"):
        frame_bits(size)


def test_a_bus_without_bitrate_is_refused() -> None:
    with pytest.raises(CanopenError, match="bitrate: 0"):
        bus_load([CyclicFrames("TPDO1", 8, 1)], 0)
