"""Telegram 111 and the torque limit of its drive: lowered for a fixed stop, and the drive's own again."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.motion.blocks import Block, BlockTask
from pdgw.gateway.reasons import FaultNumber, Reason
from tests.gateway.axis.test_positioner_handshake import (
    ACTIVATE,
    DRIVE,
    HOMING,
    NEW_SETPOINT,
    OFF2,
    REJECT,
    TAKEN,
    WARNING,
    positioner,
    shows,
)
from tests.support.axis.hand import OFF, ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES

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
    assert [event.number for event in hand.stepper.events] == [FaultNumber.POSITIONER]


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
