"""G2 of telegrams 4, 6, 103 and 106: the state machine of G1 with another position."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.gateway.axis.executors.sensor import EncoderReferences
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings, SecondSensor
from pdgw.gateway.reasons import FaultNumber
from pdgw.peers.drive.model.mode_of_operation import SECOND_ENCODER_STEPS
from pdgw.profidrive.encoder import SensorError
from pdgw.profidrive.signals import signal
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import DSC

OFF = 0x047E
NUMBERS = (4, 6, 103, 106)
STW = {bit.name: bit.mask for bit in signal("G2_STW").bits}
ZSW = {bit.name: bit.mask for bit in signal("G2_ZSW").bits}
ACTIVATE = 1 << signal("G2_STW").bit("COMMAND").position


def rig_of(number: int, second: SecondSensor = SecondSensor.DRIVE) -> Rig:
    dsc: dict[str, Any] = {"dsc": DSC} if number in {6, 106} else {}
    rig = Rig(number, second_sensor=second, **dsc)
    rig.values["STW1"] = OFF
    return rig


@pytest.mark.parametrize("number", NUMBERS)
def test_g2_is_the_position_of_the_drives_second_encoder(number: int) -> None:
    rig = rig_of(number)
    rig.enable(OFF)
    rig.values |= {"NSOLL_B": 1 << 28, "G2_STW": STW["REQUEST_ABSOLUTE"]}
    rig.until(lambda actuals: actuals["G2_XIST1"] > 5000, 500)
    assert rig.actuals["G2_ZSW"] == ZSW["ABSOLUTE_VALID"]
    assert rig.actuals["G2_XIST2"] == rig.actuals["G2_XIST1"]
    assert abs(rig.actuals["G2_XIST1"] - SECOND_ENCODER_STEPS * rig.actuals["G1_XIST1"]) < SECOND_ENCODER_STEPS
    assert (rig.actuals["G1_ZSW"], rig.actuals["G1_XIST2"]) == (0, 0), "each has its own control word"


@pytest.mark.parametrize("number", NUMBERS)
def test_without_a_source_g2_is_a_permanent_error(number: int) -> None:
    rig = rig_of(number, SecondSensor.NONE)
    for word in (0, STW["ERROR_ACKNOWLEDGE"], STW["PARK"], STW["REQUEST_ABSOLUTE"]):
        rig.values["G2_STW"] = word
        rig.step(2)
        shown = (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST1"], rig.actuals["G2_XIST2"])
        assert shown == (ZSW["ERROR"], 0, SensorError.COMMAND_NOT_SUPPORTED)
    assert rig.actuals["G1_ZSW"] == 0


@pytest.mark.parametrize(
    "word", [STW["PRESET"], STW["MODE"] | ACTIVATE | STW["FUNCTION_1"], ACTIVATE | STW["FUNCTION_1"]]
)
def test_unsupported_command_to_g2_is_an_error_until_acknowledged(word: int) -> None:
    rig = rig_of(4)
    rig.step(3)
    rig.values["G2_STW"] = word
    rig.step(2)
    assert (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST2"]) == (ZSW["ERROR"], SensorError.COMMAND_NOT_SUPPORTED)
    assert rig.actuals["G1_ZSW"] == 0, "G1 is not concerned"
    rig.values["G2_STW"] = STW["ERROR_ACKNOWLEDGE"]
    rig.step(2)
    assert rig.actuals["G2_ZSW"] == ZSW["ERROR"] | ZSW["ERROR_ACKNOWLEDGED"]
    rig.values["G2_STW"] = 0
    rig.step(2)
    assert (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST2"]) == (0, 0)


def test_parked_g2_is_constant_and_continues_from_there() -> None:
    rig = rig_of(4)
    rig.enable(OFF)
    rig.values |= {"NSOLL_B": 1 << 28, "G2_STW": STW["PARK"]}
    rig.step(2)
    parked = rig.actuals["G2_XIST1"]
    rig.step(50)
    assert (rig.actuals["G2_ZSW"], rig.actuals["G2_XIST1"]) == (ZSW["PARKED"], parked)
    assert rig.actuals["G1_XIST1"] > 500
    rig.values["G2_STW"] = 0
    rig.step(2)
    first = rig.actuals["G2_XIST1"]
    rig.step(10)
    assert parked <= first < rig.actuals["G2_XIST1"], "it follows again"
    assert rig.actuals["G2_ZSW"] == 0


def test_a_sign_of_life_that_is_lost_is_the_error_of_both_sensors() -> None:
    rig = Rig(103, second_sensor=SecondSensor.DRIVE, sign_of_life_failures=3)
    life = signal("STW2").bit("SIGN_OF_LIFE").position
    for counter in (1, 2, 3):
        rig.values["STW2"] = counter << life
        rig.step()
    rig.step(10)
    for sensor in ("G1", "G2"):
        assert rig.actuals[f"{sensor}_ZSW"] == ZSW["ERROR"], sensor
        assert rig.actuals[f"{sensor}_XIST2"] == SensorError.CONTROLLER_SIGN_OF_LIFE, sensor


@pytest.mark.parametrize("place", [0, 1])
def test_encoder_with_an_impossible_range_is_reported_without_a_position(place: int) -> None:
    settings = AxisSettings(g1_is_encoder=True, second_sensor=SecondSensor.ENCODER)
    machine = AxisMachine(4, settings, DriveFeedback())
    machine.set_references(place, EncoderReferences((1 << 64) + 1, Fraction(1)))
    (fault,) = machine.step().faults
    assert fault.number == FaultNumber.REFERENCE
    assert f"G{place + 1}: total measuring range" in fault.text
    sensor = (machine.sensor, machine.second_sensor)[place]
    assert sensor is not None
    assert not sensor.channel.valid
