"""Telegram 9: what AKTSATZ, XIST_A and ZSW1 show, and the reason of an edge that started nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.states import ControlBit, State
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.reasons import Reason
from tests.gateway.axis.test_positioning import (
    ACTIVATE,
    HOME_SET,
    HOMING,
    INTERMEDIATE,
    MDI_ACTIVE,
    POSITION,
    REJECT,
    axis,
)
from tests.gateway.axis.test_positioning_handshake import (
    HALT,
    NEW_SETPOINT,
    OFF2,
    OFF3,
    TAKEN,
    positioning,
)
from tests.support.axis.hand import OFF, ON, OPERATING
from tests.support.drives.drive_types import engel

# -- what is shown ----------------------------------------------------------------------------------------------------


def test_aktsatz_15_is_shown_in_operation_and_during_the_ramp_and_never_without_a_plc() -> None:
    hand = positioning()
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert not hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand.enable()
    hand.feedback.velocity_actual = 3000
    hand(ON)
    assert hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand(OFF)
    assert hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand(OFF3)
    assert not hand.actuals["AKTSATZ"] & MDI_ACTIVE
    lost = positioning(on_plc_loss=PlcLossReaction.RAMP).enable()
    lost.feedback.velocity_actual = 3000
    lost(None)
    assert not lost.actuals["AKTSATZ"] & MDI_ACTIVE


def test_xist_a_is_the_drives_position_and_aktsatz_its_homing_method() -> None:
    hand = positioning().enable()
    hand.feedback.position_actual = -12_345
    hand(ON)
    assert hand.actuals["XIST_A"] == POSITION.to_wire(-12_345)
    assert hand.actuals["AKTSATZ"] & 0xFF == 35


def test_without_references_neither_position_nor_task_nor_method_is_shown() -> None:
    hand = positioning().enable()
    hand.feedback.position_actual = -12_345
    hand(ON | ACTIVATE, MDI_TARPOS=POSITION.to_wire(5_000))
    hand.stepper.set_drive(None)
    assert not hand(ON) & NEW_SETPOINT
    assert (hand.actuals["XIST_A"], hand.actuals["AKTSATZ"]) == (0, 0)
    hand.stepper.set_drive(engel(), 35)
    assert not any(hand.enable()(ON) & NEW_SETPOINT for _ in range(10))


def test_loss_of_the_drive_for_a_cycle_clears_the_home_position() -> None:
    rig = axis()
    rig.values |= {"SATZANW": 0x8000 | 35, "STW1": ON | HOMING}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    rig.values["STW1"] = ON
    rig.step(3)
    assert rig.actuals["ZSW1"] & HOME_SET
    rig.connected_drive = False
    rig.step(1)
    rig.connected_drive = True
    rig.step(1)
    assert not rig.actuals["ZSW1"] & HOME_SET


@pytest.mark.parametrize("end", ["task", "reject"])
@pytest.mark.parametrize(
    ("word", "values", "present", "reason"),
    [
        (ON, {"SATZANW": 0}, Reason.MDI_OFF, Reason.LOST_EDGE),
        (ON & ~REJECT, {}, Reason.REJECTED, Reason.LOST_EDGE),
        (ON & ~INTERMEDIATE, {}, Reason.INTERMEDIATE_STOP, Reason.LOST_EDGE),
        (ON, {"MDI_VELOCITY": 0}, Reason.TASK_SPEED_ZERO, Reason.TASK_SPEED_ZERO),
        (ON, {"MDI_ACC": 0}, Reason.TASK_RAMP_ZERO, Reason.TASK_RAMP_ZERO),
        (ON, {"MDI_DEC": 0}, Reason.TASK_RAMP_ZERO, Reason.TASK_RAMP_ZERO),
    ],
    ids=lambda item: item.name if isinstance(item, Reason) else "",
)
def test_reason_of_a_rejected_edge_stays_until_the_next_task_or_reject(
    word: int, values: dict[str, int], present: Reason, reason: Reason, end: str
) -> None:
    hand = positioning().enable()
    hand(word | ACTIVATE, **values)
    assert hand.stepper.reason is present
    for _ in range(5):
        hand(ON, SATZANW=0x8000, MDI_VELOCITY=1 << 29, MDI_ACC=0x4000, MDI_DEC=0x4000)
        assert hand.stepper.reason is reason
    hand(ON, SATZANW=0)
    missing = Reason.MDI_OFF if reason is Reason.LOST_EDGE else reason
    assert hand.stepper.reason is missing, "a bit that is 0 now, or a value that the edge lacked"
    hand(ON, SATZANW=0x8000)
    if end == "task":
        assert hand(ON | ACTIVATE) & NEW_SETPOINT
    else:
        hand(ON & ~REJECT)
        hand(ON)
    own = end == "reject" and reason is Reason.LOST_EDGE
    assert hand.stepper.reason is (reason if own else None)


def test_reason_of_a_rejected_edge_ends_with_operation() -> None:
    hand = positioning().enable()
    hand(ON | ACTIVATE, MDI_VELOCITY=0)
    assert hand.stepper.reason is Reason.TASK_SPEED_ZERO
    hand(OFF2)
    hand(OFF2, State.SWITCH_ON_DISABLED)
    hand.enable()
    assert hand.stepper.reason is None


def test_relative_task_beyond_the_object_resumes_to_its_limit() -> None:
    drive = engel()
    narrow = replace(drive.entries["target_position"], low=-6_000, high=6_000)
    hand = positioning()
    hand.stepper.set_drive(replace(drive, entries={**drive.entries, "target_position": narrow}), 35)
    hand.enable()
    hand.feedback.position_actual = 4_000
    hand(ON | ACTIVATE, MDI_TARPOS=POSITION.to_wire(5_000), MDI_MOD=0)
    hand(ON, OPERATING | TAKEN)
    assert hand(ON & ~INTERMEDIATE) & HALT
    words = [hand(ON) for _ in range(3)]
    assert any(word & NEW_SETPOINT and not word & ControlBit.RELATIVE for word in words)
    assert hand.target == 6_000
