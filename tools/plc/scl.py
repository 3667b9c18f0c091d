"""Convert Structured Text to SCL of TIA Portal: same tokens, but marked variables, quoted names and versions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pdgw.tools.plc.tokens import Token, pieces

_UNITS = ("TYPE", "FUNCTION_BLOCK", "FUNCTION")
_VERSION = "\nVERSION : 0.1"
_BLOCK = f"\n{{ S7_Optimized_Access := 'TRUE' }}{_VERSION}"


def scl(text: str) -> str:
    """Convert a text to an external source of TIA Portal."""
    found = list(pieces(text))
    own = {following(found, at).key for at, token in enumerate(found) if token.key in _UNITS}
    return "".join(_Scl(found, own).text())


def following(found: Sequence[Token], at: int, count: int = 1) -> Token:
    """The ``count``-th token after this one, without spaces and comments; this one at the end."""
    rest = (token for token in found[at + 1 :] if token.kind not in {"space", "comment"})
    for _ in range(count - 1):
        next(rest, None)
    return next(rest, found[at])


class _Scl:
    def __init__(self, found: Sequence[Token], own: set[str]) -> None:
        self._found = found
        self._own = own
        self._local: set[str] = set()

    def text(self) -> Iterator[str]:
        previous, unit, declares, depth = "", "", False, 0
        for at, token in enumerate(self._found):
            key, text = token.key, token.text
            behind = following(self._found, at)
            if token.kind in {"space", "comment"}:
                yield text
                continue
            if key in _UNITS:
                unit, self._local = key, self._locals(at, behind.key) if key != "TYPE" else set()
            if key.startswith("VAR") and unit in {"FUNCTION_BLOCK", "FUNCTION"}:
                declares = True
            depth += (text in {"(", "["}) - (text in {")", "]"})
            if key == "END_VAR":
                declares = False
                yield text if behind.key.startswith("VAR") else f"{text}\nBEGIN"
            elif previous in _UNITS:
                yield f'"{text}"' + {"TYPE": _VERSION, "FUNCTION_BLOCK": _BLOCK}.get(unit, "")
            elif unit == "TYPE" and text == ":" and behind.key == "STRUCT":
                yield "\n"
            elif unit == "FUNCTION" and key == "VAR":
                yield "VAR_TEMP"
            elif unit == "FUNCTION" and previous == ":" and not declares and not self._begun(at):
                yield f"{text}{_BLOCK}"
            elif token.kind != "word" or previous == ".":
                yield text
            elif key in self._local and not (declares and behind.text in {":", ","} and previous not in {":=", "("}):
                named = depth and behind.text in {":=", "=>"} and previous in {"(", ","}
                yield text if named else f"#{text}"
            else:
                yield f'"{text}"' if key in self._own else text
            previous = key

    def _begun(self, at: int) -> bool:
        """Whether the head of the unit has ended: there was a section of variables since its keyword."""
        for token in reversed(self._found[:at]):
            if token.key.startswith("VAR"):
                return True
            if token.key in _UNITS:
                return False
        return True

    def _locals(self, at: int, name: str) -> set[str]:
        """The variables of a unit. A function's name is one: it is the result."""
        found, declares, ahead = {name} if self._found[at].key == "FUNCTION" else set(), False, True
        for place in range(at + 1, len(self._found)):
            token = self._found[place]
            if token.key.startswith("END_FUNCTION"):
                break
            if token.key.startswith("VAR"):
                declares = ahead = True
            elif token.key == "END_VAR":
                declares = False
            elif token.text == ";":
                ahead = True
            elif token.text == ":":
                ahead = False
            elif declares and ahead and token.kind == "word" and token.key != "CONSTANT":
                found.add(token.key)
        return found
