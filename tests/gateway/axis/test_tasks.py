"""Tasks and homing as telegrams 9 and 111 have them both, with a drive that answers when the test says so."""

from __future__ import annotations

from itertools import pairwise

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGE_NS
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
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
    OF_THE_MODE,
    OFF2,
    OFF3,
    REJECT,
    TAKEN,
    WARNING,
    ZSW1,
    Make,
    TaskHand,
    positioner,
)

ZSW1_REACHED = ZSW1.bit("TARGET_REACHED", positioning=True).mask
REACHED = StatusBit.TARGET_REACHED
LATE = ACKNOWLEDGE_NS // 4_000_000
"""Cycles until a setpoint without an acknowledge is reported."""
DUE = 115
"""Cycles of 4 ms until the end of a homing can be no older than its start."""


# -- setpoints ----------------------------------------------------------------------------------------------------------


def test_an_edge_before_the_drive_shows_operation_starts_nothing(make: Make) -> None:
    hand = make()
    hand(OFF, State.SWITCH_ON_DISABLED)
    hand(ON, State.READY_TO_SWITCH_ON)
    hand(ON, State.SWITCHED_ON)
    assert not hand.task(4096, State.SWITCHED_ON) & OF_THE_MODE
    assert not any(hand(ON | ACTIVATE) & NEW_SETPOINT for _ in range(10))


@pytest.mark.parametrize("end", [OFF, OFF2, OFF3, None], ids=["OFF1", "OFF2", "OFF3", "PLC lost"])
@pytest.mark.parametrize("waits", [False, True], ids=["given", "waiting"])
def test_edge_pending_at_the_end_of_operation_starts_nothing_later(
    hand: TaskHand, end: int | None, waits: bool
) -> None:
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
    hand(ON)
    if waits:
        hand.task(8192)
        hand(ON)
    assert not hand(end) & NEW_SETPOINT
    hand(end, State.SWITCH_ON_DISABLED)
    hand.enable()
    assert not any(hand(ON) & OF_THE_MODE & ~HALT for _ in range(hand.latency)), "the drive may still take it"
    assert not hand(ON) & OF_THE_MODE
    assert hand.stepper.reason is None


@pytest.mark.parametrize("waits", [False, True], ids=["given", "waiting"])
def test_on_during_the_ramp_of_an_off1_resumes_operation_and_no_task(make: Make, waits: bool) -> None:
    hand = make(ramp_stop_resume=True).enable()
    hand(ON | ACTIVATE)
    hand(ON, OPERATING if waits else OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    if waits:
        hand.task(8192)
    assert hand(OFF) & HALT
    assert all(hand(ON) & (NEW_SETPOINT | HALT) == HALT for _ in range(10)), (
        "a drive may continue the task without Halt"
    )
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON) & NEW_SETPOINT for _ in range(hand.latency))
    assert not hand(ON) & (NEW_SETPOINT | HALT)
    assert hand.stepper.power.released


@pytest.mark.parametrize("word", [ON & ~REJECT, ON & ~INTERMEDIATE], ids=["reject", "intermediate stop"])
def test_pending_task_is_stopped_with_bit_4_at_0(hand: TaskHand, word: int) -> None:
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = FAST
    assert hand(word) & HALT
    assert hand(ON & ~REJECT) & (HALT | NEW_SETPOINT) == HALT
    assert hand(ON) & (HALT | NEW_SETPOINT) == HALT, "until standstill"
    hand.feedback.velocity_actual = 0
    late = [hand(ON) & (HALT | NEW_SETPOINT) for _ in range(hand.latency)]
    assert late[:50] == [HALT] * 50, "the drive has not acknowledged the setpoint and may still start"
    assert not any(hand(ON) & (HALT | NEW_SETPOINT) for _ in range(10))


def test_bit_12_of_another_mode_is_not_an_acknowledge(hand: TaskHand) -> None:
    hand(ON | ACTIVATE)
    hand.mode = Mode.HOMING
    assert hand(ON, OPERATING | TAKEN) & NEW_SETPOINT
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand.mode = Mode.POSITION
    assert hand(ON) & NEW_SETPOINT
    assert not hand(ON, OPERATING | TAKEN) & NEW_SETPOINT


def edges(words: list[int]) -> int:
    return sum(word & ~before & NEW_SETPOINT != 0 for before, word in pairwise([0, *words]))


def unanswered(hand: TaskHand, word: int = ON) -> list[int]:
    """The Controlwords of a drive that drops the setpoint, up to the first cycle in which that is reported."""
    words = [hand(word) for _ in range(LATE - 1)]
    assert hand.stepper.reason is None
    assert not hand.actuals["ZSW1"] & WARNING
    return [*words, hand(word)]


def test_a_task_that_the_drive_drops_is_reported_and_the_next_one_replaces_it(hand: TaskHand) -> None:
    words = [hand.task(4096, relative=True), *unanswered(hand)]
    assert hand.stepper.reason is Reason.NOT_ACKNOWLEDGED
    assert hand.stepper.numbers == [FaultNumber.NOT_ACKNOWLEDGED]
    words += [hand(ON) for _ in range(1000)]
    assert edges(words) == 1, "one edge for one relative task, however long it takes"
    assert len(hand.stepper.events) == 1, "reported once"
    assert hand.actuals["ZSW1"] & WARNING
    assert edges([hand.task(2048) for _ in range(3)]) == 1
    assert hand.target == 2048
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert hand.actuals["ZSW1"] & (WARNING | ACKNOWLEDGED) == ACKNOWLEDGED
    assert not any(hand(ON, OPERATING | REACHED) & NEW_SETPOINT for _ in range(1000))
    assert hand.stepper.reason is None


def test_a_late_acknowledge_ends_the_warning(hand: TaskHand) -> None:
    hand(ON | ACTIVATE)
    unanswered(hand, ON | ACTIVATE)
    assert hand.actuals["ZSW1"] & WARNING
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert hand.stepper.reason is None
    assert hand.actuals["ZSW1"] & (WARNING | ACKNOWLEDGED) == ACKNOWLEDGED


@pytest.mark.parametrize("word", [ON & ~INTERMEDIATE, ON & ~REJECT], ids=["intermediate stop", "reject"])
def test_an_acknowledge_never_counts_for_the_task_after_the_one_it_answers(hand: TaskHand, word: int) -> None:
    hand.task(3072)
    hand(ON, OPERATING | TAKEN)
    hand(ON)
    hand(ON | ACTIVATE)
    hand(word)
    hand(ON)
    assert not hand.task(8192) & NEW_SETPOINT, "the drive may still take the first"
    assert not hand(ON | ACTIVATE, OPERATING | TAKEN) & NEW_SETPOINT
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED
    words = [hand(ON | ACTIVATE, OPERATING | REACHED) & NEW_SETPOINT for _ in range(3)]
    assert words[-1], "the axis has stopped"
    assert hand.target == 8192


def test_an_acknowledge_never_counts_for_a_task_after_off_and_on(hand: TaskHand) -> None:
    hand(ON | ACTIVATE)
    hand(OFF, State.READY_TO_SWITCH_ON)
    hand(ON, State.SWITCHED_ON)
    hand(ON)
    for status in (OPERATING, OPERATING | TAKEN):
        assert not hand.task(8192, status) & NEW_SETPOINT
        assert not hand.actuals["ZSW1"] & ACKNOWLEDGED


def test_reached_of_the_task_before_does_not_end_a_relative_task(hand: TaskHand) -> None:
    for status in (OPERATING, OPERATING | TAKEN, *(OPERATING | REACHED,) * 2 * hand.latency):
        hand.task(4096, status, relative=True)
    assert hand.actuals["ZSW1"] & ZSW1_REACHED
    hand(ON, OPERATING | REACHED)
    hand(ON | ACTIVATE, OPERATING | REACHED)
    for status in (OPERATING | TAKEN | REACHED, *(OPERATING | REACHED,) * 20):
        hand(ON | ACTIVATE, status)
        assert not hand.actuals["ZSW1"] & ZSW1_REACHED, "the drive has not begun"
    for _ in range(hand.latency):
        hand(ON | ACTIVATE, OPERATING | REACHED)
    assert hand.actuals["ZSW1"] & ZSW1_REACHED, "such a short way may leave SW.10"


@pytest.mark.parametrize("speed", [FAST, 1])
def test_a_late_target_reached_does_not_end_a_relative_task_that_has_not_begun(hand: TaskHand, speed: int) -> None:
    """The drive shows 0 and then 1 of the time before the task: its switching on, or the end of the task before."""
    for status in (OPERATING, OPERATING | TAKEN, OPERATING):
        hand.task(4096, status, relative=True)
    for _ in range(hand.latency - 10):
        hand(ON | ACTIVATE, OPERATING | REACHED)
        assert not hand.actuals["ZSW1"] & ZSW1_REACHED
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = speed
    hand.feedback.position_actual += 4096
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = 0
    for _ in range(2):
        hand(ON | ACTIVATE, OPERATING | REACHED)
    assert hand.actuals["ZSW1"] & ZSW1_REACHED


def test_target_reached_that_comes_and_goes_as_before_the_task_does_not_end_a_relative_task(hand: TaskHand) -> None:
    """The shaft dithers, and the bit is late: it still changes as at rest while the axis turns slowly."""
    hand.task(4096, OPERATING | REACHED, relative=True)
    hand.task(4096, OPERATING | TAKEN | REACHED, relative=True)
    for cycle in range(20):
        hand.feedback.velocity_actual = FAST if cycle % 2 else 1
        assert not hand.task(4096, OPERATING | (REACHED if cycle % 3 else 0), relative=True) & HALT
        assert not hand.actuals["ZSW1"] & ZSW1_REACHED
    hand.feedback.velocity_actual = FAST
    assert hand(ON & ~REJECT) & HALT, "it still runs"


def test_a_limit_bit_at_standstill_does_not_stop_a_relative_task_that_ended_before_its_acknowledge(
    hand: TaskHand,
) -> None:
    """The way is short and the acknowledge late: "target reached" is never 0 after it, so it counts after the latency."""
    rests = OPERATING | REACHED | StatusBit.INTERNAL_LIMIT
    hand.task(100, OPERATING, relative=True)
    hand.feedback.velocity_actual = FAST
    hand.task(100, OPERATING, relative=True)
    hand.feedback.velocity_actual = 0
    hand.feedback.position_actual += 100
    for status in (*(rests,) * 25, *(rests | TAKEN,) * 20):
        hand.task(100, status, relative=True)
    for _ in range(hand.latency + 1):
        assert not hand(ON, rests) & HALT
    assert hand.actuals["ZSW1"] & ZSW1_REACHED
    assert not hand.stepper.numbers


def test_a_task_that_waits_for_a_dropped_setpoint_is_given_after_the_time(hand: TaskHand) -> None:
    hand.task(4096, relative=True)
    hand(ON)
    assert edges([hand.task(2048)]) == 1, "still that of the first"
    words = [hand(ON | ACTIVATE) for _ in range(LATE + 10)]
    assert edges(words) == 2
    assert hand.target == 2048


def test_a_setpoint_comes_after_one_that_the_drive_has_not_taken_in_time(hand: TaskHand) -> None:
    hand.task(4096)
    hand(ON & ~INTERMEDIATE)
    words = [hand.task(8192) & NEW_SETPOINT for _ in range(hand.latency - 1)]
    assert words == [0] * (hand.latency - 2) + [NEW_SETPOINT]
    assert hand.target == 8192


# -- homing -------------------------------------------------------------------------------------------------------------


def homed(make: Make) -> TaskHand:
    """With method 35, which is immediate."""
    hand = make().enable()
    hand.begin_homing()
    for _ in range(3):
        hand(ON | HOMING)
    for _ in range(DUE):
        hand(ON | HOMING, OPERATING | TAKEN | REACHED)
    hand.mode = Mode.POSITION
    hand(ON)
    assert hand.actuals["ZSW1"] & HOME_SET
    return hand


def test_loss_of_the_drive_for_a_cycle_clears_the_home_position(make: Make) -> None:
    hand = homed(make)
    hand.online = False
    hand(ON)
    hand.online = True
    hand(ON)
    assert not hand.actuals["ZSW1"] & HOME_SET


def test_homing_starts_when_the_drive_has_its_method_and_shows_mode_6(hand: TaskHand) -> None:
    for _ in range(5):
        assert not hand(ON | HOMING) & OF_THE_MODE
        assert hand.stepper.command.modes_of_operation == Mode.POSITION
        assert hand.stepper.reason is Reason.HOMING_SETUP
    hand.stepper.sdo_done(None)
    for _ in range(5):
        assert not hand(ON | HOMING) & OF_THE_MODE
        assert hand.stepper.command.modes_of_operation == Mode.HOMING
    hand.mode = Mode.HOMING
    assert all(hand(ON | HOMING) & OF_THE_MODE == NEW_SETPOINT for _ in range(10))


def test_homing_that_is_withdrawn_halts_in_mode_6_and_halt_ends_alone(hand: TaskHand) -> None:
    hand.begin_homing()
    hand(ON | HOMING)
    hand.feedback.velocity_actual = FAST
    command = hand.stepper.command
    for _ in range(5):
        assert hand(ON) & OF_THE_MODE == HALT
        assert command.modes_of_operation == Mode.HOMING
    hand.feedback.velocity_actual = 0
    assert not hand(ON) & OF_THE_MODE
    assert command.modes_of_operation == Mode.HOMING
    assert not hand(ON) & OF_THE_MODE
    assert command.modes_of_operation == Mode.POSITION
    assert not hand.actuals["ZSW1"] & HOME_SET


@pytest.mark.parametrize("end", [OFF, OFF2, OFF3], ids=["OFF1", "OFF2", "OFF3"])
def test_halt_of_a_homing_ends_before_the_mode_changes_also_after_operation(hand: TaskHand, end: int) -> None:
    hand.begin_homing()
    hand(ON | HOMING)
    hand.feedback.velocity_actual = FAST
    assert hand(end if end == OFF else ON) & HALT
    hand(end, State.READY_TO_SWITCH_ON)
    command = hand.stepper.command
    assert (command.controlword & HALT, command.modes_of_operation) == (0, Mode.HOMING)
    hand(end, State.READY_TO_SWITCH_ON)
    assert (command.controlword & HALT, command.modes_of_operation) == (0, Mode.POSITION)


def test_second_homing_waits_for_the_drive_like_the_first(make: Make) -> None:
    hand = homed(make)
    hand.begin_homing()
    for _ in range(DUE):
        assert hand(ON | HOMING) & NEW_SETPOINT
        assert not hand.actuals["ZSW1"] & HOME_SET
    shown = []
    for _ in range(4):
        hand(ON | HOMING, OPERATING | TAKEN | REACHED)
        shown.append(bool(hand.actuals["ZSW1"] & HOME_SET))
    assert shown[-1]
    if make is positioner:
        assert shown == [False, False, False, True], "the position is of the same moment two cycles later"


def test_old_homing_status_does_not_end_the_next_homing(make: Make) -> None:
    """Of a drive that shows its zero while it is given the next start: until its Statusword is surely newer."""
    hand = homed(make)
    left = OPERATING | TAKEN | REACHED
    hand.begin_homing()
    late = hand.stepper.settings.reaction_ns // hand.stepper.settings.cycle_ns
    for _ in range(late):
        assert hand(ON | HOMING, left) & NEW_SETPOINT
        assert not hand.actuals["ZSW1"] & HOME_SET
    for _ in range(24):
        hand(ON | HOMING, left)
    assert hand.actuals["ZSW1"] & HOME_SET, "method 35 is immediate"


def test_late_sdo_answer_of_an_ended_homing_does_not_start_the_next(hand: TaskHand) -> None:
    hand(ON | HOMING)
    hand(OFF2)
    hand(OFF2, State.SWITCH_ON_DISABLED)
    hand.enable()
    hand(ON | HOMING)
    hand.stepper.sdo_done(None)
    for _ in range(2):
        hand(ON | HOMING)
        assert hand.stepper.command.modes_of_operation == Mode.POSITION
    assert hand.stepper.sdo_request is not None, "asked anew"
    hand.stepper.sdo_done(None)
    hand(ON | HOMING)
    hand(ON | HOMING)
    assert hand.stepper.command.modes_of_operation == Mode.HOMING


def test_homing_parameters_that_are_refused_end_the_homing_with_a_warning(hand: TaskHand) -> None:
    hand(ON | HOMING)
    hand.stepper.sdo_done("refused")
    for _ in range(10):
        assert not hand(ON | HOMING) & NEW_SETPOINT
        assert hand.stepper.command.modes_of_operation == Mode.POSITION
    assert hand.stepper.numbers == [FaultNumber.HOMING_PARAMETERS]
    assert hand.stepper.reason is Reason.HOMING_REFUSED
    assert hand.actuals["ZSW1"] & WARNING


def test_homing_error_ends_the_homing_and_returns_to_mode_1(hand: TaskHand) -> None:
    hand.begin_homing()
    for _ in range(3):
        hand(ON | HOMING)
    words = [hand(ON | HOMING, OPERATING | StatusBit.MODE_13) for _ in range(DUE + 25)]
    assert not words[-1] & OF_THE_MODE
    assert hand.stepper.numbers == [FaultNumber.HOMING]
    assert hand.actuals["ZSW1"] & (HOME_SET | WARNING) == WARNING
    hand(ON)
    assert hand.stepper.command.modes_of_operation == Mode.POSITION


# -- a limit of the drive ---------------------------------------------------------------------------------------------


def test_a_task_at_a_limit_of_the_drive_is_halted_after_half_a_second_and_not_before(hand: TaskHand) -> None:
    hand(ON | ACTIVATE)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    words = [hand(ON | ACTIVATE, OPERATING | StatusBit.INTERNAL_LIMIT) & HALT for _ in range(130)]
    assert not any(words[:124])
    assert words[-1]
    assert all(hand(ON | ACTIVATE) & HALT for _ in range(10)), "a switch that is released starts nothing"
