"""Telegram 111 and the torque limit of its drive, lowered for a fixed stop; telegram 112, the positioner in a unit of length."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.motion.blocks import Block, BlockTask
from pdgw.profidrive.datatypes import float_of, float_pattern
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.gateway.axis.test_positioner_handshake import shows
from tests.support.axis.hand import OFF, ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.axis.tasks import (
    ACTIVATE,
    DRIVE,
    HOMING,
    NEW_SETPOINT,
    OFF2,
    REJECT,
    TAKEN,
    WARNING,
    positioner,
)
from tests.support.documents.profile_numbers import word_positions
from tests.support.gateways.daemon import axis

PRESSING = replace(CHOICES, blocks=(Block(1, 50_000, 3000, task=BlockTask.FIXED_STOP, value=250),))
OWN, LOWERED = (SdoWrite(0x6072, 0, 3000),), (SdoWrite(0x6072, 0, 250),)


def pressing() -> Hand:
    """A fixed stop is being moved to, with the torque of its block."""
    hand = positioner(PRESSING).enable()
    hand(ON, POS_STW1=1)
    assert not hand(ON | ACTIVATE) & NEW_SETPOINT
    assert hand.stepper.sdo_request == LOWERED
    hand.stepper.sdo_done(None)
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    return hand


def test_fixed_stop_needs_its_torque_and_not_only_standstill() -> None:
    block = Block(1, 50_000, 3000, task=BlockTask.FIXED_STOP, value=250)
    hand = positioner(replace(CHOICES, blocks=(block,))).enable()
    hand(ON, POS_STW1=1)
    for _ in range(3):
        hand(ON | ACTIVATE)
        if hand.stepper.sdo_request is not None:
            hand.stepper.sdo_done(None)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    for _ in range(100):
        hand.feedback.current_actual = 237
        hand(ON | ACTIVATE)
        assert not shows(hand, "FIXED_STOP_REACHED")
    hand.feedback.current_actual = -238
    for _ in range(100):
        hand(ON | ACTIVATE)
    assert shows(hand, "FIXED_STOP_REACHED")


@pytest.mark.parametrize(
    ("blocks", "clamping_torque", "refused"),
    [
        ((), None, False),
        ((Block(1, 5000, 300),), None, False),
        ((Block(1, 5000, 300, task=BlockTask.FIXED_STOP, value=100),), None, True),
        ((), 100, True),
    ],
)
def test_a_drive_without_a_torque_limit_is_refused_for_a_fixed_stop_alone(
    blocks: tuple[Block, ...], clamping_torque: int | None, refused: bool
) -> None:
    choices = replace(CHOICES, blocks=blocks, clamping_torque=clamping_torque)
    hand = positioner(choices, replace(DRIVE, max_torque=0)).enable()
    assert any("Max Torque 6072h" in event.text for event in hand.stepper.events) is refused
    assert hand.stepper.power.released is not refused


def test_replaced_drive_gets_its_own_torque_limit_after_a_fixed_stop() -> None:
    hand = pressing()
    hand.stepper.drive_restarted()
    hand.stepper.set_drive(replace(DRIVE, max_torque=2000), 35)
    hand(OFF2)
    assert hand.stepper.sdo_request == (SdoWrite(0x6072, 0, 2000),)


def test_torque_limit_is_read_after_a_loss_without_a_warning() -> None:
    hand = pressing()
    hand.stepper.machine.inputs.drive_ok = False
    for _ in range(3):
        hand(ON | ACTIVATE)
        assert hand.stepper.sdo_request is None
    hand.stepper.machine.inputs.drive_ok = True
    hand(OFF2)
    assert hand.stepper.sdo_request == OWN


def test_torque_limit_delayed_by_a_homing_is_written_after_it() -> None:
    hand = pressing()
    hand(ON & ~REJECT)
    assert hand.stepper.sdo_request == OWN
    hand(ON)
    hand(ON | HOMING)
    homing = hand.stepper.sdo_request
    assert homing is not None
    assert homing[0] == SdoWrite(0x6098, 0, 35)
    hand.stepper.sdo_done(None)
    for _ in range(3):
        hand(ON | HOMING)
    assert hand.stepper.sdo_request == OWN


def test_rejected_torque_limit_is_reported_once_and_not_retried_each_cycle() -> None:
    hand = positioner(PRESSING).enable()
    hand(ON, POS_STW1=1)
    hand(ON | ACTIVATE)
    hand.stepper.sdo_done("refused")
    for _ in range(10):
        assert not hand(ON | ACTIVATE) & NEW_SETPOINT
        assert hand.stepper.sdo_request is None
        assert hand.stepper.reason is Reason.TORQUE_LIMIT
        assert hand.actuals["ZSW1"] & WARNING
    assert hand.stepper.numbers == [FaultNumber.POSITIONER]


def test_a_drive_without_a_torque_limit_is_given_none_when_it_restarts() -> None:
    hand = positioner(replace(CHOICES, blocks=()), replace(DRIVE, max_torque=0)).enable()
    hand.stepper.drive_restarted()
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.sdo_request is None


def test_a_restarted_drive_keeps_a_torque_limit_that_no_task_lowers() -> None:
    hand = positioner().enable()
    hand.stepper.drive_restarted()
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.sdo_request is None


def test_a_drive_that_restarted_is_given_its_own_torque_limit_once() -> None:
    hand = positioner(PRESSING).enable()
    assert hand.stepper.sdo_request is None
    hand.stepper.drive_restarted()
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.sdo_request == (SdoWrite(0x6072, 0, 3000),)
    hand.stepper.sdo_done(None)
    for _ in range(5):
        hand(OFF, State.READY_TO_SWITCH_ON)
        assert hand.stepper.sdo_request is None


def test_answer_from_before_a_restart_does_not_count_after_it() -> None:
    hand = positioner(PRESSING).enable()
    hand.stepper.drive_restarted()
    hand(OFF, State.SWITCH_ON_DISABLED)
    hand.stepper.drive_restarted()
    hand.stepper.sdo_done(None)
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.sdo_request == OWN
    hand.stepper.sdo_done(None)
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.sdo_request is None


# -- telegram 112, without arithmetic of length units in the PLC ----------------------------------------------


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
