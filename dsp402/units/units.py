"""Units of position, velocity and acceleration, as exact fractions: what a configuration writes and what a drive answers."""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from fractions import Fraction

from pdgw.dsp402.drive_type import Dsp402Error


class Kind(enum.Enum):
    """Kinds of units; the value is the name in a unit typed by the user."""

    TURN = "rev"
    """Revolutions of the output shaft of the gear."""
    POSITION = "counts"
    """Position units of the drive (607Ah, 6064h)."""
    INCREMENT = "inc"
    """Increments of the encoder on the motor (608Fh)."""
    METRE = "m"


@dataclass(frozen=True, slots=True)
class Unit:
    """One unit is ``factor`` times its kind, per second to the power of ``order`` (0 position, 1 velocity, 2 acceleration)."""

    factor: Fraction
    kind: Kind
    order: int
    text: str

    def __str__(self) -> str:
        return self.text


_LENGTHS: dict[str, tuple[Fraction, Kind]] = {
    "rev": (Fraction(1), Kind.TURN),
    "deg": (Fraction(1, 360), Kind.TURN),
    "counts": (Fraction(1), Kind.POSITION),
    "inc": (Fraction(1), Kind.INCREMENT),
    "m": (Fraction(1), Kind.METRE),
    "mm": (Fraction(1, 1000), Kind.METRE),
    "um": (Fraction(1, 1_000_000), Kind.METRE),
}
_SHORT = {"rpm": "rev/min", "rps": "rev/s"}
_SECONDS = {"s": 1, "min": 60}
_FORMS = ("a position such as 0.1 deg", "a velocity such as 0.1 rpm or counts/s", "an acceleration such as 10 rpm/s")
_UNIT = re.compile(r"(?:(\d+(?:\.\d+)?|\d+/\d+)\s*)?([a-z][a-z/0-9²]*)")


def parse_unit(text: str, order: int, key: str) -> Unit:
    """The unit a person wrote: ``rpm``, ``1/2 rpm``, ``0.01 mm``, ``counts/s``, ``10 rpm/s``, ``mm/s2``.

    ``order`` is what is expected: 0 a position, 1 a velocity, 2 an acceleration. Dsp402Error names ``key`` and the units allowed.
    """
    found = _UNIT.fullmatch(text.strip())
    refusal = Dsp402Error(
        key, text, f"{_FORMS[order]}, composed of {', '.join(_LENGTHS)}, {', '.join(_SHORT)} per s or min"
    )
    if found is None:
        raise refusal
    word = found[2].replace("²", "2")
    head, *times = word.split("/")
    length, *first = _SHORT.get(head, head).split("/")
    times = [*first, *times]
    if times and times[-1] == "s2":
        times[-1:] = ["s", "s"]
    if length not in _LENGTHS or len(times) != order or any(time not in _SECONDS for time in times):
        raise refusal
    factor, kind = _LENGTHS[length]
    factor *= _number(found[1])
    for time in times:
        factor /= _SECONDS[time]
    if factor <= 0:
        raise refusal
    return Unit(factor, kind, order, text.strip())


def _number(text: str | None) -> Fraction:
    try:
        return Fraction(text or 1)
    except ZeroDivisionError:
        return Fraction(0)


_SI_LENGTHS: dict[int, tuple[Fraction, Kind]] = {
    0x01: (Fraction(1), Kind.METRE),
    0x40: (Fraction(1, 400), Kind.TURN),
    0x41: (Fraction(1, 360), Kind.TURN),
    0x42: (Fraction(1, 360 * 60), Kind.TURN),
    0x43: (Fraction(1, 360 * 3600), Kind.TURN),
    0xB4: (Fraction(1), Kind.TURN),
    0xB5: (Fraction(1), Kind.INCREMENT),
    0xC1: (Fraction(254, 10_000), Kind.METRE),
}
"""Metre, gradian, degree, arc minute, arc second, revolution, increment, inch."""
_SI_SECONDS = {0x03: 1, 0x47: 60, 0x48: 3600}
_LONGEST_EXPONENT = 12


def si_unit(value: int, order: int) -> Unit | None:
    """The unit of 60A8h (``order`` 0), 60A9h (1) or 60AAh (2): prefix, unit and one byte for each time it is divided by.

    None where the drive does not say (0) or means a unit this module leaves out.
    """
    exponent = value >> 24 & 0xFF
    exponent -= (exponent & 0x80) << 1
    times = (value >> 8 & 0xFF, value & 0xFF)[:order]
    length = _SI_LENGTHS.get(value >> 16 & 0xFF)
    if length is None or abs(exponent) > _LONGEST_EXPONENT or any(time not in _SI_SECONDS for time in times):
        return None
    factor = length[0] * Fraction(10) ** exponent
    for time in times:
        factor /= _SI_SECONDS[time]
    return Unit(factor, length[1], order, f"{value & 0xFFFF_FFFF:08X}h")


_DIMENSIONS: dict[tuple[int, int], tuple[Fraction, Kind]] = {
    (0, 0x01): (Fraction(1), Kind.METRE),
    (0, 0x40): _SI_LENGTHS[0x40],
    (0, 0x41): _SI_LENGTHS[0x41],
    (0, 0x42): _SI_LENGTHS[0x42],
    (0, 0x43): _SI_LENGTHS[0x43],
    (1, 0xA3): (Fraction(1), Kind.TURN),
    (1, 0xA4): (Fraction(1, 60), Kind.TURN),
    (1, 0xA5): (Fraction(1, 3600), Kind.TURN),
    (1, 0xA6): (Fraction(1), Kind.METRE),
    (1, 0xA7): (Fraction(1, 60), Kind.METRE),
    (1, 0xA8): (Fraction(1, 3600), Kind.METRE),
    (2, 0xA9): (Fraction(1), Kind.METRE),
}
"""Order and dimension index: metre, angles; rev/s, rev/min, rev/h, m/s, m/min, m/h; m/s2."""


def dimension_unit(notation: int, dimension: int, order: int) -> Unit | None:
    """The unit of a notation index (power of ten, signed) and a dimension index; None for one that is not in the table."""
    known = _DIMENSIONS.get((order, dimension & 0xFF))
    if known is None or abs(notation) > _LONGEST_EXPONENT:
        return None
    return Unit(
        known[0] * Fraction(10) ** notation, known[1], order, f"10^{notation} of dimension {dimension & 0xFF:02X}h"
    )
