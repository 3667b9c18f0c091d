"""Values of the gateway as JSON.

It has named fields: frozen dataclasses, enums, fractions, bytes, tuples and mappings of them. A value has the name of its class,
so a recording does not depend on the module that defines it. A reader ignores a field that this version does not have, and gives
a new one its default.
"""

from __future__ import annotations

import enum
import importlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any, Final

from pdgw.gateway.base.errors import GatewayError

_KIND: Final = ""
"""Key of the kind of a value that JSON does not have."""
_VALUE: Final = "is"
HOMES: Final = (
    "pdgw.gateway.trace.pcapng",
    "pdgw.ds301.node.node",
    "pdgw.ds301.objects",
    "pdgw.ds301.pdo",
    "pdgw.ds301.values",
    "pdgw.dsp402.drive_type",
    "pdgw.gateway.axis.executors.sensor",
    "pdgw.gateway.axis.settings",
    "pdgw.gateway.axis.values",
    "pdgw.gateway.motion.blocks",
    "pdgw.gateway.motion.dsc_setpoint",
    "pdgw.gateway.motion.requests",
    "pdgw.gateway.base.fault_numbers",
    "pdgw.gateway.base.reasons",
)
"""Modules with the classes of recorded values. A description needs the first only."""


def to_json(value: object) -> Any:
    """Plain data for ``json.dumps``; TypeError for a value of another kind."""
    kind = type(value)
    if isinstance(value, enum.Enum):
        return {_KIND: kind.__name__, _VALUE: value.name}
    if value is None or isinstance(value, str | int | float):
        return value
    if is_dataclass(value):
        return {_KIND: kind.__name__} | {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {_KIND: "dict", _VALUE: [[to_json(key), to_json(item)] for key, item in value.items()]}
    if isinstance(value, tuple | list):
        return [to_json(item) for item in value]
    if isinstance(value, frozenset):
        return {_KIND: "frozenset", _VALUE: [to_json(item) for item in sorted(value)]}
    if isinstance(value, bytes):
        return {_KIND: "bytes", _VALUE: value.hex()}
    if isinstance(value, Fraction):
        return {_KIND: "Fraction", _VALUE: str(value)}
    raise TypeError(f"{kind.__name__} cannot be recorded")


def from_json(value: Any) -> Any:
    """The value of plain data; lists become tuples. GatewayError for a kind that this version does not have."""
    if isinstance(value, list):
        return tuple(from_json(item) for item in value)
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind in _BUILT_IN:
        return _BUILT_IN[kind](from_json(value[_VALUE]))
    made = recorded_class(kind)
    if issubclass(made, enum.Enum):
        return made[value[_VALUE]]
    return made(**{item.name: from_json(value[item.name]) for item in fields(made) if item.name in value})


_BUILT_IN: Final[dict[str, Any]] = {
    "dict": dict,
    "frozenset": frozenset,
    "bytes": bytes.fromhex,
    "Fraction": Fraction,
}


def recorded_class(name: str) -> Any:
    """The dataclass or enum with this name. GatewayError: there is none."""
    kind = name.rpartition(".")[2]  # 0.9.0 wrote the module before it
    for home in HOMES:
        found = getattr(importlib.import_module(home), kind, None)
        if is_dataclass(found) or (isinstance(found, type) and issubclass(found, enum.Enum)):
            return found
    raise GatewayError(f"{name}: this version has no such value")
