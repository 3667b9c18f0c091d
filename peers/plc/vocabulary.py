"""The words of the PLC simulator that nobody had to write: every value and every bit a telegram sends, by its declared name.

A value is called as its signal (``override``, ``kpc``), a bit as it is declared (``tracking``, ``open_brake``), one of a sensor's
word with the sensor before it (``g1_park``), all in lower case. Left out: bits without a function.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from pdgw.explain import did_you_mean
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationMode, telegram
from pdgw.profidrive.words import Bit

_WITHOUT_FUNCTION = ("DEVICE_", "RESERVED")
_SENSOR_WORDS = "_STW"
_SENSORS = ("G1", "G2")


@dataclass(frozen=True, slots=True)
class Word:
    """A setpoint, or one field of it."""

    name: str
    signal: Signal
    bit: Bit | None = None

    @property
    def key(self) -> str:
        """As ``set`` and ``expect`` have it: ``NSOLL_A``, ``STW1.ON``."""
        return self.signal.name if self.bit is None else f"{self.signal.name}.{self.bit.name}"

    @property
    def meaning(self) -> str:
        """Of the value, or of 1."""
        return self.signal.description if self.bit is None else self.bit.meaning

    @property
    def switch(self) -> bool:
        """It is one bit."""
        return self.bit is not None and self.bit.width == 1


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
    """Every word with the telegrams that have it."""
    found: dict[str, tuple[int, ...]] = {}
    for number in TELEGRAMS:
        for name in words_of(number):
            found[name] = (*found.get(name, ()), number)
    return MappingProxyType(found)


def word(name: str, number: int) -> Word:
    """A word of a telegram; GatewayError says which telegrams have it, or what could have been meant."""
    words = words_of(number)
    if name in words:
        return words[name]
    others = telegrams_of().get(name)
    if others:
        raise GatewayError(f"{name}: not in telegram {number}, only in {', '.join(map(str, others))}")
    raise GatewayError(f"{name}: unknown word{did_you_mean(name, words)} (of telegram {number}: {', '.join(words)})")
