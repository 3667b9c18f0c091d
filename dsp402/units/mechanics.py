"""The mechanics of a drive in its units: one revolution of its motor, gear and lengths, each with its source object or key.

What a configuration and the overlay of a family say about the units is here too; ``scaling`` makes the drive's scaling of
them. Exact rational arithmetic. A ratio of 1/1 is the default of an object that the drive does not use: it states nothing.
Source: CiA 402 (608Fh, 6091h to 6093h, 60A8h, 6089h, 608Ah), docs/devices.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from pdgw.base.durations import SECONDS_PER_MINUTE
from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402 import objects
from pdgw.dsp402.units.units import Kind, Unit, dimension_unit, parse_unit, si_unit


@dataclass(frozen=True, slots=True)
class UnitKeys:
    """Units of an axis in the configuration; None or empty: not set."""

    rated_speed_rpm: Fraction | None = None
    """100 % of a speed in rpm of the motor."""
    velocity_unit: str = ""
    position_unit: str = ""
    counts_per_revolution: Fraction | None = None
    """Position units in one revolution of the motor."""
    acceleration_unit: str = ""
    gear: Fraction | None = None
    """Revolutions of the motor in one of the output shaft of the gear."""
    rated_acceleration: Fraction | None = None
    """100 % of an acceleration or deceleration in rpm/s of the motor."""
    ignored_unit_objects: frozenset[int] = frozenset()
    """Indices of objects of the drive that say something wrong about its units."""


class KeyLine(NamedTuple):
    """A key that may be missing: its line in a configuration."""

    setting: str
    """Its value is refused until it is replaced."""
    meaning: str

    @property
    def text(self) -> str:
        """The line to paste, with its comment."""
        return f"{self.setting}  # {self.meaning}"


KEY_LINES: Mapping[str, KeyLine] = {
    "rated_speed_rpm": KeyLine("rated_speed_rpm = 0", "100 % of the speed in rpm of the motor"),
    "velocity_unit": KeyLine('velocity_unit = "?"', 'of 60FFh, such as "rpm", "0.1 rpm", "counts/s", "mm/s"'),
    "ignored_unit_objects": KeyLine('ignored_unit_objects = ["?"]', 'objects with wrong units, such as "60A9h"'),
    "counts_per_revolution": KeyLine("counts_per_revolution = 0", "position units in one revolution of the motor"),
    "acceleration_unit": KeyLine('acceleration_unit = "?"', 'of 6083h, such as "rpm/s"'),
    "rated_acceleration_rpm_s": KeyLine("rated_acceleration_rpm_s = 0", "100 % of accelerations in rpm/s of the motor"),
}
"""The keys that may be missing."""


def check_unit_keys(keys: UnitKeys) -> None:
    """Dsp402Error names the key whose unit is none."""
    for order, key in enumerate(("position_unit", "velocity_unit", "acceleration_unit")):
        text = getattr(keys, key)
        if text:
            parse_unit(text, order, key)


@dataclass(frozen=True, slots=True)
class FamilyUnits:
    """Units of a family in its overlay."""

    velocity: str = ""
    velocity_step: int = 0
    """Index of an object with numerator and denominator: one velocity unit is this many times ``velocity``."""
    only_while_one: frozenset[int] = frozenset()
    """Objects that must be 1/1, or missing, for ``velocity`` to apply."""
    increments_per_revolution: Fraction | None = None
    """For a family with constant increments, instead of 608Fh."""
    position: str = ""
    counts_per_revolution: Fraction | None = None
    acceleration: str = ""
    ignores: frozenset[int] = frozenset()
    """Objects the family has and does not apply, or applies otherwise than the profile."""
    ask: str = ""
    """Why no object shows the units of this device: the configuration must set them."""


Answers = Mapping[ObjectAddress, int]

NO_LIMIT = 0x7FFF_FFFF
"""A limit of this size or above is none, and no reference either."""
SI_UNITS = (objects.SI_UNIT_POSITION, objects.SI_UNIT_VELOCITY, objects.SI_UNIT_ACCELERATION)
NOTATIONS = (
    (objects.POSITION_NOTATION, objects.POSITION_DIMENSION),
    (objects.VELOCITY_NOTATION, objects.VELOCITY_DIMENSION),
    (objects.ACCELERATION_NOTATION, objects.ACCELERATION_DIMENSION),
)
UNIT_RATIOS = (
    *range(objects.POSITION_ENCODER_RESOLUTION, objects.VELOCITY_ENCODER_FACTOR + 1),
    objects.VELOCITY_FACTOR,
    objects.ACCELERATION_FACTOR,
)
POSITION_OBJECTS: frozenset[int] = frozenset(
    {
        objects.POLARITY,
        *NOTATIONS[0],
        SI_UNITS[0],
        objects.POSITION_ENCODER_RESOLUTION,
        objects.GEAR_RATIO,
        objects.FEED_CONSTANT,
        objects.POSITION_FACTOR,
    }
)
"""Every object that defines the unit or the sign of positions."""
UNIT_OBJECTS: frozenset[int] = frozenset({*SI_UNITS, *(index for pair in NOTATIONS for index in pair), *UNIT_RATIOS})
"""Every object that defines a unit."""
_UNIT_NAMES: dict[str, int] = {f"{index:04X}h": index for index in sorted(UNIT_OBJECTS)}
_RATIOS = (Fraction(1, 5), Fraction(5))
"""A limit of the velocity that confirms a unit is within this of the motor's speed."""


class Known(NamedTuple):
    """A value, its sources, and whether it uses a position object (608Fh, 6091h, 6092h)."""

    value: Fraction
    sources: tuple[str, ...]
    by_position: bool = False

    @property
    def source(self) -> str:
        """The sources as text."""
        return ", ".join(self.sources)


class Unknown(NamedTuple):
    """Why a value is unknown, and the key of the configuration that defines it."""

    why: str
    key: str = "velocity_unit"


Found = Known | Unknown


def amount(value: Fraction) -> str:
    """A fraction as a person reads it."""
    return str(value) if value.denominator == 1 else f"{float(value):.6g}"


def unit_object(value: object) -> int:
    """The index of an object that defines a unit, written as ``60A9h``; ValueError lists the possible ones."""
    try:
        return _UNIT_NAMES[str(value)]
    except KeyError:
        raise ValueError(f"{value!r} is not an object that defines a unit, allowed: {', '.join(_UNIT_NAMES)}") from None


def _ratio(answers: Answers, index: int) -> Fraction | None:
    numerator, denominator = answers.get((index, 1), 0), answers.get((index, 2), 0)
    return Fraction(numerator, denominator) if numerator > 0 and denominator > 0 else None


class Mechanics:
    """One revolution of the motor in every kind of unit, and the factors read from the drive."""

    def __init__(self, answers: Answers, keys: UnitKeys, family: FamilyUnits, name: str) -> None:
        own = family.only_while_one | {family.velocity_step}
        left_out = family.ignores | keys.ignored_unit_objects | (UNIT_OBJECTS if family.ask else frozenset())
        self.answers = {key: value for key, value in answers.items() if key[0] not in left_out | own}
        self.own_ratios = {index: _ratio(answers, index) for index in own - left_out}
        """Objects the overlay explains."""
        self.keys = keys
        self.family = family
        self.name = name
        self.increments = self._increments()
        self.gear = self._gear()
        self.position_unit = self._position_unit()
        self.counts = self._counts()
        self.metres = self._metres()

    def number(self, index: int, subindex: int = 0) -> int | None:
        return self.answers.get((index, subindex))

    def limit(self, index: int, subindex: int = 0) -> int | None:
        """A limit of the drive; None where it has none."""
        value = self.number(index, subindex)
        return value if value is not None and 0 < value < NO_LIMIT else None

    def ratio(self, index: int) -> Fraction | None:
        """Sub-index 1 over sub-index 2; None if it is missing, 0, negative or the default 1/1."""
        ratio = _ratio(self.answers, index)
        return None if ratio == 1 else ratio

    def limit_confirms(self, per_rpm: Fraction, limit: int | None) -> bool:
        """Whether a limit of the velocity in these units (``per_rpm`` of them are one rpm) is about the motor's speed."""
        rated: Fraction | int | None = self.limit(objects.MAX_MOTOR_SPEED) or self.keys.rated_speed_rpm
        return limit is not None and rated is not None and _RATIOS[0] <= limit / per_rpm / rated <= _RATIOS[1]

    def unit(self, order: int, configured: str, key: str, own: str) -> Unit | Unknown | None:
        """The unit of positions or accelerations from all sources but the factor group."""
        if configured:
            return parse_unit(configured, order, key)
        return self.read_unit(order) or self.noted_unit(order) or (parse_unit(own, order, self.name) if own else None)

    def read_unit(self, order: int) -> Unit | Unknown | None:
        """60A8h to 60AAh; an unknown unit is not derived from other objects."""
        index, value = SI_UNITS[order], self.number(SI_UNITS[order])
        if not value:
            return None
        unit = si_unit(value, order)
        if unit is None:
            return Unknown(f"{index:04X}h = {value & 4294967295:08X}h is an unknown unit")
        return Unit(unit.factor, unit.kind, order, f"{index:04X}h = {unit}")

    def noted_unit(self, order: int) -> Unit | Unknown | None:
        """6089h to 608Eh; the notation index is a signed byte."""
        notation, dimension = (self.number(index) for index in NOTATIONS[order])
        if notation is None or not dimension:
            return None
        where = "{:04X}h, {:04X}h".format(*NOTATIONS[order])
        unit = dimension_unit(notation - (0x100 if notation > 0x7F else 0), dimension, order)
        if unit is None:
            return Unknown(f"{where}: {notation}, {dimension & 255:02X}h is an unknown unit")
        return Unit(unit.factor, unit.kind, order, f"{where}: {unit}")

    def _increments(self) -> Known | None:
        fixed = self.family.increments_per_revolution
        if fixed is not None:
            return Known(fixed, (f"{self.name}: {amount(fixed)} inc/rev",))
        ratio = self.ratio(objects.POSITION_ENCODER_RESOLUTION)
        return None if ratio is None else Known(ratio, (f"608Fh: {amount(ratio)} inc/rev",), True)

    def _gear(self) -> Known:
        if self.keys.gear is not None:
            return Known(self.keys.gear, ("gear",))
        ratio = self.ratio(objects.GEAR_RATIO)
        return Known(Fraction(1), ()) if ratio is None else Known(ratio, ("6091h",), True)

    def _position_unit(self) -> Unit | Unknown | None:
        return self.unit(0, self.keys.position_unit, "position_unit", self.family.position)

    def _counts(self) -> Found:
        """Position units in a revolution of the motor."""
        keys, increments = self.keys, self.increments
        if keys.counts_per_revolution is not None:
            counts = keys.counts_per_revolution
            return Known(counts, (f"counts_per_revolution = {amount(counts)}",))
        unit, factor, feed = self.position_unit, self.ratio(objects.POSITION_FACTOR), self.ratio(objects.FEED_CONSTANT)
        if isinstance(unit, Unknown):
            return unit
        if unit is not None and unit.kind is Kind.TURN:
            return self._geared(Known(1 / unit.factor, (str(unit),)))
        if unit is not None and unit.kind is Kind.METRE:
            # 6092h is in position units.
            if feed is not None:
                return self._geared(Known(feed, ("6092h",), True))
            return Unknown(f"positions are in {unit}, and no feed constant 6092h defines the distance of a revolution")
        if increments is not None and unit is not None and unit.kind is Kind.INCREMENT:
            return increments._replace(value=increments.value / unit.factor)
        if factor is not None and increments is not None:
            return Known(increments.value / factor, (*increments.sources, "6093h"), True)
        if feed is not None:
            return self._geared(Known(feed, ("6092h",), True))
        if increments is not None:
            return increments
        if self.family.counts_per_revolution is not None:
            counts = self.family.counts_per_revolution
            return Known(counts, (f"{self.name}: {amount(counts)} counts/rev",))
        return Unknown("no source defines the position units of a revolution", "counts_per_revolution")

    def _geared(self, per_turn: Known) -> Known:
        gear = self.gear
        sources = (*per_turn.sources, *gear.sources)
        return Known(per_turn.value / gear.value, sources, per_turn.by_position or gear.by_position)

    def _metres(self) -> Found:
        unit, counts = self.position_unit, self.counts
        if isinstance(counts, Unknown):
            return counts
        if not isinstance(unit, Unit) or unit.kind is not Kind.METRE:
            return Unknown("positions are not in a unit of length")
        return Known(counts.value * unit.factor, (str(unit), *counts.sources), counts.by_position)

    def turn(self, kind: Kind) -> Found:
        """One revolution of the motor in this kind of unit."""
        if kind is Kind.TURN:
            return self.gear._replace(value=1 / self.gear.value)
        if kind is Kind.POSITION:
            return self.counts
        if kind is Kind.METRE:
            return self.metres
        return self.increments or Unknown("608Fh does not define the increments of a revolution")

    def per_rpm(self, unit: Unit | Unknown, what: str) -> Found:
        """Number of this unit in one rpm (velocity) or rpm/s (acceleration) of the motor."""
        if isinstance(unit, Unknown):
            return unit
        turn = self.turn(unit.kind)
        if isinstance(turn, Unknown):
            key = turn.key if unit.kind is Kind.POSITION else "velocity_unit"
            return Unknown(f"{what} in {unit}: {turn.why}", key)
        return Known(turn.value / SECONDS_PER_MINUTE / unit.factor, (str(unit), *turn.sources), turn.by_position)
