"""Telegrams 9 and 111 with a drive that continues a stopped task when Halt falls, as CiA 402 allows."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.signals import signal
from tests.gateway.axis.test_modulo import TABLE, drive_type
from tests.gateway.axis.test_positioner import positioner as simulated
from tests.gateway.axis.test_positioning import SMALL
from tests.support.axis.hand import OFF, ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.tasks import (
    ACTIVATE,
    FAST,
    HALT,
    HOMING,
    INTERMEDIATE,
    JOG,
    MDI_ABSOLUTE,
    NEW_SETPOINT,
    REACHED,
    REJECT,
    SETTING_UP,
    WARNING,
    Make,
    positioner,
    positioning,
)

SETPOINT_REACHED = signal("POS_ZSW2").bit("SETPOINT_REACHED").mask
SLOW = 60
"""Actual speed of an axis that turns at the edge of the standstill window (1 % of 6000)."""


class Continuing:
    """A drive in profile position: a setpoint stays in force until another one, Halt only interrupts it.

    ``takes_modes``: it follows 6060h, and another mode ends the setpoint. ``opening``: cycles in which its brake opens.
    """

    def __init__(self, hand: Hand, speed: int = FAST, *, takes_modes: bool = False, opening: int = 0) -> None:
        self.hand = hand
        self.speed = speed
        self.takes_modes = takes_modes
        self.opening = opening
        self.modes: set[int] = set()
        self.word = 0
        self.runs = False
        self.moved = 0
        """Cycles in which it turned."""

    def __call__(self, stw1: int, **values: int) -> int:
        hand, before = self.hand, self.word
        if self.takes_modes:
            hand.mode = hand.stepper.command.modes_of_operation
            self.modes.add(hand.mode)
            self.runs = self.runs and hand.mode == Mode.POSITION
        follows = self.runs and not before & HALT
        self.opening -= self.opening > 0
        turns = follows and not self.opening
        self.moved += turns
        hand.feedback.velocity_actual = self.speed if turns else 0
        shown = OPERATING | (StatusBit.MODE_12 if before & NEW_SETPOINT else 0)
        self.word = hand(stw1, shown | (0 if follows else StatusBit.TARGET_REACHED), **values)
        self.runs = self.runs or self.word & ~before & NEW_SETPOINT != 0
        return self.word


def rejected(make: Make, speed: int = FAST) -> Continuing:
    """A task was rejected in its middle."""
    drive = Continuing(make().enable(), speed)
    for _ in range(5):
        drive(ON | ACTIVATE)
    assert drive.moved
    drive(ON & ~REJECT)
    drive.moved = 0
    return drive


def test_a_rejected_task_that_the_drive_continues_is_stopped_for_good(make: Make) -> None:
    drive = rejected(make)
    words = [drive(ON) for _ in range(1000)]
    assert drive.moved <= 2
    assert words[-1] & HALT
    assert not any(word & NEW_SETPOINT for word in words)
    hand = drive.hand
    assert hand.stepper.reason is Reason.MOVES_UNASKED
    assert hand.stepper.numbers == [FaultNumber.MOVES_UNASKED]
    assert hand.actuals["ZSW1"] & (WARNING | REACHED) == WARNING | REACHED, "it is at standstill"


@pytest.mark.parametrize("opening", [*range(8, 14), *range(54, 64), 400])
@pytest.mark.parametrize("stopped", [1, 50])
@pytest.mark.parametrize("end", [REJECT, INTERMEDIATE], ids=["rejected", "stopped, then rejected"])
def test_a_task_that_ends_while_the_brake_opens_is_never_continued(
    make: Make, stopped: int, end: int, opening: int
) -> None:
    drive = Continuing(make().enable(), opening=opening)
    for _ in range(5):
        drive(ON | ACTIVATE)
    for _ in range(stopped):
        drive(ON & ~end)
    drive(ON & ~REJECT)
    moved = drive.moved
    halts = [drive(ON) & HALT for _ in range(1000)]
    assert drive.moved == moved
    assert sum(a != b for a, b in pairwise(halts)) <= 2, "Halt does not rise and fall in each cycle"
    assert not drive.hand.stepper.numbers


@pytest.mark.parametrize("waited", [90, 300])
def test_a_task_that_is_rejected_long_before_the_brake_opens_is_never_continued(make: Make, waited: int) -> None:
    drive = Continuing(make().enable(), opening=400)
    for _ in range(waited):
        drive(ON | ACTIVATE)
    assert not drive.moved
    drive(ON & ~REJECT)
    assert all(drive(ON) & HALT for _ in range(1000))
    assert not drive.moved
    assert not drive.hand.stepper.numbers


@pytest.mark.parametrize("late", range(1, 9))
@pytest.mark.parametrize("end", [REJECT, INTERMEDIATE], ids=["rejected", "stopped"])
def test_a_task_that_ends_while_target_reached_is_still_that_of_before_it_is_stopped(
    make: Make, end: int, late: int
) -> None:
    """The drive has taken the setpoint, begins to turn, and shows SW.10 of the last task for some more cycles."""
    hand = make().enable()
    reached = OPERATING | StatusBit.TARGET_REACHED
    hand(ON, reached)
    hand(ON | ACTIVATE, reached)
    hand(ON | ACTIVATE, reached | StatusBit.MODE_12)
    hand(ON | ACTIVATE, reached)
    hand.feedback.velocity_actual = SLOW
    assert all(hand(ON & ~end, reached) & HALT for _ in range(late))
    assert hand(ON & ~end, OPERATING) & HALT, "it brakes"
    assert not hand.stepper.numbers


def test_a_rejected_task_within_the_standstill_window_is_stopped_too(make: Make) -> None:
    drive = rejected(make, SLOW)
    words = [drive(ON) for _ in range(1000)]
    assert drive.moved <= 2
    assert words[-1] & HALT
    assert not any(word & NEW_SETPOINT for word in words)
    assert drive.hand.actuals["ZSW1"] & (WARNING | REACHED) == REACHED


@pytest.mark.parametrize("speed", [FAST, SLOW])
def test_reached_is_not_shown_while_a_rejected_task_continues(make: Make, speed: int) -> None:
    drive = rejected(make, speed)
    for _ in range(20):
        drive(ON)
        shown = drive.hand.actuals
        reached = shown["ZSW1"] & REACHED or shown.get("POS_ZSW2", 0) & SETPOINT_REACHED
        assert not (drive.hand.feedback.velocity_actual and reached)


def test_the_next_task_replaces_the_one_that_continues(make: Make) -> None:
    drive = rejected(make)
    for _ in range(20):
        drive(ON)
    words = [drive(ON | ACTIVATE) for _ in range(4)]
    assert not words[0] & (HALT | NEW_SETPOINT), "Halt falls alone"
    assert words[1] & (HALT | NEW_SETPOINT) == NEW_SETPOINT
    assert not any(word & HALT for word in words)
    assert drive.hand.stepper.reason is None
    assert not drive.hand.actuals["ZSW1"] & WARNING


def test_a_ramp_that_resumes_does_not_continue_the_task(make: Make) -> None:
    drive = Continuing(make(ramp_stop_resume=True).enable())
    for _ in range(5):
        drive(ON | ACTIVATE)
    drive(OFF)
    drive.moved = 0
    words = [drive(ON) for _ in range(100)]
    assert drive.moved <= 2
    assert words[-1] & HALT
    assert drive.hand.stepper.power.released


def test_homing_waits_with_halt_for_its_parameters(make: Make) -> None:
    drive = rejected(make)
    for _ in range(20):
        drive(ON)
    drive.moved = 0
    for _ in range(100):  # the drive has not taken the method
        drive(ON | HOMING)
    assert drive.moved == 0


@pytest.mark.parametrize("after", range(4))
@pytest.mark.parametrize("end", [ON & ~REJECT, ON], ids=["rejected", "withdrawn"])
def test_a_homing_that_ends_each_time_does_not_move_a_drive_that_continues(make: Make, after: int, end: int) -> None:
    drive = rejected(make)
    for _ in range(20):
        for word, cycles in ((ON, after), (ON | HOMING, 1), (end, 2)):
            for _ in range(cycles):  # the drive has not taken the method
                drive(word)
    assert drive.moved <= 2


def test_homing_that_interrupts_a_task_keeps_halt_until_the_mode_changes() -> None:
    drive = Continuing(positioning().enable())
    for _ in range(5):
        drive(ON | ACTIVATE)
    drive(ON | HOMING)
    drive.moved = 0
    assert all(drive(ON | HOMING) & HALT for _ in range(50)), "the drive has not taken the method"
    drive.hand.stepper.sdo_done("refused")
    assert all(drive(ON | HOMING) & HALT for _ in range(50))
    assert drive.hand.stepper.reason is Reason.HOMING_REFUSED
    assert drive.moved == 0


def test_a_drive_that_drops_a_rejected_task_has_no_halt_afterwards(make: Make) -> None:
    drive = rejected(make)
    drive.runs = False
    assert not any([drive(ON) & HALT for _ in range(100)][5:])
    assert drive.hand.stepper.reason is None


def test_halt_of_a_drive_that_continues_ends_with_the_operation(make: Make) -> None:
    drive = rejected(make)
    for _ in range(20):
        drive(ON)
    drive.runs = False  # it forgets its task without power
    drive(OFF)
    drive.hand.enable()
    assert not any(drive(ON) & HALT for _ in range(20))


NEXT: dict[str, tuple[int, dict[str, int], Mode]] = {
    "jog": (ON | JOG, {}, Mode.VELOCITY),
    "setting up": (ON | ACTIVATE, {"POS_STW1": SETTING_UP}, Mode.VELOCITY),
    "homing": (ON | HOMING, {}, Mode.HOMING),
}
"""Functions of telegram 111 in another mode."""


def run(drive: Continuing, name: str) -> None:
    """One cycle of a function; the drive accepts the homing method."""
    word, values, _ = NEXT[name]
    drive(word, **values)
    if drive.hand.stepper.sdo_request is not None:
        drive.hand.stepper.sdo_done(None)


def interrupted(*, reject: bool, takes_modes: bool, speed: int = FAST) -> Continuing:
    """Telegram 111 in the middle of a task that is rejected, or will be replaced."""
    drive = Continuing(positioner().enable(), speed, takes_modes=takes_modes)
    for _ in range(5):
        drive(ON | ACTIVATE)
    for _ in range(10):
        drive(ON & ~REJECT if reject else ON)
        if reject:
            drive(ON)
    drive.moved = 0
    return drive


@pytest.mark.parametrize(("name", "reject"), [*((name, True) for name in NEXT), ("setting up", False)])
def test_a_function_in_another_mode_begins_on_a_drive_that_continues(name: str, reject: bool) -> None:
    drive = interrupted(reject=reject, takes_modes=True)
    for _ in range(100):
        run(drive, name)
    assert drive.moved <= 2, "not in jerks to the old target"
    assert NEXT[name][2] in drive.modes


@pytest.mark.parametrize("speed", [FAST, SLOW])
@pytest.mark.parametrize("name", NEXT)
def test_a_drive_that_refuses_the_mode_does_not_continue_the_stopped_task(name: str, speed: int) -> None:
    drive = interrupted(reject=True, takes_modes=False, speed=speed)
    for _ in range(300):
        run(drive, name)
    assert drive.hand.stepper.reason is Reason.MODE_KEPT
    for _ in range(100):
        drive(ON & ~REJECT)
    for _ in range(100):
        drive(ON)
    assert drive.moved <= 6
    words = [drive(ON | ACTIVATE, POS_STW1=MDI_ABSOLUTE) for _ in range(6)]
    assert any(word & NEW_SETPOINT for word in words), "the next task"


@pytest.mark.parametrize("speed", [FAST, SLOW])
@pytest.mark.parametrize("reject", [True, False], ids=["rejected", "interrupted"])
def test_telegram_9_halts_a_drive_that_refuses_homing_and_continues_the_task(*, reject: bool, speed: int) -> None:
    drive = Continuing(positioning().enable(), speed)
    for _ in range(5):
        drive(ON | ACTIVATE)
    for _ in range(10):
        drive(ON & ~(REJECT if reject else INTERMEDIATE))
    drive.moved = 0

    def homing(word: int, cycles: int) -> list[int]:
        words = []
        for _ in range(cycles):
            words.append(drive(word))
            if drive.hand.stepper.sdo_request is not None:
                drive.hand.stepper.sdo_done(None)
        return words

    homing(ON | HOMING, 300)
    assert drive.hand.stepper.reason is Reason.MODE_KEPT
    homing(ON, 100)
    assert drive.moved <= 6
    words = [drive(ON | ACTIVATE) for _ in range(6)]
    assert any(word & NEW_SETPOINT for word in words), "the next task"


def test_a_homing_starts_once_on_a_drive_that_falls_back_to_the_mode_of_the_stopped_task(make: Make) -> None:
    drive = rejected(make)
    hand, words = drive.hand, [drive(ON) for _ in range(10)]
    for mode in [Mode.POSITION] * 10 + [Mode.HOMING] * 10 + [Mode.POSITION] * 5 + [Mode.HOMING] * 5:
        hand.mode = mode
        drive.runs = mode == Mode.POSITION
        words.append(drive(ON | HOMING))
        if hand.stepper.sdo_request is not None:
            hand.stepper.sdo_done(None)
    starts = [word for word, before in zip(words[1:], words, strict=False) if word & ~before & NEW_SETPOINT]
    assert len(starts) == 1


def test_a_task_across_the_wrap_replaces_one_on_a_drive_that_continues() -> None:
    drive = Continuing(positioner(replace(TABLE, software_limits=None), drive_type(wraps=True)).enable())
    drive.hand.feedback.position_actual = 10
    for _ in range(5):
        drive(ON | ACTIVATE, MDI_TARPOS=2000)
    drive(ON)
    words = [drive(ON | ACTIVATE, MDI_TARPOS=9900) for _ in range(10)]
    assert any(word & NEW_SETPOINT for word in words)


def test_a_homing_that_is_aborted_after_a_reject_is_not_reported_as_motion_without_a_task() -> None:
    rig = simulated(111, replace(CHOICES, homing_method=17), SMALL)
    rig.values |= {"POS_STW1": MDI_ABSOLUTE, "MDI_TARPOS": 40_000, "MDI_VELOCITY": 12_000, "STW1": ON | ACTIVATE}
    for word, cycles in ((ON | ACTIVATE, 20), (ON & ~REJECT, 60), (ON, 10), (ON | HOMING, 60)):
        rig.values["STW1"] = word
        rig.step(cycles)
    assert rig.feedback.velocity_actual
    rig.values["STW1"] = ON
    rig.step(200)
    assert not rig.stepper.events
    assert not rig.stepper.command.controlword & HALT


@pytest.mark.parametrize("rejected", range(1, 12))
def test_halt_of_a_task_that_is_rejected_at_once_stays_until_the_drive_shows_it(make: Make, rejected: int) -> None:
    """The drive gets each word five cycles late: before that it shows standstill, because it has not begun yet. Its speed comes a
    cycle after its acknowledge.
    """
    hand = make().enable()
    late = [hand.stepper.command.controlword] * 6
    braking = 0
    runs = False
    for cycle in range(150):
        word, before = late[1], late[0]
        hand.feedback.velocity_actual = FAST if runs else 0
        runs = runs or word & ~before & NEW_SETPOINT != 0
        braking = braking + 1 if runs and word & HALT else 0
        runs = runs and braking < 4
        shown = OPERATING | (StatusBit.MODE_12 if word & NEW_SETPOINT else 0)
        stw1 = ON | ACTIVATE if cycle < rejected else ON & ~REJECT if rejected <= cycle < rejected + 2 else ON
        late = [*late[1:], hand(stw1, shown | (0 if runs else StatusBit.TARGET_REACHED))]
    assert not hand.stepper.events, "the drive has stopped by the first Halt"
    assert not late[-1] & HALT
