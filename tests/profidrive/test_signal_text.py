"""One text for each value, in the form that its telegram carries it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.encoder import SENSOR_ERROR_TEXTS, SensorError
from pdgw.profidrive.signal_text import Rated, scale, texts
from pdgw.profidrive.signals import Signal, SignalQuantity
from pdgw.profidrive.telegrams import TELEGRAMS, TelegramHalf, telegram

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
        if item.bits:
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
        if not item.bits and not in_error(item, values):
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


def test_error_code_of_a_sensor_is_no_position() -> None:
    values = {"G1_ZSW": 0x8000, "G1_XIST2": 0x0F01}
    meaning = SENSOR_ERROR_TEXTS[SensorError.COMMAND_NOT_SUPPORTED]
    assert texts(telegram(3).actuals, values)["G1_XIST2"] == f"error 0F01h ({meaning})"
    assert texts(telegram(3).actuals, values | {"G1_ZSW": 0x2000})["G1_XIST2"] == "3841 increments"
