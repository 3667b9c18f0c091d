"""Telegram 9: AKTSATZ, XIST_A and ZSW1, the reason of an edge that started nothing, and overlapping commands."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.modes import MODE_CONFIRM_NS, Mode
from pdgw.dsp402.states import ControlBit, State
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.base.reasons import Reason
from tests.gateway.axis.test_positioning import MDI_ACTIVE, STOPPED, axis, home, position, task
from tests.support.axis.hand import OFF, ON, OPERATING
from tests.support.axis.tasks import (
    ACTIVATE,
    FAST,
    HALT,
    HOME_SET,
    HOMING,
    INTERMEDIATE,
    NEW_SETPOINT,
    OFF2,
    OFF3,
    POSITION,
    REJECT,
    TAKEN,
    positioning,
)
from tests.support.drives.drive_types import References, engel

# -- what is shown ----------------------------------------------------------------------------------------------------


def test_aktsatz_15_is_shown_in_operation_and_during_the_ramp_and_never_without_a_plc() -> None:
    hand = positioning()
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert not hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand.enable()
    hand.feedback.velocity_actual = FAST
    hand(ON)
    assert hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand(OFF)
    assert hand.actuals["AKTSATZ"] & MDI_ACTIVE
    hand(OFF3)
    assert not hand.actuals["AKTSATZ"] & MDI_ACTIVE
    lost = positioning(on_plc_loss=PlcLossReaction.RAMP).enable()
    lost.feedback.velocity_actual = FAST
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
    hand.task(5_000)
    hand.stepper.set_drive(None)
    assert not hand(ON) & NEW_SETPOINT
    assert (hand.actuals["XIST_A"], hand.actuals["AKTSATZ"]) == (0, 0)
    hand.stepper.set_drive(engel(), 35)
    assert not any(hand.enable()(ON) & NEW_SETPOINT for _ in range(10))


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
    hand.task(5_000, relative=True)
    hand(ON, OPERATING | TAKEN)
    assert hand(ON & ~INTERMEDIATE) & HALT
    words = [hand(ON) for _ in range(3)]
    assert any(word & NEW_SETPOINT and not word & ControlBit.RELATIVE for word in words)
    assert hand.target == 6_000


# -- edges while braking, repeated homing, tasks at the end of the number range -----------------------------------


@pytest.mark.parametrize("withheld", [REJECT, INTERMEDIATE])
def test_an_edge_latched_while_braking_does_not_start_while_bit_4_or_5_is_0(withheld: int) -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    rig.values["STW1"] = ON & ~REJECT
    rig.step(2)
    rig.values |= {"STW1": ON | ACTIVATE, "MDI_TARPOS": 0}
    rig.step(2)
    rig.values["STW1"] = ON & ~withheld
    del rig.controlwords[:-1]
    rig.step(300)
    assert not any(word & ControlBit.NEW_SETPOINT for word in rig.controlwords)
    assert rig.actuals["ZSW1"] & STOPPED
    stopped_at = position(rig)
    rig.values["STW1"] = ON
    rig.step(300)
    if withheld == REJECT:
        assert position(rig) == stopped_at, "a rejected task does not run"
    else:
        assert position(rig) == 0, "an intermediate stop keeps the task"


def test_homing_during_an_intermediate_stop_replaces_the_task() -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    rig.values["STW1"] = ON & ~INTERMEDIATE
    rig.step(100)
    rig.values |= {"SATZANW": 0x8000 | 35, "STW1": ON & ~INTERMEDIATE | HOMING}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0800))
    assert position(rig) == 0


def test_repeated_homing_waits_for_its_own_method() -> None:
    """The answer to the first writes must not count for the second: the axis would home in the wrong direction."""
    rig = axis()
    rig.sdo_delay = 10**9
    home(rig, 17)
    first = rig.stepper.sdo_request
    rig.values["STW1"] = ON
    rig.step(2)
    home(rig, 18)
    rig.stepper.sdo_done(None)
    rig.step(20)
    assert rig.stepper.command.modes_of_operation == Mode.POSITION
    second = rig.stepper.sdo_request
    assert first is not None
    assert first[0] == SdoWrite(0x6098, 0, 17)
    assert second is not None
    assert second[0] == SdoWrite(0x6098, 0, 18)
    rig.sdo_delay = 1
    rig.step(20)
    assert rig.stepper.command.modes_of_operation == Mode.HOMING
    assert rig.node.model.homing_method == 18


@pytest.mark.parametrize("modulo", [False, True])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_relative_task_at_the_end_of_the_number_range_resumes_within_it(modulo: bool, direction: int) -> None:
    hand = positioning(modulo_axis=modulo)
    hand.stepper.set_references(References(position_min=-(1 << 31) + 1, position_max=(1 << 31) - 1), 35)
    hand.feedback.position_actual = direction * ((1 << 31) - 10)
    hand.enable()
    assert hand(ON | ACTIVATE, MDI_TARPOS=direction * (1 << 29), MDI_MOD=0) & NEW_SETPOINT
    assert -(1 << 31) <= hand.target < 1 << 31
    hand(ON, OPERATING | TAKEN)
    hand(ON)
    assert hand(ON & ~INTERMEDIATE) & HALT
    assert any(hand(ON) & NEW_SETPOINT for _ in range(4))
    # The way that is left, or to the end of the range.
    end = (1 << 31) - 1 if direction > 0 else -(1 << 31)
    assert hand.target == (direction * (1 << 30) if modulo else end)


def test_a_negative_velocity_is_limited_to_0_and_counted() -> None:
    rig = axis()
    rig.values["MDI_VELOCITY"] = -(1 << 30)
    task(rig, 1_000)
    assert rig.stepper.command.profile_velocity == 0
    assert rig.stepper.saturations == 1


def test_row_homing_running_and_finished_aktsatz_15_keeps_its_value() -> None:
    rig = axis()
    rig.step(2)
    assert rig.actuals["AKTSATZ"] & MDI_ACTIVE
    rig.values |= {"SATZANW": 35, "STW1": ON | HOMING}
    rig.until(lambda actuals: bool(actuals["ZSW1"] & 0x0800))
    assert rig.actuals["AKTSATZ"] & MDI_ACTIVE
    rig.values["STW1"] = ON
    rig.step(3)
    assert not rig.actuals["AKTSATZ"] & MDI_ACTIVE
    assert rig.stepper.reason is Reason.MDI_OFF


def test_old_attempt_does_not_shorten_the_time_for_a_mode_change() -> None:
    confirm = MODE_CONFIRM_NS // 4_000_000
    hand = positioning().enable()
    hand.mode = Mode.VELOCITY
    hand(ON | ACTIVATE)
    assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
    for _ in range(2 * confirm):
        hand(OFF2, State.SWITCH_ON_DISABLED)
    hand.enable()
    for _ in range(confirm):
        hand(ON | ACTIVATE)
        assert not hand.stepper.events
    for _ in range(3):
        hand(ON | ACTIVATE)
        assert hand.stepper.numbers == [110], "reported once while it is present"
        assert hand.stepper.warning
        assert hand.stepper.reason is Reason.MODE_KEPT
    hand.mode = Mode.POSITION
    hand(ON | ACTIVATE)
    assert hand.stepper.reason is None


def test_restart_of_the_drive_clears_its_home_position() -> None:
    rig = axis()
    rig.values["SATZANW"] = 0x8000 | 35
    rig.values["STW1"] = ON | HOMING
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    rig.values["STW1"] = ON
    rig.step(3)
    assert rig.actuals["ZSW1"] & HOME_SET
    rig.restart_drive()
    rig.step(1)
    assert not rig.actuals["ZSW1"] & HOME_SET
