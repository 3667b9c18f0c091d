"""Types and values of Structured Text: numbers of limited width, structures as dictionaries, arrays as lists.

Source: IEC 61131-3 second edition, chapter 2.3. Values are converted only by conversion functions. A literal gets the type
that its use requires. TIME is in nanoseconds.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

Value = Any
"""bool, int, float, str, a dictionary (structure, instance of a block) or a list."""
Variables = dict[str, Value]


class Kind(enum.Enum):
    BOOL = "BOOL"
    BITS = "bit string"
    SIGNED = "signed integer"
    UNSIGNED = "unsigned integer"
    REAL = "floating-point number"
    TIME = "time"
    STRING = "string"


@dataclass(frozen=True, slots=True)
class Elementary:
    """``bits``: width of a number, or greatest length of a STRING."""

    name: str
    kind: Kind
    bits: int = 0
    cut: Callable[[Value], Value] = field(init=False, repr=False, compare=False)
    """Convert a value to the range of the type: integers wrap, a REAL is rounded to 32 bits."""

    @property
    def initial(self) -> Value:
        return {Kind.BOOL: False, Kind.REAL: 0.0, Kind.STRING: ""}.get(self.kind, 0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cut", self._cutting())

    def _cutting(self) -> Callable[[Value], Value]:
        mask, half = (1 << self.bits) - 1, 1 << self.bits >> 1
        if self.kind in {Kind.BITS, Kind.UNSIGNED}:
            return lambda value: value & mask
        if self.kind is Kind.SIGNED:
            return lambda value: (value + half & mask) - half
        if self.kind is Kind.REAL and self.bits == 32:
            return lambda value: struct.unpack("<f", struct.pack("<f", value))[0]
        return (lambda value: value[: self.bits]) if self.kind is Kind.STRING else lambda value: value

    def holds(self, value: Value) -> bool:
        """Whether a literal is in range."""
        if self.kind is Kind.BITS:
            return bool(0 <= value < 1 << self.bits)
        return self.kind is Kind.REAL or bool(self.cut(value) == value)


_BITS, _SIGNED, _UNSIGNED, _REAL = Kind.BITS, Kind.SIGNED, Kind.UNSIGNED, Kind.REAL
BOOL, TIME = Elementary("BOOL", Kind.BOOL), Elementary("TIME", Kind.TIME)
DINT = Elementary("DINT", _SIGNED, 32)
ELEMENTARY: dict[str, Elementary] = {
    item.name: item
    for item in (
        BOOL,
        TIME,
        DINT,
        *(Elementary(name, _BITS, bits) for name, bits in (("BYTE", 8), ("WORD", 16), ("DWORD", 32), ("LWORD", 64))),
        *(Elementary(name, _SIGNED, bits) for name, bits in (("SINT", 8), ("INT", 16), ("LINT", 64))),
        *(Elementary(name, _UNSIGNED, 8 << n) for n, name in enumerate(("USINT", "UINT", "UDINT", "ULINT"))),
        Elementary("REAL", _REAL, 32),
        Elementary("LREAL", _REAL, 64),
        Elementary("STRING", Kind.STRING, 254),
    )
}
INTEGER_LITERAL, REAL_LITERAL = Elementary("integer literal", _SIGNED, 65), Elementary("real literal", _REAL, 64)
"""Types of literals until they are used."""


@dataclass(frozen=True, slots=True)
class Array:
    low: int
    high: int
    element: Type

    @property
    def name(self) -> str:
        return f"ARRAY[{self.low}..{self.high}] OF {self.element.name}"

    @property
    def initial(self) -> Value:
        return [self.element.initial for _ in range(self.low, self.high + 1)]


@dataclass(slots=True, eq=False)
class Variable:
    """``section``: VAR_INPUT etc., or empty for a field of a structure. ``start``: its own initial value."""

    type: Type
    section: str = ""
    start: Value = None


@dataclass(slots=True, eq=False)
class Structure:
    """A structure; names of fields are upper case."""

    name: str
    fields: dict[str, Variable]

    @property
    def initial(self) -> Value:
        return first_values(self.fields)


@dataclass(slots=True, eq=False)
class Unit:
    """A program organisation unit. ``kind``: PROGRAM, FUNCTION_BLOCK or FUNCTION. ``result``: only for a function."""

    kind: str
    name: str
    variables: dict[str, Variable]
    result: Type | None = None
    body: Callable[[Variables], None] = lambda _: None

    @property
    def initial(self) -> Value:
        return first_values(self.variables)

    def section(self, name: str) -> dict[str, Variable]:
        return {key: item for key, item in self.variables.items() if item.section == name}


Type = Elementary | Array | Structure | Unit


def first_values(variables: dict[str, Variable]) -> Variables:
    """Initial values of variables. Those of VAR_IN_OUT are passed with each call."""
    return {
        key: copied(item.start)
        if item.start is not None
        else None
        if item.section == "VAR_IN_OUT"
        else item.type.initial
        for key, item in variables.items()
    }


def copied(value: Value) -> Value:
    """Copy a structure or an array for an assignment."""
    if isinstance(value, dict):
        return {key: copied(item) for key, item in value.items()}
    if not isinstance(value, list):
        return value
    return [copied(item) for item in value] if value and isinstance(value[0], dict | list) else value.copy()
