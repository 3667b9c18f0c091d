"""Errors of pydantic as texts for the user: key, value, and what is allowed.

Every package that reads a file may import this function. A check of a whole file that concerns one place raises ``misplaced``,
so that the message names the place.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterator, Mapping, Set
from difflib import get_close_matches
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

Location = tuple[str | int, ...]

_PLACED = "placed"
_RANGES = ("greater_than", "less_than")
_BOUNDS = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}
_INTEGER, _NUMBER, _LIST, _TABLE = "an integer", "a number", "a list", "keys with values"
_BOOLEAN, _TEXT = "a boolean (true or false)", "a text in quotation marks"
_EXPECTED = {
    "int_type": _INTEGER,
    "int_from_float": _INTEGER,
    "int_parsing": _INTEGER,
    "float_type": _NUMBER,
    "float_parsing": _NUMBER,
    "bool_type": _BOOLEAN,
    "bool_parsing": _BOOLEAN,
    "string_type": _TEXT,
    "path_type": _TEXT,
    "list_type": _LIST,
    "tuple_type": _LIST,
    "dict_type": _TABLE,
    "model_type": _TABLE,
    "model_attributes_type": _TABLE,
    "ip_v4_address": 'an IPv4 address such as "192.168.0.2"',
    "ip_v4_interface": 'an IPv4 address with its prefix length such as "192.168.0.2/24"',
    "ip_v4_network": 'an IPv4 address or network such as "192.168.0.0/24"',
}
_SHOWN = 6
"""Number of similar keys in the error of an unknown one."""
_SIMILAR = 0.5
_SURE = 0.8
"""A key this similar to one of its table is a typing error, also if another table has it."""
_GIVEN = re.compile(r"\{(\w+)\|(.*?)\}")
"""``{key|default}``: the user's value of a removed key."""


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
    error: ValidationError, root: type[BaseModel], hints: Mapping[str, str] = MappingProxyType({})
) -> list[Problem]:
    """Everything that is wrong with what should be a ``root``; all that a value could have been instead is one problem.

    ``hints``: texts for keys that do not exist ("transport.example"): those of earlier versions, and other words for a key. They
    can contain values of such keys of the same table, ``{key|default}``.
    """
    found: dict[tuple[Location, str], tuple[_Place, list[ErrorDetails]]] = {}
    for detail in error.errors(include_url=False):
        place = _place(detail["loc"], root)
        kind = detail["type"] if detail["type"] in {_PLACED, "missing"} else ""
        further = detail["ctx"]["location"] if kind == _PLACED else ()
        found.setdefault(((*place.location, *further), kind), (place, []))[1].append(detail)
    given = {location: details[0]["input"] for (location, _), (_, details) in found.items()}
    result = []
    for (location, kind), (place, details) in found.items():
        if kind == _PLACED:
            result += [Problem(location, "", detail["ctx"]["text"], names_key=True) for detail in details]
        elif hint := hints.get(".".join(part for part in location if isinstance(part, str))):
            result.append(Problem(location, "", _with_values(hint, location[:-1], given)))
        else:
            result.append(_problem(place, details, root))
    return list(dict.fromkeys(result))


def value_text(error: ValidationError) -> str:
    """What is wrong with one value without a model, such as that of an option."""
    problem = _problem(_Place((), frozenset(), None), error.errors(include_url=False)[:1], BaseModel)
    return problem.text if problem.value in problem.text else f"{problem.value}: {problem.text}"


def _with_values(hint: str, table: Location, given: Mapping[Location, Any]) -> str:
    return _GIVEN.sub(lambda match: repr(given[place]) if (place := (*table, match[1])) in given else match[2], hint)


def _problem(place: _Place, details: list[ErrorDetails], root: type[BaseModel]) -> Problem:
    first = details[0]
    if first["type"] == "missing":
        return _missing(place, first["input"])
    if first["type"] == "extra_forbidden":
        return Problem(place.location, "", f"unknown key{_suggestion(place, root)}")
    value, allowed = first["input"], _allowed(place.field)
    expected = dict.fromkeys(_EXPECTED[detail["type"]] for detail in details if detail["type"] in _EXPECTED)
    if len(expected) < len({detail["type"] for detail in details}):
        texts = dict.fromkeys(_text(detail, allowed) for detail in details if detail["type"] not in _EXPECTED)
        text = " or ".join(texts)
    else:
        nouns = [noun for noun in expected if noun != _INTEGER or _NUMBER not in expected]
        text = f"expected {' or '.join(nouns)}{allowed}"
    shown = "" if isinstance(value, dict | list | tuple | BaseModel) else repr(value)
    return Problem(place.location, shown, text)


def _text(detail: ErrorDetails, allowed: str) -> str:
    kind = detail["type"]
    context = detail.get("ctx", {})
    if kind in {"enum", "literal_error"}:
        return f"allowed: {context['expected']}"
    if kind == "finite_number":
        return f"expected a finite number{allowed}"
    if kind.startswith(_RANGES):
        return (allowed or _between(context)).removeprefix(", ")
    if kind == "too_short" and context.get("actual_length") == 0:
        return "at least one is needed"
    return detail["msg"].removeprefix("Value error, ")


def _missing(place: _Place, given: Any) -> Problem:
    """A mandatory key that is missing, or the misspelt one in its place."""
    *table, key = place.location
    for misspelt in get_close_matches(
        str(key), [name for name in given if isinstance(given, dict) and name not in place.keys], 1
    ):
        return Problem((*table, misspelt), "", f"unknown key; did you mean {key}?")
    return Problem(place.location, "", "is missing" + _allowed(place.field))


def _suggestion(place: _Place, root: type[BaseModel]) -> str:
    """The most similar key of this table, else the similar ones or all of them, and the table that has such a key."""
    key, tables = str(place.location[-1]), list(_tables(root))
    everywhere = [name for _, keys in tables for name in keys]
    if own := get_close_matches(key, place.keys, 1, _SURE):
        return f"; did you mean {own[0]}?"
    elsewhere = get_close_matches(key, everywhere, 1, _SURE)
    if not elsewhere and (own := get_close_matches(key, place.keys, 1)):
        return f"; did you mean {own[0]}?"
    nearest = get_close_matches(key, place.keys, _SHOWN, 0 if len(place.keys) <= _SHOWN else _SIMILAR) or place.keys
    others = len(place.keys) - len(nearest)
    shown = ", ".join(name for name in place.keys if name in nearest)
    text = f" (allowed: {shown}{f' and {others} others' if others else ''})"
    for similar in elsewhere:
        paths = [f" in [{path}]" if path else " before the first table" for path, keys in tables if similar in keys]
        text += f"; did you mean {similar}{' or'.join(paths)}?"
    return text


def _tables(model: type[BaseModel], path: str = "") -> Iterator[tuple[str, Mapping[str, FieldInfo]]]:
    """Every table of a file by its path, with its keys."""
    yield path, model.model_fields
    for key, field in model.model_fields.items():
        inner = _model_in(field.annotation)
        if inner is not None:
            yield from _tables(inner, f"{path}.{key}".lstrip("."))


# -- ranges -------------------------------------------------------------------------------------------------------------


def _allowed(field: FieldInfo | None) -> str:
    """``, allowed: 1 to 126``, as far as the field's constraints say it."""
    bounds: dict[str, Any] = {}
    for item in () if field is None else (*field.metadata, *_metadata(field.annotation)):
        for name in _BOUNDS:
            value = getattr(item, name, None)
            if value is not None:
                bounds.setdefault(name, value)
    return _between(bounds)


def _between(bounds: Mapping[str, Any]) -> str:
    if {"ge", "le"} <= bounds.keys():
        return f", allowed: {bounds['ge']} to {bounds['le']}"
    shown = " and ".join(f"{_BOUNDS[name]} {value}" for name, value in bounds.items())
    return shown and f", allowed: {shown}"


def _metadata(annotation: Any) -> Iterator[Any]:
    """The constraints inside unions and annotations."""
    if get_origin(annotation) is Annotated:
        for item in annotation.__metadata__:
            yield from item.metadata if isinstance(item, FieldInfo) else (item,)
    for part in get_args(annotation):
        if not isinstance(part, str):
            yield from _metadata(part)


# -- the way through the models -----------------------------------------------------------------------------------------


class _Place(NamedTuple):
    """A key, the keys of its table, and its field if it is known; of an item of a list, the list's."""

    location: Location
    keys: Set[str]
    field: FieldInfo | None


def _place(location: Location, root: type[BaseModel]) -> _Place:
    """Without what pydantic puts in: which member of a union it tried."""
    kept: list[str | int] = []
    keys: Set[str] = frozenset()
    annotation: Any = root
    field: FieldInfo | None = None
    for position, part in enumerate(location, 1):
        model = _model_in(annotation)
        if isinstance(part, int) or any(get_origin(member) in {dict, Mapping} for member in _members(annotation)):
            annotation = _items_of(annotation)
        elif model is not None and (part in model.model_fields or position == len(location)):
            keys, field = model.model_fields.keys(), model.model_fields.get(part)
            annotation = field and field.annotation
        else:
            continue
        kept.append(part)
    return _Place(tuple(kept), keys, field)


def _items_of(annotation: Any) -> Any:
    """Type of the items of a list or mapping."""
    for part in _members(annotation):
        if get_origin(part) in {list, tuple, dict, Mapping}:
            return [item for item in get_args(part) if item is not Ellipsis][-1]
    return annotation


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The table that a value, or each item of it, is."""
    for part in _members(annotation):
        if isinstance(part, type) and issubclass(part, BaseModel):
            return part
        items = _items_of(part)
        inner = None if items is part else _model_in(items)
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
