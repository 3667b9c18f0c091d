"""Parts of texts for the user. Every package may import it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_CONTROLS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


def printable(text: str) -> str:
    """Text from outside: control characters as ``\\x1b``, except tabs and line ends."""
    return _CONTROLS.sub(lambda match: f"\\x{ord(match[0]):02x}", text)


def counted(number: int, one: str, several: str = "") -> str:
    """Return ``1 axis`` or ``2 axes``; ``several`` is the plural where an s at the end is not enough."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean override?`` for a name that is like a known one, else nothing."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""
