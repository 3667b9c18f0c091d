"""TOML files of the user: read, validated by a pydantic model, every mistake with its line."""

from __future__ import annotations

import enum
import json
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from pdgw.base.files import read_file
from pdgw.base.validation import Location, Problem, problems
from pdgw.gateway.base.errors import GatewayError

Root = TypeVar("Root", bound=BaseModel)

FILE_MAX = 1 << 20
"""Bytes of a file a person writes: a configuration of 250 axes has a tenth of it."""
DEPTH_MAX = 16
"""Tables within tables; ours have four."""
_SHOWN = 80
"""Characters of a wrong line."""
_PLACE = re.compile(r" \(at line (\d+), column \d+\)")
_QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'|#.*")
"""Texts with both quotation marks, and comments."""
_MISTAKES = (
    (r".*\nCannot declare \('(\w+)',\) twice", r"[\1] is there twice; write [[\1]] before each of them"),
    (r"([\w.-]+)\s*=.*\nCannot overwrite", r"\1 is set twice in its table"),
    (r".*\nCannot", "check that a table is not written [..] in one place and [[..]] in another"),
    (r"[{}\]]|---|- |[\w.-]+:", "JSON and YAML are not read; expected TOML: [table], then key = value"),
    (r".*=\s*(True|False)\b", "write true or false in lower case"),
    (r".*=\s*[+-]?0\d", "a number has no leading zero"),
    (r".*=\s*[+-]?\d+,\d", "write a decimal point"),
    (r"[^=\n]*=\s*(#.*)?\n", "the value is missing"),
    (
        r"([\w.-]+)\s*=\s*([^\s\"'\[{#][^\"'#\n]*?)\s*(#.*)?\n",
        r'not a number, true or false; a text needs quotation marks: \1 = "\2"',
    ),
)
"""Patterns of a wrong line and tomllib's message, each with what the user probably meant."""


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
    text: str,
    name: str,
    hints: Mapping[str, str] = MappingProxyType({}),
    context: object = None,
) -> Root:
    """Validate TOML text by the model of the whole file; GatewayError has one line for each thing that is wrong.

    ``hints``: see ``problems``.
    ``context``: of the validation.
    """
    try:
        document = tomllib.loads(text.removeprefix("\ufeff"))
    except (ValueError, RecursionError) as error:  # tomllib passes on errors of int() and of deep nesting
        raise GatewayError(_not_toml(text, name, str(error))) from error
    check_depth(document, name)
    try:
        return root.model_validate(document, context=context)
    except ValidationError as error:
        lines = [problem_text(problem, text, name) for problem in problems(error, root, hints)]
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
        return f"{{{', '.join(f'{json.dumps(key)} = {_scalar(item)}' for key, item in value.items())}}}"
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


def _not_toml(text: str, name: str, message: str) -> str:
    """An error of the syntax: its line, and what the user probably meant."""
    lines = text.splitlines()
    place = _PLACE.search(message)
    number = int(place[1]) if place else next((n for n, line in enumerate(lines, 1) if _is_open(line)), 0)
    line = "".join(lines[number - 1 : number]).strip()[:_SHOWN]
    message = _PLACE.sub("", message)
    if _is_open(line):
        message = "a quotation mark is missing"
    for pattern, hint in _MISTAKES:
        if found := re.match(pattern, f"{line}\n{message}"):
            message = found.expand(hint)
            break
    return f"{name}:{number}: {line}: not valid TOML: {message}" if line else f"{name}: not valid TOML: {message}"


def _is_open(line: str) -> bool:
    """A quotation mark is not closed."""
    return not {'"', "'"}.isdisjoint(_QUOTED.sub("", line))


def problem_text(problem: Problem, text: str, name: str) -> str:
    """A problem with its place in the text."""
    location = problem.location
    line = line_of(text, location)
    place = f"{name}:{line}" if line else name
    path = path_text(location, whole_table=problem.names_key or not (line or location[1:]))
    if problem.value:
        path += f" = {problem.value}"
    return ": ".join(part for part in (place, path, problem.text) if part)


def path_text(location: Location, *, whole_table: bool) -> str:
    """``[transport] listen``, ``[[axis]] number 2 telegram``, without the key for a whole table; empty for the whole file."""
    if not location:
        return ""
    section, *rest = location
    if not rest and not whole_table:
        return str(section)
    path = f"[{section}]"
    if rest and isinstance(rest[0], int):
        path, rest = f"[[{section}]] number {rest[0] + 1}", rest[1:]
    keys = ".".join(str(part + 1) if isinstance(part, int) else part for part in rest)
    return path if whole_table else f"{path} {keys}".strip()


def line_of(text: str, location: Location) -> int:
    """The line of a key, or of the table that should have it; 0 if unknown."""
    lines = dict(reversed([*_places(text)]))
    wanted = tuple(part for part in location if part != 0)
    while wanted and wanted not in lines:
        wanted = wanted[:-1]
    return lines.get(wanted, 0)


def _places(text: str) -> Iterator[tuple[Location, int]]:
    """Each key and table with its line. Index 0 is left out: a table alone is written [axis] or [[axis]]."""
    counts: dict[Location, int] = {}
    table: Location = ()
    for number, line in enumerate(text.splitlines(), 1):
        key = re.split("[=#]", line)[0]
        names = [name.strip(" \t\"'") for name in key.strip(" \t[]").split(".")]
        if not line.lstrip().startswith("["):
            yield (*table, *names), number
            continue
        table = ()
        for name in names:
            table = (*table, name)
            if name is names[-1] and "[[" in line:
                counts[table] = counts.get(table, -1) + 1
            if counts.get(table):
                table = (*table, counts[table])
        yield table, number
