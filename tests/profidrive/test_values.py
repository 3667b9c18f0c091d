"""N2/N4 normalisation with the published examples, and the text of each value in the form of its telegram."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType, n2, n4
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.sensor_states import SENSOR_ERROR_TEXTS, SensorError
from pdgw.profidrive.signal_text import Rated, scale, texts
from pdgw.profidrive.signals import Signal, SignalQuantity
from pdgw.profidrive.telegrams import TELEGRAMS, TelegramHalf, telegram

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


# -- texts ------------------------------------------------------------------------------------------------------------


HALVES = [half for chosen in TELEGRAMS.values() for half in (chosen.setpoints, chosen.actuals)]
RATED = Rated(3000.0, "rpm")


@st.composite
def values_of(draw: st.DrawFn) -> tuple[TelegramHalf, dict[str, int]]:
    half = draw(st.sampled_from(HALVES))
    return half, {item.name: draw(st.integers(*item.type.integer_range)) for item in half.signals}


def number_of(text: str) -> float:
    return float(text.split(" ", maxsplit=1)[0])


def in_error(item: Signal, values: dict[str, int]) -> bool:
    return item.name.endswith("XIST2") and bool(values[f"{item.name[:2]}_ZSW"] & 0x8000)


@given(values_of(), st.sampled_from([None, RATED]))
def test_every_value_of_every_telegram_has_its_own_unit(
    case: tuple[TelegramHalf, dict[str, int]], rated: Rated | None
) -> None:
    half, values = case
    shown = texts(half, values, rated)
    assert list(shown) == list(half.names)
    for item in half.signals:
        text, raw = shown[item.name], values[item.name]
        if item.bits or item.is_word:
            assert int(text.split("h")[0], 16) == raw
        elif in_error(item, values):
            assert text.startswith(f"error {raw:04X}h (")
        elif item.type in {DataType.N2, DataType.N4}:
            assert number_of(text) == pytest.approx(item.percent(raw), abs=0.0006)
            assert ("rpm" in text) == (rated is not None and item.quantity is SignalQuantity.SPEED)
        else:
            assert "%" not in text.removesuffix(item.unit)
            assert text.endswith(item.unit)
            assert number_of(text) == pytest.approx(item.value_of(raw), rel=1e-5, nan_ok=True)


@given(values_of(), st.sampled_from([None, RATED]))
def test_trends_have_the_unit_and_the_value_of_the_text(
    case: tuple[TelegramHalf, dict[str, int]], rated: Rated | None
) -> None:
    half, values = case
    shown = texts(half, values, rated)
    for item in half.signals:
        if not item.bits and not item.is_word and not in_error(item, values):
            factor, unit = scale(item, rated)
            last = shown[item.name].rpartition(" = ")[2]
            assert last.endswith(unit)
            assert number_of(last) == pytest.approx(
                item.value_of(values[item.name]) * factor, rel=1e-5, abs=0.06, nan_ok=True
            )


def test_positions_are_length_units_where_the_telegram_has_them() -> None:
    values = {"MDI_TARPOS": 50_000, "MDI_VELOCITY": 12_000}
    assert texts(telegram(111).setpoints, values) == {"MDI_TARPOS": "50000 LU", "MDI_VELOCITY": "12000 1000 LU/min"}
    assert texts(telegram(9).setpoints, {"MDI_TARPOS": 0x2000_0000}) == {"MDI_TARPOS": "50.000 %"}


def test_words_of_telegram_100_are_hexadecimal_and_numbers_are_not() -> None:
    values = {"Controlword": 0x000F, "Digital Outputs": 0x0001_0000, "Target Torque": -20}
    shown = {"Controlword": "000Fh", "Digital Outputs": "00010000h", "Target Torque": "-20 1/1000 rated current"}
    assert texts(telegram(100).setpoints, values) == shown
    assert texts(telegram(100).actuals, {"Statusword": 0x0637, "Error Code": 6}) == {
        "Statusword": "0637h",
        "Error Code": "6",
    }


def test_error_code_of_a_sensor_is_not_a_position() -> None:
    values = {"G1_ZSW": 0x8000, "G1_XIST2": 0x0F01}
    meaning = SENSOR_ERROR_TEXTS[SensorError.COMMAND_NOT_SUPPORTED]
    assert texts(telegram(3).actuals, values)["G1_XIST2"] == f"error 0F01h ({meaning})"
    assert texts(telegram(3).actuals, values | {"G1_ZSW": 0x2000})["G1_XIST2"] == "3841 increments"
