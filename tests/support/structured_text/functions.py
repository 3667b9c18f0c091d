"""The standard functions and blocks of the subset.

Source: IEC 61131-3 second edition, chapters 2.5.1.5 and 2.5.2.3.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

from tests.support.structured_text.types import BOOL, ELEMENTARY, TIME, Elementary, Kind, Unit, Variable, Variables

_NUMBERS = {Kind.SIGNED, Kind.UNSIGNED, Kind.REAL}
_WHOLE = {Kind.BITS, Kind.SIGNED, Kind.UNSIGNED, Kind.BOOL}


class Standard(NamedTuple):
    """``like``: parameters with the type of the result; the others have their given type."""

    parameters: tuple[str, ...]
    like: frozenset[str]
    others: dict[str, str]
    kinds: set[Kind]
    does: Callable[..., Any]


def _standard(names: str, like: str, others: dict[str, str], kinds: set[Kind], does: Callable[..., Any]) -> Standard:
    return Standard(tuple(names.split()), frozenset(like.split()), others, kinds, does)


FUNCTIONS = {
    "SHL": _standard("IN N", "IN", {"N": "INT"}, {Kind.BITS}, lambda value, count: value << count),
    "SHR": _standard("IN N", "IN", {"N": "INT"}, {Kind.BITS}, lambda value, count: value >> count),
    "ABS": _standard("IN", "IN", {}, _NUMBERS, abs),
    "MIN": _standard("IN1 IN2", "IN1 IN2", {}, _NUMBERS, min),
    "LIMIT": _standard("MN IN MX", "MN IN MX", {}, _NUMBERS, lambda low, value, high: max(low, min(value, high))),
    "SEL": _standard(
        "G IN0 IN1", "IN0 IN1", {"G": "BOOL"}, {*_NUMBERS, Kind.BOOL, Kind.BITS}, lambda g, no, yes: yes if g else no
    ),
}


def conversion(name: str) -> tuple[Elementary, Elementary, Callable[[Any], Any]] | None:
    """Source, target and function of a name like INT_TO_WORD; None for other names. A REAL is rounded half to even."""
    found = re.fullmatch(r"([A-Z]+)_TO_([A-Z]+)", name)
    if found is None or not {found[1], found[2]} <= ELEMENTARY.keys():
        return None
    source, target = ELEMENTARY[found[1]], ELEMENTARY[found[2]]
    kinds = {source.kind, target.kind}
    if kinds <= _WHOLE:
        return source, target, bool if target is BOOL else lambda value: target.cut(int(value))
    if kinds <= _NUMBERS:
        return source, target, float if target.kind is Kind.REAL else lambda value: target.cut(round(value))
    return None


def _on_delay(variables: Variables, now: int) -> None:
    if not variables["IN"]:
        variables["BEGIN"] = -1
    elif variables["BEGIN"] < 0:
        variables["BEGIN"] = now
    variables["ET"] = 0 if variables["BEGIN"] < 0 else min(now - variables["BEGIN"], variables["PT"])
    variables["Q"] = variables["IN"] and variables["ET"] >= variables["PT"]


def blocks(now: Callable[[], int]) -> dict[str, Unit]:
    """TON. ``now``: time of the controller in nanoseconds."""
    variables = {
        "IN": Variable(BOOL, "VAR_INPUT"),
        "PT": Variable(TIME, "VAR_INPUT"),
        "Q": Variable(BOOL, "VAR_OUTPUT"),
        "ET": Variable(TIME, "VAR_OUTPUT"),
        "BEGIN": Variable(TIME, "VAR", -1),
    }
    return {"TON": Unit("FUNCTION_BLOCK", "TON", variables, body=lambda values: _on_delay(values, now()))}
