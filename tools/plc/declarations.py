"""Tokens and declarations of the generated Structured Text.

Split Structured Text into tokens. Source: IEC 61131-3 second edition, annex B. Comments are ``(* ... *)``. ``//`` is of the
third edition and rejected. Read the declarations of the generated Structured Text, for other file formats and for the
documents. The generated text has one declaration in each line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from pdgw.gateway.base.errors import GatewayError

_PATTERN = re.compile(
    r"""(?P<space>\s+)
    |(?P<comment>\(\*.*?\*\))
    |(?P<time>(?:TIME|T)\#-?[0-9a-z_.]+)
    |(?P<real>\d[\d_]*\.\d+(?:E[+-]?\d+)?)
    |(?P<integer>(?:[A-Z]+\#)?(?:16\#[0-9A-F][0-9A-F_]*|2\#[01][01_]*|-?\d[\d_]*))(?!\w)
    |(?P<word>[A-Z_]\w*)
    |(?P<string>'(?:\$.|[^'$])*')
    |(?P<range>\.\.)
    |(?P<sign>:=|=>|<>|<=|>=|\*\*|/(?!/)|[-+*()\[\],;:.=<>&])""",
    re.VERBOSE | re.IGNORECASE | re.DOTALL,
)


class StructuredTextError(GatewayError):
    """A program outside the supported subset or with an error; the text names the line."""


class Token(NamedTuple):
    """A part of the text. ``kind``: name of its pattern, ``end`` after the last one."""

    kind: str
    text: str
    line: str
    """Line for messages."""

    @property
    def key(self) -> str:
        """Name or keyword in upper case, for comparisons."""
        return self.text.upper()


def pieces(text: str) -> Iterator[Token]:
    """All tokens including spaces and comments; joined they are the text."""
    position, line = 0, 1
    while position < len(text):
        found = _PATTERN.match(text, position)
        # A minus belongs to a number only after a type ("INT#-5"); elsewhere it is an operator.
        if found is None or found.lastgroup is None:
            shown = text[position : position + 20].partition("\n")[0]
            raise StructuredTextError(
                f"line {line}: {shown!r} is not in the supported Structured Text (no //, no AT %)"
            )
        kind, piece = found.lastgroup, found[0]
        if kind == "integer" and piece.startswith("-"):
            kind, piece = "sign", "-"
        yield Token(kind, piece, f"line {line}")
        line += piece.count("\n")
        position += len(piece)


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
