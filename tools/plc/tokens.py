"""Split Structured Text into tokens.

Source: IEC 61131-3 second edition, annex B. Comments are ``(* ... *)``. ``//`` is of the third edition and rejected.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from pdgw.gateway.errors import GatewayError

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
