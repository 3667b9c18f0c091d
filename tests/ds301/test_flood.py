"""Which identifier fills a bus, from the frames of a sample."""

from __future__ import annotations

from random import Random

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.flood import SAMPLE_NS, Census, Flood
from pdgw.ds301.bus.load import frame_bits
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.peers.world.can_bus import SimulatedCan

BITRATE = 1_000_000
FULL = BITRATE * SAMPLE_NS // SECOND // frame_bits(8)
"""Frames with the most stuff bits in a sample of a full bus."""


def sample(**frames: int) -> Flood | None:
    census = Census()
    for name, number in frames.items():
        for _ in range(number):
            census.count(int(name.removeprefix("id"), 16), 8)
    return census.flood(BITRATE)


def test_identifier_with_most_of_a_full_bus_is_named() -> None:
    flood = sample(id001=FULL - 10, id181=10)
    assert flood is not None
    assert flood.can_id == 1
    assert 0.75 < flood.load <= 1


def test_frames_that_waited_for_the_sample_are_no_more_than_a_full_bus() -> None:
    flood = sample(id001=2 * FULL)
    assert flood is not None
    assert flood.load == 1


def test_a_busy_bus_of_several_senders_is_not_flooded_by_one() -> None:
    assert sample(id181=FULL // 3, id182=FULL // 3, id183=FULL // 3) is None


def test_a_bus_with_time_for_others_is_not_flooded() -> None:
    assert sample(id001=FULL // 2) is None
    assert sample() is None


def test_a_flood_is_sampled_until_it_is_over() -> None:
    loop = VirtualLoop()
    bus = SimulatedCan(loop, "can", BITRATE, Random(1))
    network = CanNetwork(loop, lambda: bus.join("gateway"))
    events: list[str] = []
    network.log_event = events.append  # type: ignore[assignment]
    network.start()
    flood, end = bus.join("flood"), 3 * SECOND

    def send() -> None:
        while len(flood.queue) < flood.places:
            flood.send(0x001, bytes(8))
        if loop.now() < end:
            loop.call_later(MS, send)

    send()
    network.examine()
    network.examine()
    loop.run_for(SECOND)
    assert network.flood is not None
    loop.run_for(6 * SECOND)
    assert network.flood is None
    assert events == [
        "bus can: frames with COB-ID 001h fill the bus: more than 82 % of the time",
        "bus can: not full any more",
    ]
    assert loop.waiting == 0, "nothing is counted without another reason"
