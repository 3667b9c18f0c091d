"""Bits 0-7 of G1_STW and G1_ZSW (reference mark search, measurement on the fly), and P979 with the format of a sensor."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.encoder import PARKED_NS, SensorInterface
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.measuring import Measuring
from pdgw.profidrive.sensor_format import SensorFormat, encode_sensor_format
from pdgw.profidrive.sensor_states import SensorError, SensorState
from pdgw.profidrive.signals import signal
from tests.support.documents.profile_numbers import decode_sensor_format

ON_THE_FLY, ACTIVATE, READ, ABORT = 0x80, 0x10, 0x20, 0x30
ACKNOWLEDGE, PARK = 0x8000, 0x4000
ERROR = signal("G1_ZSW").bit("ERROR").mask
WRAP = 1 << 32


class Bench:
    """A sensor whose device can latch positions."""

    def __init__(self) -> None:
        self.sensor = SensorInterface(WRAP, preset_supported=False)
        self.sensor.measuring = Measuring()
        self.now = 0
        self.position = 1000
        self.step(0)

    def step(self, word: int) -> tuple[int, int, int]:
        self.now += 4_000_000
        return self.sensor.step(word, self.position, self.now)

    def found(self, **positions: int) -> None:
        assert self.sensor.measuring is not None
        search = self.sensor.measuring.search
        assert search is not None
        self.sensor.measured(search, {int(key[1:]): value for key, value in positions.items()})


@pytest.mark.parametrize("function", range(4))
def test_a_measurement_is_active_then_available_then_read_and_gone(function: int) -> None:
    bench, selected = Bench(), 1 << function
    assert bench.step(ON_THE_FLY | ACTIVATE | selected)[0] == selected
    assert bench.step(ON_THE_FLY | selected)[0] == selected, "the command need not stand"
    bench.position = 5000
    bench.found(**{f"f{function}": 3000})
    assert bench.step(ON_THE_FLY)[0] == selected << 4
    assert bench.step(ON_THE_FLY | READ | selected) == (selected << 4, 5000, 3000)
    assert bench.step(ON_THE_FLY)[0] == 0


def test_several_functions_end_one_by_one() -> None:
    bench = Bench()
    assert bench.step(ON_THE_FLY | ACTIVATE | 0b0101)[0] == 0b0101
    bench.found(f2=10)
    assert bench.step(ON_THE_FLY | ACTIVATE | 0b0101)[0] == 0b0100_0001
    bench.found(f0=20)
    assert bench.step(0)[0] == 0b0101_0000


def test_only_the_first_reference_mark_exists() -> None:
    bench = Bench()
    assert bench.step(ACTIVATE | 0b0001)[0] == 0b0001
    assert bench.sensor.measuring is not None
    assert bench.sensor.measuring.search is not None
    assert not bench.sensor.measuring.search.on_the_fly
    bench.step(0)
    assert bench.step(ACTIVATE | 0b0010)[::2] == (ERROR, SensorError.COMMAND_NOT_SUPPORTED)


def test_an_abort_ends_what_is_active() -> None:
    bench = Bench()
    bench.step(ON_THE_FLY | ACTIVATE | 1)
    assert bench.step(ON_THE_FLY | ABORT | 1)[0] == 0
    assert bench.sensor.measuring is not None
    assert bench.sensor.measuring.search is None


@pytest.mark.parametrize(
    ("mode", "error"), [(0, SensorError.NO_REFERENCE_VALUE), (ON_THE_FLY, SensorError.NO_MEASURED_VALUE)]
)
def test_a_read_without_a_value_is_an_error(mode: int, error: SensorError) -> None:
    bench = Bench()
    assert bench.step(mode | READ | 1)[::2] == (ERROR, error)
    bench.step(ACKNOWLEDGE)
    assert bench.step(0)[0] == 0


@pytest.mark.parametrize(
    ("mode", "supported", "error"),
    [
        (0, True, SensorError.REFERENCE_ABORTED),
        (ON_THE_FLY, True, SensorError.MEASUREMENT_ABORTED),
        (ON_THE_FLY, False, SensorError.COMMAND_NOT_SUPPORTED),
    ],
)
def test_unexecuted_measurement_is_an_error(mode: int, supported: bool, error: SensorError) -> None:
    bench = Bench()
    bench.step(mode | ACTIVATE | 1)
    assert bench.sensor.measuring is not None
    search = bench.sensor.measuring.search
    assert search is not None
    bench.sensor.measurement_failed(search, supported=supported)
    assert bench.step(mode | ACTIVATE | 1)[::2] == (ERROR, error)
    assert bench.sensor.measuring.search is None, "an error ends what is active"


def test_parking_ends_a_measurement_and_its_values() -> None:
    bench = Bench()
    bench.step(ON_THE_FLY | ACTIVATE | 1)
    bench.found(f0=10)
    assert bench.step(PARK)[0] == signal("G1_ZSW").bit("PARKED").mask
    assert bench.sensor.state is SensorState.PARKED
    bench.now += PARKED_NS
    assert bench.step(0)[0] == 0


def test_a_value_is_in_the_count_of_g1_xist1_across_its_wrap() -> None:
    bench = Bench()
    bench.position = 5
    bench.step(ON_THE_FLY | ACTIVATE | 1)
    bench.found(f0=WRAP - 10)
    assert bench.step(ON_THE_FLY | READ | 1)[2] == WRAP - 10


def test_without_a_device_that_latches_every_command_is_an_error() -> None:
    bench = Bench()
    bench.sensor.measuring = None
    assert bench.step(ON_THE_FLY | ACTIVATE | 1)[::2] == (ERROR, SensorError.COMMAND_NOT_SUPPORTED)


# -- P979: format of a sensor -----------------------------------------------------------------------------------------


numbers = st.integers(0, 0xFFFF_FFFF)
sensors = st.builds(
    SensorFormat,
    *(numbers for _ in range(4)),
    *(st.booleans() for _ in range(6)),
)


def test_one_rotary_multi_turn_sensor() -> None:
    elements = encode_sensor_format([SensorFormat(resolution=8192, turns=4096, shift_xist1=7)])
    assert len(elements) == 31
    assert elements[:6] == (0x5112, 0xE000_0002, 8192, 7, 0, 4096)
    assert set(elements[6:]) == {0}


def test_a_linear_sensor_of_64_bit() -> None:
    elements = encode_sensor_format(
        [SensorFormat(1000, 0, linear=True, is_64_bit=True, xist1_absolute=False, is_static=False)]
    )
    assert elements[1] == 1 << 31 | 1 << 30 | 1 << 2 | 1


@given(st.lists(sensors, min_size=1, max_size=6))
def test_what_is_encoded_reads_as_the_profile_has_it(given_sensors: list[SensorFormat]) -> None:
    elements = encode_sensor_format(given_sensors)
    assert len(elements) == 31
    assert elements[0] == 0x5012 | len(given_sensors) << 8
    assert list(decode_sensor_format(elements)) == given_sensors


@pytest.mark.parametrize("count", [0, 7])
def test_one_to_six_sensors(count: int) -> None:
    with pytest.raises(ProfidriveError, match=r"1\.\.6"):
        encode_sensor_format([SensorFormat(1)] * count)


@pytest.mark.parametrize("value", [-1, 1 << 32])
def test_elements_are_unsigned32(value: int) -> None:
    with pytest.raises(ProfidriveError, match="sensor 1 turns"):
        encode_sensor_format([SensorFormat(1, turns=value)])
