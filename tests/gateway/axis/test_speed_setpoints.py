"""Speed setpoints: jog (STW1.8 and .9), freeze (STW1.5 = 0), and ZSW1.10 "speed reached"."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import pytest

from pdgw.base.durations import MS
from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.gateway.axis.settings import SetpointEnable
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.dsc_setpoint import DscChoices, DscForm
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References, described

# -- jog with STW1.4 to .6 = 0, begun at standstill ---------------------------------------------------------------


JOG_OFF, READY = 0x040E, 0x040F
"""STW1.4 to .6 are 0."""
ENABLED = 0x0070
JOG_1, JOG_2 = 0x0100, 0x0200
SPEEDS = (Fraction(-100), Fraction(250))
UNITS = (-200, 500)
"""In half rpm."""


def axis(number: int = 1, **settings: object) -> Rig:
    rig = Rig(number, **({"jog_speeds_rpm": SPEEDS} | settings))
    rig.enable(JOG_OFF)
    return rig


def jog(rig: Rig, bits: int, cycles: int = 100) -> int:
    """Velocity after a while with these bits."""
    rig.values["STW1"] = READY | bits
    rig.step(cycles)
    return rig.feedback.velocity_actual


@pytest.mark.parametrize("number", [1, 2, 3, 4, 20, 102, 103])
def test_each_jog_bit_has_its_speed_and_both_or_none_mean_standstill(number: int) -> None:
    rig = axis(number)
    for bits, expected in ((JOG_1, UNITS[0]), (0, 0), (JOG_2, UNITS[1]), (JOG_1 | JOG_2, 0)):
        assert jog(rig, bits) == expected
    assert rig.stepper.reason is Reason.LOST_JOG
    jog(rig, 0)
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED


def test_the_other_jog_begins_only_at_standstill() -> None:
    rig = axis()
    assert jog(rig, JOG_2) == UNITS[1]
    rig.values["STW1"] = READY | JOG_1
    rig.step()
    assert rig.stepper.command.target_velocity == 0
    assert jog(rig, JOG_1) == UNITS[0], "it was at standstill in between"


def test_jog_does_not_start_from_a_speed_setpoint() -> None:
    rig = axis()
    rig.values["NSOLL_A"] = 0x2000
    rig.values["STW1"] = READY | ENABLED
    rig.step(200)
    rig.values["STW1"] = READY | JOG_2
    rig.step()
    assert rig.stepper.command.target_velocity == 0


def test_jog_bits_are_ignored_with_an_enabled_setpoint() -> None:
    rig = axis()
    rig.values["STW1"] = READY | ENABLED | JOG_2
    rig.step(100)
    assert rig.feedback.velocity_actual == 0


def test_jog_bits_are_ignored_without_jog_speeds_or_with_the_guides_rule() -> None:
    for rig in (axis(jog_speeds_rpm=None), axis(setpoint_enable=SetpointEnable.HOLD)):
        assert jog(rig, JOG_2) == 0


def test_leaving_operation_ends_a_jog_and_its_bit_starts_nothing() -> None:
    rig = axis()
    jog(rig, JOG_2)
    rig.values["STW1"] = JOG_OFF | JOG_2
    rig.step(200)
    assert rig.feedback.velocity_actual == 0
    rig.step(3, plc=False)
    assert rig.stepper.command.target_velocity == 0


# -- STW1.5 = 0 makes the demand speed of that moment the target --------------------------------------------------


FROZEN, RUN = 0x045F, 0x047F
FULL_SPEED = 6000
"""3000 rpm in half rpm."""
WITHIN_TOLERANCE = 1 << 8
RAMPED = [1, 2, 3, 4, 20, 102, 103]


def accelerating(number: int, cycles: int = 14, **settings: object) -> Rig:
    """Under way from 0 to 100 %."""
    rig = Rig(number, **settings)
    rig.enable(0x047E)
    rig.values |= {"NSOLL_A": 0x4000} if "NSOLL_A" in rig.values else {"NSOLL_B": 0x4000_0000}
    rig.step(cycles)
    assert 0 < rig.feedback.velocity_actual < FULL_SPEED, "on the ramp"
    return rig


def stepped(rig: Rig, demand: int) -> Sequence[int]:
    """The actual values of a cycle in which the drive gives this demand speed."""
    rig.feedback.velocity_demand = demand
    setpoints = rig.stepper.telegram.setpoints.from_dict(rig.values)
    return rig.stepper.step(setpoints, rig.feedback, True, rig.now)


@pytest.mark.parametrize("number", RAMPED)
def test_freeze_makes_the_demand_speed_of_the_edge_the_target(number: int) -> None:
    rig = accelerating(number)
    rig.values["STW1"] = FROZEN
    rig.step()
    edge = rig.feedback.velocity_demand
    assert rig.stepper.command.target_velocity == edge
    rig.step(300)
    assert rig.feedback.velocity_actual == edge
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED
    rig.values["STW1"] = RUN
    rig.step(500)
    assert rig.feedback.velocity_actual == FULL_SPEED, "the ramp goes on to the setpoint"


@pytest.mark.parametrize("number", [1, 3, 20, 102])
def test_freeze_without_a_demand_value_uses_the_actual_speed(number: int) -> None:
    rig = accelerating(number)
    rig.values["STW1"] = FROZEN
    words = stepped(rig, DEMAND_UNKNOWN)
    assert rig.stepper.command.target_velocity == rig.feedback.velocity_actual
    assert not words[0] & WITHIN_TOLERANCE


def test_freeze_while_the_axis_slows_down_keeps_the_speed() -> None:
    rig = accelerating(1, cycles=600 // 4)
    rig.values["NSOLL_A"] = 0
    rig.step(5)
    rig.values["STW1"] = FROZEN
    rig.step()
    edge = rig.stepper.command.target_velocity
    assert edge > 0
    rig.values["NSOLL_A"] = -0x4000
    rig.step(200)
    assert rig.feedback.velocity_actual == edge, "another setpoint counts once the ramp is released"


def test_freeze_at_the_start_of_operation_is_standstill() -> None:
    rig = Rig(1)
    rig.values["NSOLL_A"] = 0x4000
    rig.enable(0x045E)
    rig.step(50)
    assert rig.feedback.velocity_actual == rig.stepper.command.target_velocity == 0


def test_freeze_does_not_outlast_an_off() -> None:
    rig = accelerating(1)
    rig.values["STW1"] = FROZEN
    rig.step(20)
    rig.values["STW1"] = FROZEN & ~1
    rig.until(lambda _: rig.feedback.velocity_actual == 0)
    rig.values["STW1"] = FROZEN
    rig.step(50)
    assert rig.stepper.command.target_velocity == 0


def test_setpoint_enable_hold_keeps_the_target_not_the_ramp() -> None:
    rig = accelerating(1, setpoint_enable=SetpointEnable.HOLD)
    rig.values["STW1"] = FROZEN
    rig.step(500)
    assert rig.feedback.velocity_actual == FULL_SPEED


@pytest.mark.parametrize("form", DscForm)
@pytest.mark.parametrize("number", [5, 6, 105, 106])
def test_freeze_keeps_the_speed_in_telegrams_with_dsc(number: int, form: DscForm) -> None:
    rig = Rig(number, dsc=DscChoices(form, following_window=4096))
    rig.enable(0x047E)
    rig.values["NSOLL_B"] = 0x1000_0000
    rig.step(100)
    speed = rig.feedback.velocity_actual
    assert speed == pytest.approx(FULL_SPEED // 4, abs=20)
    rig.values |= {"STW1": FROZEN, "NSOLL_B": 0x4000_0000}
    rig.step(100)
    assert rig.feedback.velocity_actual == pytest.approx(speed, abs=20)
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED
    rig.values["STW1"] = 0x040F
    rig.step(200)
    assert rig.feedback.velocity_actual > FULL_SPEED // 2, "with STW1.4 to .6 all 0 the speed stays in force"


@pytest.mark.parametrize("number", [1, 2, 3, 4, 20])
def test_zsw1_8_shows_that_the_speed_follows_the_demand(number: int) -> None:
    rig = accelerating(number)
    assert rig.actuals["ZSW1"] & WITHIN_TOLERANCE
    assert not stepped(rig, rig.feedback.velocity_actual + FULL_SPEED // 50)[0] & WITHIN_TOLERANCE


# -- ZSW1.10 is 1 only while the drive follows the setpoint of the PLC --------------------------------------------


REACHED = 0x0400
"""ZSW1.10 and bit 10 of the Statusword."""


def shown(bench: Bench, setpoint: int, velocity: int, extra: int = REACHED) -> int:
    """ZSW1.10 with a Statusword that says "reached" (unless ``extra`` says otherwise) at this actual speed."""
    feedback = bench.drive.feedback
    feedback.statusword, feedback.velocity_actual = STATUS_OF[State.OPERATION_ENABLED] | extra, velocity
    bench.now += 4 * MS
    half = bench.stepper.telegram.setpoints
    values = half.from_dict({"STW1": ON, "NSOLL_A": setpoint})
    return bench.stepper.step(values, feedback, True, bench.now)[0] & REACHED


def test_speed_reached_is_not_shown_for_an_older_setpoint() -> None:
    bench = Bench()
    bench.operate(0x2000)
    assert shown(bench, 0x2000, 3000)
    assert not shown(bench, 0x1000, 3000), "the Statusword is older than the setpoint"
    assert not shown(bench, 0x1000, 2000)
    assert not shown(bench, 0x1000, 2000, 0), "the drive follows the new one"
    assert shown(bench, 0x1000, 1500)


@pytest.mark.parametrize("shape", ["vl", "csv"])
def test_speed_reached_of_a_mode_without_bit_10_is_decided_by_the_speed(shape: str) -> None:
    """In modes 2 (vl, frequency converters) and 9 (csv), bit 10 of the Statusword is reserved."""
    bench = Bench()
    bench.stepper.set_drive(described(shape))
    bench.operate(0x2000)
    target = bench.stepper.command.target_velocity
    assert target
    assert not shown(bench, 0x2000, target // 2, 0)
    assert shown(bench, 0x2000, target, 0)
    assert not shown(bench, 0x1000, target, 0)


def test_speed_reached_is_not_shown_at_a_limit_switch() -> None:
    bench = Bench()
    bench.operate(0x2000)
    for _ in range(200):
        at_limit = shown(bench, 0x2000, 0, REACHED | StatusBit.INTERNAL_LIMIT)
    assert bench.stepper.command.target_velocity == 0
    assert not at_limit
    assert bench.stepper.reason is Reason.STOPPED_AT_LIMIT


def test_speed_reached_is_not_shown_while_a_limit_reduces_the_setpoint() -> None:
    bench = Bench(references=References(max_motor_speed=20000))
    bench.operate(0x7FFF)
    assert bench.stepper.command.target_velocity == 32767
    assert not shown(bench, 0x7FFF, 32767), "the drive has 32767, the PLC asked for 39999"


def test_speed_reached_is_not_shown_during_a_ramp_stop() -> None:
    bench = Bench()
    bench.operate(0x2000)
    bench.drive.feedback.statusword |= REACHED
    half = bench.stepper.telegram.setpoints
    zsw1 = bench.stepper.step(half.from_dict({"STW1": OFF}), bench.drive.feedback, True, bench.now + MS)[0]
    assert bench.controlword & 0xF == 0xF
    assert not zsw1 & REACHED
