"""The send queue of a bus in virtual time: every axis has its turn, a stop has it first, the Controlword follows its data."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from unittest.mock import patch

import pytest

from pdgw.ds301.bus.load import frame_bits
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.bus.send_queue import FrameQueue, SendQueue
from pdgw.ds301.communication import ERROR_CONTROL, NMT, SDO_REQUEST, SYNC
from pdgw.ds301.node.plan import PdoPlan, straight_plan
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.images import DriveCommand
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.identification.generic import generic_dictionary
from pdgw.dsp402.states import Command
from pdgw.durations import MS, SECOND
from pdgw.gateway.axis.telegrams import drive_layout
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.world import Member, World

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
            layout = drive_layout(number)
            # The fifth RPDO has a COB-ID of the pre-defined connection set for node-IDs up to 3Fh only.
            available = {pdo.communication_index for pdo in layout.rpdos if node_id <= 0x3F or pdo.number <= 4}
            plan = self.plans[node_id] = straight_plan(layout, node_id, available, sync=False)
            client = DriveClient(self.network, DriveSettings(node_id), layout, lambda _: None)
            client.rpdos.use_plan(plan, SECOND, client.settings.rpdo_refresh_ms * MS)
            client._sending = True
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


def test_nmt_and_heartbeat_do_not_wait_behind_setpoints_and_sync_does() -> None:
    axes = Axes(8, 1, places=2)
    axes.cycle(1)
    axes.network.send_sync()
    axes.network.send_heartbeat(127)
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
        axes.network.send_heartbeat(127)
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
    queue.clear()
    assert queue.flush()
