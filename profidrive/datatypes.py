"""PROFIdrive data types, the N2/N4 normalisation, and floating-point numbers as bit patterns.

Source: PROFIdrive profile 4.1 (data types, chapter 5.3), IEC 61158-5 type codes; OPC 30144 annex B.2 prints the codes.
Left out: conversion of dates and of times with a date, which no parameter of this gateway has: they are octets.

N2 and N4 are fractions of a reference: 4000h (N2) or 4000 0000h (N4) is 100 %. All arithmetic is on integers.
"""

from __future__ import annotations

import enum
import struct
from fractions import Fraction

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.normalisation import Normalisation

N2_100_PERCENT = 1 << 14
N4_100_PERCENT = 1 << 30
N4_PER_N2 = N4_100_PERCENT // N2_100_PERCENT
"""An N2 is promoted to an N4 without loss."""


class DataType(enum.Enum):
    """A wire data type: format code of the parameter channel, struct character, size in bytes.

    The struct character is empty for octet and character strings, whose size is the number of values.
    """

    BOOLEAN = (0x01, "B", 1)
    INTEGER8 = (0x02, "b", 1)
    INTEGER16 = (0x03, "h", 2)
    INTEGER32 = (0x04, "i", 4)
    UNSIGNED8 = (0x05, "B", 1)
    UNSIGNED16 = (0x06, "H", 2)
    UNSIGNED32 = (0x07, "I", 4)
    FLOATING_POINT = (0x08, "f", 4)
    VISIBLE_STRING = (0x09, "", 1)
    OCTET_STRING = (0x0A, "", 1)
    TIME_OF_DAY_WITH_DATE = (0x0C, "", 6)
    TIME_DIFFERENCE_OLD = (0x0D, "I", 4)
    """Not for new devices; milliseconds, as devices of before sent it."""
    FLOATING_POINT64 = (0x0F, "d", 8)
    UNICODE_STRING = (0x27, "", 2)
    DATE = (0x32, "", 7)
    TIME_OF_DAY = (0x34, "I", 4)
    """Milliseconds since midnight."""
    TIME_DIFFERENCE_WITH_DATE = (0x35, "", 6)
    TIME_DIFFERENCE = (0x36, "I", 4)
    """Milliseconds."""
    INTEGER64 = (0x37, "q", 8)
    UNSIGNED64 = (0x38, "Q", 8)
    N2 = (0x71, "h", 2)
    N4 = (0x72, "i", 4)
    V2 = (0x73, "H", 2)
    L2 = (0x74, "H", 2)
    R2 = (0x75, "H", 2)
    T2 = (0x76, "H", 2)
    T4 = (0x77, "I", 4)
    D2 = (0x78, "H", 2)
    E2 = (0x79, "h", 2)
    C4 = (0x7A, "i", 4)
    X2 = (0x7B, "h", 2)
    X4 = (0x7C, "i", 4)
    ZERO = (0x40, "", 0)
    BYTE = (0x41, "B", 1)
    WORD = (0x42, "H", 2)
    DOUBLE_WORD = (0x43, "I", 4)
    ERROR = (0x44, "H", 2)

    def __init__(self, code: int, char: str, size: int) -> None:
        self.code = code
        self.char = char
        self.size = size

    @property
    def is_float(self) -> bool:
        """IEEE 754, of 32 or 64 bits."""
        return self.char in {"f", "d"}

    @property
    def integer_range(self) -> tuple[int, int]:
        """Smallest and largest value of an integer-coded type; ProfidriveError for the others."""
        if not self.char or self.is_float:
            raise ProfidriveError("data type", self.name, "an integer-coded type")
        bits = 8 * self.size
        if self.char.islower():
            return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        return 0, (1 << bits) - 1

    @classmethod
    def from_code(cls, code: int) -> DataType:
        """The type with this format code; ProfidriveError where the code is unknown."""
        try:
            return _BY_CODE[code]
        except KeyError:
            raise ProfidriveError("format", code, "a data type code of PROFIdrive") from None


_BY_CODE = {data_type.code: data_type for data_type in DataType}
UNVERIFIED = frozenset({DataType.X2, DataType.X4})
"""Types whose codes no public source has."""


def n2(reference: Fraction | int, value_range: tuple[int, int], minimum: int | None = None) -> Normalisation:
    """An N2 conversion: signed 16 bit, 4000h = 100 %, range -200 % .. 200 % - 2^-14."""
    low, high = DataType.N2.integer_range
    return Normalisation(reference, N2_100_PERCENT, (low if minimum is None else minimum, high), value_range)


def n4(reference: Fraction | int, value_range: tuple[int, int], minimum: int | None = None) -> Normalisation:
    """An N4 conversion: signed 32 bit, 4000 0000h = 100 %, range -200 % .. 200 % - 2^-30."""
    low, high = DataType.N4.integer_range
    return Normalisation(reference, N4_100_PERCENT, (low if minimum is None else minimum, high), value_range)


_PATTERN, _FLOAT = struct.Struct(">I"), struct.Struct(">f")


def float_of(pattern: int) -> float:
    """The number a 32-bit pattern of IEEE 754 means."""
    value: float = _FLOAT.unpack(_PATTERN.pack(pattern))[0]
    return value


def float_pattern(value: float) -> int:
    """The pattern of a number, to the nearest; OverflowError for one beyond 32 bits."""
    pattern: int = _PATTERN.unpack(_FLOAT.pack(value))[0]
    return pattern
