"""Telegrams 9 and 111: when a task or a homing has ended, what an axis at standstill reports before that, and modes."""

from __future__ import annotations

from dataclasses import replace
from random import Random

import pytest

from pdgw.base.durations import SECOND
from pdgw.dsp402.modes import MODE_CONFIRM_NS, Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockNext
from tests.gateway.axis.test_halt_continues import Continuing
from tests.support.axis.hand import OFF, ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.tasks import (
    ACKNOWLEDGED,
    ACTIVATE,
    FAST,
    HALT,
    HOME_SET,
    HOMING,
    INTERMEDIATE,
    JOG,
    NEW_SETPOINT,
    REACHED,
    REJECT,
    TAKEN,
    WARNING,
    Make,
    TaskHand,
    positioner,
    positioning,
)

# -- the end of a task or a homing --------------------------------------------------------------------------------


SW_REACHED, FOLLOWING = StatusBit.TARGET_REACHED, StatusBit.MODE_13
STALLED = AxisSettings().stall_ns // 4_000_000 + 3
DESELECTED = {"SATZANW": 17}


def running(make: Make, **settings: object) -> TaskHand:
    """A task to the target that the drive has taken and works on, at the start of its way."""
    hand = make(**settings).enable()
    hand(ON | ACTIVATE)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    hand(ON | ACTIVATE)
    hand(ON | ACTIVATE)
    return hand


@pytest.mark.parametrize(
    ("word", "values"),
    [(ON & ~INTERMEDIATE, {}), (ON & ~REJECT, {}), (ON | ACTIVATE, DESELECTED)],
    ids=["5", "4", "MDI"],
)
def test_stop_orders_act_after_an_early_target_reached(word: int, values: dict[str, int]) -> None:
    """One TPDO says "reached" in the middle of the motion."""
    hand = running(positioning)
    hand(ON | ACTIVATE, OPERATING | SW_REACHED)
    hand(ON | ACTIVATE)
    assert not hand.actuals["ZSW1"] & REACHED
    assert hand(word, **values) & HALT


def test_reached_of_the_last_task_is_not_shown_for_the_new_one(make: Make) -> None:
    hand = make().enable()
    for status in (OPERATING | SW_REACHED, *(OPERATING | TAKEN | SW_REACHED,) * 300):
        hand(ON | ACTIVATE, status)
        assert not hand.actuals["ZSW1"] & REACHED


@pytest.mark.parametrize("stop", [State.SWITCH_ON_DISABLED, State.FAULT, None], ids=["OFF2", "fault", "OFF1"])
def test_drive_that_keeps_its_task_while_off_is_stopped(make: Make, stop: State | None) -> None:
    drive = Continuing(make().enable())
    for _ in range(5):
        drive(ON | ACTIVATE)
    for _ in range(5):
        drive(OFF) if stop is None else drive.hand(OFF, stop)
    drive.hand.feedback.velocity_actual = 0
    drive.hand.enable()
    drive.moved, drive.word = 0, 0
    words = [drive(ON) for _ in range(500)]
    assert drive.moved <= 3
    assert words[-1] & HALT
    assert not any(word & NEW_SETPOINT for word in words)
    assert drive.hand.stepper.reason is Reason.MOVES_UNASKED


@pytest.mark.parametrize(
    ("bits", "reason"),
    [(0, Reason.NOT_REACHED), (FOLLOWING, Reason.FOLLOWING_ERROR), (SW_REACHED, Reason.STANDS_AWAY)],
)
def test_axis_stopped_before_its_target_names_the_missing_bit(make: Make, bits: int, reason: Reason) -> None:
    hand = running(make)
    hand.feedback.velocity_actual, hand.feedback.position_actual = 0, 1000
    for _ in range(STALLED - 5):
        hand(ON | ACTIVATE, OPERATING | bits)
        assert hand.stepper.reason is None
    for _ in range(10):
        hand(ON | ACTIVATE, OPERATING | bits)
    assert hand.stepper.reason is reason
    assert hand.actuals["ZSW1"] & (WARNING | REACHED) == WARNING
    assert hand.stepper.numbers == [FaultNumber.STALLED]
    hand.feedback.velocity_actual = FAST
    hand(ON | ACTIVATE)
    assert hand.stepper.reason is None
    assert not hand.actuals["ZSW1"] & WARNING


def test_slow_task_inside_the_standstill_window_has_no_reason(make: Make) -> None:
    hand = running(make)
    hand.feedback.velocity_actual = 1
    for position in range(2 * STALLED):
        hand.feedback.position_actual = position // 10
        hand(ON | ACTIVATE)
        assert hand.stepper.reason is None


def test_acknowledge_that_stays_1_has_a_reason(make: Make) -> None:
    hand = make().enable()
    words = [hand(ON | ACTIVATE, OPERATING | TAKEN) for _ in range(STALLED)]
    assert not any(word & NEW_SETPOINT for word in words)
    assert hand.stepper.reason is Reason.SETPOINT_BLOCKED


def test_a_setpoint_that_waits_for_the_late_acknowledge_of_a_cancelled_one_is_not_blocked(make: Make) -> None:
    hand = make(reaction_ns=3 * AxisSettings().stall_ns).enable()
    hand(ON | ACTIVATE)
    hand(ON & ~REJECT)
    hand(ON)
    for _ in range(2 * STALLED):
        assert not hand(ON | ACTIVATE) & NEW_SETPOINT, "the drive may still acknowledge the first one"
        assert hand.stepper.reason is not Reason.SETPOINT_BLOCKED
    assert not hand.stepper.events


def homing(make: Make) -> TaskHand:
    """A homing that the drive has started long ago; it turns."""
    hand = make().enable()
    hand.begin_homing()
    hand.feedback.velocity_actual = FAST
    assert hand(ON | HOMING) & NEW_SETPOINT
    return hand


def test_stuck_bits_of_a_homing_do_not_set_the_home_position(make: Make) -> None:
    hand = homing(make)
    ended = OPERATING | TAKEN | SW_REACHED
    for turns in (True, False, True):  # it reverses at the switch
        hand.feedback.velocity_actual = FAST * turns
        for _ in range(150):
            hand(ON | HOMING, ended)
            assert not hand.actuals["ZSW1"] & HOME_SET
    hand.feedback.velocity_actual = 0
    for _ in range(STALLED):
        hand(ON | HOMING, ended)
    assert not hand.actuals["ZSW1"] & HOME_SET
    assert hand.stepper.events[0].number == FaultNumber.HOMING


@pytest.mark.parametrize(("bits", "missing"), [(TAKEN, "Statusword.10"), (SW_REACHED, "Statusword.12")])
def test_homing_that_ends_with_one_bit_fails_and_names_the_other(make: Make, bits: int, missing: str) -> None:
    hand = homing(make)
    for _ in range(150):
        hand(ON | HOMING)
    hand.feedback.velocity_actual = 0
    for _ in range(STALLED):
        hand(ON | HOMING, OPERATING | bits)
    assert missing in hand.stepper.events[0].text
    assert not hand.actuals["ZSW1"] & HOME_SET


def test_homing_at_standstill_without_an_end_has_a_reason(make: Make) -> None:
    hand = homing(make)
    hand.feedback.velocity_actual = 0
    for _ in range(150 + STALLED):
        hand(ON | HOMING)
    assert hand.stepper.reason is Reason.HOMING_STALLED


def test_edge_of_a_task_while_the_axis_brakes_is_not_shown_as_reached(make: Make) -> None:
    hand = running(make)
    hand(ON & ~REJECT)
    hand(ON)
    hand.feedback.velocity_actual = 0
    for _ in range(3):
        word = hand(ON | ACTIVATE)
        assert not hand.actuals["ZSW1"] & REACHED
    assert word & NEW_SETPOINT


def test_acknowledge_of_the_last_task_is_not_shown_for_the_next() -> None:
    hand = running(positioner)
    assert hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand(ON)
    hand(ON | ACTIVATE, MDI_TARPOS=5000)
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert hand.actuals["ZSW1"] & ACKNOWLEDGED


def test_late_acknowledge_of_the_first_task_is_not_shown_for_the_second(hand: TaskHand) -> None:
    for word in (ON | ACTIVATE, ON, ON, ON | ACTIVATE):
        hand(word)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED


def test_edge_of_homing_while_the_axis_brakes_starts_at_standstill(make: Make) -> None:
    hand = running(make)
    hand(ON & ~REJECT)
    hand(ON)
    hand(ON | HOMING)
    hand.feedback.velocity_actual = 0
    for _ in range(3):
        hand(ON | HOMING)
    assert hand.stepper.sdo_request is not None


def test_edge_of_homing_during_a_task_has_a_reason() -> None:
    hand = running(positioner)
    hand(ON | ACTIVATE | HOMING)
    assert hand.stepper.reason is Reason.FUNCTION_RUNS


def test_withdrawn_homing_starts_no_older_task() -> None:
    hand = running(positioning)
    for word in (ON | HOMING, ON | ACTIVATE, ON | HOMING, ON):
        hand(word)
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON) & NEW_SETPOINT for _ in range(20))


def test_edge_of_homing_in_the_cycle_in_which_a_waiting_task_starts_has_a_reason() -> None:
    hand = running(positioner)
    hand(ON & ~REJECT)
    hand(ON)
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = 0
    hand(ON | ACTIVATE)
    hand(ON | ACTIVATE | HOMING)
    assert hand.stepper.reason is Reason.FUNCTION_RUNS


def test_drive_that_ignores_halt_gets_quick_stop(make: Make) -> None:
    hand = running(make, stop_time_ns=500_000_000, enter_ns=SECOND)
    words = [hand(ON & ~INTERMEDIATE | ACTIVATE) for _ in range(800)]
    first = next(at for at, word in enumerate(words) if not word & 0b100)
    assert words[1] & HALT
    assert 225 <= first <= 235, "0.4 s + 0.5 s in cycles of 4 ms"
    assert all(not word & 0b100 for word in words[first:]), "and until it is off"
    assert FaultNumber.STOP_IGNORED in hand.stepper.numbers


def jogging() -> TaskHand:
    """Telegram 111 jogs with half of its speed, in profile velocity."""
    hand = positioner(replace(CHOICES, jog_velocities=(15_000, -15_000))).enable()
    hand(ON | JOG)
    hand.mode = Mode.VELOCITY
    for _ in range(10):
        hand.feedback.velocity_actual = hand.stepper.command.target_velocity
        hand(ON | JOG)
    assert hand.feedback.velocity_actual
    return hand


@pytest.mark.parametrize(
    "word", [ON, (ON | JOG) & ~REJECT, (ON | JOG) & ~INTERMEDIATE], ids=["end", "STW1.4", "STW1.5"]
)
def test_drive_that_ignores_the_end_of_a_jog_gets_quick_stop(word: int) -> None:
    hand = jogging()
    words = [hand(word) for _ in range(200)]
    first = next(at for at, sent in enumerate(words) if not sent & 0b100)
    assert hand.stepper.command.target_velocity == 0
    assert 100 <= first <= 106, "0.4 s in cycles of 4 ms"
    assert hand.stepper.numbers == [FaultNumber.STOP_IGNORED]


def test_drive_that_brakes_at_the_end_of_a_jog_is_not_stopped() -> None:
    hand = jogging()
    speed = hand.feedback.velocity_actual
    for cycle in range(3000):
        hand.feedback.velocity_actual = max(0, speed - cycle * 12 // 5)
        assert hand(ON) & 0b100
    assert not hand.stepper.events


@pytest.mark.parametrize("share", [2, 4])
def test_drive_that_does_not_take_a_slower_task_gets_quick_stop(make: Make, share: int) -> None:
    """It has the time of an acknowledge for the last task, then the ceiling of the new speed falls to 150 % of it."""
    hand = running(make, stop_time_ns=500_000_000)
    speed = hand.stepper.command.profile_velocity
    slower = {"MDI_VELOCITY": hand.values["MDI_VELOCITY"] // share}
    hand.feedback.velocity_actual = speed
    hand(ON)
    hand(ON, OPERATING)
    words = [hand(ON | ACTIVATE, **slower) for _ in range(1000)]
    assert hand.stepper.command.profile_velocity == pytest.approx(speed / share, abs=2)
    first = next(at for at, word in enumerate(words) if not word & 0b100)
    assert 630 <= first <= 760, "2 s, up to 0.5 s of ramp, and 0.5 s in cycles of 4 ms"
    assert hand.stepper.numbers[:2] == [FaultNumber.NOT_ACKNOWLEDGED, FaultNumber.VELOCITY]


def test_drive_that_is_not_free_for_a_slower_task_gets_quick_stop(make: Make) -> None:
    """Its acknowledge of the last task, which it had to begin at once, stays 1."""
    hand = running(make, stop_time_ns=500_000_000)
    hand.feedback.velocity_actual = speed = hand.stepper.command.profile_velocity
    hand(ON, OPERATING | TAKEN)
    slower = {"MDI_VELOCITY": hand.values["MDI_VELOCITY"] // 2}
    words = [hand(ON | ACTIVATE, OPERATING | TAKEN, **slower) for _ in range(1000)]
    assert hand.stepper.command.profile_velocity == speed, "the slower one was not sent"
    first = next(at for at, word in enumerate(words) if not word & 0b100)
    assert 630 <= first <= 760, "2 s, up to 0.5 s of ramp, and 0.5 s in cycles of 4 ms"
    assert hand.stepper.numbers[0] == FaultNumber.VELOCITY


def test_slower_task_that_waits_in_the_drive_leaves_it_the_speed_of_the_one_that_runs() -> None:
    chain = (Block(1, 2_000_000, 30_000, next=BlockNext.FLYING), Block(2, 4_000_000, 6000), Block(3, 4_000_000, 3000))
    hand = positioner(replace(CHOICES, blocks=chain), stop_time_ns=500_000_000).enable()
    hand(ON | ACTIVATE, POS_STW1=1)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    hand.feedback.velocity_actual = hand.stepper.command.profile_velocity
    hand(ON | ACTIVATE)
    for _ in range(1000):
        assert hand(ON | ACTIVATE) & 0b100
    assert hand.stepper.command.profile_velocity == hand.feedback.velocity_actual // 5
    full = OPERATING | TAKEN
    hand(ON, full)
    for _ in range(1000):
        assert hand(ON | ACTIVATE, full, POS_STW1=3) & 0b100, "its buffer is full"
    assert not hand.stepper.events


def test_slow_ramp_after_halt_is_not_a_fault(make: Make) -> None:
    """The deceleration is the PLC's choice: 6 % of the speed in each stop time, after a jerk limit that lets it rise."""
    hand = running(make, stop_time_ns=2 * SECOND)
    noise = Random(1)
    speed = hand.feedback.velocity_actual * 1000
    for cycle in range(6000):
        speed = speed * 1001 // 1000 if cycle < 90 else speed * 7999 // 8000
        hand.feedback.velocity_actual = speed // 1000 + round(noise.gauss(0, 10))
        assert hand(ON & ~INTERMEDIATE | ACTIVATE) & 0b100
    assert not hand.stepper.events


def test_ramp_after_halt_that_is_slower_than_the_stop_time_allows_gets_quick_stop(make: Make) -> None:
    """4 % of the speed in each stop time."""
    hand = running(make, stop_time_ns=2 * SECOND)
    speed = hand.feedback.velocity_actual * 1000
    for _ in range(1200):
        speed = speed * 12499 // 12500
        hand.feedback.velocity_actual = speed // 1000
        hand(ON & ~INTERMEDIATE | ACTIVATE)
    assert FaultNumber.STOP_IGNORED in hand.stepper.numbers


# -- a mode of operation that is requested, not confirmed, and requested again later ------------------------------


CYCLE_NS = 4_000_000


def reports_missing_mode(hand: Hand) -> bool:
    return any(
        fault.number == FaultNumber.MODE_NOT_CONFIRMED for fault in hand.stepper.machine.outputs.happened().faults
    )


def test_an_abandoned_mode_request_does_not_count_for_the_next_one() -> None:
    hand = positioner().enable()
    hand(ON | JOG)
    hand(ON | JOG)
    assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
    for _ in range(MODE_CONFIRM_NS // CYCLE_NS):
        hand(ON)
    for _ in range(10):
        hand(ON | JOG)
        assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
        assert not reports_missing_mode(hand)
