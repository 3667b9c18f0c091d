"""The UDP link and its sockets: floods, waiting datagrams, and whose values count."""

from __future__ import annotations

import socket
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterator

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.counters import Counters
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.udp import Address, UdpSocket
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.link import UdpLink
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram

# -- sockets: a flood of an unknown sender ends in the kernel, a port can be paused -------------------------------


@pytest.fixture
def port() -> Iterator[UdpSocket]:
    loop = SystemLoop()
    opened = UdpSocket(loop, "127.0.0.1", 0, "test")
    yield opened
    opened.close()
    loop.close()


@pytest.fixture
def senders() -> Iterator[list[socket.socket]]:
    """Two on different ports and one on another address."""
    made = []
    for host in ("127.0.0.1", "127.0.0.1", "127.0.0.2"):
        made.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made[-1].bind((host, 0))
    yield made
    for item in made:
        item.close()


def heard(port: UdpSocket) -> list[Address]:
    sources = []
    while (datagram := port.receive()) is not None:
        sources.append(datagram[1])
    return sources


def test_a_port_for_one_sender_hears_a_sample_of_others_until_it_is_for_all_again(
    port: UdpSocket, senders: list[socket.socket]
) -> None:
    """A second PLC can be named, and a flood costs little."""
    if sys.platform != "linux":
        pytest.skip("packet filters are of Linux")
    everybody = [item.getsockname() for item in senders]

    def all_send(times: int) -> Counter[Address]:
        found: Counter[Address] = Counter()
        for _ in range(times):
            for item in senders:
                item.sendto(b"x", port.address)
            found.update(heard(port))
        return found

    assert all_send(1) == Counter(everybody)
    for plc in (everybody[0], everybody[2]):
        port.only_from(plc)
        port.only_from(plc)
        found = all_send(3000)
        assert found.pop(plc) == 3000
        assert 2 <= found.total() <= 100, "of 6000, about 23; same number of port or not: address and port count"
    port.only_from(None)
    port.only_from(None)
    assert all_send(1) == Counter(everybody)


def test_a_paused_port_leaves_its_datagrams_in_the_kernel(port: UdpSocket, senders: list[socket.socket]) -> None:
    loop = port._loop
    seen: list[Address] = []
    port.start(lambda: seen.extend(heard(port)))
    port.pause()
    senders[0].sendto(b"x", port.address)
    loop.call_later(1_000_000, loop.stop)
    loop.run()
    assert seen == []

    def take() -> None:
        seen.extend(heard(port))
        loop.stop()

    port.start(take)
    loop.run()
    assert seen == [senders[0].getsockname()]


# -- number of datagrams taken, and whose values count ------------------------------------------------------------


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


def test_one_datagram_can_be_read_without_reading_the_next() -> None:
    scene = connected()
    scene.frame(1)
    scene.frame(2)
    before = scene.port.looks
    assert scene.link.receive(CYCLE, 1)
    assert (scene.speed, scene.port.looks - before, len(scene.port.waiting)) == (1, 1, 1)


def test_frames_after_a_punctual_one_are_left_for_the_next_turn() -> None:
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


@pytest.mark.parametrize("stop", [{"run": False}, {"good": False}], ids=["provider state STOP", "IOPS BAD"])
def test_a_stop_is_seen_before_what_follows_it(stop: dict[str, bool]) -> None:
    scene = connected()
    scene.frame(1)
    scene.frame(2, **stop)
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


def test_a_flood_of_rubbish_does_not_keep_the_plc_waiting() -> None:
    scene = connected()
    scene.port.waiting.extend(b"rubbish" for _ in range(50))
    scene.frame(7)
    assert scene.link.receive(CYCLE)
    assert scene.speed == 7


def test_unknown_senders_are_logged_once_for_each_connection() -> None:
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


def test_frames_that_waited_before_the_start_make_no_connection() -> None:
    scene = Scene()
    for speed in range(8):
        scene.frame(speed)
    scene.link.start(lambda: None)
    assert scene.port.started
    assert not scene.link.receive(100 * CYCLE)
    assert not scene.link.connected
