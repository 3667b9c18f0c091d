"""STW1.5 = 0 freezes the ramp: the demand speed of that moment becomes the target, whichever telegram asks for it."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.gateway.axis.settings import SetpointEnable
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from pdgw.gateway.reasons import Reason
from tests.support.axis.rig import Rig

FROZEN, RUN = 0x045F, 0x047F
FULL_SPEED = 6000
"""3000 rpm in half rpm."""
WITHIN_TOLERANCE = 1 << 8
RAMPED = [1, 2, 3, 4, 20, 102, 103]


def accelerating(number: int, cycles: int = 14, **settings: object) -> Rig:
    """Under way from 0 to 100 %."""
    rig = Rig(number, **settings)
    rig.enable(0x047E)
    rig.values |= {"NSOLL_A": 0x4000} if "NSOLL_A" in rig.values else {"NSOLL_B": 0x4000_0000}
    rig.step(cycles)
    assert 0 < rig.feedback.velocity_actual < FULL_SPEED, "on the ramp"
    return rig


def stepped(rig: Rig, demand: int) -> Sequence[int]:
    """The actual values of a cycle in which the drive gives this demand speed."""
    rig.feedback.velocity_demand = demand
    setpoints = rig.stepper.telegram.setpoints.from_dict(rig.values)
    return rig.stepper.step(setpoints, rig.feedback, True, rig.now)


@pytest.mark.parametrize("number", RAMPED)
def test_freeze_makes_the_demand_speed_of_the_edge_the_target(number: int) -> None:
    rig = accelerating(number)
    rig.values["STW1"] = FROZEN
    rig.step()
    edge = rig.feedback.velocity_demand
    assert rig.stepper.command.target_velocity == edge
    rig.step(300)
    assert rig.feedback.velocity_actual == edge
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED
    rig.values["STW1"] = RUN
    rig.step(500)
    assert rig.feedback.velocity_actual == FULL_SPEED, "the ramp goes on to the setpoint"


@pytest.mark.parametrize("number", [1, 3, 20, 102])
def test_freeze_without_a_demand_value_uses_the_actual_speed(number: int) -> None:
    rig = accelerating(number)
    rig.values["STW1"] = FROZEN
    words = stepped(rig, DEMAND_UNKNOWN)
    assert rig.stepper.command.target_velocity == rig.feedback.velocity_actual
    assert not words[0] & WITHIN_TOLERANCE


def test_freeze_while_the_axis_slows_down_keeps_the_speed() -> None:
    rig = accelerating(1, cycles=600 // 4)
    rig.values["NSOLL_A"] = 0
    rig.step(5)
    rig.values["STW1"] = FROZEN
    rig.step()
    edge = rig.stepper.command.target_velocity
    assert edge > 0
    rig.values["NSOLL_A"] = -0x4000
    rig.step(200)
    assert rig.feedback.velocity_actual == edge, "another setpoint counts once the ramp is released"


def test_freeze_at_the_start_of_operation_is_standstill() -> None:
    rig = Rig(1)
    rig.values["NSOLL_A"] = 0x4000
    rig.enable(0x045E)
    rig.step(50)
    assert rig.feedback.velocity_actual == rig.stepper.command.target_velocity == 0


def test_freeze_does_not_outlast_an_off() -> None:
    rig = accelerating(1)
    rig.values["STW1"] = FROZEN
    rig.step(20)
    rig.values["STW1"] = FROZEN & ~1
    rig.until(lambda _: rig.feedback.velocity_actual == 0)
    rig.values["STW1"] = FROZEN
    rig.step(50)
    assert rig.stepper.command.target_velocity == 0


def test_setpoint_enable_hold_keeps_the_target_not_the_ramp() -> None:
    rig = accelerating(1, setpoint_enable=SetpointEnable.HOLD)
    rig.values["STW1"] = FROZEN
    rig.step(500)
    assert rig.feedback.velocity_actual == FULL_SPEED


@pytest.mark.parametrize("form", DscForm)
@pytest.mark.parametrize("number", [5, 6, 105, 106])
def test_freeze_keeps_the_speed_in_telegrams_with_dsc(number: int, form: DscForm) -> None:
    rig = Rig(number, dsc=DscChoices(form, following_window=4096))
    rig.enable(0x047E)
    rig.values["NSOLL_B"] = 0x1000_0000
    rig.step(100)
    speed = rig.feedback.velocity_actual
    assert speed == pytest.approx(FULL_SPEED // 4, abs=20)
    rig.values |= {"STW1": FROZEN, "NSOLL_B": 0x4000_0000}
    rig.step(100)
    assert rig.feedback.velocity_actual == pytest.approx(speed, abs=20)
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED
    rig.values["STW1"] = 0x040F
    rig.step(200)
    assert rig.feedback.velocity_actual > FULL_SPEED // 2, "with STW1.4 to .6 all 0 the speed stays in force"


@pytest.mark.parametrize("number", [1, 2, 3, 4, 20])
def test_zsw1_8_shows_that_the_speed_follows_the_demand(number: int) -> None:
    rig = accelerating(number)
    assert rig.actuals["ZSW1"] & WITHIN_TOLERANCE
    assert not stepped(rig, rig.feedback.velocity_actual + FULL_SPEED // 50)[0] & WITHIN_TOLERANCE
