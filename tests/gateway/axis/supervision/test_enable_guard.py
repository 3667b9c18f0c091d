"""The final guard: one Enable Operation for each time the PLC starts to request operation, after an OFF."""

from __future__ import annotations

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.states import STATUS_OF, State
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.power_cells import CELLS, DRIVES, WISHES, cell
from pdgw.gateway.axis.power_states import Drive, Phase
from pdgw.gateway.axis.supervision.enable_guard import EnableGuard
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from tests.support.axis.stepper import Stepper
from tests.support.drives.drive_types import References

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


def test_guard_keeps_an_on_during_a_time_without_control() -> None:
    words = ((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.HOLD, ENABLE), (W.ON, SWITCH_ON), (W.ENABLE, ENABLE))
    assert all(allowed(*words))


@pytest.mark.parametrize("wish", [W.OFF, W.OFF_DISABLED, W.ON, W.STOP, W.COAST, W.QUICK_STOP, None])
def test_guard_rejects_an_enable_without_a_command(wish: PowerWish | None) -> None:
    assert allowed((W.OFF, SHUTDOWN), (W.ENABLE, SWITCH_ON), (wish, ENABLE))[-1] is False


@pytest.mark.parametrize("interruption", [W.COAST, W.QUICK_STOP, W.QUICK_STOP_DISABLED, W.STOP, None])
def test_guard_needs_an_off_after_a_stop_or_a_loss(interruption: PowerWish | None) -> None:
    words = (
        (W.OFF, SHUTDOWN),
        (W.ENABLE, ENABLE),
        (interruption, QUICK_STOP),
        (W.ENABLE, SWITCH_ON),
        (W.ENABLE, ENABLE),
    )
    assert allowed(*words)[-1] is False


@pytest.mark.parametrize("kept", [W.OFF, W.HOLD], ids=["resume after a ramp", "control returns"])
def test_guard_refuses_a_second_enable_under_an_on_that_kept_the_first(kept: PowerWish) -> None:
    start = ((W.OFF, SHUTDOWN), (W.ENABLE, SWITCH_ON), (W.ENABLE, ENABLE))
    again = ((kept, ENABLE), (W.ENABLE, ENABLE), (W.ENABLE, QUICK_STOP), (W.ENABLE, ENABLE))
    assert allowed(*start, *again) == [True] * 6 + [False]


def test_guard_lets_a_ramp_keep_enable_operation() -> None:
    assert all(allowed((W.OFF, SHUTDOWN), (W.ENABLE, ENABLE), (W.OFF, ENABLE), (None, ENABLE)))


class Axis:
    """Telegram 1 stepped by hand; the Controlword of each step."""

    def __init__(self) -> None:
        self.stepper = Stepper(1)
        self.stepper.set_references(References())
        self.now = 0

    def step(self, word: int, state: State) -> int:
        self.now += 4 * MS
        self.stepper.feedback.statusword = STATUS_OF[state] | 0x0400
        self.zsw1 = self.stepper.step((word, 0x2000), self.stepper.feedback, True, self.now)[0]
        return self.stepper.command.controlword & 0xF


@pytest.mark.parametrize(
    "state", [State.READY_TO_SWITCH_ON, State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED], ids=lambda s: s.name
)
def test_drive_that_falls_back_instead_of_entering_operation_needs_an_off(state: State) -> None:
    axis = Axis()
    axis.step(OFF, State.READY_TO_SWITCH_ON)
    axis.step(ON, State.SWITCHED_ON)
    assert axis.step(ON, State.SWITCHED_ON) == ENABLE
    for shown in (state, State.SWITCHED_ON, State.SWITCHED_ON):
        assert axis.step(ON, shown) in {0, QUICK_STOP}
    assert axis.stepper.reason is Reason.NEEDS_OFF
    assert FaultNumber.ENABLE_UNASKED not in axis.stepper.numbers
    axis.step(OFF, State.SWITCH_ON_DISABLED)
    axis.step(ON, State.SWITCHED_ON)
    assert axis.step(ON, State.SWITCHED_ON) == ENABLE


@pytest.mark.planted
def test_axis_replaces_an_uncommanded_enable_by_quick_stop_and_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table is made to enable a locked drive that shows Switched On."""
    axis = Axis()
    axis.step(ON, State.SWITCHED_ON)
    place = (Phase.LOCKED * DRIVES + Drive.SWITCHED_ON) * WISHES + W.ENABLE
    planted = cell(Phase.FOLLOW, Drive.SWITCHED_ON, W.ENABLE)
    monkeypatch.setattr("pdgw.gateway.axis.interlock.CELLS", (*CELLS[:place], planted, *CELLS[place + 1 :]))
    assert axis.step(ON, State.SWITCHED_ON) == QUICK_STOP
    assert axis.stepper.numbers == [FaultNumber.ENABLE_UNASKED]
    assert axis.stepper.reason is Reason.NEEDS_OFF
    assert axis.stepper.power.phase is Phase.UNCONFIRMED
    assert axis.stepper.command.target_velocity == 0
    assert not axis.zsw1 & 0x0404, "neither operation nor speed reached"
