"""Words of the PLC simulator from the telegrams: every sent value and bit by its declared name.

A value has the name of its signal (``override``, ``kpc``), a bit its declared name (``tracking``, ``open_brake``). Bits of a
sensor's word have the sensor as a prefix (``g1_park``). All are in lower case. Bits without a function are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from pdgw.gateway.errors import GatewayError
from pdgw.phrases import did_you_mean
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, Direction, TelegramHalf, telegram
from pdgw.profidrive.words import Bit

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
def words_of(number: int) -> Mapping[str, Word]:
    """The words of a telegram by name, in the order of its frame."""
    half = telegram(number).setpoints
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
    for number in TELEGRAMS:
        for name in words_of(number):
            found[name] = (*found.get(name, ()), number)
    return MappingProxyType(found)


def find(key: str, half: TelegramHalf) -> Word:
    """A word of the telegram, or a ``SIGNAL`` or ``SIGNAL.BIT`` of either half. GatewayError names what is allowed."""
    if half.direction is Direction.SETPOINT and key.islower():
        return _word(key, half.telegram)
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


def _word(name: str, number: int) -> Word:
    words = words_of(number)
    if name in words:
        return words[name]
    others = telegrams_of().get(name)
    if others:
        raise GatewayError(f"{name}: not in telegram {number}, only in {', '.join(map(str, others))}")
    raise GatewayError(f"{name}: unknown word{did_you_mean(name, words)} (of telegram {number}: {', '.join(words)})")
