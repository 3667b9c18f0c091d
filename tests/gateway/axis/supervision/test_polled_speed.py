"""What is known of a speed that is read by SDO: standstill, turning, or neither, and how long a ramp may last without it."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.states import ControlBit
from pdgw.gateway.axis.orders import Order
from pdgw.gateway.axis.supervision.polled_speed import PolledSpeed
from pdgw.gateway.axis.values import Inputs, Outputs

WINDOW, FULL, TURNING = 30, 3000, 2400
REACTION, STOP_TIME = 300 * MS, 10 * SECOND
OPERATION = 0x000F


@dataclass
class Bench:
    """An axis in operation. An answer comes 10 ms after its request, and is old 300 ms after it."""

    inputs: Inputs = field(default_factory=lambda: Inputs(DriveFeedback(), now=100 * SECOND))

    def __post_init__(self) -> None:
        self.polled = PolledSpeed(self.inputs, Outputs(0, None), REACTION, STOP_TIME)
        self.order, self.word, self.target = Order.NONE, OPERATION, 0

    def step(self, after: int = 4 * MS) -> str:
        """One cycle; what is known."""
        inputs = self.inputs
        inputs.now += after
        self.polled.step(self.order, self.word, self.target, WINDOW)
        assert not (inputs.standstill and inputs.standstill_unknown)
        return "standstill" if inputs.standstill else "unknown" if inputs.standstill_unknown else "turns"

    def answer(self, velocity: int, asked: int | None = None) -> str:
        """A cycle 100 ms later with an answer, requested 10 ms before."""
        inputs = self.inputs
        inputs.feedback.velocity_actual = velocity
        inputs.speed_asked_ns = inputs.now + 90 * MS if asked is None else asked
        inputs.speed_until_ns = inputs.speed_asked_ns + 300 * MS
        return self.step(100 * MS)

    def at_standstill(self) -> None:
        self.step()
        self.answer(0)
        assert self.answer(0) == "standstill"

    def ramps(self, after: int = 4 * MS) -> bool:
        """One cycle of a ramp stop; whether it is over."""
        self.step(after)
        return self.polled.ramps_blindly(FULL, ramps=True)


def test_two_answers_in_succession_are_a_standstill() -> None:
    bench = Bench()
    assert [bench.answer(speed) for speed in (TURNING, WINDOW, WINDOW + 1, -WINDOW, WINDOW)] == [
        *("turns", "unknown", "turns", "unknown", "standstill")
    ]


def test_a_value_that_becomes_old_is_unknown() -> None:
    bench = Bench()
    bench.at_standstill()
    assert bench.step(290 * MS) == "standstill"
    assert bench.step() == "unknown"
    assert bench.answer(TURNING) == "turns"
    assert bench.step(290 * MS) == "turns"
    assert bench.step() == "unknown"


def test_the_same_answer_counts_once() -> None:
    bench = Bench()
    bench.step()
    assert [bench.answer(0), bench.step(), bench.step()] == ["unknown"] * 3


@pytest.mark.parametrize(
    "order",
    [
        {"order": Order.STOP},
        {"target": FULL},
        {"target": -FULL},
        {"word": OPERATION | ControlBit.HALT},
        {"word": OPERATION | ControlBit.NEW_SETPOINT},
    ],
    ids=str,
)
def test_an_order_needs_two_new_answers(order: dict[str, object]) -> None:
    bench = Bench()
    bench.at_standstill()
    before = bench.inputs.now
    vars(bench).update(order)
    assert bench.step() == "unknown"
    assert bench.answer(0, asked=before) == "unknown", "it was requested before the order"
    assert [bench.answer(0), bench.answer(0)] == ["unknown", "standstill"]


@pytest.mark.parametrize("change", [{"target": WINDOW}, {"word": OPERATION & ~1}, {"word": OPERATION | 0x80}], ids=str)
def test_what_starts_and_stops_nothing_keeps_a_standstill(change: dict[str, object]) -> None:
    bench = Bench()
    bench.at_standstill()
    vars(bench).update(change)
    assert bench.step() == "standstill"


def test_power_that_goes_at_the_end_of_a_stop_keeps_its_standstill() -> None:
    bench = Bench()
    bench.order = Order.STOP
    bench.at_standstill()
    bench.order = Order.OFF
    assert bench.step() == "standstill"
    bench.order = Order.STOP
    assert bench.step() == "unknown", "another stop"


def test_the_fall_of_halt_keeps_a_standstill() -> None:
    bench = Bench()
    bench.word |= ControlBit.HALT
    bench.at_standstill()
    bench.word = OPERATION
    assert bench.step() == "standstill"


def test_a_ramp_lasts_as_from_the_last_known_speed() -> None:
    bench = Bench()
    bench.answer(1500)
    assert not bench.ramps()
    assert not bench.ramps(10 * SECOND + REACTION - 4 * MS)
    assert bench.ramps(300 * MS)


def test_a_ramp_from_an_unknown_speed_lasts_twice_the_stop_time() -> None:
    bench = Bench()
    bench.answer(0)
    bench.step(SECOND)
    assert not bench.ramps()
    assert not bench.ramps(2 * STOP_TIME + REACTION)
    assert bench.ramps()


def test_no_ramp_lasts_longer_than_twice_the_stop_time() -> None:
    bench = Bench()
    bench.answer(FULL)
    bench.ramps()
    for _ in range(198):
        bench.answer(FULL)
        assert not bench.ramps(0)
    assert not bench.ramps(400 * MS)
    assert bench.ramps(200 * MS)


def test_a_ramp_at_a_low_speed_lasts_until_two_answers_could_have_come() -> None:
    bench = Bench()
    bench.answer(2 * WINDOW)
    bench.ramps()
    assert not bench.ramps(3 * SECOND)
    assert bench.ramps(REACTION + 4 * MS)


def test_a_ramp_with_a_known_speed_is_not_over() -> None:
    bench = Bench()
    bench.step(SECOND)
    bench.ramps()
    bench.inputs.now += 2 * STOP_TIME + SECOND
    bench.answer(TURNING)
    assert not bench.ramps(0)
    bench.answer(0)
    bench.answer(0)
    assert not bench.ramps(0)
    assert not bench.polled.ramps_blindly(FULL, ramps=False)
    bench.step(SECOND)
    assert not bench.ramps(), "another ramp has its own time"
