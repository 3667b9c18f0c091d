"""Endless axes: feed rolls and tables on drives that wrap at 607Bh, at 32 bit, or not at all."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import ControlBit, State, StatusBit
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.blocks import Block, BlockNext
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.peers.drive import ENGEL, ROTARY_AXIS
from pdgw.profidrive.datatypes import n4
from pdgw.profidrive.signals import signal
from tests.support.axis.hand import OPERATING, Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, engel

OFF, ON, ACTIVATE = 0x043E, 0x043F, 0x40
LU, UNITS = 10_000, 4096
"""Of one revolution."""
RANGE = (-10_000, 10_000)
"""607Bh: less than five turns."""
FEED = 2 * LU
ROLL = replace(CHOICES, software_limits=None, blocks=())
FRACTION = n4(500_000, (-(1 << 31), (1 << 31) - 1))
"""Of a position of telegram 9; ``drive_type`` keeps this 100 %."""
HOME_SET = signal("ZSW1").bit("HOME_POSITION_SET", positioning=True).mask
REACHED = signal("ZSW1").bit("TARGET_REACHED").mask
ABSOLUTE, RELATIVE = 0x8100, 0x8000


def drive_type(limits: tuple[int, int] | None, *, wraps: bool, confirmed: bool = True) -> DriveType:
    drive = engel(References(max_acceleration=2000, max_deceleration=2000))
    scaling = replace(drive.scaling, position_range=limits, position_wraps=wraps and limits is not None)
    source = "" if limits is None else "607Bh {} to {}".format(*limits)
    return replace(drive, scaling=replace(scaling, range_source=source, wrap_confirmed=confirmed))


def axis(
    number: int,
    limits: tuple[int, int] | None = RANGE,
    choices: PositionerChoices = ROLL,
    *,
    wraps: bool = True,
    confirmed: bool = True,
) -> Rig:
    """``wraps``: the drive does. Unless that is ``confirmed``, the gateway takes each drive for one that does."""
    rig = Rig(number, ROTARY_AXIS, replace(ENGEL, wraps=wraps and limits is not None), positioner=choices)
    for subindex, value in enumerate(limits or (0, 0), 1):
        rig.node.set_data(0x607B, subindex, value.to_bytes(4, "little", signed=True), check_writable=False)
    for index in (0x60C5, 0x60C6):
        rig.node.set_data(index, 0, (2000).to_bytes(4, "little"), check_writable=False)
    rig.stepper.set_drive(drive_type(limits, wraps=wraps or not confirmed, confirmed=confirmed), homing_method=35)
    rig.enable(OFF)
    rig.stepper.events.clear()
    if number == 9:
        rig.values |= {"SATZANW": 0x8000, "MDI_MOD": 0, "MDI_TARPOS": FRACTION.to_wire(FEED * UNITS // LU)}
        rig.values["MDI_VELOCITY"] = 1 << 29
    else:
        rig.values |= {"OVERRIDE": 0x4000, "MDI_TARPOS": FEED, "MDI_VELOCITY": 20_000}
        rig.values |= {"SATZANW": 0x8000, "MDI_MOD": 0} if number == 110 else {"POS_STW1": RELATIVE}
    rig.values |= {"MDI_ACC": 0x4000, "MDI_DEC": 0x4000, "STW1": ON}
    rig.step(2)
    return rig


def run(rig: Rig) -> float:
    """One task to its end: by how many increments the motor turned."""
    begin = rig.node.model.position
    rig.values["STW1"] = ON | ACTIVATE
    rig.until(lambda actuals: not actuals["ZSW1"] & REACHED, 50)
    rig.until(lambda actuals: bool(actuals["ZSW1"] & REACHED), 3000)
    rig.values["STW1"] = ON
    rig.step(3)
    return float(rig.node.model.position - begin)


def under_way(rig: Rig, begin: float, quarters: int) -> None:
    """So many quarters of a feed from ``begin``."""
    way = quarters * FEED * UNITS / LU / 4
    rig.until(lambda _: abs(rig.node.model.position - begin) > way, 500)
    assert not rig.actuals["ZSW1"] & REACHED


def refer(rig: Rig) -> None:
    """The present position is 0 from now on."""
    name = "POS_STW" if rig.stepper.telegram.number == 110 else "POS_STW2"
    rig.values[name] = signal(name).bit("SET_REFERENCE_POINT").mask
    rig.step(2)
    rig.values[name] = 0
    rig.step(30)
    assert abs(rig.actuals["XIST_A"]) <= 3


@pytest.mark.parametrize("number", [9, 110, 111])
@pytest.mark.parametrize("limits", [RANGE, None], ids=["wraps at 607Bh", "607Bh is 0/0"])
@pytest.mark.parametrize("direction", [1, -1])
def test_feed_roll_turns_on_over_every_wrap(number: int, limits: tuple[int, int] | None, direction: int) -> None:
    rig = axis(number, limits)
    rig.values["MDI_TARPOS"] *= direction
    if limits is None:  # 32 bit
        rig.node.model.zero -= direction * ((1 << 31) - 10_000)
        rig.node.model.command()
        rig.step(3)
    for _ in range(12):
        if number != 9:
            refer(rig)
        assert run(rig) == pytest.approx(direction * FEED * UNITS / LU, abs=2)
        if number != 9:
            assert rig.actuals["XIST_A"] == pytest.approx(direction * FEED, abs=5)
    assert rig.stepper.events == []
    assert rig.stepper.reason in (None, Reason.MDI_OFF)


@pytest.mark.parametrize("target", [2000, 5000, 8000])
def test_table_that_turns_only_forward_never_reaches_an_end(target: int) -> None:
    """607Bh is the modulo range, and the way leads over its end in each second task."""
    rig = axis(111, (0, UNITS), replace(ROLL, modulo=LU))
    forward = signal("POS_STW1").bit("POSITIVE_DIRECTION").mask
    rig.values["POS_STW1"] = ABSOLUTE | forward
    for turn in range(12):
        for place in (target, 0):
            rig.values["MDI_TARPOS"] = place
            assert run(rig) > 0
        assert rig.node.model.position == pytest.approx((turn + 1) * UNITS, abs=5)
    assert rig.stepper.events == []


@pytest.mark.parametrize("number", [9, 110, 111])
@pytest.mark.parametrize("direction", [1, -1])
def test_feed_that_is_interrupted_on_either_side_of_the_wrap_is_completed(number: int, direction: int) -> None:
    rig = axis(number)
    rig.values["MDI_TARPOS"] *= direction
    for turn in range(10):
        begin = rig.node.model.position
        rig.values["STW1"] = ON | ACTIVATE
        under_way(rig, begin, 1 + turn % 3)
        rig.values["STW1"] = (ON | ACTIVATE) & ~0x20
        rig.until(lambda actuals: rig.node.model.velocity_actual == 0, 500)
        rig.step(10)
        rig.values["STW1"] = ON | ACTIVATE
        rig.step(10)
        rig.until(lambda actuals: bool(actuals["ZSW1"] & REACHED), 3000)
        rig.values["STW1"] = ON
        rig.step(3)
        assert rig.node.model.position - begin == pytest.approx(direction * FEED * UNITS / LU, abs=4)
    assert rig.stepper.events == []


def test_override_that_changes_before_the_wrap_does_not_change_the_target() -> None:
    rig = axis(111)
    for turn in range(10):
        begin = rig.node.model.position
        rig.values |= {"STW1": ON | ACTIVATE, "OVERRIDE": 0x4000}
        under_way(rig, begin, 1 + turn % 3)
        rig.values["OVERRIDE"] = 0x2000
        rig.step(10)
        rig.until(lambda actuals: bool(actuals["ZSW1"] & REACHED), 3000)
        rig.values["STW1"] = ON
        rig.step(3)
        assert rig.node.model.position - begin == pytest.approx(FEED * UNITS / LU, abs=4)


def test_absolute_target_of_the_user_is_reached_in_any_turn_of_the_drive() -> None:
    rig = axis(111)
    refer(rig)
    rig.values["POS_STW1"] = ABSOLUTE
    for target in (30_000, 100_000, -100_000, 5_000, 24_000, 25_000, 0):
        rig.values["MDI_TARPOS"] = target
        run(rig)
        assert rig.node.model.position == pytest.approx(target * UNITS / LU, abs=15), "one increment for each wrap"
        assert rig.actuals["XIST_A"] == pytest.approx(target, abs=25)
    assert rig.stepper.events == []


def test_software_limits_are_places_of_the_user_over_the_wraps() -> None:
    rig = axis(111, choices=replace(ROLL, software_limits=(-60_000, 60_000)))
    refer(rig)
    rig.values |= {"POS_STW2": signal("POS_STW2").bit("SOFTWARE_LIMITS").mask, "MDI_TARPOS": 50_000}
    run(rig)
    run(rig)
    assert rig.actuals["XIST_A"] == pytest.approx(60_000, abs=25)
    (event,) = rig.stepper.events
    assert "software_limits -60000 to 60000 LU of the configuration" in event.text
    assert rig.stepper.reason is Reason.SOFTWARE_LIMIT


def test_flying_block_over_the_wrap_stops_before_it() -> None:
    """An absolute setpoint that waits in the drive cannot lead over the wrap."""
    blocks = (Block(1, 20_000, 12_000, next=BlockNext.FLYING), Block(2, 30_000, 12_000, next=BlockNext.FLYING))
    rig = axis(111, choices=replace(ROLL, blocks=(*blocks, Block(3, 35_000, 12_000))))
    rig.values["POS_STW1"] = 1
    rig.controlwords.clear()
    run(rig)
    assert not any(word & ControlBit.HALT for word in rig.controlwords)
    assert rig.node.model.position == pytest.approx(35_000 * UNITS / LU, abs=4)
    assert rig.stepper.events == []


def test_target_of_telegram_9_at_the_wrap_is_reached_on_either_side() -> None:
    """The last position of 607Bh may be shown as the first one."""
    rig = axis(9)
    rig.values |= {"MDI_MOD": 1, "MDI_TARPOS": FRACTION.to_wire(RANGE[1])}
    run(rig)
    assert rig.node.model.position_actual == RANGE[0]
    rig.step(600)
    assert rig.stepper.events == []


def test_target_of_telegram_9_is_the_drives_own_in_another_turn() -> None:
    rig = axis(9)
    run(rig)
    run(rig)
    rig.values |= {"MDI_MOD": 1, "MDI_TARPOS": FRACTION.to_wire(5000)}
    run(rig)
    assert (rig.stepper.command.target_position, rig.node.model.position_actual) == (5000, 5000)
    assert rig.stepper.events == []


def test_waiting_target_of_telegram_9_counts_in_the_turn_in_which_it_is_given() -> None:
    """The axis wraps while the drive still shows the acknowledge of the task before."""
    values = {"SATZANW": 0x8000, "MDI_VELOCITY": 1 << 29, "MDI_ACC": 1 << 14, "MDI_DEC": 1 << 14, "MDI_MOD": 1}
    hand = Hand(9, drive_type(RANGE, wraps=True), Mode.POSITION, values).enable()
    taken, reached = OPERATING | StatusBit.MODE_12, OPERATING | StatusBit.TARGET_REACHED
    for position in (9000, 9900):
        hand.feedback.position_actual = position
        hand(ON)
    hand(ON | ACTIVATE, MDI_TARPOS=FRACTION.to_wire(9990))
    hand(ON, taken)
    hand(ON | ACTIVATE, taken, MDI_TARPOS=FRACTION.to_wire(-5000))
    hand.feedback.position_actual = -9900
    hand(ON | ACTIVATE, taken)
    assert hand(ON | ACTIVATE) & ControlBit.NEW_SETPOINT
    assert hand.target == -5000
    hand(ON | ACTIVATE, taken)
    hand.feedback.position_actual = -5000
    for _ in range(600):
        hand(ON, reached)
    assert hand.actuals["ZSW1"] & REACHED
    assert hand.stepper.events == []


@pytest.mark.parametrize("number", [9, 111])
def test_position_in_another_turn_is_the_drives_own_after_a_loss(number: int) -> None:
    rig = axis(number)
    for _ in range(2):
        run(rig)
    rig.connected_drive = False
    rig.step(3)
    rig.connected_drive = True
    rig.enable(OFF)
    rig.stepper.events.clear()
    if number == 111:
        assert rig.actuals["XIST_A"] == pytest.approx(rig.node.model.position_actual * LU / UNITS, abs=2)
    rig.values["STW1"] = ON
    rig.step(3)
    assert run(rig) == pytest.approx(FEED * UNITS / LU, abs=2)


def test_homing_in_another_turn_sets_the_position_to_the_reference() -> None:
    rig = axis(111)
    for _ in range(2):
        run(rig)
    rig.values["STW1"] = ON | 0x800
    rig.until(lambda actuals: bool(actuals["ZSW1"] & HOME_SET), 500)
    assert rig.actuals["XIST_A"] == 0


def test_units_read_again_in_another_turn_keep_the_position() -> None:
    rig = axis(111)
    refer(rig)
    for _ in range(3):
        run(rig)
    before, drive = rig.actuals["XIST_A"], drive_type(RANGE, wraps=True)
    rig.stepper.set_drive(drive, homing_method=35)
    rig.step(3)
    assert rig.actuals["XIST_A"] == before == pytest.approx(3 * FEED, abs=10)
    assert rig.actuals["ZSW1"] & HOME_SET
    rig.stepper.set_drive(drive_type((-20_000, 20_000), wraps=True), homing_method=35)
    rig.step(3)
    assert not rig.actuals["ZSW1"] & HOME_SET, "positions wrap elsewhere"


# -- drives that do not wrap ----------------------------------------------------------------------------------------------


def refused(rig: Rig) -> str:
    """The text of the one warning of a task that is refused."""
    rig.stepper.events.clear()
    rig.values["STW1"] = ON | ACTIVATE
    begin = rig.node.model.position
    rig.step(20)
    rig.values["STW1"] = ON
    rig.step(3)
    assert rig.node.model.position == begin
    (event,) = rig.stepper.events
    assert event.number == FaultNumber.POSITIONER
    return event.text


def test_end_of_the_drive_refuses_a_feed_with_value_bound_and_source() -> None:
    rig = axis(111, wraps=False)
    refer(rig)
    run(rig)
    refer(rig)
    text = refused(rig)
    assert "end of the task 20000 LU, allowed -44414 to 4414 (607Bh -10000 to 10000 of the drive)" in text
    assert rig.stepper.reason is Reason.TASK_DRIVE_RANGE


@pytest.mark.parametrize(
    ("choices", "word", "target", "text"),
    [
        (replace(ROLL, modulo=LU), ABSOLUTE, LU, "target 10000 LU, allowed 0 to 9999 (modulo_range)"),
        (
            replace(ROLL, lu_per_revolution=100),
            RELATIVE,
            53_000_000,
            "distance 53000000 LU, allowed -52428800 to 52428800 (607Ah of the drive)",
        ),
    ],
)
def test_task_out_of_range_names_value_bound_and_source(
    choices: PositionerChoices, word: int, target: int, text: str
) -> None:
    rig = axis(111, None, choices)
    rig.values |= {"POS_STW1": word, "MDI_TARPOS": target}
    assert text in refused(rig)
    assert rig.stepper.reason is Reason.TASK_TARGET_RANGE


def test_feed_beyond_the_numbers_of_a_position_names_them() -> None:
    rig = axis(111, None, replace(ROLL, reference_coordinate=(1 << 31) - 1000))
    rig.values["POS_STW2"] = signal("POS_STW2").bit("SET_REFERENCE_POINT").mask
    rig.step(40)
    assert "end of the task 2147502648 LU, allowed -2147483648 to 2147483647 (32 bits of a position)" in refused(rig)


@pytest.mark.parametrize("confirmed", [False, True], ids=["expected to wrap", "known to end"])
def test_relative_task_of_telegram_9_ends_short_at_the_end_of_the_drive(confirmed: bool) -> None:
    rig = axis(9, wraps=False, confirmed=confirmed)
    run(rig)
    rig.values["STW1"] = ON | ACTIVATE
    rig.until(lambda actuals: rig.stepper.reason is Reason.TASK_AT_LIMIT, 3000)
    assert rig.node.model.position_actual == RANGE[1]
    assert not rig.actuals["ZSW1"] & REACHED


@pytest.mark.parametrize("number", [9, 110, 111])
def test_drive_that_ends_instead_of_wrapping_does_not_show_reached(number: int) -> None:
    """Only the profile says that it wraps: the drive shows "target reached" at the end of 607Bh."""
    rig = axis(number, wraps=False, confirmed=False)
    run(rig)
    rig.values["STW1"] = ON | ACTIVATE
    rig.until(lambda actuals: not actuals["ZSW1"] & REACHED, 50)
    rig.until(lambda actuals: rig.node.model.position_actual == RANGE[1], 3000)
    for _ in range(600):
        assert not rig.step()["ZSW1"] & REACHED
    assert rig.stepper.reason is Reason.TASK_AT_LIMIT


@pytest.mark.parametrize("number", [9, 111])
def test_drive_that_ends_without_a_limit_bit_is_reported_as_stalled(number: int) -> None:
    rig = axis(number, wraps=False, confirmed=False)
    rig.node.model.disguises.append(lambda model, _: setattr(model, "statusword", model.statusword & ~0x800))
    run(rig)
    rig.values["STW1"] = ON | ACTIVATE
    rig.until(lambda actuals: rig.stepper.reason is Reason.STANDS_AWAY, 3000)
    assert not rig.actuals["ZSW1"] & REACHED
    assert "positions wrap at 607Bh -10000 to 10000, as CiA 402 says (not confirmed" in rig.stepper.events[-1].text


def test_wrap_that_only_the_profile_says_counts_once_it_was_seen() -> None:
    rig = axis(111, confirmed=False)
    executor = rig.stepper.machine.executor
    assert "not confirmed" in executor.range_note
    for _ in range(3):
        assert run(rig) == pytest.approx(FEED * UNITS / LU, abs=2)
    assert executor.range_note == ""
    assert rig.state is State.OPERATION_ENABLED


def test_range_note_counts_the_turns_to_the_ends_of_the_drive() -> None:
    executor = axis(111, wraps=False).stepper.machine.executor
    assert executor.range_note == "positions end at 607Bh -10000 to 10000: 2.4 turns forward, 2.4 turns backward"
    limited = axis(111, wraps=False, choices=replace(ROLL, software_limits=(0, 100))).stepper.machine.executor
    assert limited.range_note == "", "the configuration ends them before"
