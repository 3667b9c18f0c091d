"""Telegrams 102 and 103: torque reduction and message word."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pdgw.gateway.axis.values import NodeNotice, Notice
from pdgw.gateway.reasons import FaultNumber
from pdgw.profidrive.signals import signal
from tests.support.axis.rig import Rig
from tests.support.drives.drive_types import References

OFF = 0x047E
_NAMES = {bit.name: bit.mask for bit in signal("MELDW").bits}


def messages(rig: Rig) -> set[str]:
    return {name for name, mask in _NAMES.items() if rig.actuals["MELDW"] & mask}


@pytest.mark.parametrize("number", [102, 103])
def test_worked_example_750_rpm_at_half_torque(number: int) -> None:
    rig = Rig(number)
    rig.enable(OFF)
    half = rig.stepper.telegram.setpoints
    data = bytes.fromhex("047F 1000 0000 0000 2000 0000") + bytes(2 * (number - 102))
    rig.values |= half.as_dict(half.decode(data))
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 28, 500)
    assert rig.stepper.command.target_velocity == 1500
    assert (rig.stepper.command.max_torque, rig.node.model.max_torque) == (1500, 1500)


def test_torque_limit_is_100_percent_without_a_plc() -> None:
    rig = Rig(102)
    rig.step(3, plc=False)
    assert rig.node.model.max_torque == 3000
    rig.enable(OFF)
    rig.values["MOMRED"] = 0x4000
    rig.step(3)
    assert rig.node.model.max_torque == 0
    rig.step(3, plc=False)
    assert rig.node.model.max_torque == 3000


def test_a_negative_reduction_reduces_nothing() -> None:
    rig = Rig(102)
    rig.enable(OFF)
    rig.values["MOMRED"] = -0x2000
    rig.step(3)
    assert rig.node.model.max_torque == 3000


def test_reduced_torque_accelerates_more_slowly() -> None:
    def cycles(reduction: int) -> int:
        rig = Rig(102)
        rig.node.set_data(0x6083, 0, (1000).to_bytes(4, "little"), check_writable=True)
        rig.enable(OFF)
        rig.values |= {"MOMRED": reduction, "NSOLL_B": 1 << 29}
        return rig.until(lambda actuals: actuals["NIST_B"] >= 1 << 28, 5000)

    assert cycles(0x3C00) > 2 * cycles(0)


def test_the_message_word_follows_the_drive() -> None:
    rig = Rig(102)
    rig.step(3)
    standing = {"TORQUE_BELOW_THRESHOLD", "SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
    cool = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}
    assert messages(rig) >= standing | cool
    assert not messages(rig) & {"CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"}
    rig.enable(OFF)
    assert messages(rig) >= {"CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"}
    rig.values["NSOLL_B"] = 1 << 29
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 29, 1000)
    rig.step(20)
    assert not messages(rig) & {"SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
    assert messages(rig) >= {"RAMP_COMPLETED", "SPEED_WITHIN_TOLERANCE"}


def test_a_drive_without_a_torque_limit_does_not_operate() -> None:
    rig = Rig(102)
    rig.stepper.set_references(replace(References(), max_torque=0))
    rig.step(2)
    assert [event.number for event in rig.stepper.events] == [FaultNumber.REFERENCE]
    assert "6072h" in rig.stepper.events[0].text
    assert rig.actuals["ZSW1"] & 0x0008


@pytest.mark.parametrize("number", [4, 103])
def test_missing_second_sensor_is_reported(number: int) -> None:
    rig = Rig(number)
    rig.step(3)
    assert (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST2"]) == (0x8000, 0x0F01)
    assert rig.actuals["G1_ZSW"] == 0


def test_telegram_4_is_telegram_3_with_more_words() -> None:
    rig = Rig(4)
    rig.enable(OFF)
    rig.values["NSOLL_B"] = 1 << 28
    rig.until(lambda actuals: actuals["NIST_B"] == 1 << 28, 500)
    assert rig.actuals["G1_XIST1"]


def test_zsw1_8_is_the_deviation_of_meldw_8() -> None:
    rig = Rig(102)
    rig.enable(OFF)
    mask = signal("ZSW1").bit("WITHIN_TOLERANCE").mask
    assert rig.actuals["ZSW1"] & mask
    rig.feedback.velocity_demand = 400
    rig._tpdos.clear()
    rig.step()
    assert not rig.actuals["ZSW1"] & mask
    assert "SPEED_WITHIN_TOLERANCE" not in messages(rig)


@pytest.mark.parametrize(
    ("code", "gone"),
    [(0x4310, "NO_MOTOR_OVERTEMPERATURE"), (0x4210, "NO_POWER_STAGE_OVERTEMPERATURE")],
)
def test_overtemperature_is_shown_until_it_ends_in_the_drive(code: int, gone: str) -> None:
    rig = Rig(102)
    rig.enable(OFF)
    both = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}
    assert both <= messages(rig)
    rig.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, code, 0x09))
    rig.step()
    assert messages(rig) & both == both - {gone}
    rig.stepper.machine.inputs.news.append(NodeNotice(Notice.EMERGENCY, "EMCY", rig.now, 0, 0))
    rig.step()
    assert both <= messages(rig)
