"""Telegram 9 with a drive that answers when the test says so: edges, acknowledges, the fall of Halt, and what is shown."""

from __future__ import annotations

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.base.reasons import Reason
from pdgw.peers.drive.objects import TURNTABLE
from tests.gateway.axis.test_positioning import SMALL, axis, home, position, task
from tests.support.axis.hand import OFF, ON, OPERATING
from tests.support.axis.tasks import (
    ACKNOWLEDGED,
    ACTIVATE,
    FAST,
    HALT,
    HOME_SET,
    HOMING,
    INTERMEDIATE,
    NEW_SETPOINT,
    POSITION,
    REACHED,
    REJECT,
    TAKEN,
    WARNING,
    TaskHand,
    positioning,
)


def test_edge_of_one_cycle_keeps_bit_4_until_the_drive_accepts_the_task() -> None:
    hand = positioning().enable()
    assert hand.task(5_000) & NEW_SETPOINT
    assert all(hand(ON) & NEW_SETPOINT for _ in range(20))
    assert not hand(ON, OPERATING | TAKEN) & NEW_SETPOINT


def test_edge_during_a_handshake_waits_until_bit_4_and_acknowledge_are_0() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON)
    word = hand.task(7_000)
    assert (word & NEW_SETPOINT, hand.target) == (NEW_SETPOINT, 5_000), "the data of the edge the drive has not taken"
    assert not hand(ON | ACTIVATE, OPERATING | TAKEN) & NEW_SETPOINT, "the bit of the second edge stands"
    old = OPERATING | TAKEN | StatusBit.TARGET_REACHED
    assert not hand(ON | ACTIVATE, old) & NEW_SETPOINT, "the drive has not taken bit 4 = 0 back"
    assert not hand.actuals["ZSW1"] & REACHED, "that of the task before"
    assert hand.target == 5_000
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
    assert hand.target == 7_000


def test_task_edge_in_the_resuming_frame_waits_until_halt_has_ended() -> None:
    hand = positioning(ramp_stop_resume=True).enable()
    hand.feedback.velocity_actual = FAST
    assert hand(OFF) & HALT
    assert not hand.task(5_000) & (HALT | NEW_SETPOINT)
    assert hand(ON | ACTIVATE) & NEW_SETPOINT


def test_a_task_that_the_drive_takes_only_after_an_intermediate_stop_is_not_overdue() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    assert all(hand(ON & ~INTERMEDIATE) & HALT for _ in range(1000))
    assert [hand(ON) & (HALT | NEW_SETPOINT) for _ in range(2)] == [0, NEW_SETPOINT]
    hand(ON, OPERATING | TAKEN)
    assert not hand.stepper.events
    assert not hand.actuals["ZSW1"] & WARNING


@pytest.mark.parametrize("mod", [0b001, 0b011, 0b101])
def test_task_direction_is_ignored_without_a_modulo_axis(mod: int) -> None:
    hand = positioning().enable()
    word = hand.task(5_000, MDI_MOD=mod)
    assert word & NEW_SETPOINT
    assert not word & (TURNTABLE.shortest | TURNTABLE.ccw)


def test_shortest_distance_of_a_modulo_axis_is_sent_to_the_drive() -> None:
    hand = positioning(modulo_axis=True).enable()
    word = hand.task(5_000, MDI_MOD=0b001)
    assert word & (TURNTABLE.shortest | TURNTABLE.ccw) == TURNTABLE.shortest


def test_edge_during_the_last_acknowledge_is_a_rejectable_task() -> None:
    hand = positioning().enable()
    assert not hand.task(5_000, OPERATING | TAKEN) & NEW_SETPOINT
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert not hand.actuals["ZSW1"] & REACHED
    hand(ON & ~REJECT, OPERATING | TAKEN)
    assert not any(hand(ON) & NEW_SETPOINT for _ in range(10))


def test_target_reached_stays_while_the_bit_of_the_ended_task_is_set() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    ended = OPERATING | TAKEN | StatusBit.TARGET_REACHED
    hand(ON | ACTIVATE, ended)
    shown = []
    for _ in range(6):
        assert hand(ON | ACTIVATE, ended) & NEW_SETPOINT
        shown.append(bool(hand.actuals["ZSW1"] & REACHED))
    assert all(shown)


def test_removed_mdi_brakes_the_task_and_is_the_reason_until_standstill() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON, OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    for _ in range(3):
        assert hand(ON, SATZANW=0) & HALT
        assert hand.stepper.reason is Reason.MDI_OFF
    hand(ON, SATZANW=0x8000)
    assert hand.stepper.reason is Reason.MDI_OFF
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON) & (HALT | NEW_SETPOINT) for _ in range(10))
    assert hand.stepper.reason is None


def braking() -> TaskHand:
    """A task that was rejected and has not come to standstill."""
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON, OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    assert hand(ON & ~REJECT) & HALT
    return hand


@pytest.mark.parametrize(("word", "satzanw"), [(ON & ~REJECT, 0x8000), (ON, 0)], ids=["reject", "no MDI"])
def test_edge_while_braking_is_cancelled_by_one_frame_without_it(word: int, satzanw: int) -> None:
    hand = braking()
    hand.task(7_000)
    hand(word, SATZANW=satzanw)
    hand(ON, SATZANW=0x8000)
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON) & (HALT | NEW_SETPOINT) for _ in range(10))


def test_homing_withdrawn_before_standstill_does_not_start() -> None:
    hand = braking()
    hand(ON | HOMING, SATZANW=0x8000 | 35)
    hand(ON)
    hand.feedback.velocity_actual = 0
    for _ in range(10):
        assert not hand(ON) & (HALT | NEW_SETPOINT)
        assert hand.stepper.sdo_request is None
        assert hand.stepper.command.modes_of_operation == Mode.POSITION


def test_relative_task_pending_at_a_stop_is_sent_unchanged_later() -> None:
    hand = positioning().enable()
    hand.task(5_000, OPERATING | TAKEN, relative=True)
    hand(ON & ~INTERMEDIATE)
    hand(ON)
    assert hand(ON) & (NEW_SETPOINT | ControlBit.RELATIVE) == NEW_SETPOINT | ControlBit.RELATIVE
    assert hand.target == 5_000


def test_edge_during_an_intermediate_stop_replaces_the_kept_task_data() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON, OPERATING | TAKEN)
    stop = ON & ~INTERMEDIATE
    hand(stop)
    assert hand(stop | ACTIVATE, MDI_TARPOS=POSITION.to_wire(7_000)) & (HALT | NEW_SETPOINT) == HALT
    hand(stop)
    assert not hand(ON) & (HALT | NEW_SETPOINT)
    assert hand(ON) & NEW_SETPOINT
    assert hand.target == 7_000


def test_homing_with_velocity_0_uses_the_lowest_velocity() -> None:
    hand = positioning().enable()
    hand(ON | HOMING, SATZANW=0x8000 | 17, MDI_VELOCITY=0)
    assert hand.stepper.sdo_request == (SdoWrite(0x6098, 0, 17), SdoWrite(0x6099, 1, 1), SdoWrite(0x6099, 2, 1))


def test_mode_of_a_modulo_axis_is_read_before_operation() -> None:
    hand = positioning(modulo_axis=True)
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.command.modes_of_operation == TURNTABLE.mode


def test_homing_while_braking_uses_method_and_speed_of_its_edge() -> None:
    hand = braking()
    hand(ON | HOMING, SATZANW=0x8000 | 17, MDI_VELOCITY=1 << 29)
    hand(ON | HOMING, SATZANW=0x8000 | 18, MDI_VELOCITY=1 << 30)
    hand.feedback.velocity_actual = 0
    hand(ON | HOMING)
    assert hand.stepper.sdo_request == (SdoWrite(0x6098, 0, 17), SdoWrite(0x6099, 1, 3000), SdoWrite(0x6099, 2, 3000))


def test_homing_that_interrupts_a_task_drops_the_waiting_edge() -> None:
    hand = braking()
    hand.task(7_000)
    hand(ON | HOMING, SATZANW=0x8000 | 17)
    hand.feedback.velocity_actual = 0
    hand(ON | HOMING)
    assert hand.stepper.sdo_request is not None
    assert not any(hand(ON) & (HALT | NEW_SETPOINT) for _ in range(10))


@pytest.mark.parametrize("method", [0, 99])
def test_edge_with_an_unknown_method_does_not_restart_a_withdrawn_homing(method: int) -> None:
    hand = braking()
    hand(ON | HOMING, SATZANW=0x8000 | 17)
    hand(ON)
    hand(ON | HOMING, SATZANW=0x8000 | method)
    hand.feedback.velocity_actual = 0
    for _ in range(5):
        hand(ON | HOMING)
        assert hand.stepper.sdo_request is None
    assert hand.stepper.numbers == [108]


def test_homing_withdrawn_before_its_method_is_written_sends_nothing_more() -> None:
    hand = positioning().enable()
    hand(ON | HOMING, SATZANW=0x8000 | 17)
    hand.stepper.sdo_done(None)
    for _ in range(5):
        assert not hand(ON) & (HALT | NEW_SETPOINT)
        assert hand.stepper.sdo_request is None
        assert hand.stepper.command.modes_of_operation == Mode.POSITION


@pytest.mark.parametrize("answered", [False, True], ids=["method not taken", "method taken"])
@pytest.mark.parametrize("stays", [False, True], ids=["bit 6 in one frame", "bit 6 stays 1"])
def test_task_edge_in_the_frame_that_withdraws_a_waiting_homing_starts(answered: bool, stays: bool) -> None:
    hand = positioning().enable()
    hand(ON | HOMING, SATZANW=0x8000 | 17)
    if answered:
        hand.stepper.sdo_done(None)
        hand(ON | HOMING)
    word = hand.task(7_000)
    for _ in range(AxisSettings().latency_ns // 4_000_000 + 2 if answered else 5):
        hand.feedback.modes_of_operation_display = hand.stepper.command.modes_of_operation
        word = hand(ON | ACTIVATE if stays else ON)
    assert (word & NEW_SETPOINT, hand.target) == (NEW_SETPOINT, 7_000)


def test_task_edge_that_withdraws_a_running_homing_starts_at_standstill() -> None:
    rig = axis(SMALL)
    home(rig, 17)
    rig.step(20)
    assert rig.feedback.velocity_actual
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(4_000), "MDI_MOD": 1, "STW1": ON | ACTIVATE}
    rig.step(1)
    assert rig.stepper.command.controlword & (HALT | NEW_SETPOINT) == HALT
    rig.values["STW1"] = ON
    rig.until(lambda _: position(rig) == 4_000)


@pytest.mark.parametrize(
    ("values", "reason"), [({"SATZANW": 0}, Reason.MDI_OFF), ({"MDI_VELOCITY": 0}, Reason.TASK_SPEED_ZERO)]
)
def test_rejected_task_edge_that_withdraws_a_homing_has_its_reason(values: dict[str, int], reason: Reason) -> None:
    hand = positioning().enable()
    hand(ON | HOMING, SATZANW=0x8000 | 17)
    hand(ON | ACTIVATE, **values)
    hand(ON | ACTIVATE)
    assert hand.stepper.reason is reason


def test_finished_homing_keeps_bit_4_without_a_reason_until_stw1_11_falls() -> None:
    rig = axis(SMALL)
    home(rig, 35)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET))
    for _ in range(10):
        rig.step(1)
        assert rig.stepper.command.controlword & NEW_SETPOINT
        assert rig.stepper.reason is None
    rig.values["STW1"] = ON
    rig.step(1)
    assert not rig.stepper.command.controlword & NEW_SETPOINT


def test_task_edge_at_the_end_of_a_failed_homing_clears_its_warning() -> None:
    rig = axis(SMALL)
    rig.sdo_error = "time-out"
    home(rig, 17)
    rig.step(10)
    assert rig.actuals["ZSW1"] & WARNING
    rig.values |= {"MDI_TARPOS": POSITION.to_wire(4_000), "STW1": ON | ACTIVATE}
    rig.step(4)
    assert not rig.actuals["ZSW1"] & WARNING
    assert rig.stepper.command.target_position == 4_000


def test_intermediate_stop_ends_the_handshake_of_its_task() -> None:
    hand = positioning().enable()
    stop = ON & ~INTERMEDIATE
    hand.task(5_000)
    assert hand(stop) & (HALT | NEW_SETPOINT) == HALT | NEW_SETPOINT, "the drive has not taken it"
    assert hand(stop, OPERATING | TAKEN) & (HALT | NEW_SETPOINT) == HALT
    assert hand(stop) & (HALT | NEW_SETPOINT) == HALT


def test_task_waiting_at_an_intermediate_stop_is_resumed() -> None:
    hand = positioning().enable()
    stop = ON & ~INTERMEDIATE
    hand.task(5_000)
    hand(ON)
    hand.task(7_000)
    assert hand(stop) & (HALT | NEW_SETPOINT) == HALT, "the edge of the first is over"
    assert not hand(ON) & (HALT | NEW_SETPOINT)
    assert not hand(ON, OPERATING | TAKEN) & (HALT | NEW_SETPOINT), "the drive took the first late"
    assert hand(ON) & (HALT | NEW_SETPOINT) == NEW_SETPOINT
    assert hand.target == 7_000


def test_acknowledge_of_a_rejected_task_is_not_shown_for_the_next_edge() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand.feedback.velocity_actual = 300
    for stw1 in (ON & ~REJECT, ON, ON | ACTIVATE):
        hand(stw1, OPERATING | TAKEN)
        assert not hand.actuals["ZSW1"] & ACKNOWLEDGED, "the drive has not seen that bit 4 is 0"


@pytest.mark.parametrize("relative", [False, True])
def test_resumed_task_of_a_modulo_axis_ends_at_its_target(relative: bool) -> None:
    hand = positioning(modulo_axis=True).enable()
    hand.feedback.position_actual = 1_000
    hand.task(5_000, MDI_MOD=0 if relative else 0b011)
    hand(ON, OPERATING | TAKEN)
    hand.feedback.position_actual = 3_000
    hand(ON & ~INTERMEDIATE)
    hand(ON)
    word = hand(ON)
    assert word & (NEW_SETPOINT | ControlBit.RELATIVE) == NEW_SETPOINT | (ControlBit.RELATIVE if relative else 0)
    assert hand.target == (3_000 if relative else 5_000)


# -- Halt and the mode ------------------------------------------------------------------------------------------------


def test_off1_ramps_a_homing_down_in_its_own_mode() -> None:
    rig = axis(SMALL)
    home(rig, 17)
    rig.step(20)
    command = rig.stepper.command
    rig.values["STW1"] = OFF
    seen = []
    while not seen or seen[-1][0]:
        rig.step(1)
        seen.append((command.controlword & HALT, command.modes_of_operation))
    assert len(seen) > 2
    assert set(seen) == {(HALT, Mode.HOMING), (0, Mode.HOMING)}
    rig.step(1)
    assert (command.controlword & HALT, command.modes_of_operation) == (0, Mode.POSITION)
    assert not rig.actuals["ZSW1"] & HOME_SET


def test_halt_stays_with_the_command_that_ends_the_ramp_of_an_off1() -> None:
    rig = axis()
    task(rig, 200_000)
    rig.step(50)
    rig.values["STW1"] = OFF
    del rig.controlwords[:-1]
    rig.until(lambda _: not rig.stepper.command.controlword & HALT)
    assert [word & (HALT | 0xF) for word in rig.controlwords[1:]] == [HALT | 0xF, HALT | 0x6, 0x6]


# -- A limit of the drive ---------------------------------------------------------------------------------------------

AT_LIMIT = OPERATING | StatusBit.INTERNAL_LIMIT
HALF_A_SECOND, TEN_SECONDS = 125, 2500
"""Cycles."""


def at_limit(cycles: int) -> TaskHand:
    """A task that was given this number of cycles ago, with the drive at its limit since then."""
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON, OPERATING | TAKEN)
    for _ in range(cycles):
        assert not hand(ON, AT_LIMIT) & HALT
    return hand


def test_task_replacing_one_at_a_limit_has_the_time_of_a_way_out() -> None:
    hand = at_limit(HALF_A_SECOND - 5)
    hand.task(-5_000, AT_LIMIT)
    assert hand.target == -5_000
    assert not hand(ON, AT_LIMIT | TAKEN) & HALT
    assert not any(hand(ON, AT_LIMIT) & HALT for _ in range(TEN_SECONDS - 1))
    assert hand(ON, AT_LIMIT) & HALT


def test_task_after_one_ended_at_a_limit_has_the_time_of_a_way_out() -> None:
    hand = at_limit(HALF_A_SECOND - 5)
    hand(ON, AT_LIMIT | StatusBit.TARGET_REACHED)
    assert hand.actuals["ZSW1"] & REACHED
    hand.task(-5_000, AT_LIMIT)
    assert not any(hand(ON, AT_LIMIT | (0 if i else TAKEN)) & HALT for i in range(TEN_SECONDS))
    assert hand(ON, AT_LIMIT) & HALT


def test_task_away_from_a_limit_at_rest_that_begins_late_is_not_stopped() -> None:
    hand = positioning().enable()
    hand(ON, AT_LIMIT)
    hand.task(-5_000, AT_LIMIT)
    hand(ON, AT_LIMIT | TAKEN)
    assert not any(hand(ON, AT_LIMIT) & HALT for _ in range(2 * HALF_A_SECOND))
    assert not hand.stepper.warning
    hand.feedback.velocity_actual = -1000
    hand(ON, AT_LIMIT)
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON, AT_LIMIT) & HALT for _ in range(HALF_A_SECOND))
    assert hand(ON, AT_LIMIT) & HALT, "it was on its way, and the limit has stopped it"
    assert hand.stepper.warning


def test_slow_task_with_a_limit_bit_that_makes_way_is_not_stopped() -> None:
    hand = positioning().enable()
    hand.task(5_000)
    hand(ON, OPERATING | TAKEN)
    for cycle in range(4 * HALF_A_SECOND):
        hand.feedback.position_actual = cycle // 50
        assert not hand(ON, AT_LIMIT) & HALT


def test_a_task_with_speed_0_does_not_resume_the_task_that_a_limit_stopped() -> None:
    hand = at_limit(HALF_A_SECOND)
    assert hand(ON, AT_LIMIT) & HALT
    assert hand(ON | ACTIVATE, MDI_VELOCITY=0) & HALT
    assert all(hand(ON) & (HALT | NEW_SETPOINT) == HALT for _ in range(5))
    assert hand.stepper.reason is Reason.TASK_AT_LIMIT
    assert not hand(ON | ACTIVATE, MDI_VELOCITY=1 << 29) & HALT
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
