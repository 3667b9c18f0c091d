"""Values of a telegram as text, the same on every surface: status, page, PLC simulator, decoder. Trends use the same scale.

The form that the telegram carries decides, not the name: MDI_TARPOS is a fraction in telegram 9 and a number of length units in
telegram 111.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from pdgw.profidrive.sensor_states import SENSOR_ERROR_TEXTS
from pdgw.profidrive.signals import Signal, SignalQuantity, signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf

_SENSOR_ERROR = signal("G1_ZSW").bit("ERROR").mask


class Rated(NamedTuple):
    """100 % of a speed."""

    speed: float
    unit: str


class Scale(NamedTuple):
    """Factor and unit of a signal's value."""

    factor: float
    unit: str


def scale(item: Signal, rated: Rated | None) -> Scale:
    """The unit of a value: percent of a reference, a speed if its reference is known, else the unit of the signal."""
    percent = item.percent(1)
    if percent is None:
        return Scale(1.0, item.unit)
    if rated is None or item.quantity is not SignalQuantity.SPEED:
        return Scale(percent, "%")
    return Scale(percent * rated.speed / 100, rated.unit)


def texts(half: TelegramHalf, values: Mapping[str, int], rated: Rated | None = None) -> dict[str, str]:
    """Value and unit, or the set bits, of each signal by name. ``rated``: 100 % of the speeds, None if unknown."""
    return {item.name: _text(half, item, values, rated) for item in half.signals if item.name in values}


def _text(half: TelegramHalf, item: Signal, values: Mapping[str, int], rated: Rated | None) -> str:
    raw = values[item.name]
    if item.bits:
        names = [
            bit.name if bit.width == 1 else f"{bit.name}={bit.of(raw)}"
            for bit in item.fields(positioning=half.mode is ApplicationMode.POSITIONING)
            if bit.of(raw)
        ]
        return " ".join((_hexadecimal(item, raw), *names))
    if item.is_word:
        return _hexadecimal(item, raw)
    sensor, _, place = item.name.partition("_")
    if place == "XIST2" and values.get(f"{sensor}_ZSW", 0) & _SENSOR_ERROR:
        return f"error {raw:04X}h ({SENSOR_ERROR_TEXTS.get(raw, 'unknown')})"
    return value_text(item, raw, rated)


def _hexadecimal(item: Signal, raw: int) -> str:
    return f"{raw:0{2 * item.type.size}X}h"


def value_text(item: Signal, raw: int, rated: Rated | None = None) -> str:
    """Value and unit of a signal without bits. ``rated``: 100 % of a speed, None if unknown."""
    percent = item.percent(raw)
    if percent is None:
        return f"{item.value_of(raw):{'.7g' if item.is_float else 'd'}} {item.unit}".rstrip()
    factor, unit = scale(item, rated)
    return f"{percent:.3f} %" + ("" if unit == "%" else f" = {raw * factor:.1f} {unit}")
