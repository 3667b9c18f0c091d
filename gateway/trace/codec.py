"""Values of the gateway as JSON with named fields: frozen dataclasses, enums, fractions, bytes, tuples and mappings of them.

A reader ignores a field that this version does not have, and gives a new one its default.
"""

from __future__ import annotations

import enum
import importlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any, Final

from pdgw.gateway.errors import GatewayError

_KIND: Final = ""
"""Key of the kind of a value that JSON does not have."""
_VALUE: Final = "is"
_PACKAGE: Final = __name__.partition(".")[0]


def to_json(value: object) -> Any:
    """Plain data for ``json.dumps``; TypeError for a value of another kind."""
    kind = type(value)
    if isinstance(value, enum.Enum):
        return {_KIND: _name(kind), _VALUE: value.name}
    if value is None or isinstance(value, str | int | float):
        return value
    if is_dataclass(value):
        return {_KIND: _name(kind)} | {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
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
    made = _class(kind)
    if issubclass(made, enum.Enum):
        return made[value[_VALUE]]
    return made(**{item.name: from_json(value[item.name]) for item in fields(made) if item.name in value})


_BUILT_IN: Final[dict[str, Any]] = {
    "dict": dict,
    "frozenset": frozenset,
    "bytes": bytes.fromhex,
    "Fraction": Fraction,
}


def _name(kind: type) -> str:
    return f"{kind.__module__.removeprefix(_PACKAGE + '.')}.{kind.__qualname__}"


def _class(name: str) -> Any:
    module, _, kind = name.rpartition(".")
    try:
        found = getattr(importlib.import_module(f"{_PACKAGE}.{module}"), kind)
    except (ImportError, AttributeError):
        found = None
    if not is_dataclass(found) and not (isinstance(found, type) and issubclass(found, enum.Enum)):
        raise GatewayError(f"{name}: this version has no such value")
    return found
