"""Turns of tasks, and SDO requests that leave a bus its room."""

from __future__ import annotations

from pdgw.ds301.bus.load import frame_bits, sdo_gap_ns
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import SDO_REQUEST
from pdgw.ds301.loop.jobs import Turns
from pdgw.ds301.loop.loop import Task
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.durations import MS, SECOND
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.world import World


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


def test_tasks_have_their_turn_in_order_and_so_many_at_a_time() -> None:
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
