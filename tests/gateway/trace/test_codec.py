"""Recorded values: every class that can be in one is found by its name."""

from __future__ import annotations

import enum
import importlib
import typing
from collections.abc import Iterator
from dataclasses import is_dataclass

from pdgw.gateway.trace.steps import HOMES, recorded_class


def test_every_class_within_a_recorded_value_is_found_by_its_name() -> None:
    waiting = [found for home in HOMES for found in _own(home)]
    seen: set[type] = set()
    while waiting:
        kind = waiting.pop()
        if kind not in seen:
            seen.add(kind)
            waiting += [inner for hint in _hints(kind) for inner in _classes(hint)]
    assert [kind for kind in seen if recorded_class(kind.__name__) is not kind] == []


def _own(module: str) -> Iterator[type]:
    """The dataclasses that a module defines."""
    for found in vars(importlib.import_module(module)).values():
        if isinstance(found, type) and is_dataclass(found) and found.__module__ == module:
            yield found


def _hints(kind: type) -> list[object]:
    return list(typing.get_type_hints(kind).values()) if is_dataclass(kind) else []


def _classes(hint: object) -> Iterator[type]:
    """The dataclasses and enums in a type."""
    if isinstance(hint, type) and (is_dataclass(hint) or issubclass(hint, enum.Enum)):
        yield hint
    for inner in typing.get_args(hint):
        yield from _classes(inner)
