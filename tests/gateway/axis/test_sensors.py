"""Encoders in virtual time: telegrams 81 to 84 with simulated encoders, and G2 of telegrams 4, 6, 103 and 106."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp406.images import PARAMETER_OBJECTS, EncoderParameters
from pdgw.dsp406.kinds import LINEAR, MULTI_SENSOR, ROTARY, EncoderDevice
from pdgw.gateway.axis.executors.sensor import EncoderReferences
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings, SecondSensor, SensorSettings
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.peers.drive.model.ramps import SECOND_ENCODER_STEPS
from pdgw.peers.encoder.encoder import SimulatedEncoderNode
from pdgw.peers.encoder.motion import Motion, constant_speed
from pdgw.profidrive.sensor_states import SensorError
from pdgw.profidrive.signals import signal
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.rig import Rig
from tests.support.axis.stepper import DSC, EncoderStepper

# -- telegrams 81 to 84 -------------------------------------------------------------------------------------------


CONTROL = 0x0400
ABSOLUTE, PRESET, RELATIVE = 0x2000, 0x1000, 0x0800
RPM = Fraction(3000)
MM_PER_SECOND = Fraction(1000)


class EncoderRig:
    """A machine joined to one channel of a simulated encoder; SDO writes are answered after ``delay`` cycles."""

    def __init__(
        self, number: int, device: EncoderDevice, motions: list[Motion], channel: int = 1, delay: int = 2
    ) -> None:
        self.node = SimulatedEncoderNode(3, lambda _can_id, _data: None, device=device, motions=motions)
        self.channel = channel
        self.multi = bool(device.channels > 1)
        self.delay = delay
        self.now = 0
        self.age = 0
        self.stepper = EncoderStepper(number, SensorSettings())
        self.node.start(0)
        self.node.poll(0)
        self.linear = device.is_linear
        self.read_references()

    def read_references(self) -> None:
        present = set(self.node.entries)
        values = {name: self.value(i, s) for name, i, s in PARAMETER_OBJECTS if (i, s) in present}
        parameters = EncoderParameters(**values)
        self.total_range = parameters.total_range
        channel = self.channel if self.multi else None
        if self.linear:
            self.stepper.set_references(EncoderReferences.linear(parameters, MM_PER_SECOND, channel))
        else:
            self.stepper.set_references(EncoderReferences.rotary(parameters, RPM, channel))

    def value(self, index: int, subindex: int = 0) -> int:
        return int(self.node.read(index, subindex))

    # What the machine reads of an encoder.

    @property
    def position(self) -> int:
        return self.value(0x6020, self.channel) if self.multi else self.value(0x6004)

    @property
    def position_time(self) -> int:
        return self.now

    @property
    def speed(self) -> int | None:
        return self.value(0x6030, self.channel) if self.multi else None

    @property
    def alarms(self) -> int:
        return self.value(0x6503)

    @property
    def warnings(self) -> int:
        return self.value(0x6505)

    @property
    def error_register(self) -> int:
        return self.value(0x1001)

    @property
    def error_code(self) -> int:
        return 0

    @property
    def valid(self) -> bool:
        return True

    def step(self, g1_stw: int, cycles: int = 1) -> dict[str, int]:
        for _ in range(cycles):
            self.now += 4 * MS
            self.node.poll(self.now)
            actuals = self.stepper.step((CONTROL, g1_stw), self, True, self.now)
            self._serve()
        return self.stepper.telegram.actuals.as_dict(actuals)

    def _serve(self) -> None:
        request = self.stepper.sdo_request
        self.age = self.age + 1 if request is not None else 0
        if request is not None and self.age > self.delay:
            for write in request:
                self.node.set_data(write.index, write.subindex, write.value.to_bytes(4, "little"), check_writable=True)
            self.stepper.sdo_done(None)


@settings(max_examples=40)
@given(
    value=st.integers(0, 4095),
    relative=st.booleans(),
    speed=st.floats(-2, 2),
    delay=st.integers(0, 4),
    device=st.sampled_from([(ROTARY, 1), (LINEAR, 1), (MULTI_SENSOR, 2)]),
)
def test_preset_then_read_gives_the_preset(
    value: int, relative: bool, speed: float, delay: int, device: tuple[EncoderDevice, int]
) -> None:
    model, channel = device
    per_second = speed if not model.is_linear else 0
    rig = EncoderRig(83, model, [constant_speed(per_second, 100.5)] * model.channels, channel, delay)
    rig.stepper.channel.sensor.preset_value = value
    word = ABSOLUTE | PRESET | (RELATIVE if relative else 0)
    before = rig.step(ABSOLUTE, 3)
    status = 0
    cycles = 0
    while not status & PRESET:
        actuals = rig.step(word)
        status = actuals["G1_ZSW"]
        cycles += 1
        assert cycles <= delay + 55
    step = per_second * model.steps_per_unit * 0.004
    expected = before["G1_XIST2"] + value if relative else value
    assert abs(around(actuals["G1_XIST2"] - expected, rig.total_range)) <= abs(step) * cycles + 2
    # If the shaft turns further than the preset jumps, the two cannot be distinguished.
    if abs(around(expected - before["G1_XIST2"], rig.total_range)) > 4 * abs(step) * (cycles + 3):
        assert abs(around(actuals["G1_XIST1"] - before["G1_XIST1"], 1 << 32) - step * cycles) <= abs(step) + 2


def around(difference: int, total_range: int) -> int:
    """The short way round."""
    return (difference + total_range // 2) % total_range - total_range // 2


@pytest.mark.parametrize(
    ("device", "channel"), [(ROTARY, 1), (MULTI_SENSOR, 1), (MULTI_SENSOR, 2)], ids=["rotary", "channel 1", "channel 2"]
)
@pytest.mark.parametrize("rpm", [-3000, -60, 0, 7, 300, 1500])
def test_telegram_83_shows_the_speed_of_the_shaft(device: EncoderDevice, channel: int, rpm: int) -> None:
    rig = EncoderRig(83, device, [constant_speed(rpm / 60, 2000)] * device.channels, channel)
    found = rig.step(0, 50)["NIST_B"] / (1 << 30) * 3000
    assert found == pytest.approx(rpm, abs=0.4)  # one step in 50 ms is 0.3 1/min


def test_the_speed_of_a_linear_encoder() -> None:
    rig = EncoderRig(82, LINEAR, [constant_speed(250.0)])
    assert rig.step(0, 50)["NIST_A"] / 0x4000 == pytest.approx(0.25, abs=0.001)


def test_position_continues_across_the_device_overflow() -> None:
    rig = EncoderRig(84, ROTARY, [constant_speed(5.0, 4095.9)])
    first = rig.step(ABSOLUTE)
    last = rig.step(ABSOLUTE, 250)
    assert last["G1_XIST2"] < first["G1_XIST2"]
    assert last["G1_XIST3"] - first["G1_XIST3"] == 5 * 4096


# -- G2 -----------------------------------------------------------------------------------------------------------


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
    machine = AxisMachine(telegram(4), settings, DriveFeedback())
    machine.set_references(place, EncoderReferences((1 << 64) + 1, Fraction(1)))
    (fault,) = machine.step().happened().faults
    assert fault.number == FaultNumber.REFERENCE
    assert f"G{place + 1}: total measuring range" in fault.text
    sensor = (machine.sensor, machine.second_sensor)[place]
    assert sensor is not None
    assert not sensor.channel.valid
