"""Modulo axes on simulated drives: one that counts on, one that wraps at 607Bh, and the end of 32 bit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.dsp402.drive_type import DriveType
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.requests import PositionerChoices
from pdgw.peers.drive import ENGEL, ROTARY_AXIS
from pdgw.profidrive.signals import signal
from tests.support.axis.hand import Hand
from tests.support.axis.positioner import CHOICES
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, engel

OFF, ON = 0x043E, 0x043F
LU, UNITS = 10_000, 4096
"""Of one revolution, which is the modulo range."""
TABLE = replace(CHOICES, modulo=LU, software_limits=None, blocks=())
REACHED = signal("ZSW1").bit("TARGET_REACHED").mask
POSITIVE = signal("POS_STW1").bit("POSITIVE_DIRECTION").mask
NEGATIVE = signal("POS_STW1").bit("NEGATIVE_DIRECTION").mask
MDI_ABSOLUTE = 0x8100


def drive_type(*, wraps: bool) -> DriveType:
    drive = engel(References(max_acceleration=2000, max_deceleration=2000))
    scaling = replace(drive.scaling, position_range=(0, UNITS) if wraps else None, position_wraps=wraps)
    return replace(drive, scaling=scaling)


def table(number: int = 111, choices: PositionerChoices = TABLE, *, wraps: bool) -> Rig:
    shape = replace(ENGEL, habits={"position-wraps": {}}) if wraps else ENGEL
    rig = Rig(number, ROTARY_AXIS, shape, positioner=choices)
    values = ((0x607B, 1, 0), (0x607B, 2, UNITS if wraps else 0), (0x60C5, 0, 2000), (0x60C6, 0, 2000))
    for index, subindex, value in values:
        rig.node.set_data(index, subindex, value.to_bytes(4, "little"), check_writable=False)
    rig.stepper.set_drive(drive_type(wraps=wraps), homing_method=35)
    rig.enable(OFF)
    rig.stepper.events.clear()
    rig.values |= {"OVERRIDE": 0x4000, "MDI_ACC": 0x4000, "MDI_DEC": 0x4000}
    return rig


def test_g1_xist1_counts_across_the_wrap_of_the_drive() -> None:
    hand = Hand(3, drive_type(wraps=True), 3, {"G1_STW": 0x2000})
    shown = []
    for position in (UNITS - 1, UNITS, 0, 1, 0, UNITS):
        hand.feedback.position_actual = position
        hand(OFF)
        shown.append((hand.actuals["G1_XIST1"] - UNITS, hand.actuals["G1_XIST2"]))
    assert shown == [(-1, UNITS - 1), (0, UNITS), (1, 0), (2, 1), (1, 0), (0, UNITS)]


def in_range_and_reached(actuals: dict[str, int]) -> bool:
    assert 0 <= actuals["XIST_A"] < LU
    return bool(actuals["ZSW1"] & REACHED)


def go(rig: Rig, target: int, direction: int = 0, velocity: int = 12_000) -> float:
    """A task to its end; how far the motor turned, in increments."""
    begin = rig.node.model.position
    rig.values |= {
        "MDI_TARPOS": target,
        "MDI_VELOCITY": velocity,
        "POS_STW1": MDI_ABSOLUTE | direction,
        "STW1": ON | 0x40,
    }
    rig.until(lambda actuals: not actuals["ZSW1"] & REACHED, 50)
    rig.until(in_range_and_reached, 3000)
    rig.values["STW1"] = ON
    rig.step(3)
    return float(rig.node.model.position - begin)


@pytest.mark.parametrize("wraps", [False, True], ids=["counts on", "wraps at 607Bh"])
def test_mdi_turns_in_the_direction_asked_for_over_the_end_of_the_range(wraps: bool) -> None:
    rig = table(wraps=wraps)
    quarter = UNITS / 4
    assert go(rig, 2500) == pytest.approx(quarter, abs=2)
    assert go(rig, 7500, NEGATIVE) == pytest.approx(-2 * quarter, abs=2)
    assert rig.actuals["XIST_A"] == pytest.approx(7500, abs=3)
    assert go(rig, 0) == pytest.approx(quarter, abs=2), "the shortest way leads over the end"
    assert go(rig, 9000, POSITIVE) == pytest.approx(0.9 * UNITS, abs=3)
    assert go(rig, 1000, POSITIVE) == pytest.approx(0.2 * UNITS, abs=3)
    for _ in range(5):
        assert go(rig, 5000, POSITIVE) + go(rig, 0, POSITIVE) > 0.5 * UNITS
    assert rig.actuals["XIST_A"] in {0, *range(LU - 3, LU), 1, 2, 3}, "no creeping over the turns"
    assert rig.stepper.events == []


@pytest.mark.parametrize("wraps", [False, True], ids=["counts on", "wraps at 607Bh"])
def test_a_task_over_the_end_that_replaces_a_running_one_ends_at_its_target(wraps: bool) -> None:
    rig = table(wraps=wraps)
    rig.values |= {"MDI_TARPOS": 4000, "MDI_VELOCITY": 12_000, "POS_STW1": MDI_ABSOLUTE, "STW1": ON | 0x40}
    rig.until(lambda actuals: actuals["XIST_A"] > 1500, 500)
    rig.values["STW1"] = ON
    rig.step(3)
    begin = rig.node.model.position
    rig.values |= {"MDI_TARPOS": 9500, "POS_STW1": MDI_ABSOLUTE | POSITIVE, "STW1": ON | 0x40}
    rig.step(3)
    rig.until(lambda actuals: actuals["ZSW1"] & REACHED, 3000)
    assert rig.actuals["XIST_A"] == pytest.approx(9500, abs=20)
    rig.values["STW1"] = ON
    rig.step(3)
    rig.values |= {"MDI_TARPOS": 9000, "STW1": ON | 0x40}
    rig.until(lambda actuals: actuals["XIST_A"] < 5000, 1000)
    rig.values |= {"STW1": ON & ~0x20 | 0x40}  # intermediate stop, on the other side of the end
    rig.step(300)
    rig.values["STW1"] = ON | 0x40
    rig.until(lambda actuals: actuals["ZSW1"] & REACHED, 3000)
    assert rig.actuals["XIST_A"] == pytest.approx(9000, abs=20)
    assert rig.node.model.position - begin > 0.5 * UNITS


@pytest.mark.parametrize("wraps", [False, True], ids=["counts on", "wraps at 607Bh"])
def test_setting_up_and_relative_tasks_turn_without_limit(wraps: bool) -> None:
    rig = table(wraps=wraps)
    rig.values |= {"MDI_VELOCITY": 12_000, "POS_STW1": 0xC000 | POSITIVE, "STW1": ON | 0x40}
    rig.until(lambda actuals: in_range_and_reached(actuals) or rig.node.model.position > 3.3 * UNITS, 3000)
    rig.values["STW1"] = ON & ~0x10
    rig.until(lambda actuals: actuals["ZSW1"] & REACHED, 500)
    rig.values["STW1"] = ON
    rig.step(3)
    before, begin = rig.actuals["XIST_A"], rig.node.model.position
    rig.values |= {"MDI_TARPOS": -25_000, "POS_STW1": 0x8000, "STW1": ON | 0x40}
    rig.step(5)
    rig.until(lambda actuals: actuals["ZSW1"] & REACHED, 3000)
    assert rig.node.model.position - begin == pytest.approx(-2.5 * UNITS, abs=3)
    assert (rig.actuals["XIST_A"] - before + 5000) % LU == pytest.approx(0, abs=3) or (
        rig.actuals["XIST_A"] - before + 5000
    ) % LU > LU - 3


def test_continuous_position_crosses_the_32_bit_overflow() -> None:
    rig = table(wraps=False)
    model = rig.node.model
    go(rig, 100)
    model.zero -= (1 << 31) - 1000
    model.command()
    rig.step(3)
    begin = rig.actuals["XIST_A"]
    moved = go(rig, (begin + 5000) % LU, POSITIVE)
    assert moved == pytest.approx(UNITS / 2, abs=3)
    assert rig.node.model.position_actual < 0, "6064h begins anew"
    assert go(rig, begin, NEGATIVE) == pytest.approx(-UNITS / 2, abs=3)


def test_drive_with_another_modulo_range_is_rejected() -> None:
    rig = Rig(111, ROTARY_AXIS, positioner=replace(TABLE, modulo=9000))
    rig.stepper.set_drive(drive_type(wraps=True), homing_method=35)
    rig.step(2)
    assert rig.stepper.numbers == [FaultNumber.REFERENCE]
    assert "modulo_range" in rig.stepper.events[0].text
    assert "607Bh 0 to 4096" in rig.stepper.events[0].text


def test_telegram_110_has_its_directions_in_mdi_mod() -> None:
    rig = table(110, wraps=False)
    mod = {bit.name: bit.mask for bit in signal("MDI_MOD").bits}
    rig.values |= {"SATZANW": 0x8000, "MDI_TARPOS": 2500, "MDI_VELOCITY": 12_000, "STW1": ON | 0x40}
    rig.values["MDI_MOD"] = mod["ABSOLUTE"] | mod["NEGATIVE_DIRECTION"]
    rig.step(5)
    rig.until(lambda actuals: actuals["ZSW1"] & REACHED, 3000)
    assert rig.node.model.position == pytest.approx(-0.75 * UNITS, abs=3)
    assert rig.actuals["XIST_A"] == pytest.approx(2500, abs=3)


@pytest.mark.parametrize(("turns", "refused"), [(524_287, False), (524_289, True), (-524_287, False), (-524_289, True)])
def test_relative_task_is_limited_to_the_range_of_one_setpoint(turns: int, refused: bool) -> None:
    rig = table(choices=replace(TABLE, lu_per_revolution=1000, modulo=1000), wraps=False)
    rig.values |= {"MDI_TARPOS": 1000 * turns, "MDI_VELOCITY": 3000, "POS_STW1": 0x8000, "STW1": ON}
    rig.step(2)
    rig.values["STW1"] = ON | 0x40
    rig.step(20)
    assert (rig.stepper.reason is Reason.TASK_TARGET_RANGE) is refused
    assert rig.stepper.command.target_position == (0 if refused else UNITS * turns)
