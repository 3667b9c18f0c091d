"""ZSW1.10 "speed reached": 1 only while the setpoint on the wire is the PLC's and the drive follows it."""

from __future__ import annotations

import pytest

from pdgw.dsp402.states import STATUS_OF, State, StatusBit
from pdgw.durations import MS
from pdgw.gateway.reasons import Reason
from tests.gateway.axis.test_velocity import OFF, ON, Bench
from tests.support.drives.drive_types import References, described

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
