"""N2/N4 normalisation: the published examples and the properties an axis relies on."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType, n2, n4
from pdgw.profidrive.errors import ProfidriveError

I16 = (-(1 << 15), (1 << 15) - 1)
I32 = (-(1 << 31), (1 << 31) - 1)


def test_example_1500_of_3000_rpm_is_nsoll_a_2000h() -> None:
    assert n2(3000, I32).to_wire(1500) == 0x2000
    assert n2(3000, I32).to_value(0x2000) == 1500


def test_example_300_of_3000_rpm_is_nist_a_0666h_truncated() -> None:
    assert n2(3000, I32).to_wire(300) == 0x0666


def test_example_target_200_of_500000_is_mdi_tarpos_68db8h_and_comes_back() -> None:
    position = n4(500_000, I32)
    assert position.to_wire(200) == 429_496
    assert position.to_value(0x68DB8) == 200


def test_example_2500_of_5000_rpm_is_mdi_velocity_2000_0000h() -> None:
    assert n4(5000, I32).to_wire(2500) == 0x2000_0000


def test_example_600_of_3000_is_mdi_acc_0ccch() -> None:
    assert n2(3000, I32).to_wire(600) == 3276


def test_speed_in_half_rpm_units_1500_rpm_is_3000_on_can() -> None:
    speed = n2(Fraction(3000 * 2, 1), I32)
    assert speed.to_value(0x2000) == 3000
    assert speed.to_wire(3000) == 0x2000


def test_negative_values_truncate_toward_zero() -> None:
    assert n2(3000, I32).to_wire(-300) == -0x0666


@pytest.mark.parametrize("reference", [0, -1, Fraction(-1, 3)])
def test_reference_of_zero_or_less_is_refused(reference: Fraction) -> None:
    with pytest.raises(ProfidriveError, match="normalisation reference"):
        n2(reference, I16)


references = st.fractions(min_value=Fraction(1, 1000), max_value=Fraction((1 << 29) - 1))


@given(reference=references, value=st.integers(*I32))
def test_to_wire_never_leaves_the_range_of_the_type(reference: Fraction, value: int) -> None:
    assert I16[0] <= n2(reference, I32).to_wire(value) <= I16[1]
    assert I32[0] <= n4(reference, I32).to_wire(value) <= I32[1]


@given(reference=references, wire=st.integers(*I32), low=st.integers(-1000, 0), high=st.integers(0, 1000))
def test_to_value_saturates_at_the_objects_limits_and_reports_it(
    reference: Fraction, wire: int, low: int, high: int
) -> None:
    conversion = n4(reference, (low, high))
    value = conversion.to_value(wire)
    assert low <= value <= high
    unlimited = n4(reference, (-(1 << 62), 1 << 62)).to_value(wire)
    assert conversion.saturates(wire) == (unlimited != value)


@given(reference=st.integers(1, (1 << 29) - 1), share=st.fractions(Fraction(-199, 100), Fraction(199, 100)))
def test_value_written_and_read_back_is_itself(reference: int, share: Fraction) -> None:
    value = int(reference * share)
    conversion = n4(reference, (-(1 << 40), 1 << 40))
    assert conversion.to_value(conversion.to_wire(value)) == value


@given(reference=references, a=st.integers(*I16), b=st.integers(*I16))
def test_conversion_is_monotone_and_odd(reference: Fraction, a: int, b: int) -> None:
    conversion = n2(reference, (-(1 << 62), 1 << 62))
    assert (a <= b) <= (conversion.to_value(a) <= conversion.to_value(b))
    assert conversion.to_value(-a) == -conversion.to_value(a)


def test_data_type_codes_are_unique_and_found_by_code() -> None:
    assert len({data_type.code for data_type in DataType}) == len(DataType)
    assert DataType.from_code(0x72) is DataType.N4
    with pytest.raises(ProfidriveError, match="format"):
        DataType.from_code(0xEE)
