"""Telegram 112: the positioner in a unit of length, without any arithmetic of length units in the PLC."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.reasons import Reason
from pdgw.profidrive.signals import float_of, float_pattern, signal
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.documents.word_positions import word_positions
from tests.support.gateways.daemon import axis

TASK, START = 0x047F, 0x043F
POS_STW1, POS_STW2 = signal("POS_STW1"), signal("POS_STW2")
ABSOLUTE = POS_STW1.word("MDI", "ABSOLUTE")
REACHED = signal("ZSW1").bit("TARGET_REACHED").mask
NAN, INFINITY = float("nan"), float("inf")
MILLIMETRES = CHOICES
"""10000 LU a revolution: 10 mm."""


def rig(word: int = ABSOLUTE, *, seconds: bool = False, **values: float) -> Rig:
    made = Rig(112, positioner=replace(MILLIMETRES, units_per_second=seconds))
    made.values |= {"POS_STW1": word, "OVERRIDE": 0x4000}
    give(made, **({"MDI_ACC_F": 100.0, "MDI_DEC_F": 100.0} | values))
    made.enable()
    return made


def give(made: Rig, **values: float) -> None:
    made.values |= {name: float_pattern(value) for name, value in values.items()}


def start(made: Rig, word: int = TASK) -> None:
    made.values["STW1"] = START
    made.step(4)
    made.values["STW1"] = word
    made.step(4)


def shown(made: Rig, name: str) -> float:
    return float_of(made.actuals[name])


def test_the_layout_is_the_published_one() -> None:
    found = telegram(112)
    assert (found.setpoints.words, found.actuals.words) == (17, 12)
    assert word_positions(found.setpoints) == (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16)
    assert word_positions(found.actuals) == (1, 2, 3, 4, 5, 6, 8, 10, 11, 12)


def test_an_mdi_task_goes_to_a_position_in_millimetres() -> None:
    made = rig(MDI_TARPOS_F=12.5, MDI_VELOCITY_F=6000.0)
    start(made)
    assert made.stepper.command.target_position == round(12.5 / 10 * 4096)
    assert made.stepper.command.profile_velocity == 1200, "6000 mm/min are 600 rpm"
    made.step(20)
    assert shown(made, "VIST_F") == pytest.approx(made.feedback.velocity_actual / 2 * 10, rel=1e-3)
    made.until(lambda actuals: bool(actuals["ZSW1"] & REACHED))
    assert shown(made, "XIST_F") == pytest.approx(12.5, abs=0.003)


def test_velocities_can_be_per_second() -> None:
    made = rig(seconds=True, MDI_TARPOS_F=-50.0, MDI_VELOCITY_F=100.0)
    start(made)
    assert made.stepper.command.profile_velocity == 1200, "100 mm/s are 600 rpm"
    made.step(60)
    assert shown(made, "VIST_F") == pytest.approx(made.feedback.velocity_actual / 2 * 10 / 60, rel=1e-3)


@pytest.mark.parametrize("name", ["MDI_TARPOS_F", "MDI_VELOCITY_F", "MDI_ACC_F", "MDI_DEC_F"])
@pytest.mark.parametrize("value", [NAN, INFINITY, -INFINITY])
def test_nan_and_infinity_move_nothing(name: str, value: float) -> None:
    made = rig(**({"MDI_TARPOS_F": 5.0, "MDI_VELOCITY_F": 600.0} | {name: value}))
    start(made)
    made.step(50)
    assert made.feedback.velocity_actual == 0
    assert made.stepper.reason is Reason.TASK_SPEED_ZERO


def test_a_position_out_of_range_moves_nothing() -> None:
    made = rig(MDI_TARPOS_F=3.0e38, MDI_VELOCITY_F=600.0)
    start(made)
    assert made.stepper.reason is Reason.TASK_TARGET_RANGE


def test_the_reference_point_is_where_the_plc_says() -> None:
    made = rig(REF_COORDINATE=-7.25)
    made.values["POS_STW2"] = POS_STW2.word("SET_REFERENCE_POINT")
    made.step(5)
    assert shown(made, "XIST_F") == -7.25


def test_the_configuration_needs_the_unit() -> None:
    positioner = (
        "lu_per_revolution = 10000\nmax_velocity = 1\nmax_acceleration = 1\nmax_deceleration = 1\nposition_window = 1\n"
    )
    text = '[can]\ninterface = "virtual"\nchannel = "x"\n' + axis(
        1, telegram_number=112, more=f"[axis.positioner]\n{positioner}"
    )
    with pytest.raises(GatewayError, match="needs lu_per_unit and velocity_per"):
        parse_config(text)
    with pytest.raises(GatewayError, match="velocity_per"):
        parse_config(text + "lu_per_unit = 1000\n")
    assert parse_config(text + 'lu_per_unit = 1000\nvelocity_per = "second"\n').axis[0].telegram == 112
