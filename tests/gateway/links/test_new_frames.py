"""No frame that counts is older than the age limit, in a network that loses, repeats, reorders and delays frames."""

from __future__ import annotations

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count, groupby

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.counters import Counters
from pdgw.gateway.base.finding_text import finding_line
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.link import UdpLink
from pdgw.gateway.links.new_frames import NewFrames, Verdict
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.telegrams import telegram

CYCLE = 4 * MS
WATCHDOG = 3 * CYCLE
LIMIT = 2 * WATCHDOG
PLC, SECOND_PLC, OTHER = ("192.168.0.10", 4000), ("192.168.0.10", 4001), ("192.168.0.11", 4000)
TELEGRAM = telegram(9)
TICK = slice(38, 42)
"""Its place in a frame of one axis with telegram 9, in both directions."""


@dataclass
class Network:
    """``delays``: constant ones to the gateway and to the PLC. A share ``late`` of the frames comes up to ``latest`` later."""

    loss: float = 0.0
    twice: float = 0.0
    late: float = 0.0
    latest: int = 5 * SECOND
    delays: tuple[int, int] = (MS // 20, MS // 20)

    def copies(self, chance: random.Random, way: int) -> list[int]:
        """The delay of each copy of a frame that arrives."""
        number = (chance.random() >= self.loss) + (chance.random() < self.twice)
        later = [chance.randrange(self.latest) if chance.random() < self.late else 0 for _ in range(number)]
        return [self.delays[way] + item for item in later]


class Port:
    """The gateway's port: what waits in it."""

    errors = 0
    address = ("192.168.0.5", 34962)

    def __init__(self, send: Callable[[bytes, Address], None]) -> None:
        self.waiting: deque[tuple[int, bytes, Address]] = deque()
        self.received_at: int | None = None
        self._send = send

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None: ...

    def pause(self) -> None: ...

    def only_from(self, sender: Address | None) -> None: ...

    def close(self) -> None: ...

    def receive(self) -> tuple[bytes, Address] | None:
        if not self.waiting:
            return None
        self.received_at, data, source = self.waiting.popleft()
        return data, source

    def send(self, data: bytes | bytearray, address: Address) -> None:
        self._send(bytes(data), address)


@dataclass
class Site:
    """A PLC, the network and the gateway's link in virtual time. Each frame of the PLC has a number; ``sent`` has its time."""

    seed: int = 0
    network: Network = field(default_factory=Network)
    ppm: int = 0
    """The PLC's clock is too fast by this much."""
    at_most: int = 1000
    """Frames that the PLC reads in a scan."""
    change: Callable[[bytes], bytes] = lambda tick: tick
    """What the PLC does with the tick instead of copying it."""

    def __post_init__(self) -> None:
        self.chance = random.Random(self.seed)
        self.now = SECOND
        self.events: list[tuple[int, int, Callable[[], None]]] = []
        self.numbers = count(1)
        self.sent: dict[int, int] = {}
        self.accepted: list[tuple[int, int]] = []
        """Time and number of each frame that counted."""
        self.losses = 0
        self.address = PLC
        self.word = 0x043E
        self.silent = False
        self.words: list[int] = []
        """Each control word in force."""
        self._serial = count()
        self._step_at = self._sent_at = 0
        self.start_gateway()
        self.start_plc()
        self.at(self.now, self._scan)
        self.at(self.now, self._due)

    def start_gateway(self) -> None:
        """The gateway starts: another offset of its ticks."""
        self.port = Port(lambda data, address: self.carry(1, lambda: self._to_plc(data, address)))
        transport = TransportConfig.model_validate({"listen": "192.168.0.5", "peer": PLC[0]})
        self.link = UdpLink(self.port, transport, [telegram(9)], Counters(), self.chance.getrandbits(32))

    def start_plc(self) -> None:
        self.plc = PlcEndpoint([TELEGRAM], CYCLE)
        self.inbox: deque[bytes] = deque()

    def restart_plc(self, address: Address) -> None:
        """No PLC starts within the age limit."""
        self.silent = True
        self.run(LIMIT // CYCLE + 1)
        self.silent = False
        self.address = address
        self.start_plc()

    def at(self, time: int, action: Callable[[], None]) -> None:
        heapq.heappush(self.events, (time, next(self._serial), action))

    def carry(self, way: int, arrive: Callable[[], None]) -> None:
        for delay in self.network.copies(self.chance, way):
            self.at(self.now + delay, arrive)

    def run(self, cycles: int) -> Site:
        end = self.now + cycles * CYCLE
        while self.events[0][0] <= end:
            self.now, _, action = heapq.heappop(self.events)
            action()
        self.now = end
        return self

    def _to_plc(self, data: bytes, address: Address) -> None:
        if address == self.address:
            self.inbox.append(data)

    def _scan(self) -> None:
        for _ in range(min(self.at_most, len(self.inbox))):
            self.plc.receive(self.inbox.popleft(), self.now)
        if not self.silent:
            self.plc.tick = self.change(self.plc.tick)
            self.send(self.plc, self.address)
        self.at(self.now + CYCLE - CYCLE * self.ppm // 1_000_000, self._scan)

    def send(self, plc: PlcEndpoint, address: Address) -> None:
        number = next(self.numbers)
        self.sent[number] = self.now
        plc.set(0, {"STW1": self.word, "MDI_TARPOS": number})
        data = bytes(plc.build(self.now + self.now * self.ppm // 1_000_000))
        self.carry(0, lambda: self.arrive(data, address))

    def arrive(self, data: bytes, address: Address) -> None:
        self.port.waiting.append((self.now, data, address))
        while self.port.waiting:
            if self.link.receive(self.now, 1):
                self._take()
                self._step()

    def _take(self) -> None:
        setpoints = self.link.setpoints[0]
        assert setpoints is not None
        number = TELEGRAM.setpoints.as_dict(setpoints)["MDI_TARPOS"]
        assert self.now - self.sent[number] <= LIMIT, f"{(self.now - self.sent[number]) / MS} ms old"
        assert not self.accepted or number > self.accepted[-1][1], "older than the frame before"
        self.accepted.append((self.now, number))
        if self.words[-1:] != [setpoints[0]]:
            self.words.append(setpoints[0])

    def _due(self) -> None:
        if self.now - self._step_at >= CYCLE + CYCLE // 2:
            self._step(accepted=False)
        self.at(self.now + CYCLE // 2, self._due)

    def _step(self, *, accepted: bool = True) -> None:
        """As the daemon does it: the watchdog, and an answer to each frame, without frames every second cycle."""
        self._step_at = self.now
        self.losses += self.link.poll(self.now) != ""
        if accepted or self.now - self._sent_at >= 2 * CYCLE:
            self._sent_at = self.now
            self.link.send([(0,) * len(TELEGRAM.actuals.signals)], [True], self.now)

    @property
    def counted(self) -> dict[Verdict, int]:
        return {verdict: number for verdict, number in self.link.endpoint.counts.frames.items() if number}


PHASES = st.lists(
    st.tuples(
        st.sampled_from(
            ["run", "silent", "plc restarts", "plc restarts at once", "plc moves", "gateway restarts", "other layout"]
        ),
        st.integers(1, 100),
    ),
    min_size=1,
    max_size=6,
)
SHARES = st.sampled_from([0.0, 0.02, 0.3])
DELAYS = st.tuples(st.integers(0, 2 * WATCHDOG), st.integers(0, 2 * WATCHDOG))


@settings(deadline=None)
@given(
    phases=PHASES,
    seed=st.integers(0, 1 << 30),
    shares=st.tuples(SHARES, SHARES, SHARES),
    latest=st.sampled_from([CYCLE, WATCHDOG, LIMIT, 5 * SECOND]),
    delays=st.one_of(st.just((0, 0)), DELAYS),
    ppm=st.sampled_from([-10_000, 0, 10_000]),
    at_most=st.sampled_from([1, 1000]),
)
def test_no_frame_that_counts_is_older_than_the_limit_or_than_the_one_before(
    phases: list[tuple[str, int]],
    seed: int,
    shares: tuple[float, float, float],
    latest: int,
    delays: tuple[int, int],
    ppm: int,
    at_most: int,
) -> None:
    """The oracle is in ``Site``: the time at which each frame that counts was sent."""
    site = Site(seed, Network(*shares, latest, delays), ppm, at_most)
    for what, cycles in phases:
        site.silent = what == "silent"
        if what == "plc restarts":
            site.restart_plc(site.address)
        elif what == "plc restarts at once":
            site.start_plc()
        elif what == "plc moves":
            site.restart_plc(SECOND_PLC if site.address == PLC else PLC)
        elif what == "gateway restarts":
            site.start_gateway()
        elif what == "other layout":
            # P922 to a telegram whose frames have the same size, and back.
            site.link.set_layout([telegram(1)])
            site.link.set_layout([TELEGRAM])
        site.run(cycles)


@given(seed=st.integers(0, 1 << 30), ppm=st.sampled_from([-10_000, 0, 10_000]), late=st.sampled_from([0.0, 0.1]))
def test_a_healthy_plc_connects_within_a_round_trip_and_is_never_lost(seed: int, ppm: int, late: float) -> None:
    """Repeated frames and copies that come seconds later change nothing."""
    site = Site(seed, Network(twice=late, late=0.0, latest=5 * SECOND), ppm)
    site.run(200)
    assert site.accepted[0][0] <= SECOND + 4 * CYCLE + MS
    assert site.losses == 0
    assert site.link.connected


def test_no_loss_but_those_of_the_lost_frames() -> None:
    """Of each 100 frames 2 are lost, in both directions. Three in a row are a loss with every rule; the ticks add none."""
    site = Site(1, Network(loss=0.02))
    site.run(20_000)
    arrived = {number for _, number in site.accepted}
    present = (number in arrived for number in sorted(site.sent))
    gaps = sum(len(list(group)) >= 3 for here, group in groupby(present) if not here)
    assert site.losses <= gaps
    assert site.counted[Verdict.ACCEPTED] >= 0.98 * len(site.sent) - 500


@pytest.mark.parametrize("delay", [0, WATCHDOG // 2, WATCHDOG - CYCLE])
def test_a_constant_delay_up_to_the_limit_connects(delay: int) -> None:
    site = Site(network=Network(delays=(delay, delay))).run(500)
    assert site.link.connected
    assert site.losses == 0
    assert site.link.age_ns is not None
    assert 2 * delay <= site.link.age_ns <= LIMIT


def finding_text(site: Site) -> str:
    finding = site.link.finding()
    return "" if finding is None else finding_line(finding)


@pytest.mark.parametrize("delays", [(LIMIT, MS), (MS, LIMIT), (WATCHDOG, WATCHDOG + MS), (2 * SECOND, 0)])
def test_a_constant_delay_above_the_limit_never_connects_and_is_named(delays: tuple[int, int]) -> None:
    site = Site(network=Network(delays=delays)).run(2000)
    assert not site.accepted
    assert "ms old, limit 24 ms; raise watchdog_factor" in finding_text(site)


def test_a_plc_that_reads_one_frame_a_scan_is_lost_and_named_when_its_socket_fills() -> None:
    """A gateway with a shorter cycle: its frames wait in the PLC for longer with each scan."""
    site = Site(at_most=1, network=Network(twice=0.2)).run(1000)
    assert not site.link.connected
    assert "if the age rises steadily, the PLC must read all waiting frames in each scan" in finding_text(site)


@pytest.mark.parametrize("tick", [bytes(4), b"\x12\x34\x56\x78"])
def test_a_plc_without_the_tick_is_never_connected_and_the_bytes_are_named(tick: bytes) -> None:
    site = Site(change=lambda _: tick).run(200)
    assert not site.accepted
    assert (
        "copy bytes 38 to 41 of the newest one to bytes 38 to 41 of its own, before the cycle counter"
        in finding_text(site)
    )


def test_two_plcs_at_one_gateway_are_named() -> None:
    site = Site()
    second = PlcEndpoint([TELEGRAM], CYCLE)
    for _ in range(100):
        site.send(second, OTHER)
        site.run(1)
    assert site.link.connected
    assert site.losses == 0
    assert "frames of 192.168.0.11:4000 do not count: the PLC is 192.168.0.10:4000" in finding_text(site)
    site.run(2600)
    assert site.link.finding() is None


def test_first_of_two_senders_connects_though_the_second_sends_between() -> None:
    """Only one sender at a time is answered, so only it can have a tick."""
    site = Site()
    second = PlcEndpoint([TELEGRAM], CYCLE)
    for _ in range(10):
        site.run(1)
        site.send(second, SECOND_PLC)
        assert site.link.endpoint.peer == PLC
    assert site.link.connected
    assert site.accepted[0][0] <= SECOND + 4 * CYCLE + MS
    site.silent = True
    for _ in range(10):
        site.run(1)
        site.send(second, SECOND_PLC)
    assert site.link.endpoint.peer == SECOND_PLC, "the next one, after the watchdog time"


def test_a_pulse_of_one_frame_acts_from_the_first_frame_on() -> None:
    site = Site().run(4)
    words = [0x04BE, 0x043E, 0x043F]
    for word in words:
        site.word = word
        site.run(1)
    site.run(1)
    assert site.words == [0x043E, *words]


def test_old_frames_of_a_connection_before_do_not_count_after_a_loss() -> None:
    """An attacker repeats the OFF and ON frames of an earlier connection, in their order and rhythm."""
    site = Site().run(10)
    recorded = [bytes(site.link.newest()[2])]
    for word in (0x043E, 0x043F):
        site.word = word
        site.run(1)
        recorded.append(bytes(site.link.newest()[2]))
    site.silent = True
    site.run(100)
    assert site.losses == 1
    before = len(site.accepted)
    for data in recorded * 20:
        site.arrive(data, PLC)
        site.run(1)
    assert len(site.accepted) == before


# -- the rule itself ----------------------------------------------------------------------------------------------------


def test_ticks_wrap_and_are_never_0() -> None:
    rule = NewFrames(LIMIT, offset=(1 << 32) - 3)
    ticks = [rule.tick(n * CYCLE // 128) for n in range(6)]
    assert ticks == [0xFFFFFFFD, 0xFFFFFFFE, 0xFFFFFFFF, 1, 1, 2]
    assert rule.check(0xFFFFFFFF, 0, CYCLE) is Verdict.ACCEPTED
    assert rule.check(1, 1, CYCLE) is Verdict.ACCEPTED, "later, though its number is smaller"
    assert rule.check(0xFFFFFFFE, 2, CYCLE) is Verdict.STALE


def test_frames_with_one_tick_are_ordered_by_their_counters() -> None:
    rule = NewFrames(LIMIT)
    first, second = rule.tick(SECOND), rule.tick(SECOND + CYCLE)
    now = SECOND + 2 * CYCLE
    assert rule.check(first, 65535, now) is Verdict.ACCEPTED
    assert rule.check(first, 65535, now) is Verdict.STALE
    assert rule.check(first, 127, now) is Verdict.ACCEPTED
    assert rule.check(second, 5, now) is Verdict.STALE, "the PLC received its tick before that of the frame with 127"
    assert rule.check(second, 255, now) is Verdict.ACCEPTED
    assert rule.check(first, 256, now) is Verdict.STALE
    assert rule.check(rule.tick(now), 5, now + 1) is Verdict.ACCEPTED, "sent after all of them"
    assert rule.check(second, 6, SECOND + CYCLE + LIMIT) is Verdict.STALE
    assert rule.check(second, 7, SECOND + CYCLE + LIMIT + 1) is Verdict.TOO_OLD


@pytest.mark.parametrize("limit", [LIMIT, 512 * MS, SECOND])
def test_older_frame_with_the_same_tick_is_stale_up_to_the_age_limit(limit: int) -> None:
    """The counter repeats every 2.048 s: one that is older by up to the age limit must not look like a newer one."""
    for older in range(MS, limit + 1, limit // 100):
        rule = NewFrames(limit)
        tick, counter = rule.tick(SECOND), 60_000
        assert rule.check(tick, counter, SECOND + limit) is Verdict.ACCEPTED
        assert rule.check(tick, counter - older // COUNTER_UNIT_NS & 0xFFFF, SECOND + limit) is Verdict.STALE


def test_a_frozen_tick_never_counts_again_in_40_hours() -> None:
    """Not either when the gateway's clock has the same value again, after 37.3 h."""
    rule = NewFrames(LIMIT)
    frozen = rule.tick(SECOND)
    step = 512 * MS
    end = SECOND + 40 * 3600 * SECOND
    for now in range(SECOND + step, end, step):
        rule.tick(now)
        assert rule.check(frozen, now // MS & 0xFFFF, now + MS) is not Verdict.ACCEPTED


def test_ticks_of_another_start_or_for_another_plc_do_not_count() -> None:
    first, second = NewFrames(LIMIT, 1000), NewFrames(LIMIT, 77_000_000)
    old = first.tick(SECOND)
    second.tick(SECOND)
    assert second.check(old, 0, SECOND + MS) is Verdict.NO_TICK
    first.restart()
    assert first.check(old, 0, SECOND + MS) is Verdict.NO_TICK


def test_without_an_age_limit_the_counter_decides_whatever_the_tick_is() -> None:
    rule = NewFrames(None)
    assert rule.tick(SECOND)
    assert rule.check(0, 7, 0) is Verdict.ACCEPTED
    assert rule.check(5, 7, 0) is Verdict.STALE
    assert rule.check(0, 8, 99 * SECOND) is Verdict.ACCEPTED
    rule.lose()
    assert rule.check(0, 3, 0) is Verdict.ACCEPTED
    assert rule.age_ns is None
