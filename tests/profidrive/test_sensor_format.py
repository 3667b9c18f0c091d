"""P979: header and elements as the table of the parameter channel gives them, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.measuring import SensorFormat, encode_sensor_format
from tests.support.documents.sensor_format import decode_sensor_format

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
