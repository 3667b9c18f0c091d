"""Errors of pydantic as texts for the user: key, value, and what is allowed.

Every package that reads a file may import this function. A check of a whole file that concerns one place raises ``misplaced``,
so that the message names the place.
"""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from pdgw.phrases import did_you_mean

Location = tuple[str | int, ...]

_PLACED = "placed"
_RANGES = ("greater_than", "less_than")
_INTEGER, _NUMBER = "an integer", "a number"
_EXPECTED = {
    "int_type": _INTEGER,
    "int_from_float": _INTEGER,
    "int_parsing": _INTEGER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "bool_type": "a boolean (true or false)",
    "bool_parsing": "a boolean (true or false)",
    "string_type": "a text",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "keys with values",
    "model_type": "keys with values",
    "model_attributes_type": "keys with values",
}


class Problem(NamedTuple):
    """One thing that is wrong. ``value``: as text, empty where it would not help. ``names_key``: the text has the key."""

    location: Location
    value: str
    text: str
    names_key: bool = False

    @property
    def line(self) -> str:
        """``motion.limit = 0: allowed: 1 to 5``: the complete text for input without a file."""
        key = "" if self.names_key else ".".join(map(str, self.location))
        value = f" = {self.value}" if key and self.value else ""
        return f"{key}{value}{': ' if key else ''}{self.text}"


def misplaced(text: str, *location: str | int) -> PydanticCustomError:
    """The error of a check of several keys; ``text`` names them, ``location`` is where to look, like ``"axis", 1, "g1"``."""
    return PydanticCustomError(_PLACED, "{text}", {"text": text, "location": location})


def problems(
    error: ValidationError, root: type[BaseModel], removed: Mapping[str, str] = MappingProxyType({})
) -> list[Problem]:
    """Everything that is wrong with what should be a ``root``; all that a value could have been instead is one problem.

    ``removed``: keys of earlier versions ("transport.example") with the version of their end and the reason.
    """
    found: dict[tuple[Location, str], list[ErrorDetails]] = {}
    for detail in error.errors(include_url=False):
        context = detail.get("ctx", {})
        if detail["type"] == _PLACED:
            key = ((*_without_tags(detail["loc"], root), *context["location"]), _PLACED)
        else:
            key = (_without_tags(detail["loc"], root), "missing" if detail["type"] == "missing" else "")
        found.setdefault(key, []).append(detail)
    result = []
    for (location, kind), details in found.items():
        if kind == _PLACED:
            result += [Problem(location, "", detail["ctx"]["text"], names_key=True) for detail in details]
        else:
            result.append(_problem(location, details, root, removed))
    return result


def _problem(
    location: Location, details: list[ErrorDetails], root: type[BaseModel], removed: Mapping[str, str]
) -> Problem:
    first = details[0]
    if first["type"] == "missing":
        return Problem(location, "", "is missing")
    if first["type"] == "extra_forbidden":
        reason = removed.get(".".join(part for part in location if isinstance(part, str)))
        if reason is not None:
            return Problem(location, "", f"was removed in {reason}")
        model = _model_at(location[:-1], root)
        known = list(model.model_fields) if model else []
        hint = did_you_mean(str(location[-1]), known)
        return Problem(location, "", f"unknown key{hint} (allowed: {', '.join(known)})")
    field = _field_at(location, root)
    expected = list(dict.fromkeys(_EXPECTED[detail["type"]] for detail in details if detail["type"] in _EXPECTED))
    if len(expected) < len({detail["type"] for detail in details}):
        texts = dict.fromkeys(_text(detail, field) for detail in details if detail["type"] not in _EXPECTED)
        return Problem(location, _shown(first["input"]), " or ".join(texts))
    nouns = [noun for noun in expected if noun != _INTEGER or _NUMBER not in expected]
    allowed = _range(field) if field is not None else ""
    text = f"expected {' or '.join(nouns)}" + (f", allowed: {allowed}" if allowed else "")
    return Problem(location, _shown(first["input"]), text)


def _shown(value: Any) -> str:
    return "" if isinstance(value, dict | list | tuple | BaseModel) else repr(value)


def _text(detail: ErrorDetails, field: FieldInfo | None) -> str:
    kind = detail["type"]
    context = detail.get("ctx", {})
    if kind in {"enum", "literal_error"}:
        return f"allowed: {context['expected']}"
    allowed = _range(field) if field is not None else ""
    if kind == "finite_number":
        return "expected a finite number" + (f", allowed: {allowed}" if allowed else "")
    if kind.startswith(_RANGES) and allowed:
        return f"allowed: {allowed}"
    if kind == "too_short" and context.get("actual_length") == 0:
        return "at least one is needed"
    return detail["msg"].removeprefix("Value error, ")


# -- ranges -------------------------------------------------------------------------------------------------------------


def _range(field: FieldInfo) -> str:
    """``1 to 126``, as far as the field's constraints say it."""
    bounds: dict[str, Any] = {}
    for item in (*field.metadata, *_metadata(field.annotation)):
        for name in ("ge", "gt", "le", "lt"):
            value = getattr(item, name, None)
            if value is not None:
                bounds.setdefault(name, value)
    low = f"{bounds['ge']}" if "ge" in bounds else f"more than {bounds['gt']}" if "gt" in bounds else ""
    high = f"{bounds['le']}" if "le" in bounds else f"less than {bounds['lt']}" if "lt" in bounds else ""
    if low and high:
        return f"{low} to {high}"
    return f"at most {high}" if high else f"at least {low}" if "ge" in bounds else low


def _metadata(annotation: Any) -> Iterator[Any]:
    """The constraints inside unions and annotations."""
    if get_origin(annotation) is Annotated:
        for item in annotation.__metadata__:
            yield from item.metadata if isinstance(item, FieldInfo) else (item,)
    for part in get_args(annotation):
        if not isinstance(part, str):
            yield from _metadata(part)


# -- the way through the models -----------------------------------------------------------------------------------------


def _without_tags(location: Location, root: type[BaseModel]) -> Location:
    """The keys of a location: pydantic also puts in which member of a union it tried."""
    kept: list[str | int] = []
    annotation: Any = root
    for position, part in enumerate(location):
        model = _model_in(annotation)
        last = position == len(location) - 1
        if isinstance(part, int) or _is_mapping(annotation):
            kept.append(part)
            annotation = _items_of(annotation)
        elif model is not None and part in model.model_fields:
            kept.append(part)
            annotation = _annotation(model.model_fields[part])
        elif model is not None and last:
            kept.append(part)  # an unknown key
    return tuple(kept)


def _field_at(location: Location, root: type[BaseModel]) -> FieldInfo | None:
    model = _model_at(location[:-1], root)
    return model.model_fields.get(str(location[-1])) if model is not None and location else None


def _model_at(location: Location, root: type[BaseModel]) -> type[BaseModel] | None:
    annotation: Any = root
    for part in location:
        model = _model_in(annotation)
        if isinstance(part, int) or _is_mapping(annotation):
            annotation = _items_of(annotation)
        elif model is not None and part in model.model_fields:
            annotation = _annotation(model.model_fields[part])
        else:
            return None
    return _model_in(annotation)


def _annotation(field: FieldInfo) -> Any:
    return field.annotation


def _items_of(annotation: Any) -> Any:
    """Type of the items of a list or mapping."""
    for part in _members(annotation):
        if get_origin(part) in {list, tuple, dict, Mapping}:
            return [item for item in get_args(part) if item is not Ellipsis][-1]
    return annotation


def _is_mapping(annotation: Any) -> bool:
    return any(get_origin(part) in {dict, Mapping} for part in _members(annotation))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    for part in _members(annotation):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part
        if get_origin(part) in {list, tuple}:
            inner = _model_in(get_args(part)[0])
            if inner is not None:
                return inner
    return None


def _members(annotation: Any) -> Iterator[Any]:
    """The types an annotation is made of, without ``Annotated`` and unions around them."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _members(get_args(annotation)[0])
    elif origin in {Union, types.UnionType}:
        for part in get_args(annotation):
            yield from _members(part)
    else:
        yield annotation
