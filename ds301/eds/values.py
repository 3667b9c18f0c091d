"""Values of EDS/DCF entries as they are found in real files, and the one spelling every reader understands.

Source: CiA 306 V1.3 (numbers are decimal, 0x hexadecimal or octal with a leading 0; ``$NODEID+`` in front of values that
depend on the node-ID), CiA 301 (data types). Left out: limits of REAL32/REAL64 as bit patterns.
"""

from __future__ import annotations

import math
import re

from pdgw.ds301.connection_set import NODE_IDS

NUMBER_OF_BITS: dict[int, tuple[int, bool]] = {
    0x02: (8, True),
    0x03: (16, True),
    0x04: (32, True),
    0x05: (8, False),
    0x06: (16, False),
    0x07: (32, False),
    0x0C: (48, False),
    0x0D: (48, False),
    0x10: (24, True),
    0x12: (40, True),
    0x13: (48, True),
    0x14: (56, True),
    0x15: (64, True),
    0x16: (24, False),
    0x18: (40, False),
    0x19: (48, False),
    0x1A: (56, False),
    0x1B: (64, False),
}
"""Integer-coded data types: bits and whether signed (TIME_OF_DAY and TIME_DIFFERENCE as 48 bits)."""
BOOLEAN = 0x01
UNSIGNED8 = 0x05
REALS = (0x08, 0x11)
VISIBLE_STRING = 0x09
OCTET_STRING = 0x0A
UNICODE_STRING = 0x0B
DOMAIN = 0x0F
DATA_TYPES = frozenset((*NUMBER_OF_BITS, BOOLEAN, *REALS, VISIBLE_STRING, OCTET_STRING, UNICODE_STRING, DOMAIN))
"""The simple data types of CiA 301."""

_LONGEST_NUMBER = 40

_PLAIN = re.compile(r"-?(?:0x[0-9a-f]+|0|[1-9][0-9]*)", re.IGNORECASE)
_PLAIN_RELATIVE = re.compile(r"\$NODEID\+(?:0x[0-9a-f]+|0|[1-9][0-9]*)", re.IGNORECASE)
_COMMENT = re.compile(r"(?:;|//|#).*")
_NODE_ID = re.compile(r"\$?node[ _-]?id", re.IGNORECASE)
_TERM = re.compile(r"\s*([+-]?)\s*([^+\-\s][^+\-]*)")
_TRUE = ("true", "yes", "on")
_FALSE = ("false", "no", "off")


class ValueRefused(ValueError):  # noqa: N818 - the reader of a file says what it refuses
    """A value with no, or with more than one, possible meaning; the message is the reason."""


def is_plain(text: str) -> bool:
    """Whether a number is spelled so that every reader takes it for the same."""
    return _PLAIN.fullmatch(text) is not None


def number(text: str) -> int | None:
    """The number in a text, None for an empty one (blank, ``0x``).

    ValueRefused for another text, or one with two meanings: ``010`` is 8 by CiA 306 and 10 to most tools.
    """
    digits = _COMMENT.sub("", text).strip().strip("\"'").strip().lower()
    sign = -1 if digits.startswith("-") else 1
    if digits.startswith(("+", "-")):
        digits = digits[1:].strip()
    if digits in ("", "0x"):
        return None
    if len(digits) > _LONGEST_NUMBER:
        raise ValueRefused("longer than any number of CiA 301")
    if match := re.fullmatch(r"0x\s*([0-9a-f]+)h?", digits) or re.fullmatch(r"([0-9a-f]+)h", digits):
        return sign * int(match[1], 16)
    if re.fullmatch(r"[0-9]+", digits):
        return sign * _decimal(digits)
    if match := re.fullmatch(r"([0-9]+)\.0*", digits):
        return sign * _decimal(match[1])
    if re.fullmatch(r"[0-9]+e[0-9]+", digits):
        raise ValueRefused("hexadecimal without 0x, or a power of ten")
    if re.fullmatch(r"f+|[0-9a-f]*[0-9][0-9a-f]*", digits):  # only letters: may be a word
        return sign * int(digits, 16)
    raise ValueRefused("not a number")


def _decimal(digits: str) -> int:
    value = int(digits)
    if digits[0] == "0" and re.fullmatch(r"[0-7]+", digits) and int(digits, 8) != value:
        raise ValueRefused(f"octal by CiA 306 ({int(digits, 8)}), decimal to most tools ({value})")
    return value


def same_value(left: str, right: str) -> bool:
    """Whether two spellings mean the same."""
    if left.casefold() == right.casefold():
        return True
    try:
        return number(left) == number(right)
    except ValueRefused:
        return False


def _relative(text: str) -> int | None:
    """The offset of a ``$NODEID`` expression, None where the text does not speak of the node-ID."""
    expression = re.sub(r"[()]", " ", _COMMENT.sub("", text))
    expression, count = _NODE_ID.subn("§", expression)
    if not count:
        return None
    offset = 0
    terms = 0
    position = 0
    expression = expression.strip()
    while position < len(expression):
        match = _TERM.match(expression, position)
        if match is None or (position and not match[1]):
            raise ValueRefused("not a sum of $NODEID and a number")
        position = match.end()
        term = match[2].strip()
        if term == "§":
            terms += 1
            if match[1] == "-" or terms > 1:
                raise ValueRefused("$NODEID can only be added, once")
            continue
        value = number(term)
        if value is None:
            raise ValueRefused("the offset of $NODEID is missing")
        offset += -value if match[1] == "-" else value
    return offset


def value_text(data_type: int, text: str) -> tuple[str, bool]:
    """A DefaultValue or ParameterValue in the spelling that every reader understands, and whether this is a repair.

    "" means no value. ValueRefused for a text that is not a value of the type.
    """
    if data_type in NUMBER_OF_BITS:
        return _integer_text(data_type, text)
    if data_type == BOOLEAN:
        return _boolean_text(text)
    if data_type in REALS:
        return _real_text(text)
    if data_type in (OCTET_STRING, DOMAIN):
        return _bytes_text(data_type, text)
    return text, False


def _integer_text(data_type: int, text: str) -> tuple[str, bool]:
    bits, signed = NUMBER_OF_BITS[data_type]
    offset = _relative(text)
    if offset is not None:
        if offset + 1 < 0 or offset + NODE_IDS[-1] > _highest(bits, signed):
            raise ValueRefused(f"outside the {bits} bits of its data type")
        if _PLAIN_RELATIVE.fullmatch(text):
            return "$NODEID" + text[len("$NODEID") :], False
        return f"$NODEID{'-' if offset < 0 else '+'}0x{abs(offset):X}", True
    value = number(text)
    if value is None:
        return "", bool(text)
    plain = is_plain(text)
    fitted = _fit(value, bits, signed)
    if fitted is None:
        raise ValueRefused(f"outside the {bits} bits of its data type")
    if fitted == value:
        return (text, False) if plain else (_spelled(value, text), True)
    # Hexadecimal two's complement of a signed type is correct, but not every reader applies the sign.
    legal = plain and signed and 0 <= value < 1 << bits
    return str(fitted), not legal


def _highest(bits: int, signed: bool) -> int:
    return (1 << (bits - signed)) - 1


def _fit(value: int, bits: int, signed: bool) -> int | None:
    """The value in the range of its type, two's complement resolved; None where no reading fits.

    64-bit patterns are accepted for shorter types when they are the sign extension of a value that fits.
    """
    low, high = (-(1 << (bits - 1)) if signed else 0), _highest(bits, signed)
    if low <= value <= high:
        return value
    if signed:
        for width in (bits, 32, 64):
            negative = value - (1 << width)
            if 1 << (width - 1) <= value < 1 << width and low <= negative:
                return negative
        return None
    return value + (1 << bits) if -(1 << (bits - 1)) <= value < 0 else None


def _spelled(value: int, text: str) -> str:
    """Hexadecimal stays hexadecimal."""
    hexadecimal = value >= 0 and re.search(r"[xh]|[a-f]", text.lower()) is not None
    return f"0x{value:X}" if hexadecimal else str(value)


def _boolean_text(text: str) -> tuple[str, bool]:
    word = _COMMENT.sub("", text).strip().lower()
    if word in _TRUE:
        return "1", True
    if word in _FALSE:
        return "0", True
    value = number(text)
    if value is None:
        return "", bool(text)
    if is_plain(text) and value in (0, 1):
        return text, False
    return str(int(value != 0)), True


def _real_text(text: str) -> tuple[str, bool]:
    cleaned = _COMMENT.sub("", text).strip()
    if not cleaned:
        return "", bool(text)
    if re.fullmatch(r"[+-]?[0-9]+,[0-9]+", cleaned):
        cleaned = cleaned.replace(",", ".")
    try:
        value = float(cleaned) if "_" not in cleaned else math.nan
    except ValueError:
        raise ValueRefused("not a decimal fraction") from None
    if not math.isfinite(value):
        raise ValueRefused("not a finite number")
    return cleaned, cleaned != text


def _bytes_text(data_type: int, text: str) -> tuple[str, bool]:
    cleaned = re.sub(r"^0x", "", text, flags=re.IGNORECASE)
    try:
        bytes.fromhex(cleaned)
    except ValueError:
        if data_type == DOMAIN:  # no reader can use it, and nothing is lost: the content is in the device
            return "", True
        raise ValueRefused("not hexadecimal octets") from None
    return cleaned, cleaned != text


def limit_text(data_type: int, text: str, *, lower: bool) -> tuple[str, bool]:
    """A LowLimit or HighLimit as a decimal or plain number, and whether this is a repair; "" means no limit.

    A limit outside the type is replaced by the type's own, and so is one that would leave no value. ValueRefused for a text
    that is not a number.
    """
    if data_type in REALS:
        return _real_text(text)
    if data_type == BOOLEAN:
        return _boolean_text(text)
    if data_type not in NUMBER_OF_BITS:
        return "", bool(text)  # strings and octets have no range
    if _relative(text) is not None:
        return "", True  # a limit that depends on the node-ID cannot be stated here
    value = number(text)
    if value is None:
        return "", bool(text)
    bits, signed = NUMBER_OF_BITS[data_type]
    low, high = (-(1 << (bits - 1)) if signed else 0), _highest(bits, signed)
    if low <= value <= high:
        return (text, False) if is_plain(text) else (_spelled(value, text), True)
    if signed and not lower and value >= 1 << bits and _fit(value, bits, signed) is not None:
        return "", True  # FFFFFFFFh in 16 bits means no limit; -1 would be one
    fitted = _fit(value, bits, signed) if signed or (value == -1 and not lower) else None
    if fitted is not None:
        return str(fitted), not (is_plain(text) and signed and value < 1 << bits)
    if (value > high and lower) or (value < low and not lower):
        return "", True
    return str(low if lower else high), True


def is_unsigned_pattern(data_type: int, text: str) -> bool:
    """Whether a limit of a signed type is written as a positive number that the type does not hold, such as FFh in 8 bits."""
    value = number(text)
    if value is None or data_type not in NUMBER_OF_BITS:
        return False
    bits, signed = NUMBER_OF_BITS[data_type]
    return signed and value > _highest(bits, signed)
