"""Telegrams 9 and 111: when a task or a homing has ended, what an axis at standstill reports before that, and modes."""

from __future__ import annotations

from random import Random

import pytest

from pdgw.dsp402.modes import MODE_CONFIRM_NS, Mode
from pdgw.dsp402.states import State, StatusBit
from pdgw.durations import SECOND
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.reasons import FaultNumber, Reason
from tests.gateway.axis.test_halt_continues import (
    ACTIVATE,
    FAST,
    HALT,
    HOMING,
    INTERMEDIATE,
    MAKES,
    NEW_SETPOINT,
    REACHED,
    REJECT,
    WARNING,
    Continuing,
)
from tests.gateway.axis.test_positioner_handshake import positioner
from tests.support.axis.hand import OFF, ON, OPERATING, Hand

# -- the end of a task or a homing --------------------------------------------------------------------------------


SW_REACHED, SW_TAKEN, FOLLOWING = StatusBit.TARGET_REACHED, StatusBit.MODE_12, StatusBit.MODE_13
STALLED = AxisSettings().stall_ns // 4_000_000 + 3
ACKNOWLEDGED, HOME_SET = 0x1000, 0x800
MDI = {"9": {"SATZANW": 0x8000 | 17}, "111": {}}
DESELECTED = {"SATZANW": 17}


def running(name: str, **settings: object) -> Hand:
    """A task to the target that the drive has taken and works on, at the start of its way."""
    make, values = MAKES[name]
    hand: Hand = make(**settings).enable()
    hand(ON | ACTIVATE, **values)
    hand(ON | ACTIVATE, OPERATING | SW_TAKEN)
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
    hand = running("9")
    hand(ON | ACTIVATE, OPERATING | SW_REACHED)
    hand(ON | ACTIVATE)
    assert not hand.actuals["ZSW1"] & REACHED
    assert hand(word, **values) & HALT


@pytest.mark.parametrize("name", MAKES)
def test_reached_of_the_last_task_is_not_shown_for_the_new_one(name: str) -> None:
    make, values = MAKES[name]
    hand = make().enable()
    for status in (OPERATING | SW_REACHED, *(OPERATING | SW_TAKEN | SW_REACHED,) * 300):
        hand(ON | ACTIVATE, status, **values)
        assert not hand.actuals["ZSW1"] & REACHED


@pytest.mark.parametrize("stop", [State.SWITCH_ON_DISABLED, State.FAULT, None], ids=["OFF2", "fault", "OFF1"])
@pytest.mark.parametrize("name", MAKES)
def test_drive_that_keeps_its_task_while_off_is_stopped(name: str, stop: State | None) -> None:
    make, values = MAKES[name]
    drive = Continuing(make().enable())
    for _ in range(5):
        drive(ON | ACTIVATE, **values)
    for _ in range(5):
        drive(OFF) if stop is None else drive.hand(OFF, stop)
    drive.hand.feedback.velocity_actual = 0
    drive.hand.enable()
    drive.moved, drive.word = 0, 0
    words = [drive(ON, POS_STW1=0x8100) if name == "111" else drive(ON) for _ in range(500)]
    assert drive.moved <= 3
    assert words[-1] & HALT
    assert not any(word & NEW_SETPOINT for word in words)
    assert drive.hand.stepper.reason is Reason.MOVES_UNASKED


@pytest.mark.parametrize(
    ("bits", "reason"),
    [(0, Reason.NOT_REACHED), (FOLLOWING, Reason.FOLLOWING_ERROR), (SW_REACHED, Reason.STANDS_AWAY)],
)
@pytest.mark.parametrize("name", MAKES)
def test_axis_stopped_before_its_target_names_the_missing_bit(name: str, bits: int, reason: Reason) -> None:
    hand = running(name)
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


@pytest.mark.parametrize("name", MAKES)
def test_slow_task_inside_the_standstill_window_has_no_reason(name: str) -> None:
    hand = running(name)
    hand.feedback.velocity_actual = 1
    for position in range(2 * STALLED):
        hand.feedback.position_actual = position // 10
        hand(ON | ACTIVATE)
        assert hand.stepper.reason is None


@pytest.mark.parametrize("name", MAKES)
def test_acknowledge_that_stays_1_has_a_reason(name: str) -> None:
    make, values = MAKES[name]
    hand = make().enable()
    words = [hand(ON | ACTIVATE, OPERATING | SW_TAKEN, **values) for _ in range(STALLED)]
    assert not any(word & NEW_SETPOINT for word in words)
    assert hand.stepper.reason is Reason.SETPOINT_BLOCKED


@pytest.mark.parametrize("name", MAKES)
def test_a_setpoint_that_waits_for_the_late_acknowledge_of_a_cancelled_one_is_not_blocked(name: str) -> None:
    make, values = MAKES[name]
    hand = make(reaction_ns=3 * AxisSettings().stall_ns).enable()
    hand(ON | ACTIVATE, **values)
    hand(ON & ~REJECT)
    hand(ON)
    for _ in range(2 * STALLED):
        assert not hand(ON | ACTIVATE) & NEW_SETPOINT, "the drive may still acknowledge the first one"
        assert hand.stepper.reason is not Reason.SETPOINT_BLOCKED
    assert not hand.stepper.events


def homing(name: str) -> Hand:
    """A homing that the drive has started long ago; it turns."""
    hand = MAKES[name][0]().enable()
    hand.values |= MDI[name]
    hand(ON | HOMING)
    hand.stepper.sdo_done(None)
    hand(ON | HOMING)
    hand.mode = Mode.HOMING
    hand.feedback.velocity_actual = FAST
    assert hand(ON | HOMING) & NEW_SETPOINT
    return hand


@pytest.mark.parametrize("name", MAKES)
def test_stuck_bits_of_a_homing_do_not_set_the_home_position(name: str) -> None:
    hand = homing(name)
    ended = OPERATING | SW_TAKEN | SW_REACHED
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


@pytest.mark.parametrize(("bits", "missing"), [(SW_TAKEN, "Statusword.10"), (SW_REACHED, "Statusword.12")])
@pytest.mark.parametrize("name", MAKES)
def test_homing_that_ends_with_one_bit_fails_and_names_the_other(name: str, bits: int, missing: str) -> None:
    hand = homing(name)
    for _ in range(150):
        hand(ON | HOMING)
    hand.feedback.velocity_actual = 0
    for _ in range(STALLED):
        hand(ON | HOMING, OPERATING | bits)
    assert missing in hand.stepper.events[0].text
    assert not hand.actuals["ZSW1"] & HOME_SET


@pytest.mark.parametrize("name", MAKES)
def test_homing_at_standstill_without_an_end_has_a_reason(name: str) -> None:
    hand = homing(name)
    hand.feedback.velocity_actual = 0
    for _ in range(150 + STALLED):
        hand(ON | HOMING)
    assert hand.stepper.reason is Reason.HOMING_STALLED


def test_edge_of_a_task_while_the_axis_brakes_is_not_shown_as_reached() -> None:
    hand = running("111")
    hand(ON & ~REJECT)
    hand(ON)
    hand.feedback.velocity_actual = 0
    for _ in range(3):
        word = hand(ON | ACTIVATE)
        assert not hand.actuals["ZSW1"] & REACHED
    assert word & NEW_SETPOINT


def test_acknowledge_of_the_last_task_is_not_shown_for_the_next() -> None:
    hand = running("111")
    assert hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand(ON)
    hand(ON | ACTIVATE, MDI_TARPOS=5000)
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED
    hand(ON | ACTIVATE, OPERATING | SW_TAKEN)
    assert hand.actuals["ZSW1"] & ACKNOWLEDGED


def test_late_acknowledge_of_the_first_task_is_not_shown_for_the_second() -> None:
    make, values = MAKES["9"]
    hand = make().enable()
    for word in (ON | ACTIVATE, ON, ON, ON | ACTIVATE):
        hand(word, **values)
    hand(ON | ACTIVATE, OPERATING | SW_TAKEN)
    assert not hand.actuals["ZSW1"] & ACKNOWLEDGED


def test_edge_of_homing_while_the_axis_brakes_starts_at_standstill() -> None:
    hand = running("111")
    hand(ON & ~REJECT)
    hand(ON)
    hand(ON | HOMING)
    hand.feedback.velocity_actual = 0
    for _ in range(3):
        hand(ON | HOMING)
    assert hand.stepper.sdo_request is not None


def test_edge_of_homing_during_a_task_has_a_reason() -> None:
    hand = running("111")
    hand(ON | ACTIVATE | HOMING)
    assert hand.stepper.reason is Reason.FUNCTION_RUNS


def test_withdrawn_homing_starts_no_older_task() -> None:
    hand = running("9")
    for word in (ON | HOMING, ON | ACTIVATE, ON | HOMING, ON):
        hand(word, **MDI["9"])
    hand.feedback.velocity_actual = 0
    assert not any(hand(ON) & NEW_SETPOINT for _ in range(20))


def test_edge_of_homing_in_the_cycle_in_which_a_waiting_task_starts_has_a_reason() -> None:
    hand = running("111")
    hand(ON & ~REJECT)
    hand(ON)
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = 0
    hand(ON | ACTIVATE)
    hand(ON | ACTIVATE | HOMING)
    assert hand.stepper.reason is Reason.FUNCTION_RUNS


@pytest.mark.parametrize("name", MAKES)
def test_drive_that_ignores_halt_gets_quick_stop(name: str) -> None:
    hand = running(name, stop_time_ns=500_000_000, enter_ns=SECOND)
    words = [hand(ON & ~INTERMEDIATE | ACTIVATE) for _ in range(800)]
    first = next(at for at, word in enumerate(words) if not word & 0b100)
    assert words[1] & HALT
    assert 700 <= first <= 720, "2 x (0.4 s + 2 x 0.5 s) in cycles of 4 ms"
    assert all(not word & 0b100 for word in words[first:]), "and until it is off"
    assert FaultNumber.STOP_IGNORED in hand.stepper.numbers


@pytest.mark.parametrize("name", MAKES)
def test_slow_ramp_after_halt_is_not_a_fault(name: str) -> None:
    """The deceleration is the PLC's choice: 1/3000 of the speed in each cycle, after a jerk limit that lets it rise."""
    hand = running(name, stop_time_ns=500_000_000)
    noise = Random(1)
    speed = hand.feedback.velocity_actual * 1000
    for cycle in range(6000):
        speed = speed * 1001 // 1000 if cycle < 300 else speed * 2999 // 3000
        hand.feedback.velocity_actual = speed // 1000 + round(noise.gauss(0, 20))
        assert hand(ON & ~INTERMEDIATE | ACTIVATE) & 0b100
    assert not hand.stepper.events


# -- a mode of operation that is requested, not confirmed, and requested again later ------------------------------


JOG = 0x100
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
