"""Notation of a scenario: its values, and the words of the telegrams by the names of their bits.

Values: ``1234``, ``0x4D2``, ``2000h``, ``50 %`` or, with the references of the scenario, ``1500 rpm`` and ``2000 inc``.
Expected values also ``<= 5``, ``100 +- 2`` and ``& 0x4F = 0x40``. Times ``500 ms`` and ``3 s``. A value has the name of its
signal (``override``, ``kpc``), a bit its declared name (``tracking``, ``open_brake``). Bits of a sensor's word have the sensor
as a prefix (``g1_park``). All are in lower case. Bits without a function are left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, partial
from types import MappingProxyType
from typing import Protocol

from pdgw.base.durations import MS, SECOND
from pdgw.base.phrases import did_you_mean
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.address import parse_integer
from pdgw.profidrive.datatypes import N2_100_PERCENT, N4_100_PERCENT, DataType, float_of, float_pattern
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Direction, TelegramHalf
from pdgw.profidrive.words import Bit

Scalar = int | float | str
_FULL_SCALE = {DataType.N2: N2_100_PERCENT, DataType.N4: N4_100_PERCENT}
_LARGEST = 2
"""Range of N2 and N4: up to 200 %."""


class FullScale(Protocol):
    """100 % of the quantities of a scenario, which has them as ``references``."""

    speed_rpm: float
    position: int


def parse_time(text: str) -> int:
    """``500 ms`` or ``3 s`` in nanoseconds; GatewayError otherwise."""
    match = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{1,9})?)\s*(ms|s)\s*", text)
    if match is None:
        raise GatewayError(f"time {text[:40]!r}: expected a number with ms or s")
    return int(Fraction(match[1]) * (MS if match[2] == "ms" else SECOND))


def comparison(condition: Scalar, raw: Callable[[Scalar], float]) -> Callable[[float], bool]:
    """Convert an expected value to a predicate. ``raw`` converts each value in the text to a number."""
    text = str(condition).strip()
    match = re.fullmatch(r"&\s*(\S+)\s*=\s*(\S+)", text)
    if match:
        mask, bits = int(raw(match[1])), int(raw(match[2]))
        return lambda value: int(value) & mask == bits
    match = re.fullmatch(r"(<=|>=|<|>)\s*(.+)", text)
    if match:
        bound = raw(match[2])
        compare: dict[str, Callable[[float], bool]] = {
            "<": lambda value: value < bound,
            ">": lambda value: value > bound,
            "<=": lambda value: value <= bound,
            ">=": lambda value: value >= bound,
        }
        return compare[match[1]]
    centre, _, tolerance = text.partition("+-")
    middle = raw(centre)
    width = abs(raw(tolerance)) if tolerance else 0
    return lambda value: abs(value - middle) <= width


def expected(references: FullScale, item: Signal, condition: Scalar) -> Callable[[int], bool]:
    """Convert an expected value to a predicate on a signal's raw integer; GatewayError for an invalid text."""
    if not item.is_float:
        return comparison(condition, partial(raw_value, references, item))
    if "&" in str(condition):
        raise GatewayError(
            f"{item.name} = {condition}: & is allowed only for words of bits, expected a number, <= 5 or 100 +- 2"
        )
    holds = comparison(condition, lambda value: float_of(raw_value(references, item, value)))
    return lambda raw: holds(float_of(raw))


def raw_value(references: FullScale, item: Signal, value: Scalar) -> int:
    """Convert a value in any notation to the signal's raw integer."""
    text = str(value).strip()
    match = re.fullmatch(r"(-?\d{1,15}(?:\.\d{1,9})?)\s*(%|rpm|inc)", text)
    if match:
        number = Fraction(match[1])
        if item.is_float and match[2] == item.unit[:1]:
            return float_pattern(float(number))
        most = _LARGEST * _reference(references, match[2])
        if abs(number) > most:
            raise GatewayError(
                f"{item.name} = {text}: the maximum is {float(most):g} {match[2]} in either direction (200 %)"
            )
        low, high = item.type.integer_range
        return max(low, min(int(number * _scale(references, item, match[2])), high))
    if item.is_float and re.fullmatch(r"-?\d{1,15}(?:\.\d{1,9})?", text):
        return float_pattern(float(text))
    return integer(item.name, value, ", 50 %, 1500 rpm or 2000 inc")


def written(references: FullScale, item: Signal, condition: str, value: int) -> str:
    """Format a raw value like the expected one: in its unit with one decimal, or in hexadecimal digits."""
    if item.is_float:
        return f"{float_of(value):g}"
    unit = re.search(r"%|rpm|inc", condition)
    if unit is not None:
        return f"{float(round(value / _scale(references, item, unit[0]), 1)):.1f} {unit[0]}"
    if re.search(r"0x[0-9a-fA-F]|[0-9a-fA-F]h\b", condition):
        digits = item.type.size * 2
        return f"{value & (1 << 4 * digits) - 1:0{digits}X}h"
    return str(value)


def _reference(references: FullScale, unit: str) -> Fraction:
    """100 % in this unit."""
    return Fraction({"%": 100, "rpm": references.speed_rpm, "inc": references.position}[unit])


def _scale(references: FullScale, item: Signal, unit: str) -> Fraction:
    """The raw value of one unit."""
    if item.type not in _FULL_SCALE:
        raise GatewayError(f"{item.name}: %, rpm and inc are allowed only for normalised signals")
    return _FULL_SCALE[item.type] / _reference(references, unit)


def integer(name: str, value: Scalar, others: str = "") -> int:
    """A whole number in any notation. ``others`` completes the message of the GatewayError for anything else."""
    if isinstance(value, int):
        return int(value)
    text = str(value).strip()
    try:
        return parse_integer(text)
    except ValueError:
        raise GatewayError(f"{name} = {text[:40]!r}: expected 1234, 0x4D2, 2000h{others}") from None


_WITHOUT_FUNCTION = ("DEVICE_", "RESERVED")
_SENSOR_WORDS = "_STW"
_SENSORS = ("G1", "G2")


@dataclass(frozen=True, slots=True)
class Word:
    """A value of a telegram, or one field of it."""

    name: str
    signal: Signal
    bit: Bit | None = None

    def of(self, values: Mapping[str, int]) -> int:
        """Its value, unsigned if it is a field."""
        raw = values[self.signal.name]
        return raw if self.bit is None else (raw & self.bit.mask) >> self.bit.position


@cache
def words_of(half: TelegramHalf) -> Mapping[str, Word]:
    """The words of a telegram's setpoints by name, in the order of its frame."""
    words: dict[str, Word] = {}
    for signal in half.signals:
        prefix = signal.name.removesuffix(_SENSOR_WORDS)
        sensor = f"{prefix.lower()}_" if prefix in _SENSORS else ""
        words[signal.identifier] = Word(signal.identifier, signal)
        for bit in signal.fields(positioning=half.mode is ApplicationMode.POSITIONING):
            if not bit.name.startswith(_WITHOUT_FUNCTION):
                name = f"{sensor}{bit.name.lower()}"
                words[name] = Word(name, signal, bit)
    return MappingProxyType(words)


@cache
def telegrams_of() -> Mapping[str, tuple[int, ...]]:
    """Every word with the telegrams that contain it."""
    found: dict[str, tuple[int, ...]] = {}
    for number, chosen in TELEGRAMS.items():
        for name in words_of(chosen.setpoints):
            found[name] = (*found.get(name, ()), number)
    return MappingProxyType(found)


def find(key: str, half: TelegramHalf) -> Word:
    """A word of the telegram, or a ``SIGNAL`` or ``SIGNAL.BIT`` of either half. GatewayError names what is allowed."""
    if half.direction is Direction.SETPOINT and key.islower():
        return _word(key, half)
    signal_name, _, bit_name = key.partition(".")
    if signal_name not in half.names:
        hint = did_you_mean(signal_name, half.names)
        raise GatewayError(f"signal {signal_name!r} is not in the telegram{hint} (allowed: {', '.join(half.names)})")
    item = half.signal(signal_name)
    if not bit_name:
        return Word(key, item)
    bits = {bit.name: bit for bit in item.fields(positioning=half.mode is ApplicationMode.POSITIONING)}
    if bit_name not in bits:
        hint = did_you_mean(bit_name, bits)
        raise GatewayError(f"{key}: not a bit of {signal_name}{hint} (allowed: {', '.join(bits)})")
    return Word(key, item, bits[bit_name])


def _word(name: str, half: TelegramHalf) -> Word:
    number, words = half.telegram, words_of(half)
    if name in words:
        return words[name]
    others = telegrams_of().get(name)
    if others:
        raise GatewayError(f"{name}: not in telegram {number}, only in {', '.join(map(str, others))}")
    raise GatewayError(f"{name}: unknown word{did_you_mean(name, words)} (of telegram {number}: {', '.join(words)})")
