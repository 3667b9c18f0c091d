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
        """Name for ``set`` and ``expect``: ``NSOLL_A``, ``STW1.ON``."""
        return self.signal.name if self.bit is None else f"{self.signal.name}.{self.bit.name}"

    @property
    def meaning(self) -> str:
        """Meaning of the value, or of 1."""
        return self.signal.description if self.bit is None else self.bit.meaning

    @property
    def switch(self) -> bool:
        """Whether it is one bit."""
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
    """Every word with the telegrams that contain it."""
    found: dict[str, tuple[int, ...]] = {}
    for number in TELEGRAMS:
        for name in words_of(number):
            found[name] = (*found.get(name, ()), number)
    return MappingProxyType(found)


def word(name: str, number: int) -> Word:
    """A word of a telegram. GatewayError names the telegrams that have it, or similar words."""
    words = words_of(number)
    if name in words:
        return words[name]
    others = telegrams_of().get(name)
    if others:
        raise GatewayError(f"{name}: not in telegram {number}, only in {', '.join(map(str, others))}")
    raise GatewayError(f"{name}: unknown word{did_you_mean(name, words)} (of telegram {number}: {', '.join(words)})")
