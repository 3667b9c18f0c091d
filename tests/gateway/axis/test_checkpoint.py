"""A machine restored to a saved time accepts the answers that belong to this time."""

from __future__ import annotations

from dataclasses import replace

from pdgw.dsp402.states import State
from pdgw.gateway.axis.values import ProbeAnswer
from pdgw.gateway.motion.blocks import Block, BlockTask
from tests.gateway.axis.test_positioner_handshake import HOMING as HOME
from tests.gateway.axis.test_positioner_handshake import NEW_SETPOINT, positioner
from tests.gateway.axis.test_positioning import ACTIVATE, HOME_SET, HOMING
from tests.gateway.axis.test_positioning_handshake import positioning
from tests.support.axis.hand import ON, Hand
from tests.support.axis.positioner import CHOICES

OFF2 = ON & ~2
PRESSING = replace(CHOICES, blocks=(Block(1, 50_000, 3000, task=BlockTask.FIXED_STOP, value=250),))


def ask_twice(hand: Hand, word: int) -> None:
    """The machine asks for writes, is saved, asks for equal writes later, and goes back to the saved moment."""
    hand(word)
    first = hand.stepper.machine.outputs.writes
    moment = hand.stepper.checkpoints.save()
    hand.stepper.sdo_done(None)
    hand(OFF2, State.SWITCH_ON_DISABLED)
    if hand.stepper.machine.outputs.writes is not None:
        hand.stepper.sdo_done(None)
    hand.feedback.position_actual = 4096  # other actual values: a part of the outputs differs beside the request
    hand.enable()(word)
    second = hand.stepper.machine.outputs.writes
    assert first is not None
    assert second == first
    assert second is not first
    hand.stepper.checkpoints.restore(moment)


def test_a_restored_homing_takes_the_answer_to_its_writes() -> None:
    hand = positioning().enable()
    hand(ON, SATZANW=0x8000 | 17)
    ask_twice(hand, ON | HOMING)
    hand.stepper.sdo_done(None)
    hand(ON | HOMING)
    assert hand.stepper.machine.outputs.writes is None


def test_a_restored_torque_limit_takes_the_answer_to_its_writes() -> None:
    hand = positioner(PRESSING).enable()
    hand(ON, POS_STW1=1)
    ask_twice(hand, ON | ACTIVATE)
    hand.stepper.sdo_done(None)
    assert hand(ON | ACTIVATE) & NEW_SETPOINT, "the block starts with its torque"
    assert hand.stepper.machine.outputs.writes is None


def test_a_restored_passive_homing_takes_the_answer_to_its_probe() -> None:
    hand = positioner().enable()
    hand(ON, POS_STW2=0x100)
    hand(ON | HOME)
    first = hand.stepper.machine.outputs.probe
    moment = hand.stepper.checkpoints.save()
    hand(ON)
    hand.feedback.position_actual = 4096
    hand(ON | HOME)
    assert hand.stepper.machine.outputs.probe is not first
    hand.stepper.checkpoints.restore(moment)
    assert first is not None
    hand.stepper.machine.inputs.news.append(ProbeAnswer(first, {0: 0}))
    hand(ON | HOME)
    hand(ON | HOME)
    assert hand.actuals["ZSW1"] & HOME_SET
