"""The guard behind the last translator: one Enable Operation for each time the PLC begins to ask for operation, after an OFF."""

from __future__ import annotations

import pytest

from pdgw.dsp402.states import STATUS_OF, State
from pdgw.durations import MS
from pdgw.gateway.axis.enable_guard import EnableGuard
from pdgw.gateway.axis.power_table import Phase
from pdgw.gateway.axis.waist import PowerWish
from pdgw.gateway.reasons import FaultNumber, Reason
from tests.support.drive_types import References
from tests.support.stepper import Stepper

QUICK_STOP, SHUTDOWN, SWITCH_ON, ENABLE = 0x2, 0x6, 0x7, 0xF
OFF, ON, NO_OPERATION = 0x047E, 0x047F, 0x0477
W = PowerWish


def allowed(*steps: tuple[PowerWish | None, int]) -> list[bool]:
    guard = EnableGuard()
    return [guard.step(wish, word) for wish, word in steps]


def test_guard_allows_one_enable_for_each_off_and_on() -> None:
    start = ((W.OFF, SHUTDOWN), (W.ENABLE, SWITCH_ON), (W.ENABLE, ENABLE), (W.ENABLE, ENABLE))
    assert all(allowed(*start, *start))


def test_guard_refuses_a_second_enable_under_one_on() -> None:
    words = ((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.ENABLE, SWITCH_ON), (W.ENABLE, ENABLE))
    assert allowed(*words) == [True, True, True, False]


def test_guard_allows_an_enable_for_each_operation_enable_of_one_on() -> None:
    assert all(allowed((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.ON, SWITCH_ON), (W.ENABLE, ENABLE)))


def test_guard_keeps_the_order_of_an_on_over_a_time_without_control() -> None:
    words = ((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.HOLD, ENABLE), (W.ON, SWITCH_ON), (W.ENABLE, ENABLE))
    assert all(allowed(*words))


@pytest.mark.parametrize("wish", [W.OFF, W.OFF_DISABLED, W.ON, W.STOP, W.COAST, W.QUICK_STOP, None])
def test_guard_refuses_an_enable_that_is_not_asked_for(wish: PowerWish | None) -> None:
    assert allowed((W.OFF, SHUTDOWN), (W.ENABLE, SWITCH_ON), (wish, ENABLE))[-1] is False


@pytest.mark.parametrize("doubt", [W.COAST, W.QUICK_STOP, W.QUICK_STOP_DISABLED, W.STOP, None])
def test_guard_needs_an_off_after_a_stop_or_a_loss(doubt: PowerWish | None) -> None:
    words = ((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (doubt, QUICK_STOP), (W.ENABLE, SWITCH_ON), (W.ENABLE, ENABLE))
    assert allowed(*words)[-1] is False


def test_guard_lets_a_ramp_keep_enable_operation() -> None:
    assert all(allowed((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.OFF, ENABLE), (None, ENABLE)))


def test_axis_replaces_an_unasked_enable_by_quick_stop_and_faults() -> None:
    """A drive that falls back from Switched On twice would be enabled twice by one ON."""
    stepper = Stepper(1)
    stepper.set_references(References())
    feedback = stepper.feedback
    now = 0

    def step(word: int, state: State) -> int:
        nonlocal now
        now += 4 * MS
        feedback.statusword = STATUS_OF[state]
        stepper.step((word, 0), feedback, True, now)
        return stepper.command.controlword & 0xF

    step(OFF, State.READY_TO_SWITCH_ON)
    step(ON, State.SWITCHED_ON)
    assert step(ON, State.SWITCHED_ON) == ENABLE
    step(ON, State.READY_TO_SWITCH_ON)
    assert step(ON, State.SWITCHED_ON) == QUICK_STOP
    assert FaultNumber.ENABLE_UNASKED in [event.number for event in stepper.events]
    assert stepper.reason is Reason.NEEDS_OFF
    assert stepper.power.phase is Phase.DOUBT
    for state in (State.SWITCHED_ON, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON):
        assert step(ON, state) in {0, QUICK_STOP}, "locked until an OFF"
    assert step(OFF, State.SWITCH_ON_DISABLED) == SHUTDOWN
    assert step(ON, State.READY_TO_SWITCH_ON) == SWITCH_ON
    assert step(ON, State.SWITCHED_ON) == ENABLE
