"""A stop in STW1 acts with its first frame where frames may be late; its return, and all that starts something, is confirmed."""

from __future__ import annotations

import pytest

from pdgw.durations import MS
from pdgw.gateway.configuration.example import simulated
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.reasons import Reason, UnconfirmedOrder
from pdgw.profidrive.frame import COUNTER_UNIT_NS, FRAME_ID_TO_DEVICE, IOPS_BAD, IOPS_GOOD, RtFrame
from pdgw.profidrive.telegrams import telegram
from tests.gateway.links.test_short_orders import ACKNOWLEDGED, HIGH, LOW, PLC, REACHED, ROUTED, TARGETS, Tasks
from tests.support.gateways.daemon import running

OFF, ON = 0x047E, 0x047F
CYCLE = 4 * MS
REJECT, HALT = 0x10, 0x100


class Line:
    """An endpoint of a young connection, whose frames may all be old ones, with ``ON`` in force."""

    def __init__(self, number: int = 1, *, released: bool = True) -> None:
        self.telegram = telegram(number)
        self.endpoint = CyclicEndpoint([self.telegram], cycle_ns=CYCLE)
        self.released = released
        self.values = [0] * len(self.telegram.setpoints.signals)
        self.number = 0
        self.send(ON, 20)

    def send(self, word: int, frames: int = 1, **others: int) -> int:
        """Frames with this STW1 and other values; the STW1 in force."""
        self.frames(word, frames, IOPS_GOOD, others)
        return self.in_force[0]

    def frames(self, word: int, frames: int, iops: int, others: dict[str, int]) -> None:
        half = self.telegram.setpoints
        for name, value in {half.names[0]: word, **others}.items():
            self.values[half.index(name)] = value
        for _ in range(frames):
            self.number += 1
            counter = self.number * CYCLE // COUNTER_UNIT_NS & 0xFFFF
            data = half.struct.pack(*self.values) + bytes((iops, IOPS_GOOD))
            now = self.number * CYCLE
            frame = RtFrame(FRAME_ID_TO_DEVICE, data, counter).encode()
            self.endpoint.receive(frame, ("192.168.0.10", 40000), now, now)
            self.endpoint.poll(now)
            self.endpoint.build([[0] * len(self.telegram.actuals.signals)], [True], [self.released])

    @property
    def in_force(self) -> tuple[int, ...]:
        values = self.endpoint.setpoints[0]
        assert values is not None
        return values

    @property
    def unconfirmed(self) -> UnconfirmedOrder:
        return self.endpoint.unconfirmed_orders[0]


@pytest.mark.parametrize(
    ("number", "word"),
    [(1, word) for word in (0x046F, 0x045F, 0x044F, 0x043F, 0x040F, 0x0477, 0x007F, OFF, 0x046E)]
    + [(9, word) for word in (0x046F, 0x045F, 0x044F, 0x0477, 0x007F, OFF, 0x046E)],
)
def test_a_stop_acts_with_its_first_frame_and_ends_with_the_third_without(number: int, word: int) -> None:
    line = Line(number)
    assert line.send(word) == word
    assert [line.send(ON), line.send(ON), line.send(ON)] == [word, word, ON]


def test_halt_of_telegram_100_acts_with_its_first_frame() -> None:
    """Bit 8 of the Controlword, which stops where it is 1."""
    halt = ON | HALT
    line = Line(100)
    assert line.send(halt) == halt
    assert [line.send(ON), line.send(ON), line.send(ON)] == [halt, halt, ON]
    assert line.unconfirmed is UnconfirmedOrder.NONE
    assert line.endpoint.orders_dropped == 0
    # What the frame orders besides waits: bit 4 starts a positioning or a homing.
    line.send(ON & ~0x10, 3)
    assert line.send(halt) == halt & ~0x10
    assert line.unconfirmed is UnconfirmedOrder.WAITS
    assert line.send(halt, 2) == halt
    released = Line(100, released=False)
    assert [released.send(halt), released.send(halt), released.send(halt)] == [ON, ON, halt], "no motion to stop"


@pytest.mark.parametrize("number", [1, 9, 111])
def test_the_bit_that_is_halt_in_a_controlword_is_no_stop_in_stw1(number: int) -> None:
    """STW1.8 is a jog: its rise waits."""
    line = Line(number)
    assert [line.send(ON | HALT), line.send(ON | HALT), line.send(ON | HALT)] == [ON, ON, ON | HALT]


@pytest.mark.parametrize("word", [0x043F, 0x047F & ~0x0400 | 0x80, 0x0C7F, 0x04FF, 0x147F])
def test_what_starts_something_waits_also_beside_a_stop(word: int) -> None:
    """A falling edge of STW1.6 does not stop in positioning telegrams; .7, .11 and .12 start or release something."""
    line = Line(9)
    stops = ON & (word | ~0x0400)
    assert [line.send(word), line.send(word), line.send(word)] == [stops, stops, word]
    assert Line(9).send(word & ~REJECT) == stops & ~REJECT


def test_only_the_stop_of_a_frame_acts_at_once_its_other_words_wait() -> None:
    for word, others in ((0x046F, {"POS_STW1": 0x8000}), (0x047D, {"POS_STW2": 1}), (OFF, {"POS_STW1": 5})):
        line = Line(111)
        target = {"MDI_TARPOS": 1000}
        assert line.send(word, **others, **target) == word
        assert line.in_force[1:] == (0,) * (len(line.in_force) - 1)
        assert line.unconfirmed is UnconfirmedOrder.WAITS
        line.send(word, 2)
        half = line.telegram.setpoints
        assert {name: line.in_force[half.index(name)] for name in (*others, *target)} == others | target
        assert line.unconfirmed is UnconfirmedOrder.NONE


def test_off1_and_stw1_3_wait_while_they_release_a_lock_or_end_a_braking() -> None:
    for word in (OFF, 0x0477):
        line = Line(1, released=False)
        assert [line.send(word), line.send(word), line.send(word)] == [ON, ON, word]


@pytest.mark.parametrize("number", [1, 2, 3, 5, 7, 9, 20, 102, 111])
def test_off2_and_off3_of_one_frame_act_after_a_loss_and_nothing_else_of_that_frame(number: int) -> None:
    """Without STW1.10, which returns with the third frame, the other words are ignored."""
    for word in (0x047D, 0x047B):
        line = Line(number)
        line.frames(ON, 1, IOPS_BAD, {})
        assert line.endpoint.setpoints == [None]
        others = {name: 0x10 for name in ("G1_STW", "SATZANW", "STW2") if name in line.telegram.setpoints.names}
        assert line.send(word, **others) == word & ~0x400
        assert line.send(word ^ 1, **others) == word & ~0x400 ^ 1
        assert [line.send(ON), line.send(ON), line.send(ON)] == [word & ~0x400 ^ 1] * 2 + [ON]
        assert line.unconfirmed is UnconfirmedOrder.NONE


def test_no_stop_begins_a_jog() -> None:
    """A jog begins where STW1.4 to .6 are 0."""
    line = Line(1)
    line.send(0x057F, 3)
    assert line.send(0x050F) == 0x040F
    assert line.send(0x050F, 2) == 0x050F, "confirmed"
    assert line.send(0x040F) == 0x040F, "released"


def test_a_released_jog_of_a_positioner_stands_without_another_edge() -> None:
    """The return of STW1.8 would be the edge of another incremental jog."""
    for bit in (0x0100, 0x0200):
        line = Line(111)
        line.send(ON | bit, 3)
        assert line.send(ON) == ON & ~0x20 | bit
        assert line.send(ON | bit, 3) == ON | bit
        line.send(ON)
        assert line.send(ON, 2) == ON


def test_a_reject_that_may_be_an_old_frame_is_in_doubt_until_repeated_or_another_task() -> None:
    ends = {"repeated": (ON & ~REJECT, 3), "off": (OFF, 3), "another task": (ON, 3)}
    for end, (word, frames) in ends.items():
        line = Line(111)
        line.send(ON & ~REJECT)
        assert line.unconfirmed is UnconfirmedOrder.WAITS
        line.send(ON, 100)
        assert line.unconfirmed is UnconfirmedOrder.DROPPED
        assert line.endpoint.orders_dropped == 1
        if end == "another task":
            line.send(LOW, 3)
            assert line.unconfirmed is UnconfirmedOrder.DROPPED, "the older task is over, reached or not"
        line.send(word, frames)
        assert line.unconfirmed is UnconfirmedOrder.NONE, end


@pytest.mark.parametrize(("number", "word"), [(1, 0x046F), (1, 0x045F), (9, 0x045F), (9, 0x047D)])
def test_a_short_stop_that_discards_no_task_leaves_no_doubt(number: int, word: int) -> None:
    line = Line(number)
    line.send(word)
    line.send(ON, 3)
    assert line.unconfirmed is UnconfirmedOrder.NONE
    assert line.endpoint.orders_dropped == 0


@pytest.mark.parametrize("number", TARGETS)
def test_a_reject_of_one_frame_stops_the_axis_and_shows_no_target_reached(number: int) -> None:
    config = simulated([number])
    transport = config.transport.model_copy(update=ROUTED)
    with running(config.model_copy(update={"transport": transport})) as daemon:
        plc = Tasks(daemon, [number], PLC)
        plc.begin(number)
        plc.run(50, STW1=LOW, MDI_TARPOS=TARGETS[number][0])
        plc.run(30, STW1=HIGH)
        begun = plc.value("XIST_A")
        plc.run(1, STW1=HIGH & ~REJECT)
        for _ in range(1000):
            plc.run(1, STW1=HIGH)
            assert not plc.value("ZSW1") & REACHED
        assert begun, "the axis moved"
        assert not plc.at(0)
        before = plc.value("XIST_A")
        plc.run(100)
        assert plc.value("XIST_A") == before, "it stands"
        assert daemon.axes[0].reason is Reason.ORDER_DROPPED
        plc.run(5, STW1=LOW)
        plc.run(1500, STW1=HIGH)
        assert plc.at(0)
        assert plc.value("ZSW1") & (REACHED | ACKNOWLEDGED) == REACHED | ACKNOWLEDGED
