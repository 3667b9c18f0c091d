"""Numbers and values of EDS/DCF entries as they are found in real files.

Source: CiA 306 V1.3 (numbers are decimal, 0x hexadecimal or octal with a leading 0; ``$NODEID+`` in front of values that
depend on the node-ID), CiA 301 (data types).
"""

from __future__ import annotations

import math
import re
import struct

from pdgw.ds301.values import INTEGERS, UNICODE_STRING

_TIMES = (0x0C, 0x0D)
_REALS = {0x08: "!f", 0x11: "!d"}
UNSIGNED8 = 0x05
DOMAIN = 0x0F
_OCTETS = (0x0A, DOMAIN)
DATA_TYPES = frozenset((*INTEGERS, *_REALS, 0x09, *_OCTETS, UNICODE_STRING))
"""The simple data types of CiA 301."""

_LONGEST_NUMBER = 40
_PLAIN = re.compile(r"-?(?:0x[0-9a-f]+|0|[1-9][0-9]*)", re.IGNORECASE)
_PLAIN_RELATIVE = re.compile(r"\$NODEID\+(?:0x[0-9a-fA-F]+|0|[1-9][0-9]*)")
_COMMENT = re.compile(r"(?:;|//|#).*")
_NODE_ID = re.compile(r"\$?node[ _-]?id", re.IGNORECASE)
_WORDS = {**dict.fromkeys(("true", "yes", "on"), 1), **dict.fromkeys(("false", "no", "off"), 0)}


def is_plain(text: str) -> bool:
    """Whether every reader accepts the spelling of a number, and reads the same number."""
    return _PLAIN.fullmatch(text) is not None


def without_comment(text: str) -> str:
    """A value without comment, blanks and quotes around it."""
    return _COMMENT.sub("", text).strip().strip("\"'").strip()


def number(text: str) -> int | None:
    """The number in a text, None for an empty one (blank, ``0x``).

    ValueError with the reason for another text, or one with two meanings: ``010`` is 8 by CiA 306 and 10 to most tools.
    """
    digits = without_comment(text).lower()
    if digits in _WORDS:
        return _WORDS[digits]
    sign = -1 if digits.startswith("-") else 1
    digits = re.sub(r"^(0x[0-9a-f]+|[0-9]+)(?:[ul]{1,3}|\.0*)$", r"\1", re.sub(r"^[+-]\s*", "", digits))
    if digits in ("", "0x"):
        return None
    if len(digits) > _LONGEST_NUMBER:
        raise ValueError("longer than any number of CiA 301")
    if match := re.fullmatch(r"0x\s*([0-9a-f]+)h?", digits) or re.fullmatch(r"([0-9a-f]+)h", digits):
        return sign * int(match[1], 16)
    if re.fullmatch(r"[0-9]+", digits):
        if re.fullmatch(r"0[0-7]+", digits) and int(digits, 8) != int(digits):
            raise ValueError(f"octal by CiA 306 ({int(digits, 8)}), decimal to most tools ({int(digits)})")
        return sign * int(digits)
    if re.fullmatch(r"[0-9]+e[0-9]+", digits):
        raise ValueError("hexadecimal without 0x, or a power of ten")
    if re.fullmatch(r"f+|[0-9a-f]*[0-9][0-9a-f]*", digits):  # only letters: may be a word
        return sign * int(digits, 16)
    raise ValueError("not a number")


def same_value(left: str, right: str) -> bool:
    """Whether two spellings mean the same."""
    try:
        return left.casefold() == right.casefold() or number(left) == number(right)
    except ValueError:
        return False


def value_text(data_type: int, text: str, *, limit: bool = False) -> str:
    """A value, or a ``limit``, in a spelling that canopen's importer reads; "" without a value.

    ValueError for a text that is not a value of the type.
    """
    if data_type in INTEGERS:
        return _integer_text(data_type, text, limit=limit)
    if limit:
        return text
    if data_type in _REALS:
        return _real_text(data_type, without_comment(text))
    if data_type in _OCTETS:
        digits = re.sub(r"^0x", "", text, flags=re.IGNORECASE)
        bytes.fromhex(digits)
        return digits
    return text


def _integer_text(data_type: int, text: str, *, limit: bool) -> str:
    bits, signed = INTEGERS[data_type]
    offset = _node_id_offset(text)
    if offset is not None:
        return text if _PLAIN_RELATIVE.fullmatch(text) else f"$NODEID{'-' if offset < 0 else '+'}0x{abs(offset):X}"
    if data_type in _TIMES and (match := re.fullmatch(r"([0-9]+)\s+([0-9]+)", text)):
        return str(int(match[1]) << 32 | int(match[2]))  # days and milliseconds
    value = number(text)
    if value is None:
        return ""
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    # Two's complement of this type; of a value also that of a longer type, or a negative number as an unsigned one.
    widths = (bits,) if limit else (bits, 32, 64)
    readings = [value, *(value - (1 << width) for width in widths if signed and value >> (width - 1) == 1)]
    if not signed and not limit:
        readings.append(value + (1 << bits))
    fitting = [reading for reading in readings if low <= reading <= high]
    if not fitting:
        raise ValueError(f"outside the {bits} bits of its data type")
    return text if fitting[0] == value and is_plain(text) else str(fitting[0])


def _node_id_offset(text: str) -> int | None:
    """The number that a ``$NODEID`` expression adds to the node-ID, None where the text has no node-ID."""
    expression, count = _NODE_ID.subn(" 0 ", re.sub(r"[()]", " ", without_comment(text)))
    if not count:
        return None
    terms = re.findall(r"[+-]?[^+-]+", expression)
    if count > 1 or "".join(terms) != expression or re.search(r"-\s*\$?node", text, re.IGNORECASE):
        raise ValueError("$NODEID can only be added, once")
    values = [number(term) for term in terms]
    return sum(value for value in values if value is not None)


def _real_text(data_type: int, text: str) -> str:
    size = struct.calcsize(_REALS[data_type])
    if re.fullmatch(rf"0x[0-9a-f]{{{2 * size}}}", text, re.IGNORECASE):
        return repr(struct.unpack(_REALS[data_type], bytes.fromhex(text[2:]))[0])
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", text):
        text = text.replace(",", ".")
    if text and not ("_" not in text and math.isfinite(float(text))):
        raise ValueError("not a finite number")
    return text
