"""Telegram 111 with a drive that answers on demand of the test: homing, modulo axes, ranges, and reports of the drive."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import NEGATIVE_LIMIT_SWITCH, POSITIVE_LIMIT_SWITCH
from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.values import ProbeAnswer
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from tests.gateway.axis.test_modulo import TABLE, drive_type
from tests.gateway.axis.test_positioner_handshake import SHOWN, shows, turning
from tests.gateway.axis.test_tasks import DUE, homed
from tests.support.axis.hand import ON, OPERATING
from tests.support.axis.positioner import CHOICES
from tests.support.axis.tasks import (
    ACTIVATE,
    DRIVE,
    FAST,
    HALT,
    HOME_SET,
    HOMING,
    NEW_SETPOINT,
    REJECT,
    RELATIVE,
    TAKEN,
    WARNING,
    ZSW1,
    TaskHand,
    positioner,
)

REACHED = StatusBit.TARGET_REACHED
FOLLOWS = ZSW1.bit("WITHIN_TOLERANCE", positioning=True).mask


# -- homing -------------------------------------------------------------------------------------------------------------


def test_homing_on_a_limit_switch_has_no_warning() -> None:
    hand = positioner().enable()
    hand.begin_homing()
    for _ in range(3 * DUE):
        hand(ON | HOMING, OPERATING | StatusBit.INTERNAL_LIMIT)
        assert (hand.stepper.reason, hand.stepper.warning) == (None, 0)
    for _ in range(DUE):
        hand(ON | HOMING, OPERATING | StatusBit.INTERNAL_LIMIT | TAKEN | REACHED)
    assert hand.actuals["ZSW1"] & HOME_SET
    assert not hand.stepper.events


def test_a_homing_attained_of_before_is_not_the_end_of_a_homing_whose_statusword_is_late() -> None:
    hand = homed(positioner)
    hand.begin_homing()
    for _ in range(hand.stepper.settings.reaction_ns // hand.stepper.settings.cycle_ns):
        hand(ON | HOMING, OPERATING | TAKEN | REACHED)
    for _ in range(DUE):
        word = hand(ON | HOMING, OPERATING)
    assert word & NEW_SETPOINT
    assert not hand.actuals["ZSW1"] & HOME_SET
    for _ in range(10):
        hand(ON | HOMING, OPERATING | TAKEN | REACHED)
    assert hand.actuals["ZSW1"] & HOME_SET


@pytest.mark.parametrize(("value", "kept"), [(0, True), (0x80, False)], ids=["same value", "another value"])
def test_another_unit_or_polarity_of_positions_clears_the_home_position(value: int, kept: bool) -> None:
    def read_again(polarity: int) -> None:
        hand.stepper.set_drive(replace(DRIVE, position_objects={(0x607E, 0): polarity}), homing_method=35)
        hand(ON)

    hand = homed(positioner)
    read_again(0)
    assert hand.actuals["ZSW1"] & HOME_SET, "nothing is known to have changed"
    read_again(value)
    assert bool(hand.actuals["ZSW1"] & HOME_SET) is kept


def test_homing_waits_for_standstill_in_the_present_mode() -> None:
    hand = turning()
    hand(ON & ~REJECT)
    hand.feedback.velocity_actual = 0
    hand(ON)
    hand(ON)
    hand.feedback.velocity_actual = FAST
    command = hand.stepper.command
    for _ in range(5):
        assert not hand(ON | HOMING) & NEW_SETPOINT
        assert (command.modes_of_operation, command.target_velocity) == (Mode.VELOCITY, 0)
        assert hand.stepper.sdo_request is None
    hand.feedback.velocity_actual = 0
    hand(ON | HOMING)
    assert hand.stepper.sdo_request is not None


@pytest.mark.parametrize("method", [None, 99])
def test_unsupported_homing_method_warns_and_starts_nothing(method: int | None) -> None:
    hand = positioner(replace(CHOICES, homing_method=method)).enable()
    for _ in range(10):
        assert not hand(ON | HOMING) & NEW_SETPOINT
        assert hand.stepper.sdo_request is None
        assert hand.stepper.command.modes_of_operation == Mode.POSITION
    assert hand.stepper.numbers == [FaultNumber.HOMING_METHOD]
    assert hand.stepper.reason is Reason.HOMING_METHOD, "not the home switch"
    assert hand.actuals["ZSW1"] & (WARNING | 0x7) == WARNING | 0x7, "beside operation"
    assert hand.stepper.machine.outputs.warning, "P953"
    assert not hand.actuals["ZSW1"] & HOME_SET


# -- a modulo axis ------------------------------------------------------------------------------------------------------


def ring() -> TaskHand:
    hand = positioner(TABLE, drive_type(wraps=True)).enable()
    hand.feedback.position_actual = 3000
    hand(ON)
    return hand


def test_move_across_the_overflow_is_sent_as_absolute_then_relative() -> None:
    hand = ring()
    assert hand(ON | ACTIVATE, MDI_TARPOS=0) & (NEW_SETPOINT | RELATIVE) == NEW_SETPOINT
    assert hand.target == 3000
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert hand(ON | ACTIVATE) & (NEW_SETPOINT | RELATIVE) == NEW_SETPOINT | RELATIVE
    assert hand.target == 1096
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert not any(hand(ON | ACTIVATE) & NEW_SETPOINT for _ in range(10))


def test_move_within_the_range_is_one_absolute_setpoint() -> None:
    hand = ring()
    assert hand(ON | ACTIVATE, MDI_TARPOS=5000) & (NEW_SETPOINT | RELATIVE) == NEW_SETPOINT
    assert hand.target == 2048
    hand(ON | ACTIVATE, OPERATING | TAKEN)
    assert not any(hand(ON | ACTIVATE) & NEW_SETPOINT for _ in range(10))


def test_move_across_the_overflow_starts_at_standstill() -> None:
    hand = ring()
    hand(ON | ACTIVATE, MDI_TARPOS=9000)
    hand(ON, OPERATING | TAKEN)
    hand.feedback.velocity_actual = FAST
    for _ in range(5):
        assert hand(ON | ACTIVATE, MDI_TARPOS=0) & (HALT | NEW_SETPOINT) == HALT
    hand.feedback.velocity_actual = 0
    assert not hand(ON | ACTIVATE) & (HALT | NEW_SETPOINT), "Halt falls alone"
    assert hand(ON | ACTIVATE) & (HALT | NEW_SETPOINT) == NEW_SETPOINT


def test_position_continues_across_the_32_bit_overflow() -> None:
    hand = positioner(TABLE, drive_type(wraps=False)).enable()
    shown = []
    for position in ((1 << 31) - 1, -(1 << 31)):
        hand.feedback.position_actual = position
        hand(ON)
        shown.append(hand.actuals["XIST_A"])
    assert (shown[1] - shown[0]) % 10_000 <= 3, "one unit is 2.4 LU"


@pytest.mark.parametrize(
    ("limits", "fits"),
    [
        ((0, 4095), True),
        ((0, 4096), True),
        ((-2048, 2047), True),
        ((-2048, 2048), True),
        ((0, 4094), False),
        ((0, 4097), False),
        ((0, 8191), False),
    ],
)
def test_drive_overflows_at_the_modulo_range_or_is_rejected(limits: tuple[int, int], fits: bool) -> None:
    drive = drive_type(wraps=True)
    hand = positioner(TABLE, replace(drive, scaling=replace(drive.scaling, position_range=limits))).enable()
    assert hand.stepper.power.released is fits
    assert any("modulo_range" in event.text for event in hand.stepper.events) is not fits


# -- the range ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limits", "lu", "target", "given"),
    [
        ((-1_000_000, 1_000_000), 4096, 1_000_000, True),
        ((-1_000_000, 1_000_000), 4096, 1_000_001, False),
        ((-1_000_000, 1_000_000), 4096, -1_000_001, False),
        (None, 4096, 1_000_001, True),
        (None, 100, 53_000_000, False),
    ],
)
def test_target_outside_the_drives_range_is_not_sent(
    limits: tuple[int, int] | None, lu: int, target: int, given: bool
) -> None:
    choices = replace(CHOICES, lu_per_revolution=lu, software_limits=None, blocks=())
    hand = positioner(choices, replace(DRIVE, scaling=replace(DRIVE.scaling, position_range=limits))).enable()
    word = hand(ON | ACTIVATE, MDI_TARPOS=target)
    assert bool(word & NEW_SETPOINT) is given
    assert bool(hand.actuals["ZSW1"] & WARNING) is not given


@pytest.mark.parametrize(("limit", "given"), [(5000, True), (4000, False)])
def test_modulo_axis_is_not_sent_beyond_the_end_of_its_drive(limit: int, given: bool) -> None:
    drive = drive_type(wraps=False)
    hand = positioner(TABLE, replace(drive, scaling=replace(drive.scaling, position_range=(-limit, limit)))).enable()
    hand.feedback.position_actual = 2048
    hand(ON)
    assert bool(hand(ON | ACTIVATE, MDI_TARPOS=0) & NEW_SETPOINT) is given


# -- reports of the drive -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("switch", "name"),
    [(NEGATIVE_LIMIT_SWITCH, "NEGATIVE_HARDWARE_LIMIT"), (POSITIVE_LIMIT_SWITCH, "POSITIVE_HARDWARE_LIMIT")],
)
def test_the_limit_switches_of_the_drive_are_shown_while_they_are_hit(switch: int, name: str) -> None:
    hand = positioner().enable()
    names = ("NEGATIVE_HARDWARE_LIMIT", "POSITIVE_HARDWARE_LIMIT")
    for hit in (switch, 0, switch):
        hand.feedback.digital_inputs = hit
        hand(ON, POS_STW2=0x8000)
        hand(ON)
        assert [item for item in names if shows(hand, item)] == ([name] if hit else [])


@pytest.mark.parametrize(("mode", "shown"), [(Mode.POSITION, True), (Mode.HOMING, False)])
def test_bit_13_is_a_following_error_in_mode_1_alone(mode: Mode, shown: bool) -> None:
    hand = positioner().enable()
    assert hand.actuals["ZSW1"] & FOLLOWS
    hand.mode = mode
    hand(ON, OPERATING | StatusBit.MODE_13)
    assert bool(hand.actuals["ZSW1"] & FOLLOWS) is not shown


def test_meldw_shows_the_state_of_the_drive() -> None:
    hand = positioner().enable()
    slow = hand.actuals["MELDW"]
    hand.feedback.velocity_actual = 6000
    hand(ON)
    assert hand.actuals["MELDW"] != slow


@pytest.mark.parametrize(("bits", "edge"), [(0x000, 0), (0x800, 1), (0x400, 2), (0xC00, 3)])
def test_passive_homing_uses_the_configured_probe_edge_and_no_old_answer(bits: int, edge: int) -> None:
    hand = positioner().enable()
    news = hand.stepper.machine.inputs.news
    hand(ON, POS_STW2=0x100 | bits)
    hand(ON | HOMING)
    first = hand.stepper.machine.outputs.probe
    assert first is not None
    assert first.edges == (edge,)
    hand(ON)
    assert hand.stepper.machine.outputs.probe is None
    hand(ON | HOMING)
    second = hand.stepper.machine.outputs.probe
    news.append(ProbeAnswer(first, {edge: 100}))
    hand(ON | HOMING)
    hand(ON | HOMING)
    assert not hand.actuals["ZSW1"] & HOME_SET, "the answer to the wish that was taken back"
    assert second is not None
    hand.feedback.position_actual = 4096
    news.append(ProbeAnswer(second, {edge: 2048}))
    hand(ON | HOMING)
    hand(ON | HOMING)
    assert hand.actuals["ZSW1"] & HOME_SET
    assert hand.actuals["XIST_A"] == 5000, "half a revolution behind the edge"


def test_rejected_probe_does_not_block_the_next() -> None:
    hand = positioner().enable()
    hand(ON, POS_STW2=0x100)
    hand(ON | HOMING)
    refused = hand.stepper.machine.outputs.probe
    assert refused is not None
    hand.stepper.machine.inputs.news.append(ProbeAnswer(refused, {}, "no touch probe"))
    hand(ON | HOMING)
    hand(ON | HOMING)
    assert hand.stepper.machine.outputs.probe is None
    hand(ON)
    for _ in range(3):
        hand(ON | HOMING)
        assert hand.stepper.machine.outputs.probe is not None


def test_velocity_cut_by_a_limit_of_the_drive_is_counted() -> None:
    hand = positioner(replace(CHOICES, max_velocity=1_000_000)).enable()
    hand(ON | ACTIVATE, MDI_TARPOS=10_000, MDI_VELOCITY=30_000)
    assert (hand.stepper.command.profile_velocity, hand.stepper.saturations) == (6000, 0)
    hand(ON, OPERATING | TAKEN)
    hand(ON | ACTIVATE, MDI_TARPOS=20_000, MDI_VELOCITY=1_000_000)
    assert (hand.stepper.command.profile_velocity, hand.stepper.saturations) == (6000, 1)


def test_no_old_value_is_shown_while_references_are_invalid() -> None:
    hand = homed(positioner)
    hand.feedback.velocity_actual = FAST
    hand(ON)
    assert hand.actuals["NIST_B"]
    hand.stepper.set_references(None)
    hand(ON)
    shown = hand.actuals
    assert not shown["POS_ZSW1"] & SHOWN.bit("HOMING").mask
    assert (shown["NIST_B"], shown["MELDW"]) == (0, 0)
