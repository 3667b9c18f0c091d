"""Telegram 111 with a drive that answers on demand of the test: setpoints, modes, Halt, homing, and displayed states."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.gateway.axis.executors.positions.handshake import ACKNOWLEDGE_NS
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockNext
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.profidrive.signals import signal
from tests.gateway.axis.test_modulo import TABLE, drive_type
from tests.gateway.axis.test_tasks import edges, unanswered
from tests.support.axis.hand import OFF, ON, OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.tasks import (
    ACTIVATE,
    DRIVE,
    FAST,
    HALT,
    INTERMEDIATE,
    MDI_ABSOLUTE,
    MDI_RELATIVE,
    NEW_SETPOINT,
    OF_THE_MODE,
    OFF2,
    OFF3,
    REJECT,
    RELATIVE,
    SETTING_UP,
    TAKEN,
    TaskHand,
    positioner,
)

REACHED = StatusBit.TARGET_REACHED
CONTINUOUS_UPDATE = 0x1000
SHOWN, SHOWN_2 = signal("POS_ZSW1"), signal("POS_ZSW2")


def shows(hand: Hand, name: str) -> bool:
    found = SHOWN_2 if name in {bit.name for bit in SHOWN_2.bits} else SHOWN
    word = "POS_ZSW2" if found is SHOWN_2 else "POS_ZSW1"
    return bool(hand.actuals[word] & found.bit(name).mask)


def turning() -> TaskHand:
    """Setting up in operation: the drive is in mode 3 and turns."""
    hand = positioner().enable()
    hand(ON | ACTIVATE, POS_STW1=SETTING_UP | CONTINUOUS_UPDATE)
    hand.mode = Mode.VELOCITY
    hand(ON | ACTIVATE)
    assert hand.stepper.command.target_velocity == 600
    hand.feedback.velocity_actual = FAST
    hand(ON | ACTIVATE)
    return hand


# -- setpoints ----------------------------------------------------------------------------------------------------------


def test_bit_4_and_data_stay_until_the_drive_accepts_the_setpoint() -> None:
    hand = positioner().enable()
    hand.task(4096, POS_STW1=MDI_ABSOLUTE | CONTINUOUS_UPDATE)
    for target in range(11_000, 20_000, 1000):
        assert hand(ON | ACTIVATE, MDI_TARPOS=target) & NEW_SETPOINT
        assert hand.target == 4096, "continuous update waits for the acknowledge"
    assert not hand(ON | ACTIVATE, OPERATING | TAKEN) & NEW_SETPOINT
    assert not hand(ON | ACTIVATE, OPERATING | TAKEN) & NEW_SETPOINT, "the acknowledge stands"
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
    assert hand.target == round(19_000 * 0.4096)


@pytest.mark.parametrize(
    ("wanted", "mode"), [(MDI_ABSOLUTE, Mode.VELOCITY), (SETTING_UP, Mode.POSITION)], ids=["position", "speed"]
)
def test_no_setpoint_is_sent_before_the_drive_shows_its_mode(wanted: int, mode: Mode) -> None:
    hand = positioner().enable()
    hand.mode = mode
    for _ in range(10):
        assert not hand.task(4096, POS_STW1=wanted) & NEW_SETPOINT
        assert hand.stepper.command.target_velocity == 0
        assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
    hand.mode = Mode.VELOCITY if wanted == SETTING_UP else Mode.POSITION
    word = hand(ON | ACTIVATE)
    assert word & NEW_SETPOINT or hand.stepper.command.target_velocity
    assert hand.stepper.reason is None


@pytest.mark.parametrize("shown", [Mode.VELOCITY, Mode.HOMING])
def test_a_task_rises_bit_4_once_when_the_drive_leaves_the_mode_before_it_acknowledges(shown: Mode) -> None:
    hand = positioner().enable()
    assert hand.task(4096, relative=True) & NEW_SETPOINT
    hand.mode = shown
    words = [hand(ON, OPERATING | TAKEN) for _ in range(5)]
    assert hand.stepper.reason is Reason.MODE_NOT_CONFIRMED
    hand.mode = Mode.POSITION
    assert all(word & NEW_SETPOINT for word in [*words, hand(ON)]), "a second rising edge would be a second task"
    assert not any(hand(ON, OPERATING | TAKEN) & NEW_SETPOINT for _ in range(3))
    assert not any(hand(ON) & NEW_SETPOINT for _ in range(10))


def test_setting_up_replaces_a_setpoint_that_the_drive_has_not_acknowledged() -> None:
    hand = positioner().enable()
    assert hand.task(4096) & NEW_SETPOINT
    hand(ON)
    assert not hand(ON | ACTIVATE, POS_STW1=SETTING_UP) & NEW_SETPOINT
    hand(ON, MDI_TARPOS=20_000)
    words = [hand(ON | ACTIVATE, POS_STW1=MDI_ABSOLUTE) for _ in range(110)]
    assert edges(words) == 1, "when 6061h = 1 can no longer be older than the request of mode 3"
    assert hand.target == 8192, "not the target of the first task again"


@pytest.mark.parametrize("way", ["override", "continuous update"])
def test_a_dropped_setpoint_is_not_repeated_for_the_same_task(way: str) -> None:
    hand = positioner().enable()
    hand(ON | ACTIVATE, POS_STW1=MDI_ABSOLUTE | CONTINUOUS_UPDATE, MDI_TARPOS=10_000)
    unanswered(hand, ON | ACTIVATE)
    changed = {"OVERRIDE": 0x2000} if way == "override" else {"MDI_TARPOS": 20_000}
    assert all(hand(ON | ACTIVATE, **changed) & NEW_SETPOINT for _ in range(1000))
    assert hand.target == 4096
    assert hand.stepper.reason is Reason.NOT_ACKNOWLEDGED


def test_a_setpoint_that_waits_in_the_drive_is_not_overdue_before_the_motion_ends() -> None:
    blocks = (
        Block(0, position=100_000, velocity=3000, next=BlockNext.FLYING),
        Block(1, position=200_000, velocity=3000),
    )
    hand = positioner(replace(CHOICES, blocks=blocks)).enable()
    hand(ON | ACTIVATE, POS_STW1=0)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = hand.stepper.command.profile_velocity
    assert all(hand(ON | ACTIVATE) & NEW_SETPOINT for _ in range(1000)), "the drive has one buffer"
    assert hand.stepper.reason is None
    hand.feedback.velocity_actual = 0
    for _ in range(ACKNOWLEDGE_NS // 4_000_000 + 1):
        hand(ON | ACTIVATE, OPERATING | REACHED)
    assert hand.stepper.reason is Reason.NOT_ACKNOWLEDGED


def test_anchor_of_a_modulo_axis_that_the_drive_drops_is_not_followed_by_the_task() -> None:
    """It would be relative to an unknown position."""
    hand = positioner(replace(TABLE, software_limits=None), drive_type(wraps=True)).enable()
    hand.feedback.position_actual = 10
    hand(ON)
    words = [hand(ON | ACTIVATE, MDI_TARPOS=9_900)]
    assert hand.target == 10, "the actual position"
    words += [hand(ON | ACTIVATE) for _ in range(1000)]
    assert edges(words) == 1
    assert hand.stepper.reason is Reason.NOT_ACKNOWLEDGED


def test_bits_5_and_6_of_a_position_are_not_those_of_a_speed() -> None:
    hand = positioner().enable()
    assert hand.task(4096, POS_STW1=MDI_RELATIVE) & RELATIVE
    hand(ON, OPERATING | TAKEN)
    hand(ON | ACTIVATE, POS_STW1=SETTING_UP)
    hand.mode = Mode.VELOCITY
    words = [hand(ON | ACTIVATE) for _ in range(5)]
    assert hand.stepper.command.target_velocity
    assert not words[-1] & OF_THE_MODE


def test_from_a_position_to_a_speed_the_axis_is_halted_to_standstill_before_the_mode_changes() -> None:
    hand = positioner().enable()
    hand.task(4096)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    hand(ON)
    command = hand.stepper.command
    for _ in range(5):
        assert hand(ON | ACTIVATE, POS_STW1=SETTING_UP) & (HALT | NEW_SETPOINT) == HALT
        assert (command.modes_of_operation, command.target_velocity) == (Mode.POSITION, 0)
    hand.feedback.velocity_actual = 0
    assert not hand(ON | ACTIVATE) & (HALT | NEW_SETPOINT), "Halt falls alone"
    assert command.modes_of_operation == Mode.POSITION
    hand(ON | ACTIVATE)
    assert (command.modes_of_operation, command.target_velocity) == (Mode.VELOCITY, 0)


@pytest.mark.parametrize("word", [ON & ~REJECT, ON & ~INTERMEDIATE], ids=["reject", "intermediate stop"])
def test_setpoint_after_a_withdrawn_one_has_its_own_data(word: int) -> None:
    hand = positioner().enable()
    hand.task(4096)
    hand(word)
    hand(word & ~REJECT)
    hand(ON & ~REJECT, OPERATING | TAKEN)
    for _ in range(3):
        assert not hand(ON) & NEW_SETPOINT
    assert not hand.task(8192) & (HALT | NEW_SETPOINT), "Halt falls alone"
    assert hand(ON | ACTIVATE) & NEW_SETPOINT
    assert hand.target == 8192


def test_speed_replaces_a_pending_setpoint() -> None:
    hand = positioner().enable()
    hand.task(4096)
    hand.feedback.velocity_actual = FAST
    hand(ON)
    assert hand(ON | ACTIVATE, POS_STW1=SETTING_UP) & (HALT | NEW_SETPOINT) == HALT
    hand(ON & ~REJECT, OPERATING | TAKEN)
    hand.feedback.velocity_actual = 0
    for _ in range(5):
        assert not hand(ON) & NEW_SETPOINT
    word = hand(ON | ACTIVATE, POS_STW1=MDI_ABSOLUTE, MDI_TARPOS=20_000)
    assert (word & (HALT | NEW_SETPOINT), hand.target) == (NEW_SETPOINT, 8192)


def test_a_speed_follows_the_override_also_through_0() -> None:
    hand = turning()
    for override, expected in ((0x2000, 300), (0, 0), (0x4000, 600)):
        hand(ON | ACTIVATE, OVERRIDE=override)
        hand(ON | ACTIVATE)
        assert hand.stepper.command.target_velocity == expected


@pytest.mark.parametrize(
    ("choices", "wraps", "waits"),
    [(CHOICES, None, True), (replace(CHOICES, waiting_setpoints=False), None, False), (TABLE, False, False)],
    ids=["drive keeps one", "drive keeps none", "modulo axis"],
)
def test_flying_block_is_sent_early_only_to_a_drive_with_a_setpoint_queue(
    choices: PositionerChoices, wraps: bool | None, waits: bool
) -> None:
    choices = replace(choices, blocks=(Block(1, 5000, 3000, next=BlockNext.FLYING), Block(2, 9000, 3000)))
    hand = positioner(choices, DRIVE if wraps is None else drive_type(wraps=wraps)).enable()
    hand(ON, POS_STW1=1)
    hand(ON | ACTIVATE)
    hand.feedback.velocity_actual = 600
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert any(hand(ON | ACTIVATE) & NEW_SETPOINT for _ in range(5)) is waits


def test_from_a_speed_to_a_position_the_drive_ramps_down_by_its_speed() -> None:
    hand = turning()
    hand(ON)
    command = hand.stepper.command
    for _ in range(5):
        assert not hand(ON | ACTIVATE, POS_STW1=MDI_ABSOLUTE, MDI_TARPOS=10_000) & (HALT | NEW_SETPOINT)
        assert (command.modes_of_operation, command.target_velocity) == (Mode.VELOCITY, 0)


def test_halt_stays_in_an_intermediate_stop_and_ends_after_a_reject() -> None:
    hand = positioner().enable()
    hand.task(4096)
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    stand = OPERATING | REACHED
    assert all(hand(ON & ~INTERMEDIATE | ACTIVATE, stand) & HALT for _ in range(50))
    hand.feedback.velocity_actual = FAST
    assert all(hand(ON & ~REJECT, OPERATING) & HALT for _ in range(5))
    hand.feedback.velocity_actual = 0
    assert not hand(ON & ~REJECT, stand) & HALT
    assert not any(hand(ON, stand) & OF_THE_MODE & ~ControlBit.CHANGE_IMMEDIATELY for _ in range(10))


def test_intermediate_stop_of_a_speed_is_speed_0_and_then_resumes() -> None:
    hand = turning()
    command = hand.stepper.command
    for _ in range(5):
        assert not hand(ON & ~INTERMEDIATE | ACTIVATE) & HALT
        assert command.target_velocity == 0
    hand(ON | ACTIVATE)
    assert command.target_velocity == 600


@pytest.mark.parametrize(("word", "mode"), [(MDI_ABSOLUTE, Mode.POSITION), (SETTING_UP, Mode.VELOCITY)])
def test_override_above_100_percent_does_not_exceed_the_maximum_velocity(word: int, mode: Mode) -> None:
    hand = positioner(replace(CHOICES, max_velocity=3000)).enable()
    hand.mode = mode
    limited = []
    for override in (0x7FFF, 0x4000, 0x2000):
        for _ in range(3):
            hand(ON | ACTIVATE, OVERRIDE=override, POS_STW1=word, MDI_TARPOS=50_000)
        hand(ON | ACTIVATE, OPERATING | TAKEN)
        hand(ON | ACTIVATE)
        hand(ON | ACTIVATE)
        command = hand.stepper.command
        speed = command.profile_velocity if mode is Mode.POSITION else command.target_velocity
        assert speed == (300 if override == 0x2000 else 600)
        limited.append(shows(hand, "SPEED_LIMITED"))
    assert limited == [True, False, False]


def test_a_speed_follows_its_set_point() -> None:
    hand = turning()
    command = hand.stepper.command
    for velocity, expected in ((6000, 1200), (30_000, 6000), (300, 60)):
        hand(ON | ACTIVATE, MDI_VELOCITY=velocity)
        hand(ON | ACTIVATE)
        assert command.target_velocity == expected


# -- the end of operation -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("end", "word"), [(OFF2, 0x0), (OFF3, 0x2)], ids=["OFF2", "OFF3"])
def test_off2_and_off3_clear_the_mode_bits_and_the_speed(end: int, word: int) -> None:
    hand = turning()
    command = hand.stepper.command
    assert hand(end) == word
    assert command.target_velocity == 0
    assert hand(end) == word
    assert command.modes_of_operation == Mode.POSITION
    hand(end, State.SWITCH_ON_DISABLED)
    hand.feedback.velocity_actual = 0
    hand.enable()
    assert not any(hand(ON) & OF_THE_MODE for _ in range(10))
    assert command.target_velocity == 0


def test_off1_ramps_a_speed_down_and_halt_stays_with_the_last_command() -> None:
    hand = turning()
    command = hand.stepper.command
    for _ in range(5):
        assert hand(OFF) & (HALT | 0xF) == HALT | 0xF
        assert (command.modes_of_operation, command.target_velocity) == (Mode.VELOCITY, 0)
    hand.feedback.velocity_actual = 0
    assert hand(OFF) == HALT | 0x6
    assert command.modes_of_operation == Mode.VELOCITY
    assert hand(OFF, State.READY_TO_SWITCH_ON) == 0x6
    hand(OFF, State.READY_TO_SWITCH_ON)
    assert command.modes_of_operation == Mode.POSITION


def test_outage_of_references_stops_the_axis_without_a_resume() -> None:
    hand = turning()
    command = hand.stepper.command
    hand.stepper.set_drive(None)
    assert hand(ON | ACTIVATE) == 0x2, "quick stop"
    assert command.target_velocity == 0
    hand(ON | ACTIVATE)
    assert not shows(hand, "SETTING_UP")
    hand.stepper.set_drive(DRIVE, 35)
    hand(ON | ACTIVATE, State.SWITCH_ON_DISABLED)
    hand.feedback.velocity_actual = 0
    hand(OFF | ACTIVATE, State.SWITCH_ON_DISABLED)
    for status in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, *[State.OPERATION_ENABLED] * 10):
        assert not hand(ON | ACTIVATE, status) & OF_THE_MODE
        assert command.target_velocity == 0
