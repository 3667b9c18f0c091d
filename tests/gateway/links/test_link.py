"""The UDP link: how many of the datagrams that wait it takes, and whose values count."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

from pdgw.ds301.counters import Counters
from pdgw.durations import MS
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.link import UdpLink
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram

CYCLE = 4 * MS
PLC = ("127.0.0.1", 40000)


class Port:
    """A UDP port whose datagrams are those of the test; ``looks`` counts who asked for one."""

    errors = 0
    address = ("127.0.0.1", 34962)
    received_at = None

    def __init__(self) -> None:
        self.waiting: deque[bytes] = deque()
        self.looks = 0
        self.filters: list[tuple[str, int] | None] = []

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        self.started = True

    def pause(self) -> None:
        raise AssertionError("no loop here")

    def only_from(self, sender: tuple[str, int] | None) -> None:
        self.filters.append(sender)

    def receive(self) -> tuple[bytes, tuple[str, int]] | None:
        self.looks += 1
        return (self.waiting.popleft(), PLC) if self.waiting else None

    def send(self, data: bytes | bytearray, address: tuple[str, int]) -> None:
        raise AssertionError("nothing is answered here")

    def close(self) -> None:
        """Nothing to release."""


class Scene:
    """A link with one axis of telegram 1, and a PLC that numbers its speeds."""

    def __init__(self) -> None:
        self.port = Port()
        self.link = UdpLink(self.port, TransportConfig(cycle_time_ms=4), [telegram(1)], Counters())
        self.plc = PlcEndpoint([telegram(1)], CYCLE)

    def frame(self, speed: int, *, word: int = 0x047F, run: bool = True, good: bool = True) -> None:
        self.plc.set(0, {"STW1": word, "NSOLL_A": speed})
        self.plc.run = run
        self.plc.bad = set() if good else {0}
        self.port.waiting.append(bytes(self.plc.build()))

    @property
    def speed(self) -> int | None:
        values = self.link.setpoints[0]
        return None if values is None else values[1]


def connected() -> Scene:
    """A PLC whose frames came every cycle up to the time 0."""
    scene = Scene()
    for number in range(-20, 1):
        scene.frame(0)
        scene.link.receive(number * CYCLE)
        scene.link.poll(number * CYCLE)
    assert scene.link.connected
    return scene


def test_one_datagram_can_be_taken_without_a_look_at_what_is_behind_it() -> None:
    scene = connected()
    scene.frame(1)
    scene.frame(2)
    before = scene.port.looks
    assert scene.link.receive(CYCLE, 1)
    assert (scene.speed, scene.port.looks - before, len(scene.port.waiting)) == (1, 1, 1)


def test_frames_behind_a_punctual_one_are_left_for_the_next_turn() -> None:
    scene = connected()
    now = 0
    seen = []
    for later in (CYCLE, 3 * CYCLE, CYCLE // 8):  # punctual, after a pause, at the heels of the one before
        now += later
        scene.frame(1)
        assert scene.link.receive(now, 1)
        seen.append(scene.link.more)
    assert seen == [False, True, True]
    assert not scene.link.receive(now)
    assert scene.link.more


def test_of_frames_that_piled_up_the_newest_counts() -> None:
    scene = connected()
    for speed in (1, 2, 3):
        scene.frame(speed)
    assert scene.link.receive(3 * CYCLE)
    assert (scene.speed, scene.link.skipped) == (3, 2)
    assert not scene.link.receive(3 * CYCLE), "nothing waits"


def test_a_stop_is_seen_before_what_follows_it() -> None:
    scene = connected()
    scene.frame(1)
    scene.frame(2, run=False)
    scene.frame(3)
    assert scene.link.receive(CYCLE)
    assert scene.speed is None
    assert len(scene.port.waiting) == 1


@pytest.mark.parametrize("word", [0x047E, 0x047D, 0x047B, 0x046F, 0x04FF])
def test_each_change_of_a_control_word_is_a_step_of_its_own_however_many_frames_wait(word: int) -> None:
    """An OFF of one frame must not be overtaken by the ON behind it."""
    scene = connected()
    scene.frame(1)
    scene.frame(2, word=word)
    scene.frame(3)
    scene.frame(4)
    seen = []
    while scene.link.receive(CYCLE):
        seen.append(scene.link.setpoints[0])
    assert seen == [(word, 2), (0x047F, 3), (0x047F, 4)]


def test_bad_data_is_seen_before_what_follows_it() -> None:
    scene = connected()
    scene.frame(1)
    scene.frame(2, good=False)
    scene.frame(3)
    assert scene.link.receive(CYCLE)
    assert scene.speed is None


def test_a_flood_of_rubbish_does_not_keep_the_plc_waiting() -> None:
    scene = connected()
    scene.port.waiting.extend(b"rubbish" for _ in range(50))
    scene.frame(7)
    assert scene.link.receive(CYCLE)
    assert scene.speed == 7


def test_strangers_are_kept_out_once_for_each_connection() -> None:
    scene = connected()
    for number in (1, 2):
        scene.frame(number)
        scene.link.receive(number * CYCLE)
    assert scene.port.filters == [PLC]
    assert scene.link.poll(6 * CYCLE), "lost"
    for number in range(7, 12):
        scene.frame(number)
        scene.link.receive(number * CYCLE)
    assert scene.port.filters == [PLC, None, PLC]


def test_what_waited_before_the_start_connects_nobody() -> None:
    scene = Scene()
    for speed in range(8):
        scene.frame(speed)
    scene.link.start(lambda: None)
    assert scene.port.started
    assert not scene.link.receive(100 * CYCLE)
    assert not scene.link.connected
