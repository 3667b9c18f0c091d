"""Jog of the speed telegrams: STW1.8 and .9 with .4 to .6 = 0, begun at standstill."""

from __future__ import annotations

from fractions import Fraction

import pytest

from pdgw.gateway.axis.settings import SetpointEnable
from pdgw.gateway.reasons import Reason
from tests.support.axis.rig import Rig

OFF, READY = 0x040E, 0x040F
"""STW1.4 to .6 are 0."""
RUN = 0x0070
JOG_1, JOG_2 = 0x0100, 0x0200
SPEEDS = (Fraction(-100), Fraction(250))
UNITS = (-200, 500)
"""In half rpm."""


def axis(number: int = 1, **settings: object) -> Rig:
    rig = Rig(number, **({"jog_speeds_rpm": SPEEDS} | settings))
    rig.enable(OFF)
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
    assert rig.stepper.reason is Reason.SETPOINT_DISABLED


def test_the_other_jog_begins_only_at_standstill() -> None:
    rig = axis()
    assert jog(rig, JOG_2) == UNITS[1]
    rig.values["STW1"] = READY | JOG_1
    rig.step()
    assert rig.stepper.command.target_velocity == 0
    assert jog(rig, JOG_1) == UNITS[0], "it stood meanwhile"


def test_jog_does_not_start_from_a_speed_setpoint() -> None:
    rig = axis()
    rig.values["NSOLL_A"] = 0x2000
    rig.values["STW1"] = READY | RUN
    rig.step(200)
    rig.values["STW1"] = READY | JOG_2
    rig.step()
    assert rig.stepper.command.target_velocity == 0


def test_jog_bits_are_ignored_with_an_enabled_setpoint() -> None:
    rig = axis()
    rig.values["STW1"] = READY | RUN | JOG_2
    rig.step(100)
    assert rig.feedback.velocity_actual == 0


def test_jog_bits_are_ignored_without_jog_speeds_or_with_the_guides_rule() -> None:
    for rig in (axis(jog_speeds_rpm=None), axis(setpoint_enable=SetpointEnable.HOLD)):
        assert jog(rig, JOG_2) == 0


def test_leaving_operation_ends_a_jog_and_its_bit_starts_nothing() -> None:
    rig = axis()
    jog(rig, JOG_2)
    rig.values["STW1"] = OFF | JOG_2
    rig.step(200)
    assert rig.feedback.velocity_actual == 0
    rig.step(3, plc=False)
    assert rig.stepper.command.target_velocity == 0
