"""Sign of life of drives: STW2 and ZSW2 bits 12-15, P925, and what its loss does."""

from __future__ import annotations

import pytest

from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import State
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.sensor_states import SensorError
from pdgw.profidrive.sign_of_life import MONITORING_OFF, following
from pdgw.profidrive.signals import signal
from tests.support.axis.hand import Hand
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import engel

OFF, ON = 0x047E, 0x047F


def turning(number: int = 3, failures: int = 2) -> Rig:
    rig = Rig(number, sign_of_life_failures=failures)
    rig.enable(OFF)
    rig.values["NSOLL_B"] = 1 << 28
    return rig


def alive(rig: Rig, cycles: int) -> None:
    for _ in range(cycles):
        rig.values["STW2"] = following(rig.values["STW2"] >> 12) << 12
        rig.step()


def test_sign_of_life_has_the_same_bits_in_stw2_and_zsw2() -> None:
    assert signal("STW2").bit("SIGN_OF_LIFE").mask == signal("ZSW2").bit("SIGN_OF_LIFE").mask


@pytest.mark.parametrize("number", [2, 3, 9])
def test_gateway_counter_starts_with_the_first_sign_of_life_of_the_plc(number: int) -> None:
    rig = Rig(number, sign_of_life_failures=2)
    rig.step(20)
    assert rig.actuals["ZSW2"] == 0
    alive(rig, 3)
    assert rig.actuals["ZSW2"] == 0x3000


def test_plc_without_sign_of_life_is_not_monitored() -> None:
    rig = turning(failures=0)
    rig.step(50)
    assert rig.state is State.OPERATION_ENABLED
    assert not rig.stepper.events


def test_loss_stops_the_axis_with_fault_and_sensor_error_until_off_and_on() -> None:
    rig = turning()
    alive(rig, 100)
    assert rig.feedback.velocity_actual
    rig.step(2)
    assert not rig.stepper.events
    rig.step(2)
    assert rig.stepper.numbers == [FaultNumber.SIGN_OF_LIFE]
    assert rig.actuals["G1_XIST2"] == SensorError.CONTROLLER_SIGN_OF_LIFE
    assert rig.actuals["ZSW2"] == 0
    rig.step(300)
    assert (rig.feedback.velocity_actual, rig.state) == (0, State.SWITCH_ON_DISABLED)
    alive(rig, 100)
    assert rig.state is not State.OPERATION_ENABLED, "a standing ON starts nothing"
    rig.values["STW1"] = OFF
    alive(rig, 4)
    rig.values["STW1"] = ON
    alive(rig, 30)
    assert rig.state is State.OPERATION_ENABLED
    assert len(rig.stepper.events) == 1


def test_plc_that_counts_too_slowly_is_one_fault_that_names_p925() -> None:
    rig = turning(failures=3)
    for frame in range(1000):
        rig.values["STW2"] = frame // 8 % 15 + 1 << 12
        rig.step()
    (event,) = rig.stepper.events
    assert event.number == FaultNumber.SIGN_OF_LIFE
    assert "more than 3 frames (P925) in succession without the next counter" in event.text


def test_off2_without_sign_of_life_takes_the_voltage_off() -> None:
    rig = turning()
    alive(rig, 100)
    rig.step(4)
    assert rig.stepper.command.controlword & 0xF == 0x2, "the quick stop of a loss"
    rig.values["STW1"] = OFF & ~0x2
    rig.step()
    assert rig.stepper.command.controlword & 0xF == 0x0


def test_frame_without_control_after_a_loss_is_not_a_new_connection() -> None:
    """The gateway brakes a drive in operation that no PLC commanded, as without a PLC, until a frame with control arrives."""
    hand = Hand(2, engel(), Mode.VELOCITY, {}, sign_of_life_failures=0)
    hand(OFF, State.SWITCH_ON_DISABLED, STW2=1 << 12)
    hand(OFF, State.SWITCH_ON_DISABLED)
    assert hand.stepper.reason is Reason.PLC_LOST
    assert hand(OFF & ~0x400, State.OPERATION_ENABLED, STW2=2 << 12) & 0xF == 0x2
    for counter in range(3, 16):
        assert hand(OFF, State.SWITCH_ON_DISABLED, STW2=counter << 12) & 0xF != 0x6, "not yet 15 correct ones"
    assert hand(OFF, State.SWITCH_ON_DISABLED, STW2=1 << 12) & 0xF == 0x6


def test_tolerated_number_of_failures_has_no_effect() -> None:
    rig = turning()
    alive(rig, 20)
    for _ in range(10):
        rig.step(2)
        alive(rig, 1)
    assert rig.state is State.OPERATION_ENABLED


def test_p925_65535_answers_without_monitoring() -> None:
    rig = turning(failures=MONITORING_OFF)
    alive(rig, 5)
    rig.step(100)
    assert rig.state is State.OPERATION_ENABLED
    assert not rig.stepper.events


def test_new_connection_restarts_the_sign_of_life() -> None:
    rig = turning(failures=0)
    alive(rig, 10)
    rig.step(400, plc=False)
    rig.values["STW2"] = 0
    rig.values["STW1"] = OFF
    rig.step(10)
    rig.values["STW1"] = ON
    rig.step(20)
    assert rig.state is State.OPERATION_ENABLED


def test_p925_takes_effect_at_once() -> None:
    rig = turning(failures=MONITORING_OFF)
    alive(rig, 5)
    rig.stepper.machine.tolerate(0)
    alive(rig, 5)
    rig.step(1)
    assert rig.stepper.numbers == [FaultNumber.SIGN_OF_LIFE]


def test_counter_reset_to_0_is_a_failure_like_a_constant_counter() -> None:
    rig = turning()
    alive(rig, 20)
    rig.values["STW2"] = 0
    rig.step(3)
    assert rig.stepper.numbers == [FaultNumber.SIGN_OF_LIFE]
    rig.step(300)
    assert (rig.feedback.velocity_actual, rig.state) == (0, State.SWITCH_ON_DISABLED)


def test_p925_ends_a_loss_also_without_a_counter_of_the_plc() -> None:
    rig = turning(failures=0)
    alive(rig, 5)
    rig.values["STW2"] = 0
    rig.step(300)
    rig.stepper.machine.tolerate(2)
    rig.values["STW1"] = OFF
    rig.step(4)
    assert rig.actuals["ZSW2"] == 0
    rig.values["STW1"] = ON
    rig.step(20)
    assert rig.state is State.OPERATION_ENABLED


def test_p925_restarts_the_gateway_counter() -> None:
    rig = turning(failures=2)
    alive(rig, 5)
    rig.stepper.machine.tolerate(2)
    rig.values["STW2"] = 0
    rig.step(1)
    assert rig.actuals["ZSW2"] == 0


def test_a_loss_ends_with_its_connection() -> None:
    rig = turning(failures=0)
    alive(rig, 5)
    rig.step(300, plc=False)
    assert rig.actuals["ZSW2"] == 0, "there is no PLC to answer"
    alive(rig, 5)
    rig.step(5)
    rig.step(5, plc=False)
    rig.values |= {"STW2": 0, "STW1": OFF}
    rig.step(4)
    rig.values["STW1"] = ON
    rig.step(20)
    assert rig.state is State.OPERATION_ENABLED
