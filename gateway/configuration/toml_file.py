"""TOML files of the user: read, validated by a pydantic model, every mistake with its line."""

from __future__ import annotations

import enum
import json
import re
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pdgw.explain import Location, Problem, problems
from pdgw.files import read_file
from pdgw.gateway.errors import GatewayError

Root = TypeVar("Root", bound=BaseModel)
Sections = Mapping[str, type[BaseModel]]

FILE_MAX = 1 << 20
"""Bytes of a file a person writes: a configuration of 250 axes has a tenth of it."""
DEPTH_MAX = 16
"""Tables within tables; ours have four."""
_TWICE = re.compile(r"Cannot declare \('(\w+)',\) twice")
_ARRAY_AND_TABLE = re.compile(r"Cannot (?:overwrite a value|mutate immutable namespace \('(\w+)',\))")


def read_text(path: Path) -> str:
    """The text of a file, UTF-8 with or without byte order mark; GatewayError when it cannot be read."""
    try:
        return read_file(path, FILE_MAX).decode("utf-8-sig")
    except OSError as error:
        raise GatewayError(f"{path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise GatewayError(
            f"{path}: cannot be read: byte {error.start} is not UTF-8; save the file as UTF-8"
        ) from error


def parse_toml(
    root: type[Root],
    sections: Sections,
    text: str,
    name: str,
    removed: Mapping[str, str] = MappingProxyType({}),
    folder: Path = Path(),
) -> Root:
    """Validate TOML text by the model of the whole file; GatewayError has one line for each thing that is wrong.

    ``sections``: the models of the file's tables, by their name. ``removed``: see ``problems``.
    ``folder``: the context of the validation.
    """
    try:
        document = tomllib.loads(text.removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:  # tomllib passes on errors of int() and of deep nesting
        raise GatewayError(f"{name}: not valid TOML: {error}{_hint(str(error))}") from error
    check_depth(document, name)
    try:
        return root.model_validate(document, context=folder)
    except ValidationError as error:
        lines = [problem_text(problem, text, name, sections) for problem in problems(error, root, removed)]
        raise GatewayError("\n".join(lines)) from error


def toml_text(document: Mapping[str, Any]) -> str:
    """Plain data as TOML: scalars, then tables, then arrays of tables; a file with no deeper nesting than the gateway's own."""
    lines = [f"{key} = {_scalar(value)}" for key, value in document.items() if not _is_table(value)]
    for key, value in document.items():
        if not _is_table(value):
            continue
        for table in [value] if isinstance(value, Mapping) else value:
            lines.append(f"\n[{key}]" if isinstance(value, Mapping) else f"\n[[{key}]]")
            lines += [f"{name} = {_scalar(item)}" for name, item in table.items() if item is not None]
    return "\n".join(lines).strip() + "\n"


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple) and bool(value) and isinstance(value[0], Mapping)
    )


def _scalar(value: object) -> str:
    if isinstance(value, enum.Enum):
        value = value.value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, list | tuple | set | frozenset):
        return f"[{', '.join(_scalar(item) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_scalar(item)}' for key, item in value.items())}}}"
    return json.dumps(str(value))  # TOML's basic strings are JSON's


def check_depth(document: object, name: str) -> None:
    """GatewayError when tables or arrays are nested deeper than ``DEPTH_MAX``, without recursion of its own."""
    level = [document]
    for _ in range(DEPTH_MAX + 1):
        level = [inner for item in level for inner in _inside(item)]
        if not level:
            return
    raise GatewayError(f"{name}: nested deeper than {DEPTH_MAX} levels; no configuration of the gateway needs that")


def _inside(item: object) -> Collection[object]:
    if isinstance(item, dict):
        return item.values()
    return item if isinstance(item, list) else ()


def _hint(message: str) -> str:
    twice = _TWICE.search(message)
    if twice is not None:
        return f"; write [[{twice[1]}]] before each of them"
    if _ARRAY_AND_TABLE.search(message):
        return "; check that a table is not written [..] in one place and [[..]] in another"
    return ""


def problem_text(problem: Problem, text: str, name: str, sections: Sections) -> str:
    """A problem with its place in the text."""
    location = problem.location
    line = line_of(text, location, sections)
    place = f"{name}:{line}" if line else name
    path = path_text(_table(location) if problem.names_key else location, sections)
    if problem.value:
        path += f" = {problem.value}"
    return ": ".join(part for part in (place, path, problem.text) if part)


def _table(location: Location) -> Location:
    """The table a location is in."""
    return location[:2] if len(location) > 1 and isinstance(location[1], int) else location[:1]


def path_text(location: Location, sections: Sections) -> str:
    """``[transport] listen``, ``[[axis]] number 2 telegram``; empty for the whole file."""
    if not location:
        return ""
    section, *rest = location
    if section not in sections:
        return ".".join(str(part) for part in location)
    path = f"[{section}]"
    if rest and isinstance(rest[0], int):
        path = f"[[{section}]] number {rest[0] + 1}"
        rest = rest[1:]
    keys = ".".join(str(part + 1) if isinstance(part, int) else part for part in rest)
    return f"{path} {keys}" if keys else path


def line_of(text: str, location: Location, sections: Sections) -> int:
    """The line of a key, or of its table's header if the key is missing; 0 if unknown."""
    if not location:
        return 0
    section, *rest = location
    if section not in sections:
        return next((n for n, line in enumerate(text.splitlines(), 1) if _key(line) == section), 0)
    occurrence = rest[0] if rest and isinstance(rest[0], int) else 0
    keys = [part for part in rest if isinstance(part, str)]
    seen, header, inside = -1, 0, False
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if line.startswith("["):
            inside = line.split("#")[0].strip(" []") == section
            if inside:
                seen += 1
                inside = seen == occurrence
                header = number if inside else header
        elif inside and keys and _key(line) == keys[0]:
            return number
    return header


def _key(line: str) -> str:
    """The key that a line sets, or the table that it starts; empty for any other line."""
    key, equals, _ = line.partition("=")
    if equals:
        return key.strip().strip('"')
    return line.partition("#")[0].strip(" []") if line.lstrip().startswith("[") else ""
