"""No start and no task from an old frame: a network that delays frames by up to 5 s, repeats, reorders and loses them."""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.links.confirmation import CONFIRMING_FRAMES
from pdgw.gateway.links.cyclic import CyclicEndpoint, Verdict
from pdgw.gateway.links.sequence import OLDEST_NS, SEQUENCE_FRAMES, WRAP_NS, FrameSequence, Order
from pdgw.profidrive.frame import COUNTER_UNIT_NS, FRAME_ID_TO_DEVICE, IOPS_GOOD, RtFrame
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References
from tests.support.drives.plain_drive import PlainDrive

PLC = ("127.0.0.1", 40000)
CYCLE = 4 * MS
WATCHDOG = 3 * CYCLE
ACCEPTED = (Verdict.ACCEPTED, Verdict.PROVIDER_STOP)
OFF, ON = 0x047E, 0x047F
TASK = 0x0800
"""An edge starts something."""
STOPS = (0x10, 0x20, 0x40, 0x30)
"""Speed 0 or a frozen ramp where one of these bits is 0."""
CLAIMS = 0x1400
"""Target reached, task acknowledged."""
RECENT = WATCHDOG + (CONFIRMING_FRAMES + 1) * CYCLE
"""Greatest age of a command in force: a late frame, and those that had to confirm it."""


@dataclass
class Plc:
    """Sends a frame each cycle of its own clock, which may be off; a restart begins with any counter.

    ``life``: the sign of life in STW2 counts (telegram 2). ``jitter``: noise of the counter, as of a clock read at uneven times.
    """

    ppm: int = 0
    life: bool = False
    jitter: random.Random | None = None
    sent: list[tuple[int, int]] = field(default_factory=list)
    """Time and order of each frame."""
    edges: list[int] = field(default_factory=list)
    _counter: int = 0
    _noise: int = 0
    _life: int = 0
    _order: int = 0

    def restart(self, counter: int) -> None:
        self._counter = counter
        self._life = counter
        self._order = 0

    def frame(self, now: int, order: int) -> bytes:
        if order & TASK and not self._order & TASK:
            self.edges.append(now)
        self._order = order
        self.sent.append((now, order))
        self._counter += CYCLE // COUNTER_UNIT_NS
        self._life += 1
        if self.jitter is not None:
            self._noise = self.jitter.randrange(CYCLE // COUNTER_UNIT_NS // 2)
        values = bytes((0, 0, 0, 0, (self._life % 15 + 1) << 4, 0)) if self.life else bytes(2)
        c_sdu = order.to_bytes(2, "big") + values + bytes((IOPS_GOOD, IOPS_GOOD))
        return RtFrame(FRAME_ID_TO_DEVICE, c_sdu, self._counter + self._noise & 0xFFFF).encode()

    @property
    def period(self) -> int:
        return CYCLE + CYCLE * self.ppm // 1_000_000

    def ordered(self, order: int, since: int, until: int) -> bool:
        """Whether a frame with this order was sent in a time."""
        for when, what in reversed(self.sent):
            if when < since:
                return False
            if what == order and when <= until:
                return True
        return False


class Gateway:
    """Endpoint, machine and drive, and what is never allowed to happen."""

    def __init__(self, plc: Plc) -> None:
        self.plc = plc
        number = 2 if plc.life else 1
        self.endpoint = CyclicEndpoint([telegram(number)], cycle_ns=CYCLE)
        self.stepper = Stepper(number)
        self.stepper.set_references(References())
        self.drive = PlainDrive()
        self.order: int | None = None
        self.tasks = 0
        self.starts = 0
        self.lost_at = 0
        self.accepted: list[int] = []
        self._task_ended = False
        """A frame took the task bit back, and that is not in force yet."""
        self._stepped = 0

    def receive(self, data: bytes, now: int) -> None:
        verdict = self.endpoint.receive(data, PLC, now, now)
        if verdict in ACCEPTED:
            order = int.from_bytes(data[2:4], "big")
            self.accepted.append(now)
            self._task_ended |= not order & TASK
            in_force = self.endpoint.setpoints[0]
            assert in_force is None or not in_force[0] & ~order & 0x76, f"a stop waits at {now / MS} ms"
            self.step(now)
        elif now - self._stepped >= CYCLE:
            self.step(now)

    def step(self, now: int) -> None:
        self._stepped = now
        if self.endpoint.poll(now):
            self.lost_at = now
        values = self.endpoint.setpoints[0]
        self._check_order(None if values is None else values[0], now)
        if values is None or not values[0] & TASK or values[0] & 0x7 != 0x7:
            self._task_ended = False  # no task outlives OFF1, OFF2 and OFF3
        unconfirmed = self.endpoint.unconfirmed_orders[0]
        assert unconfirmed or not self._task_ended, (
            f"an end of the task bit was dropped without a word at {now / MS} ms"
        )
        self.stepper.machine.inputs.unconfirmed = unconfirmed
        zsw1, *others = self.stepper.step(values, self.drive.feedback, True, now)
        assert not unconfirmed or not zsw1 & CLAIMS
        self.endpoint.build([(zsw1, *others)], [True], [self.stepper.power.released])
        before = self.drive.state
        self.drive.step(self.stepper.command)
        if self.drive.state is State.OPERATION_ENABLED and before is not State.OPERATION_ENABLED:
            self.starts += 1
            self._check_start(now)

    def _check_order(self, order: int | None, now: int) -> None:
        if order is not None and order != self.order:
            # Old OFFs start nothing, nor does ON before an OFF; whether an old OFF released an ON is seen where it starts.
            starts = order & ~(self.order or 0) and order & 0x7 == 0x7 and self.stepper.power.released
            assert not starts or self.plc.ordered(order, now - RECENT, now), (
                f"{order:04X}h put in force at {now / MS} ms is old"
            )
            operating = self.order is not None and self.order & order & 0x6 == 0x6
            if operating and order & TASK and not (self.order or 0) & TASK:
                self.tasks += 1
                assert self.tasks <= len(self.plc.edges), f"task at {now / MS} ms"
        self.order = order

    def _check_start(self, now: int) -> None:
        """ON was sent just now, and after an OFF in this connection."""
        since = self.lost_at - RECENT
        orders = [(when, order) for when, order in self.plc.sent if since <= when <= now]
        on = max((when for when, order in orders if order & 0xF == 0xF), default=None)
        assert on is not None, f"start at {now / MS} ms without ON"
        # The drive takes three steps from ready to operation.
        assert on >= now - RECENT - 3 * CYCLE
        assert any(when < on and order & 0x7 == 0x6 for when, order in orders), f"start at {now / MS} ms without OFF"


def network(
    rng: random.Random, late: float, doubled: float, lost: float, jitter: int, *, turns: bool = True
) -> Iterator[list[int]]:
    """The delays of the copies of each frame: none for a lost one.

    With ``turns`` half of the late ones are late by about one or two turns of the cycle counter, which is the worst.
    """
    while True:
        copies = [] if rng.random() < lost else [rng.randrange(jitter)]
        if rng.random() < late:
            turn = rng.randrange(4) if turns else 0
            near = turn * WRAP_NS + rng.randint(-WATCHDOG, WATCHDOG)
            delay = near if 0 < turn <= 2 else rng.randrange(OLDEST_NS)
            if rng.random() < doubled:
                copies.append(delay)
            else:
                copies = [delay]
        yield copies


PHASES = st.tuples(
    st.sampled_from(["off", "on", "coast", "tasks", "stops", "silent", "restart"]),
    st.sampled_from([1, 2, 5, 30, 130, 520]),
)


def play(plc: Plc, phases: list[tuple[str, int]], rng: random.Random, delays: Iterator[list[int]]) -> Gateway:
    gateway = Gateway(plc)
    arrivals: list[tuple[int, int, bytes]] = []
    now = 10 * WRAP_NS
    number = 0
    due = now
    order = OFF

    def until(time: int) -> None:
        nonlocal due
        while True:
            arrival = arrivals[0][0] if arrivals else time
            if min(arrival, due) > time or (arrival >= time and due >= time):
                return
            if arrival < due:
                gateway.receive(arrivals[0][2], arrival)
                heapq.heappop(arrivals)
            else:
                gateway.step(due)
                due += CYCLE

    for kind, cycles in phases:
        if kind == "restart":
            plc.restart(rng.randrange(65536))
            continue
        for cycle in range(cycles):
            if kind != "silent":
                task = order & ~TASK | (cycle // 5 % 2) * TASK
                stop = order | 0x70 if cycle % 6 > 1 else order & ~rng.choice(STOPS)
                order = {"off": OFF, "on": ON, "coast": 0x047D, "stops": stop}.get(kind, task)
                frame = plc.frame(now, order)
                for delay in next(delays):
                    number += 1
                    heapq.heappush(arrivals, (now + delay, number, frame))
            now += plc.period
            until(now)
    while arrivals:
        until(arrivals[0][0] + CYCLE)
    return gateway


@given(
    phases=st.lists(PHASES, min_size=2, max_size=10),
    seed=st.integers(0, 1 << 30),
    late=st.sampled_from([(0.0, 0.0), (0.01, 0.0), (0.1, 0.0), (0.1, 1.0), (0.5, 1.0)]),
    lost=st.sampled_from([0.0, 0.02, 0.3]),
    ppm=st.sampled_from([-10_000, 0, 10_000]),
    life=st.booleans(),
    uneven=st.booleans(),
)
def test_no_start_and_no_task_from_an_old_frame_and_no_silent_drop(
    phases: list[tuple[str, int]], seed: int, late: tuple[float, float], lost: float, ppm: int, life: bool, uneven: bool
) -> None:
    rng = random.Random(seed)
    plc = Plc(ppm, life, random.Random(seed) if uneven else None)
    play(plc, phases, rng, network(rng, *late, lost, CYCLE))


@settings(max_examples=settings().max_examples // 2)
@given(
    seed=st.integers(0, 1 << 30),
    counter=st.integers(0, 65535),
    ppm=st.sampled_from([-10_000, -1000, 0, 1000, 10_000]),
    late=st.sampled_from([0.0, 0.1, 0.5]),
)
def test_a_healthy_plc_is_never_refused_for_more_than_five_cycles(
    seed: int, counter: int, ppm: int, late: float
) -> None:
    """Its frames come in time; copies of them, and of frames of its earlier life, come up to 5 s later too."""
    rng = random.Random(seed)
    plc = Plc(ppm)
    restarted_at = 10 * WRAP_NS + 300 * plc.period
    phases = [("off", 20), ("on", 280), ("restart", counter), ("off", 20), ("on", 800)]
    gateway = play(plc, phases, random.Random(counter), network(rng, late, 1.0, 0.0, CYCLE // 4, turns=False))
    times = [10 * WRAP_NS, *gateway.accepted]
    gaps = [after - before for before, after in pairwise(times)]
    assert max(gaps) <= 5 * plc.period
    assert max(gateway.accepted) > restarted_at
    assert late or gateway.starts == 2, "after each OFF and ON of the PLC"


def test_a_healthy_plc_is_taken_up_with_its_fourth_frame_and_stops_and_starts_without_delay_once_it_is_known() -> None:
    plc = Plc()
    gateway = Gateway(plc)
    now = 10 * WRAP_NS
    for cycle in range(3000):
        now += CYCLE
        order = OFF if cycle < 2000 or cycle >= 2500 else ON
        gateway.receive(plc.frame(now, order), now)
        assert (gateway.order is not None) == (cycle >= SEQUENCE_FRAMES - 1)
        if cycle >= SEQUENCE_FRAMES:
            assert gateway.order == order


def connected(order: int, cycles: int) -> tuple[Plc, Gateway, int]:
    plc = Plc()
    gateway = Gateway(plc)
    now = 10 * WRAP_NS
    for _ in range(cycles):
        now += CYCLE
        gateway.receive(plc.frame(now, order), now)
    return plc, gateway, now


@pytest.mark.parametrize("turns", [1, 2])
@pytest.mark.parametrize("received", [False, True])
def test_a_frame_that_is_late_by_whole_turns_of_the_counter_orders_nothing(turns: int, received: bool) -> None:
    """It fits the sequence perfectly; whether it came at its time too or was only delayed."""
    plc, gateway, now = connected(OFF, 1500)
    late: dict[int, bytes] = {}
    for cycle in range(3 * WRAP_NS // CYCLE):
        now += CYCLE
        order = ON if cycle == 5 else OFF
        frame = plc.frame(now, order)
        if now in late:
            gateway.receive(late[now], now - MS)
            assert gateway.endpoint.counters[Verdict.STALE] == 0, "it comes before the frame whose counter it has"
            gateway.receive(frame, now)
            break
        if cycle == 5:
            late[now + turns * WRAP_NS] = frame
            if not received:
                continue
        gateway.receive(frame, now)
    assert gateway.starts == 0
    assert gateway.order == OFF


def test_old_off_frames_of_an_earlier_connection_do_not_release_a_standing_on() -> None:
    """An attack on an earlier gateway: OFF frames delayed beyond the watchdog, then the ON that stays active."""
    plc, gateway, now = connected(OFF, 50)
    delayed = [plc.frame(now + n * CYCLE, OFF) for n in range(1, 6)]
    now += 5 * CYCLE
    for _ in range(20):
        now += CYCLE
        gateway.receive(plc.frame(now, ON), now)
    assert gateway.endpoint.connected
    gateway.step(now + 10 * CYCLE)
    now += 10 * CYCLE
    assert not gateway.endpoint.connected
    gateway.plc.sent += [(now + n * CYCLE, OFF) for n in range(6)]  # may be accepted for a while
    for frame in delayed:
        now += CYCLE
        gateway.receive(frame, now - 2 * MS)
        gateway.receive(plc.frame(now, ON), now)
    for _ in range(100):
        now += CYCLE
        gateway.receive(plc.frame(now, ON), now)
    assert gateway.endpoint.connected
    assert gateway.starts == 0


def test_a_second_path_that_brings_every_frame_again_later_is_not_taken_for_a_restarted_plc() -> None:
    plc, gateway, now = connected(OFF, 1300)
    late: dict[int, bytes] = {}
    for cycle in range(2000):
        now += CYCLE
        if now in late:
            gateway.receive(late.pop(now), now - MS)
        # The PLC sends ON for a while, then pauses for longer than the watchdog, then sends OFF.
        order = ON if cycle < 500 else OFF
        if not 500 <= cycle < 520:
            frame = plc.frame(now, order)
            late[now + 375 * CYCLE] = frame
            gateway.receive(frame, now)
        if cycle > 520 + SEQUENCE_FRAMES:
            assert gateway.order == OFF
    assert gateway.starts == 1


def test_two_frames_with_one_counter_that_disagree_confirm_nothing() -> None:
    """Copies that are late by a whole turn come each just before the frame of now, whose place they take."""
    plc, gateway, now = connected(OFF, 10)
    for cycle in range(60):
        now += CYCLE
        genuine = plc.frame(now, OFF)
        copy = bytearray(genuine)
        copy[3] = ON & 0xFF
        if cycle >= 10:
            gateway.receive(bytes(copy), now - MS)
        gateway.receive(genuine, now)
        assert gateway.order == OFF
    assert gateway.starts == 0


@pytest.mark.parametrize("word", [0x047D, 0x047B, 0x0000])
def test_off2_and_off3_act_at_once_however_young_the_connection(word: int) -> None:
    plc, gateway, now = connected(ON, 10)
    gateway.receive(plc.frame(now + CYCLE, word), now + CYCLE)
    assert gateway.order == word


def test_a_start_that_may_be_an_old_one_counts_with_its_third_frame_in_a_row() -> None:
    plc, gateway, now = connected(OFF, 10)
    in_force = []
    for order in (ON, ON, OFF, ON, ON, ON):
        now += CYCLE
        gateway.receive(plc.frame(now, order), now)
        in_force.append(gateway.order)
    assert in_force == [OFF, OFF, OFF, OFF, OFF, ON]


def test_frames_further_apart_than_the_watchdog_are_no_sequence_however_well_their_counters_fit() -> None:
    sequence = FrameSequence(CYCLE, WATCHDOG)
    now = 0
    for gap in (CYCLE, CYCLE, WATCHDOG + MS, CYCLE, WATCHDOG, CYCLE):
        assert sequence.follow("plc", now // COUNTER_UNIT_NS & 0xFFFF, now, None, may_connect=True) is Order.UNCONFIRMED
        now += gap
    assert sequence.follow("plc", now // COUNTER_UNIT_NS & 0xFFFF, now, None, may_connect=True) is Order.NEXT


def test_a_burst_of_old_frames_is_no_sequence() -> None:
    plc = Plc()
    frames = [plc.frame(n * CYCLE, OFF) for n in range(50)]
    gateway = Gateway(plc)
    for frame in frames:
        assert gateway.endpoint.receive(frame, PLC, 5000 * MS, 5000 * MS) is Verdict.UNCONFIRMED


def test_a_silence_longer_than_the_counter_s_turn_is_counted_whole() -> None:
    """With a long watchdog the history of commands must include the counter periods without frames."""
    cycle = 4 * MS
    sequence = FrameSequence(cycle, 5_000 * MS)
    now = 0
    for _ in range(SEQUENCE_FRAMES):
        now += cycle
        order = sequence.follow("plc", now // COUNTER_UNIT_NS & 0xFFFF, now, None, may_connect=True)
    assert order is Order.NEXT
    later = now + 3_000 * MS
    assert sequence.next(later // COUNTER_UNIT_NS & 0xFFFF, later)
    assert abs(sequence.elapsed_ns - 3_000 * MS) < cycle


def test_an_overtaken_frame_belongs_where_it_was_sent_unless_that_is_longer_ago_than_the_watchdog() -> None:
    cycle, units = 4 * MS, 4 * MS // COUNTER_UNIT_NS
    sequence = FrameSequence(cycle, 20 * MS)
    for count in range(1, SEQUENCE_FRAMES + 1):
        sequence.follow("plc", count * units, count * cycle, None, may_connect=True)
    for count in range(SEQUENCE_FRAMES + 1, SEQUENCE_FRAMES + 20):
        assert sequence.next(count * units, count * cycle)
    for behind in range(6):
        assert sequence.place((count - behind) * units) == sequence.elapsed_ns - behind * cycle
    assert sequence.place((count - 6) * units) is None


def test_frames_that_come_slower_than_they_were_sent_are_no_sequence() -> None:
    """As a queue lets old ones out: each of them fits the counter of the one before."""
    cycle, units = 4 * MS, 4 * MS // COUNTER_UNIT_NS
    sequence = FrameSequence(cycle, 50 * MS)
    for count in range(1, 20):
        order = sequence.follow("plc", count * units, count * 3 * cycle, None, may_connect=True)
        assert order is not Order.NEXT
