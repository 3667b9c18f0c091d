"""Telegrams 81 to 84: sizes and bytes, sensor commands to SDO writes, speed with and without a speed object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.dsp406.images import EncoderParameters
from pdgw.gateway.axis.executors.sensor import EncoderReferences, SpeedFromPosition
from pdgw.gateway.axis.settings import SensorSettings
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import SdoWrite
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS, FaultNumber, warning_bits
from pdgw.gateway.base.reasons import Reason
from pdgw.profidrive.encoder import PARKED_NS
from pdgw.profidrive.sensor_states import SensorError
from pdgw.profidrive.telegrams import telegram
from tests.support.axis.stepper import EncoderStepper
from tests.support.axis.strategies import half_values

CONTROL, FAULT_ACKNOWLEDGE = 0x0400, 0x0080
ACKNOWLEDGE, PARK, ABSOLUTE, PRESET, RELATIVE = 0x8000, 0x4000, 0x2000, 0x1000, 0x0800
UNITS = 4096
"""Per revolution; 100 % is 3000 1/min."""
REFERENCES = EncoderReferences(total_range=UNITS * 4096, speed_reference=Fraction(3000 * UNITS, 60))


@dataclass
class Encoder:
    """An encoder as its client shows it."""

    position: int = 1000
    position_time: int = 0
    speed: int | None = None
    alarms: int = 0
    warnings: int = 0
    error_register: int = 0
    error_code: int = 0
    valid: bool = True


class Bench:
    """The machine of a telegram on an encoder, stepped by hand."""

    def __init__(
        self, number: int = 83, references: EncoderReferences | None = REFERENCES, failures: int = 65535
    ) -> None:
        self.stepper = EncoderStepper(number, SensorSettings(sign_of_life_failures=failures))
        self.stepper.set_references(references)
        self.encoder = Encoder()
        self.ok = True
        self.now = 0

    def step(self, g1_stw: int = 0, stw2: int | None = CONTROL, cycles: int = 1) -> dict[str, int]:
        """Cycles of 4 ms with these words (stw2 None: no PLC); returns the actual values by name."""
        for _ in range(cycles):
            self.now += 4 * MS
            self.encoder.position_time = self.now
            setpoints = None if stw2 is None else (stw2, g1_stw)
            actuals = self.stepper.step(setpoints, self.encoder, self.ok, self.now)
        assert len(self.stepper.telegram.actuals.encode(actuals)) == self.stepper.telegram.actuals.size
        return self.stepper.telegram.actuals.as_dict(actuals)

    def answer(self, error: str | None = None) -> None:
        """As the axis does when the SDO is answered."""
        self.stepper.sdo_done(error)


# -- the wire ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "size"), [(81, 12), (82, 14), (83, 16), (84, 20)])
def test_sizes_on_the_wire(number: int, size: int) -> None:
    layout = telegram(number)
    assert (layout.setpoints.size, layout.actuals.size) == (4, size)


@pytest.mark.parametrize(
    ("number", "data"),
    [
        (81, "0280 2000 0001 0203 0001 0203"),
        (82, "0280 2000 0001 0203 0001 0203 0666"),
        (83, "0280 2000 0001 0203 0001 0203 0666 6666"),
        (84, "0280 2000 0000 0000 0001 0203 0001 0203 0666 6666"),
    ],
)
def test_bytes_of_an_encoder_at_300_of_3000_rpm_with_a_warning(number: int, data: str) -> None:
    bench = Bench(number)
    bench.encoder = Encoder(position=0x10203, speed=300 * UNITS // 60, warnings=1)
    actuals = bench.step(ABSOLUTE)
    assert bench.stepper.telegram.actuals.encode(tuple(actuals.values())) == bytes.fromhex(data)


def test_only_the_encoder_telegrams_have_an_encoder_machine() -> None:
    assert ENCODER_TELEGRAM_NUMBERS == (81, 82, 83, 84)
    with pytest.raises(GatewayError, match="telegram: 3"):
        EncoderStepper(3, SensorSettings())


@given(
    number=st.sampled_from(ENCODER_TELEGRAM_NUMBERS),
    data=st.data(),
    total_range=st.sampled_from([1, 7, 1 << 12, 1 << 32]),
)
def test_answer_to_any_setpoints_fits_the_telegram(number: int, data: st.DataObject, total_range: int) -> None:
    stepper = EncoderStepper(number, SensorSettings(3))
    stepper.set_references(EncoderReferences(total_range, Fraction(1, 3)))
    now = 0
    for _ in range(data.draw(st.integers(1, 12))):
        now += data.draw(st.integers(0, 1000 * MS))
        encoder = Encoder(
            data.draw(st.integers(-(1 << 31), (1 << 32) - 1)),
            data.draw(st.integers(0, now)),
            data.draw(st.none() | st.integers(-32768, 32767)),
            *(data.draw(st.integers(0, 0xFFFF)) for _ in range(3)),
            data.draw(st.booleans()),
        )
        setpoints = data.draw(st.none() | half_values(stepper.telegram.setpoints))
        stepper.telegram.actuals.encode(stepper.step(setpoints, encoder, data.draw(st.booleans()), now))
        for write in stepper.sdo_request or ():
            assert write.index == 0x6003
        if stepper.sdo_request and data.draw(st.booleans()):
            stepper.sdo_done(data.draw(st.none() | st.just("refused")))
    assert {event.number for event in stepper.events} <= set(GATEWAY_FAULTS)


# -- sensor commands --------------------------------------------------------------------------------------------------


def test_a_preset_is_written_confirmed_and_read_back() -> None:
    bench = Bench()
    bench.stepper.channel.sensor.preset_value = 5000
    bench.step(ABSOLUTE)
    bench.step(ABSOLUTE | PRESET)
    assert bench.stepper.sdo_request == (SdoWrite(0x6003, 0, 5000),)
    assert bench.stepper.reason is Reason.SENSOR_PRESETTING
    bench.encoder.position = 5000
    bench.answer()
    bench.step(ABSOLUTE | PRESET)
    actuals = bench.step(ABSOLUTE | PRESET)
    assert (actuals["G1_ZSW"], actuals["G1_XIST2"], actuals["G1_XIST1"]) == (ABSOLUTE | PRESET, 5000, 1000)
    assert bench.stepper.sdo_request is None
    assert bench.step(ABSOLUTE)["G1_ZSW"] == ABSOLUTE
    assert bench.stepper.reason is None


@pytest.mark.parametrize(("value", "written"), [(50, 1050), (-1001, UNITS * 4096 - 1)])
def test_a_relative_preset_of_a_channel_is_the_position_and_the_shift(value: int, written: int) -> None:
    references = EncoderReferences(REFERENCES.total_range, REFERENCES.speed_reference, channel=3)
    bench = Bench(84, references)
    bench.stepper.channel.sensor.preset_value = value
    bench.step()
    bench.step(PRESET | RELATIVE)
    assert bench.stepper.sdo_request == (SdoWrite(0x6010, 3, written),)


def test_rejected_preset_is_a_sensor_error_and_a_warning() -> None:
    bench = Bench()
    bench.step()
    bench.step(PRESET)
    bench.answer("node 3 object 6003h/0: read only")
    actuals = bench.step(PRESET)
    assert (actuals["G1_ZSW"], actuals["G1_XIST2"]) == (0x8000, SensorError.MEMORY)
    assert [(event.number, "read only" in event.text) for event in bench.stepper.events] == [(118, True)]
    assert bench.stepper.reason is Reason.SENSOR_ERROR
    bench.step(PRESET | ACKNOWLEDGE)
    assert bench.step(PRESET)["G1_ZSW"] == 0
    assert bench.stepper.sdo_request is None, "the request that still stands is no new one"


@pytest.mark.parametrize("age_ms", [0, 3000])
def test_confirmed_preset_without_effect_is_a_sensor_error_and_a_warning(age_ms: int) -> None:
    """A position that arrives seldom has as much more time."""
    bench = Bench(references=replace(REFERENCES, position_age_ns=age_ms * MS))
    bench.stepper.channel.sensor.preset_value = 5000
    bench.step()
    bench.step(PRESET)
    bench.answer()
    waiting = (1000 + age_ms) // 4
    assert bench.step(PRESET, cycles=waiting)["G1_ZSW"] == 0
    assert bench.stepper.reason is Reason.SENSOR_PRESETTING
    actuals = bench.step(PRESET, cycles=2)
    assert (actuals["G1_ZSW"], actuals["G1_XIST1"], actuals["G1_XIST2"]) == (0x8000, 1000, SensorError.MEMORY)
    assert bench.stepper.reason is Reason.SENSOR_ERROR
    bench.step(PRESET, cycles=5)
    assert bench.stepper.numbers == [118]
    assert f"did not become 5000 within {1000 + age_ms} ms" in bench.stepper.events[0].text


def test_parking_cancels_a_preset() -> None:
    bench = Bench()
    bench.step()
    bench.step(PRESET)
    bench.step(PARK)
    assert bench.stepper.sdo_request is None
    assert bench.stepper.reason is Reason.SENSOR_PARKED


def test_without_control_by_plc_the_last_sensor_command_stays() -> None:
    bench = Bench()
    bench.step(PARK)
    assert bench.step(0, stw2=0)["G1_ZSW"] == PARK
    assert bench.stepper.reason is Reason.ENCODER_NO_CONTROL
    assert bench.step(0, cycles=PARKED_NS // (4 * MS))["G1_ZSW"] == 0


def test_preset_active_at_reconnect_is_not_executed() -> None:
    bench = Bench()
    bench.step()
    bench.step(stw2=None)
    assert bench.stepper.reason is Reason.ENCODER_NO_PLC
    bench.step(PRESET)
    assert bench.stepper.sdo_request is None


# -- faults -----------------------------------------------------------------------------------------------------------


def test_emcy_and_position_alarm_are_faults_until_acknowledged() -> None:
    bench = Bench()
    assert bench.step()["ZSW2_ENC"] == 0x0200
    bench.encoder.error_register = 0x10
    assert bench.step()["ZSW2_ENC"] == 0x0208
    bench.encoder.error_register = 0
    assert bench.step()["ZSW2_ENC"] == 0x0208
    assert bench.step(stw2=CONTROL | FAULT_ACKNOWLEDGE)["ZSW2_ENC"] == 0x0200
    bench.encoder.alarms = 1
    actuals = bench.step()
    assert (actuals["ZSW2_ENC"], actuals["G1_ZSW"], actuals["G1_XIST2"]) == (0x0208, 0x8000, 0x0001)


def test_every_alarm_makes_the_position_invalid() -> None:
    bench = Bench()
    bench.encoder.alarms = 2  # commissioning diagnostics
    actuals = bench.step(ABSOLUTE)
    assert (actuals["ZSW2_ENC"], actuals["G1_ZSW"], actuals["G1_XIST2"]) == (0x0208, 0x8000, 0x0001)


def test_an_alarm_after_a_memory_emergency_is_a_memory_error() -> None:
    bench = Bench()
    bench.encoder.alarms, bench.encoder.error_code = 1, 0x5100
    actuals = bench.step(ABSOLUTE)
    assert (actuals["G1_ZSW"], actuals["G1_XIST2"]) == (0x8000, 0x1001)


def test_reported_fault_is_acknowledged_only_with_the_encoder_online() -> None:
    bench = Bench()
    bench.step()
    bench.stepper.emergency(0x5000, bench.now)
    bench.ok = False
    assert bench.step()["ZSW2_ENC"] == 0x0208
    bench.step(stw2=CONTROL | FAULT_ACKNOWLEDGE)
    bench.step()
    bench.ok = True
    assert bench.step()["ZSW2_ENC"] == 0x0208
    assert bench.step(stw2=CONTROL | FAULT_ACKNOWLEDGE)["ZSW2_ENC"] == 0x0200


@pytest.mark.parametrize("before", [None, 0, FAULT_ACKNOWLEDGE], ids=["no PLC", "no control", "only acknowledge"])
def test_an_acknowledge_needs_a_0_since_the_plc_has_control(before: int | None) -> None:
    bench = Bench()
    bench.step()
    bench.stepper.emergency(0x5000, bench.now)
    bench.step()
    for word in (before, CONTROL | FAULT_ACKNOWLEDGE):
        assert bench.step(stw2=word)["ZSW2_ENC"] & 8
        assert not bench.stepper.machine.outputs.happened().acknowledged
    bench.step()
    bench.step(stw2=CONTROL | FAULT_ACKNOWLEDGE)
    assert bench.stepper.machine.outputs.happened().acknowledged


def test_fault_before_the_encoder_is_online_needs_no_acknowledge() -> None:
    bench = Bench()
    bench.ok = False
    actuals = bench.step(ABSOLUTE)
    assert actuals == {"ZSW2_ENC": 0x0208, "G1_ZSW": 0, "G1_XIST1": 0, "G1_XIST2": 0, "NIST_B": 0}
    assert bench.stepper.reason is Reason.ENCODER_OFFLINE
    bench.ok = True
    assert bench.step(ABSOLUTE)["ZSW2_ENC"] == 0x0200


def test_an_encoder_that_is_lost_keeps_xist1_and_has_to_be_acknowledged() -> None:
    bench = Bench()
    bench.step()
    bench.ok = False
    actuals = bench.step(ABSOLUTE)
    assert (actuals["G1_ZSW"], actuals["G1_XIST1"], actuals["G1_XIST2"]) == (0x8000, 1000, 0x0001)
    bench.ok = True
    bench.stepper.set_references(REFERENCES)
    assert bench.step(ABSOLUTE)["G1_ZSW"] == 0x8000
    bench.step(ABSOLUTE | ACKNOWLEDGE)
    assert bench.step(ABSOLUTE)["G1_ZSW"] == ABSOLUTE


@pytest.mark.parametrize("total_range", [0, -1])
def test_a_range_of_0_refuses_operation(total_range: int) -> None:
    bench = Bench(83, EncoderReferences(total_range, Fraction(1)))
    assert bench.step(ABSOLUTE)["ZSW2_ENC"] == 0x0208
    assert bench.stepper.reason is Reason.REFERENCE_INVALID
    assert bench.stepper.numbers == [104]


def test_a_speed_reference_of_0_refuses_operation_only_where_there_is_a_speed() -> None:
    references = EncoderReferences(4096, Fraction(0))
    assert Bench(82, references).step()["ZSW2_ENC"] == 0x0208
    assert Bench(81, references).step()["ZSW2_ENC"] == 0x0200


def test_sign_of_life_in_both_directions_and_its_loss() -> None:
    bench = Bench(failures=2)
    own = [bench.step(stw2=CONTROL | (cycle % 15 + 1) << 12)["ZSW2_ENC"] >> 12 for cycle in range(20)]
    assert own == [cycle % 15 + 1 for cycle in range(20)]
    bench.step(stw2=CONTROL | 5 << 12, cycles=2)
    assert bench.stepper.events == []
    actuals = bench.step(stw2=CONTROL | 5 << 12, cycles=3)
    assert (actuals["ZSW2_ENC"] >> 12, actuals["G1_ZSW"], actuals["G1_XIST2"]) == (0, 0x8000, 0x0F02)
    assert bench.stepper.numbers == [124]


# -- speed ------------------------------------------------------------------------------------------------------------


def test_without_a_speed_object_the_speed_is_that_of_the_position_across_wraps() -> None:
    bench = Bench()
    bench.encoder.position = REFERENCES.total_range - 3 * 4096
    for _ in range(40):
        bench.encoder.position = (bench.encoder.position + 512) % REFERENCES.total_range
        actuals = bench.step()
    per_second = 512 * 250
    assert actuals["NIST_B"] == int(Fraction(per_second) / REFERENCES.speed_reference * (1 << 30))


def test_preset_is_not_shown_as_a_speed() -> None:
    bench = Bench()
    bench.stepper.channel.sensor.preset_value = 9_000_000
    bench.step(cycles=5)
    bench.step(PRESET)
    bench.encoder.position = 9_000_000
    bench.answer()
    speeds = {bench.step(PRESET)["NIST_B"] for _ in range(20)}
    assert speeds == {0}


@pytest.mark.parametrize("limit", [-32768, 32767])
def test_saturated_speed_object_is_not_used(limit: int) -> None:
    bench = Bench()
    bench.encoder.speed = limit
    assert bench.step(cycles=10)["NIST_B"] == 0
    bench.encoder.speed = limit // 2
    assert bench.step()["NIST_B"] != 0


def turning(bench: Bench, seconds: int, shown: int, **more: int) -> dict[str, int]:
    """Turn at 600 rpm, while the encoder reports a speed."""
    for _ in range(seconds * 250):
        bench.encoder = replace(bench.encoder, position=bench.encoder.position + UNITS // 25, speed=shown, **more)
        actuals = bench.step()
    return actuals


RIGHT = UNITS * 10
"""Steps a second of 600 rpm."""
WARNING = 1 << 7
"""Of ZSW2_ENC."""


@pytest.mark.parametrize("number", [82, 83, 84])
def test_speed_that_contradicts_the_position_is_warning_115_until_it_is_right(number: int) -> None:
    bench = Bench(number)
    assert not turning(bench, 10, RIGHT * 4 // 5)["ZSW2_ENC"] & WARNING
    assert turning(bench, 10, 600)["ZSW2_ENC"] & WARNING
    assert bench.stepper.machine.outputs.warning == warning_bits(FaultNumber.VELOCITY_DEVIATES)
    (record,) = bench.stepper.events
    assert (record.number, record.is_warning) == (FaultNumber.VELOCITY_DEVIATES, True)
    assert "the position moves at 40750 steps/s, 6030h reports 600" in record.text
    assert not turning(bench, 10, RIGHT)["ZSW2_ENC"] & WARNING
    assert len(bench.stepper.events) == 1


def test_speed_of_a_telegram_without_speed_is_not_compared() -> None:
    bench = Bench(81)
    turning(bench, 10, 600)
    assert not bench.stepper.events


@pytest.mark.parametrize(
    "more", [{"alarms": 1}, {"error_register": 1}, {"valid": False}], ids=["alarm", "error", "no position"]
)
def test_speed_is_not_compared_with_a_position_that_may_be_wrong(more: dict[str, int]) -> None:
    bench = Bench()
    turning(bench, 10, 600, **more)
    assert not [event for event in bench.stepper.events if event.number == FaultNumber.VELOCITY_DEVIATES]


def test_speed_at_the_limit_of_its_object_is_not_compared() -> None:
    bench = Bench()
    turning(bench, 10, 32767)
    assert not bench.stepper.events


def test_parked_sensor_does_not_contradict_its_speed() -> None:
    bench = Bench()
    for _ in range(2500):
        bench.encoder = replace(bench.encoder, position=bench.encoder.position + UNITS // 50, speed=RIGHT // 2)
        bench.step(PARK)
    assert not bench.stepper.events


def test_the_speed_object_has_its_own_unit() -> None:
    unit = EncoderReferences(REFERENCES.total_range, Fraction(1000), speed_unit=Fraction(1, 100))
    bench = Bench(82, unit)
    bench.encoder.speed = -5000
    assert bench.step()["NIST_A"] == -(0x4000 * 50 // 1000)


def test_references_of_a_rotary_encoder() -> None:
    parameters = EncoderParameters(operating=4, units_per_revolution=UNITS, scaled_range=UNITS * 4096, resolution=8192)
    assert EncoderReferences.rotary(parameters, Fraction(3000)) == REFERENCES


def test_references_of_a_linear_encoder_with_steps_of_5_um_and_100_um_per_second() -> None:
    parameters = EncoderParameters(position_step=5, speed_step=10, scaled_range=100_000, resolution=1)
    references = EncoderReferences.linear(parameters, Fraction(2000))
    assert (references.total_range, references.speed_reference, references.speed_unit) == (100_000, 400_000, 20)
    bench = Bench(82, references)
    bench.encoder.speed = 10_000  # 1 m/s
    assert bench.step()["NIST_A"] == 0x2000


def test_linear_encoder_without_measuring_step_is_rejected() -> None:
    bench = Bench(82, EncoderReferences.linear(EncoderParameters(), Fraction(1)))
    bench.step()
    assert bench.stepper.reason is Reason.REFERENCE_INVALID


def test_a_speed_above_200_percent_is_limited_and_counted() -> None:
    bench = Bench(82, EncoderReferences(4096, Fraction(100)))
    bench.encoder.speed = 1000
    assert bench.step()["NIST_A"] == 0x7FFF
    assert bench.stepper.saturations == 1


@given(
    speed=st.integers(-(10**6), 10**6),
    interval=st.integers(1, 20),
    jitter=st.lists(st.integers(0, 900_000), min_size=30),
)
def test_time_stamps_make_the_speed_right_whatever_the_jitter(speed: int, interval: int, jitter: list[int]) -> None:
    estimate = SpeedFromPosition()
    found = 0
    for cycle, late in enumerate(jitter):
        time = cycle * interval * MS + late
        estimate.add(speed * time // 10**9, time)
        found = estimate.mean(time)
    span = min(50 * MS, (len(jitter) - 1) * interval * MS) - MS
    assert abs(found - speed) <= 10**9 // max(1, span) + 1


def test_encoder_without_new_frames_shows_standstill() -> None:
    estimate = SpeedFromPosition()
    estimate.add(0, 0)
    assert estimate.mean(0) == 0
    estimate.add(10, 10 * MS)
    assert [estimate.mean(now * MS) for now in (10, 100, 111)] == [1000, 1000, 0]


def test_encoder_with_rare_frames_does_not_show_standstill() -> None:
    estimate = SpeedFromPosition()
    estimate.add(0, 0)
    estimate.add(1000, 1000 * MS)
    assert estimate.mean(3000 * MS) == 1000
