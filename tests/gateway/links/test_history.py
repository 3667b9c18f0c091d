"""Delayed copies of frames: which ones the history of frames recognises, and that none orders anything. In virtual time."""

from __future__ import annotations

from itertools import product

import pytest

from pdgw.durations import MS
from pdgw.gateway.links.confirmation import Orders
from pdgw.gateway.links.cyclic import CyclicEndpoint, Verdict
from pdgw.gateway.links.history import FrameHistory
from pdgw.gateway.links.sequence import OLDEST_NS, WRAP_NS
from pdgw.profidrive.frame import COUNTER_UNIT_NS, FRAME_ID_TO_DEVICE, IOPS_GOOD, RtFrame
from pdgw.profidrive.telegrams import telegram

PLC = ("192.168.0.10", 40000)
ON, TASK = 0x047F, 0x0C7F
"""STW1.11 starts homing; its falling edge does not stop at once."""


def sent(number: int, order: int, cycle: int, *, life: bool) -> bytes:
    """Frame ``number`` of a PLC with telegram 2; with ``life`` the sign of life in STW2 counts."""
    stw2 = (number % 15 + 1) << 12 if life else 0
    c_sdu = order.to_bytes(2, "big") + bytes(4) + stw2.to_bytes(2, "big") + bytes((IOPS_GOOD, IOPS_GOOD))
    return RtFrame(FRAME_ID_TO_DEVICE, c_sdu, number * cycle // COUNTER_UNIT_NS & 0xFFFF).encode()


STW1_ALONE = 0xFFFF << 8 * (len(sent(0, ON, 4 * MS, life=False)) - 4)
"""As a mask of the whole frame, whose first word is the FrameID."""


def history_of(cycle: int, *, life: bool, orders: dict[int, int], lost: set[int], count: int) -> FrameHistory:
    history = FrameHistory(cycle, STW1_ALONE, [2 + place for place in Orders(telegram(2).setpoints).lives])
    for number in range(count):
        if number not in lost:
            history.enter(sent(number, orders.get(number, ON), cycle, life=life), number * cycle)
    return history


def test_an_order_is_new_where_the_frames_of_one_and_two_turns_ago_differ() -> None:
    cycle, turn = 4 * MS, WRAP_NS // (4 * MS)
    now = 3 * turn
    for place in (now - turn, now - 2 * turn):
        history = history_of(cycle, life=False, orders={place: TASK}, lost=set(), count=now)
        assert not history.is_new(sent(now, TASK, cycle, life=False), now * cycle)
        assert history.is_new(sent(now, ON & ~1, cycle, life=False), now * cycle)
        lost = history_of(cycle, life=False, orders={}, lost={place}, count=now)
        assert not lost.is_new(sent(now, TASK, cycle, life=False), now * cycle), "what was lost may have been it"


def test_a_sign_of_life_tells_copies_apart_even_where_the_earlier_frame_was_lost() -> None:
    cycle, turn = 4 * MS, WRAP_NS // (4 * MS)
    now = 3 * turn
    for lost in (set(), {now - turn}, {now - turn, now - turn - 1}, {now - 2 * turn}):
        history = history_of(cycle, life=True, orders={now - turn: TASK}, lost=lost, count=now)
        assert history.is_new(sent(now, TASK, cycle, life=True), now * cycle)
        for turns in (1, 2):
            copy = sent(now - turns * turn, TASK if turns == 1 else ON, cycle, life=True)
            assert not history.is_new(copy, now * cycle)


@pytest.mark.parametrize("cycle", [3 * MS, 5 * MS, 10 * MS])
def test_a_sign_of_life_helps_where_a_turn_is_no_whole_number_of_cycles(cycle: int) -> None:
    now = 3 * WRAP_NS // cycle
    near = range(now - WRAP_NS // cycle - 2, now - WRAP_NS // cycle + 3)
    for life in (False, True):
        history = history_of(cycle, life=life, orders=dict.fromkeys(near, TASK), lost=set(), count=now)
        assert history.is_new(sent(now, TASK, cycle, life=life), now * cycle) == life


def test_a_sign_of_life_that_skips_across_a_gap_proves_nothing() -> None:
    cycle, turn = 4 * MS, WRAP_NS // (4 * MS)
    now = 3 * turn
    gap = now - turn
    history = FrameHistory(cycle, STW1_ALONE, [8])
    for number in range(now):
        if number != gap:
            life = number + (number > gap)
            frame = bytearray(sent(number, ON, cycle, life=False))
            frame[8] = (life % 15 + 1) << 4
            history.enter(bytes(frame), number * cycle)
    assert not history.is_new(sent(now, TASK, cycle, life=True), now * cycle)


def test_a_late_frame_that_differs_makes_only_its_own_moment_unknown() -> None:
    cycle, turn = 4 * MS, WRAP_NS // (4 * MS)
    now = 3 * turn
    history = history_of(cycle, life=False, orders={}, lost=set(), count=now + 1)
    task = sent(now, TASK, cycle, life=False)
    history.contradict(sent(now - turn, ON, cycle, life=False), (now - turn) * cycle)
    assert history.is_new(task, now * cycle), "the same again contradicts nothing"
    history.contradict(sent(now - turn, TASK, cycle, life=False), (now - turn) * cycle)
    assert not history.is_new(task, now * cycle)
    assert history.is_new(sent(now + 1, TASK, cycle, life=False), (now + 1) * cycle)
    history.contradict(task, (now - 2 * turn) * cycle + MS)
    assert not history.is_new(task, now * cycle + MS), "a frame between two known ones"


def test_frames_are_kept_for_two_turns_of_the_counter_and_no_longer() -> None:
    cycle = 4 * MS
    history = history_of(cycle, life=False, orders={}, lost=set(), count=10_000)
    assert 2 * WRAP_NS // cycle < len(history._times) < 3 * WRAP_NS // cycle


class Line:
    """An endpoint fed by a PLC whose frames arrive at once unless the test loses them; copies come when it says so."""

    def __init__(self, cycle: int, *, life: bool) -> None:
        self.cycle, self.life = cycle, life
        self.endpoint = CyclicEndpoint([telegram(2)], cycle_ns=cycle)
        self.number = 0

    @property
    def order(self) -> int | None:
        values = self.endpoint.setpoints[0]
        return None if values is None else values[0]

    def frame(self, number: int, order: int) -> bytes:
        return sent(number, order, self.cycle, life=self.life)

    def send(self, order: int, *, lost: bool = False, copy: bytes = b"") -> None:
        """The next frame of the PLC, and a copy of an older one that comes just before it."""
        now = self.number * self.cycle
        if copy:
            self.endpoint.receive(copy, PLC, now - MS, now - MS)
        if not lost:
            self.endpoint.receive(self.frame(self.number, order), PLC, now, now)
        self.endpoint.poll(now)
        self.endpoint.build([(0,) * 3], [True], [True])
        self.number += 1


@pytest.mark.parametrize("life", [False, True])
def test_no_copy_of_a_pulse_up_to_5_s_late_orders_anything_exhaustive(life: bool) -> None:
    """All delays up to 5 s, one or two copies, received before or not, in the place of genuine frames or beside them."""
    cycle = 128 * MS  # 16 frames to a turn of the counter
    begin = OLDEST_NS // cycle + 10
    late = OLDEST_NS // cycle + 1
    for width, delay, copies, received, lost in product((1, 3), range(1, late), (1, 2), (False, True), (False, True)):
        if delay < width + copies:
            continue
        line = Line(cycle, life=life)
        for _ in range(begin):
            line.send(ON)
        for place in range(width):
            line.send(TASK, lost=not received and place < copies)
        ended = False
        for step in range(width, delay + copies + 4):
            copied = step - delay
            copy = line.frame(begin + copied, TASK) if 0 <= copied < min(copies, width) else b""
            line.send(ON, lost=bool(copy) and lost, copy=copy)
            ended = ended or line.order != TASK
            assert line.order != TASK or not ended, (width, delay, copies, received, lost, step)
        assert ended


def test_a_frame_of_an_earlier_connection_orders_nothing_until_5_s_have_passed() -> None:
    """Its delay is not a multiple of the counter's period, because the PLC restarted with another counter."""
    for age in (0, 500, 1020, 1030, 1100, 1240):
        line = Line(4 * MS, life=False)
        for _ in range(age + 4):
            line.send(ON)
        line.send(ON, lost=True, copy=line.frame(line.number, TASK))
        assert line.order == ON, age
        assert line.endpoint.counters[Verdict.STALE] == 0
    for _ in range(8):
        line.send(ON)
    line.send(TASK)
    assert line.order == TASK, "a known PLC is believed at once"


def test_a_pulse_that_is_dropped_stays_in_doubt_until_the_plc_repeats_it() -> None:
    line = Line(4 * MS, life=False)
    for order in [ON] * 20 + [TASK] * 20:
        line.send(order)
    assert (line.order, line.endpoint.unconfirmed_orders[0].name) == (TASK, "NONE")
    line.send(ON)
    assert (line.order, line.endpoint.unconfirmed_orders[0].name) == (TASK, "WAITS")
    for _ in range(500):
        line.send(TASK)
        assert (line.order, line.endpoint.unconfirmed_orders[0].name, line.endpoint.orders_dropped) == (
            TASK,
            "DROPPED",
            1,
        )
    line.send(ON)
    line.send(ON)
    assert line.endpoint.unconfirmed_orders[0].name == "WAITS", "a waiting order comes before a dropped one"
    line.send(ON)
    assert (line.order, line.endpoint.unconfirmed_orders[0].name, line.endpoint.orders_dropped) == (ON, "NONE", 1)


def test_another_change_does_not_end_the_doubt_about_a_pulse() -> None:
    line = Line(4 * MS, life=False)
    for order in [ON] * 20 + [TASK] * 20 + [ON] + [TASK] * 5:
        line.send(order)
    for _ in range(5):
        line.send(TASK | 0x100)
    assert (line.order, line.endpoint.unconfirmed_orders[0].name) == (TASK | 0x100, "DROPPED")
    for _ in range(5):
        line.send(TASK & ~1)
    assert line.endpoint.unconfirmed_orders[0].name == "NONE", "OFF ends every task"
