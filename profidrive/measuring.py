"""Reference mark search and measurement on the fly: bits 0-7 of G1_STW and 0-7 of G1_ZSW. Sans-I/O."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pdgw.profidrive.signals import signal

_G1_STW = signal("G1_STW")
_G1_ZSW = signal("G1_ZSW")
FUNCTIONS: Final = 4
_SELECTED: Final = (1 << FUNCTIONS) - 1
_COMMAND = _G1_STW.bit("COMMAND")
_ON_THE_FLY = _G1_STW.bit("MODE").mask
_VALUE_1 = _G1_ZSW.bit("VALUE_1").position
_REFERENCE_FUNCTIONS = 1 << 0


class SensorCommand(enum.IntEnum):
    """G1_STW bits 4-6."""

    NONE = 0
    ACTIVATE = 1
    READ = 2
    ABORT = 3


class Refusal(enum.Enum):
    """Why a command is not carried out."""

    NOT_SUPPORTED = "no such function"
    NO_VALUE = "no value to read"
    REFUSED = "not carried out by the device"


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Positions that the device must latch; a new object for each activation. ``functions``: a mask, bit 0 is function 1."""

    on_the_fly: bool
    functions: int


class Measuring:
    """One sensor. Call ``step`` once per cycle. While ``search`` is not None, the owner must search and call ``found``."""

    def __init__(self) -> None:
        self.search: Search | None = None
        self.on_the_fly = False
        """Whether the last command was a measurement on the fly."""
        self.value: int | None = None
        """Value of the present read command."""
        self.refusal: Refusal | None = None
        """Problem in this step."""
        self._values: dict[int, int] = {}
        self._command = SensorCommand.NONE.value
        self._read = -1

    def step(self, word: int) -> int:
        """One cycle: G1_STW (0 without a PLC); returns bits 0-7 of G1_ZSW."""
        self.refusal = None
        command = _COMMAND.of(word)
        if command != self._command:
            self._command = command
            self._end_read()
            self.on_the_fly = word & _ON_THE_FLY != 0
            functions = word & _SELECTED
            if command == SensorCommand.ACTIVATE:
                self._activate(functions)
            elif command == SensorCommand.READ:
                self._begin_read(functions)
            elif command == SensorCommand.ABORT:
                self.search = None
            elif command != SensorCommand.NONE:
                self.refusal = Refusal.NOT_SUPPORTED
        active = 0 if self.search is None else self.search.functions
        for function in self._values:
            active |= 1 << function + _VALUE_1
        return active

    @property
    def busy(self) -> bool:
        """There is something to do or to show, also without a command."""
        return self.search is not None or self._command != SensorCommand.NONE or bool(self._values)

    def cancel(self) -> None:
        """The sensor has another state: abort searches, drop values."""
        self.search = None
        self.value = None
        self._values.clear()

    def found(self, search: Search, values: Mapping[int, int]) -> None:
        """Positions by function (0 to 3); those of a search that is over count for nothing."""
        if search is not self.search:
            return
        self._values |= values
        left = search.functions & ~sum(1 << function for function in values)
        self.search = Search(search.on_the_fly, left) if left else None

    def _activate(self, functions: int) -> None:
        allowed = _SELECTED if self.on_the_fly else _REFERENCE_FUNCTIONS
        if not functions or functions & ~allowed:
            self.refusal = Refusal.NOT_SUPPORTED
            return
        for function in range(FUNCTIONS):
            if functions >> function & 1:
                self._values.pop(function, None)
        self.search = Search(self.on_the_fly, functions)

    def _begin_read(self, functions: int) -> None:
        chosen = functions.bit_length() - 1
        if chosen in self._values and functions == 1 << chosen:
            self._read = chosen
            self.value = self._values[chosen]
        else:
            self.refusal = Refusal.NO_VALUE

    def _end_read(self) -> None:
        self.value = None
        self._values.pop(self._read, None)
        self._read = -1
