"""While a command is unconfirmed, no status word shows "reached" or "acknowledged". The oracle is published bit numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.dsp402.states import State
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS, Kind, drive_telegram
from pdgw.gateway.reasons import Reason, UnconfirmedOrder
from pdgw.profidrive.telegrams import telegram
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import DSC

CLAIMS = {"ZSW1": 0x1400, "Statusword": 0x1400, "POS_ZSW": 0x0008, "POS_ZSW2": 0x3008, "MELDW": 0x0001}
"""ZSW1.10 and .12, POS_ZSW.3, POS_ZSW2.3, .12 and .13, MELDW.0."""
FLOAT_100 = 0x42C8_0000
MOVING = {
    "NSOLL_A": 0x1000,
    "NSOLL_B": 0x1000_0000,
    "SATZANW": 0x8000,
    "POS_STW1": 0x8100,
    "MDI_MOD": 1,
    "MDI_TARPOS": 20_000,
    "MDI_TARPOS_F": FLOAT_100,
    "MDI_VELOCITY": 300_000,
    "MDI_VELOCITY_F": FLOAT_100,
    "MDI_ACC": 0x4000,
    "MDI_ACC_F": FLOAT_100,
    "MDI_DEC": 0x4000,
    "MDI_DEC_F": FLOAT_100,
    "OVERRIDE": 0x4000,
}
"""Setpoints that each telegram takes its own of."""


class Twins:
    """Two axes with the same PLC and drive; a command to one of them is unconfirmed."""

    def __init__(self, number: int) -> None:
        self.rigs = [Rig(number, positioner=CHOICES, dsc=DSC) for _ in range(2)]
        self.shown = dict.fromkeys((name for name in telegram(number).actuals.names if name in CLAIMS), 0)
        """All confirmations of the other axis until now."""

    def step(self, cycles: int, unconfirmed: UnconfirmedOrder, **values: int) -> None:
        certain, doubtful = self.rigs
        for rig in self.rigs:
            rig.values |= {name: value for name, value in values.items() if name in rig.values}
        for _ in range(cycles):
            doubtful.stepper.machine.inputs.unconfirmed = unconfirmed
            certain.step()
            doubtful.step()
            hidden = CLAIMS if unconfirmed else {}
            assert doubtful.actuals == {
                name: value & ~hidden.get(name, 0) for name, value in certain.actuals.items()
            }, "all else is shown"
            for name in self.shown:
                self.shown[name] |= certain.actuals[name] & CLAIMS[name]
        assert certain.controlwords == doubtful.controlwords


@given(
    number=st.sampled_from([item for item in DRIVE_TELEGRAM_NUMBERS if item != 100]),
    orders=st.lists(
        st.tuples(
            st.sampled_from([0x0040, 0x0030, 0x0100, 0x0800, 0x0020, 0x0400]),
            st.sampled_from(UnconfirmedOrder),
            st.integers(1, 60),
            st.integers(-30_000, 30_000),
        ),
        max_size=8,
    ),
)
def test_no_status_bit_is_confirmed_while_a_command_is_unconfirmed(
    number: int, orders: list[tuple[int, UnconfirmedOrder, int, int]]
) -> None:
    twins = Twins(number)
    for rig in twins.rigs:
        rig.enable()
    word = 0x043F
    twins.step(2, UnconfirmedOrder.NONE, **MOVING | {"STW1": word})
    for change, unconfirmed, cycles, target in orders:
        word ^= change
        twins.step(cycles, unconfirmed, STW1=word, MDI_TARPOS=target, NSOLL_A=target // 2)


@pytest.mark.parametrize("number", [1, 9, 102, 110, 111, 112])
def test_every_status_bit_is_shown_once_the_command_is_confirmed(number: int) -> None:
    """Else the test above would prove nothing. A fixed stop is in ``test_positioner_torque``."""
    twins = Twins(number)
    for rig in twins.rigs:
        rig.enable()
    twins.step(2, UnconfirmedOrder.NONE, **MOVING | {"STW1": 0x043F})
    expected = {name: CLAIMS[name] & ~0x3000 if name == "POS_ZSW2" else CLAIMS[name] for name in twins.shown}
    if drive_telegram(number).kind not in {Kind.POSITIONING, Kind.POSITIONER}:
        expected["ZSW1"] = 0x0400
    for _ in range(60):
        twins.step(50, UnconfirmedOrder.WAITS, STW1=0x047F)
        if twins.shown == expected:
            break
    assert twins.shown == expected


@pytest.mark.parametrize("unconfirmed", list(UnconfirmedOrder))
def test_an_off_releases_a_locked_axis_only_if_no_other_order_waits(unconfirmed: UnconfirmedOrder) -> None:
    bench = Bench()
    bench.operate()
    bench.drive_ok = False
    bench.step(OFF, cycles=10)
    bench.drive_ok = True
    inputs = bench.stepper.machine.inputs
    inputs.unconfirmed = unconfirmed  # an ON, sent while the drive was lost, is not confirmed yet
    bench.step(OFF, cycles=100)
    inputs.unconfirmed = UnconfirmedOrder.NONE
    bench.step(ON, cycles=10)
    started = bench.drive.state is State.OPERATION_ENABLED
    assert started is (unconfirmed is not UnconfirmedOrder.WAITS)
    if not started:
        assert bench.stepper.reason is Reason.NEEDS_OFF
        bench.operate()
