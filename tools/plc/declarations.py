"""Read the declarations of the generated Structured Text, for other file formats and for the documents.

The generated text has one declaration in each line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

_HEAD = re.compile(r"(TYPE|FUNCTION_BLOCK|FUNCTION|PROGRAM) (\w+)(?: : (\w+))?(?: \(\* (.*) \*\))?$")
_VARIABLE = re.compile(r"    (\w+) : ([^:;]+?)(?: := ([^;]+))?;(?: \(\* (.*) \*\))?$")
_COMMENT = re.compile(r"\(\* (.*) \*\)$")


class Declared(NamedTuple):
    """A variable or a field. ``section``: VAR_INPUT etc., empty for a field. ``initial``: empty without an initial value."""

    section: str
    name: str
    type: str
    initial: str
    comment: str


class Declaration(NamedTuple):
    """A structure (kind TYPE) or a program organisation unit. ``result``: type of a function's result."""

    kind: str
    name: str
    result: str
    comment: str
    variables: tuple[Declared, ...]
    body: str

    def section(self, name: str) -> tuple[Declared, ...]:
        return tuple(item for item in self.variables if item.section == name)


def declarations(text: str) -> Iterator[Declaration]:
    """All types and units of a generated text, in order."""
    lines = iter(text.split("\n"))
    for line in lines:
        head = _HEAD.match(line)
        if head is not None:
            yield _declaration(head, lines)


def _declaration(head: re.Match[str], lines: Iterator[str]) -> Declaration:
    kind, name, result, comment = head[1], head[2], head[3] or "", head[4] or ""
    variables, body, section = [], [], ""
    for line in lines:
        found = _VARIABLE.match(line)
        said = _COMMENT.match(line)
        if line.startswith(("END_STRUCT", f"END_{kind}")):
            break
        if line.startswith("VAR"):
            section = line
        elif line == "END_VAR":
            section = ""
        elif found is not None and (section or kind == "TYPE"):
            variables.append(Declared(section, found[1], found[2], found[3] or "", found[4] or ""))
        elif said is not None and not variables:
            comment = said[1]
        else:
            body.append(line)
    return Declaration(kind, name, "" if kind == "TYPE" else result, comment, tuple(variables), "\n".join(body))
