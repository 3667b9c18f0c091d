"""How a value is named, scaled and shown, and the dictionary for packets that wait for an answer.

One ``Field`` is for a telegram signal or a mapped object. Source: ``profidrive.signals`` and the object declarations of
``ds301``/``dsp402``; nothing is declared twice here. The dictionary drops its oldest entries."""

from __future__ import annotations

import enum
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from math import isfinite
from typing import Any, Final, Generic, TypeVar

from pdgw.ds301.objects import Entry
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay, modes_of
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.states import Command, ControlBit, StatusBit, state_of
from pdgw.profidrive.datatypes import DataType, float_of
from pdgw.profidrive.signal_text import scale, value_text
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf
from pdgw.profidrive.words import Bit, unswapped

REMEMBERED: Final = 256
"""Calls and requests that wait for an answer."""

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class BoundedDict(Generic[K, V]):
    """The newest entries, so that unanswered packets do not fill the memory in a long capture."""

    def __init__(self) -> None:
        self._entries: OrderedDict[K, V] = OrderedDict()

    def put(self, key: K, value: V) -> None:
        """Remember, and forget the oldest."""
        self._entries[key] = value
        self._entries.move_to_end(key)
        if len(self._entries) > REMEMBERED:
            self._entries.popitem(last=False)

    def newest(self) -> Iterator[V]:
        """All that is remembered, the newest first."""
        return reversed(self._entries.values())

    def get(self, key: K) -> V | None:
        return self._entries.get(key)

    def pop(self, key: K) -> V | None:
        return self._entries.pop(key, None)


Raw = int | float | bytes
Document = dict[str, Any]


def parameter_text(item: Document) -> str:
    """One parameter of a request or response document."""
    parts = []
    if "pnu" in item:
        pnu = item["pnu"]
        # Users know 1:1 objects by their CANopen index.
        name = f"{pnu:04X}h" if 1000 <= pnu < 60000 else f"P{pnu}"
        parts.append(f"{name}.{item['subindex']}")
        if item["elements"] > 1:
            parts.append(f"x{item['elements']}")
        if item["attribute"] != "value":
            parts.append(item["attribute"])
    if "text" in item:
        parts.append(f"= {item['text']}" if "pnu" in item else item["text"])
    return " ".join(parts)


def identifier(name: str) -> str:
    """A name as filters spell it: lower case, everything but letters, digits and underscores replaced by ``_``."""
    return "".join(c if c.isalnum() else "_" for c in name.lower())


@dataclass(frozen=True, slots=True)
class Field:
    """One value of a data unit.

    ``convert`` makes a number in the unit of a raw value, None where raw values are shown as they are. ``shown`` gives the text
    of a telegram's number with its unit. ``explain`` gives a word for the value (the state of a Statusword), empty where it has
    none.
    """

    name: str
    description: str
    unit: str = ""
    bits: tuple[Bit, ...] = ()
    convert: Callable[[int], float] | None = None
    shown: Callable[[int], str] | None = None
    hex_digits: int = 0
    explain: Callable[[int], str] | None = None
    identifier: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "identifier", identifier(self.name))

    def value(self, raw: Raw) -> Raw:
        """The value in its unit."""
        return self.convert(raw) if self.convert and isinstance(raw, int) else raw

    def text(self, raw: Raw) -> str:
        """Name and value for the reader."""
        if isinstance(raw, bytes):
            return f"{self.name} {raw.hex(' ')}"
        if self.shown and isinstance(raw, int):
            return f"{self.name} {self.shown(raw)}"
        if self.hex_digits and isinstance(raw, int):
            word = self.explain(raw) if self.explain else ""
            return f"{self.name} {raw:0{self.hex_digits}X}h" + (f" [{word}]" if word else "")
        shown = f"{self.name} {raw}"
        if self.explain and isinstance(raw, int):
            word = self.explain(raw)
            return f"{shown} [{word}]" if word else shown
        return f"{shown} {self.unit}" if self.unit else shown

    def document(self, raw: Raw) -> Document:
        """Plain data: raw, value (None: not a number), unit, named bits, and the word for the value where it has one."""
        plain = raw.hex() if isinstance(raw, bytes) else raw
        value = self.value(plain) if isinstance(plain, int) else plain
        # JSON has no notation for NaN and infinity.
        shown = None if isinstance(value, float) and not isfinite(value) else value
        document: Document = {"raw": plain, "value": shown, "unit": self.unit, "bits": {}}
        if isinstance(raw, int):
            document["bits"] = {bit.name: bit.of(raw) for bit in self.bits}
            word = self.explain(raw) if self.explain else ""
            if word:
                document["text"] = word
        return document

    def bit(self, name: str) -> Bit | None:
        """The bit with this name (case ignored)."""
        return next((bit for bit in self.bits if bit.name.lower() == name), None)


def _status_word(word: int) -> str:
    state = state_of(word)
    return state.value if state else "not a state of CiA 402"


def _control_word(word: int) -> str:
    meant = unswapped(word)
    return "" if meant is None else f"bytes swapped? {meant:04X}h"


def _command_word(word: int) -> str:
    """The command a Controlword gives; of several that match, the one that decides on more bits."""
    matching = [command for command in Command if command is not Command.FAULT_RESET and command.matches(word)]
    if not matching:
        return "Fault Reset" if Command.FAULT_RESET.matches(word) else ""
    best = max(matching, key=lambda command: command.mask.bit_count())
    reset = " + Fault Reset" if Command.FAULT_RESET.matches(word) else ""
    return best.name.replace("_", " ").title() + reset


def _flags(masks: Mapping[str, int]) -> tuple[Bit, ...]:
    return tuple(Bit(mask.bit_length() - 1, name, name.replace("_", " ").lower()) for name, mask in masks.items())


def _declared(container: type) -> dict[str, int]:
    """The bits declared as constants of a class."""
    return {name: value for name, value in vars(container).items() if name.isupper()}


def name_in(kind: type[enum.Enum], value: object, other: str = "") -> str:
    """The name of a value in words; ``other`` for one that the enum does not have."""
    return kind(value).name.lower().replace("_", " ") if value in set(kind) else other


_Words = dict[str, tuple[tuple[Bit, ...], Callable[[int], str]]]


@cache
def _words(families: tuple[Overlay, ...]) -> _Words:
    """Objects whose values have a name, of a drive of one of these families: the same in a PDO, an SDO and telegram 100."""
    modes = modes_of(families)
    control = _declared(ControlBit)
    for family in families:
        control |= family.control_bits

    def mode_word(value: int) -> str:
        low = value & 0xFF
        signed = low - 256 if low > 127 else low
        return name_in(Mode, signed, modes.get(signed, ""))

    return {
        "Controlword": (_flags(control), _command_word),
        "Statusword": (_flags(_declared(StatusBit)), _status_word),
        "Modes of Operation": ((), mode_word),
        "Modes of Operation Display": ((), mode_word),
    }


def signal_field(signal: Signal, mode: ApplicationMode, families: Families) -> Field:
    """A telegram signal; the bits have the meaning of the telegram's application mode."""
    bits = tuple(signal.fields(positioning=mode is ApplicationMode.POSITIONING))
    word_bits, explain = _words(families.known).get(signal.name, ((), None))
    factor = scale(signal, None).factor
    is_word = bits or word_bits or signal.type is DataType.V2
    return Field(
        signal.name,
        signal.description,
        signal.unit,
        bits or word_bits,
        float_of if signal.is_float else None if factor == 1 else factor.__mul__,
        None if is_word or explain else partial(value_text, signal),
        2 * signal.type.size if is_word else 0,
        _control_word if signal.name == "STW1" else explain,
    )


def half_fields(half: TelegramHalf, families: Families = NO_CHOICE) -> tuple[Field, ...]:
    """The signals of one telegram direction."""
    return tuple(signal_field(signal, half.mode, families) for signal in half.signals)


def entry_field(entry: Entry, families: tuple[Overlay, ...]) -> Field:
    """An object of a drive that is of one of these families."""
    bits, explain = _words(families).get(entry.name, ((), None))
    return Field(
        entry.name,
        f"{entry.index:04X}h.{entry.subindex} {entry.name}",
        entry.unit,
        bits,
        hex_digits=entry.type.bits // 4 if bits else 0,
        explain=explain,
    )
