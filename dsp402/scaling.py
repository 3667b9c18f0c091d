"""What 100 % of a speed, an acceleration or a position is in a drive's own units: found, in a fixed order of sources, or refused.

Sources, first to last: the configuration; the SI units 60A8h to 60AAh; the factor group 608Fh to 6097h; notation and dimension
index 6089h to 608Eh; 6094h and 6080h as an overlay explains them; the overlay. Exact rational arithmetic; nothing is assumed:
what no source tells is refused with the key that settles it. Source: CiA 402, docs/units.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from types import MappingProxyType
from typing import NamedTuple

from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402.drive_type import Quantity, Reference, Scaling
from pdgw.dsp402.indices import (
    ACCELERATION_DIMENSION,
    ACCELERATION_FACTOR,
    ACCELERATION_NOTATION,
    FEED_CONSTANT,
    GEAR_RATIO,
    MAX_ACCELERATION,
    MAX_DECELERATION,
    MAX_MOTOR_SPEED,
    MAX_PROFILE_VELOCITY,
    POSITION_DIMENSION,
    POSITION_ENCODER_RESOLUTION,
    POSITION_FACTOR,
    POSITION_NOTATION,
    POSITION_RANGE_LIMIT,
    PROFILE_ACCELERATION,
    PROFILE_DECELERATION,
    SI_UNIT_ACCELERATION,
    SI_UNIT_POSITION,
    SI_UNIT_VELOCITY,
    SOFTWARE_POSITION_LIMIT,
    TARGET_VELOCITY,
    VELOCITY_DIMENSION,
    VELOCITY_ENCODER_FACTOR,
    VELOCITY_ENCODER_RESOLUTION,
    VELOCITY_FACTOR,
    VELOCITY_NOTATION,
    VL_DIMENSION_FACTOR,
    VL_MIN_MAX,
    VL_SETPOINT_FACTOR,
    VL_TARGET_VELOCITY,
)
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.unit_keys import FamilyUnits, UnitKeys
from pdgw.dsp402.units import Kind, Unit, dimension_unit, parse_unit, si_unit
from pdgw.durations import SECONDS_PER_MINUTE

Answers = Mapping[ObjectAddress, int]

_VL_FACTORS = (VL_SETPOINT_FACTOR, VL_DIMENSION_FACTOR)
_SI_UNITS = (SI_UNIT_POSITION, SI_UNIT_VELOCITY, SI_UNIT_ACCELERATION)
_NOTATIONS = (
    (POSITION_NOTATION, POSITION_DIMENSION),
    (VELOCITY_NOTATION, VELOCITY_DIMENSION),
    (ACCELERATION_NOTATION, ACCELERATION_DIMENSION),
)
_RATIOS = (
    *range(POSITION_ENCODER_RESOLUTION, VELOCITY_ENCODER_FACTOR + 1),
    VELOCITY_FACTOR,
    ACCELERATION_FACTOR,
    *_VL_FACTORS,
    POSITION_RANGE_LIMIT,
    SOFTWARE_POSITION_LIMIT,
    VL_MIN_MAX,
)
_NUMBERS = (
    MAX_MOTOR_SPEED,
    MAX_PROFILE_VELOCITY,
    MAX_ACCELERATION,
    MAX_DECELERATION,
    *_SI_UNITS,
    *(index for pair in _NOTATIONS for index in pair),
)
SCALING_OBJECTS: tuple[ObjectAddress, ...] = (
    *((index, 0) for index in _NUMBERS),
    *((index, subindex) for index in _RATIOS for subindex in (1, 2)),
)
"""What a drive is asked for its scaling, as far as it has it."""

_NO_LIMIT = 0x7FFF_FFFF
"""A limit of this size or above is none, and no reference either."""
_ALL_POSITIONS = DRIVE_OBJECTS.attribute("target_position").limits
_NO_RANGE = Reference(
    Fraction(-_ALL_POSITIONS[0], 2),
    f"100 % = 607Ah {-_ALL_POSITIONS[0] // 2} (no range limit in 607Bh: 200 % is all that 607Ah holds)",
)


class _Known(NamedTuple):
    value: Fraction
    source: str


class _Unknown(NamedTuple):
    why: str


_Found = _Known | _Unknown


def _first(*sources: Callable[[], _Known | None]) -> _Known | None:
    return next((found for source in sources if (found := source()) is not None), None)


def _amount(value: Fraction) -> str:
    """A fraction as a person reads it."""
    return str(value) if value.denominator == 1 else f"{float(value):.6g}"


def _ratio(answers: Answers, index: int) -> Fraction | None:
    numerator, denominator = answers.get((index, 1), 0), answers.get((index, 2), 0)
    return Fraction(numerator, denominator) if numerator > 0 and denominator > 0 else None


class _Mechanics:
    """What one revolution of the motor is in every kind of unit, and the factors the drive answers."""

    def __init__(self, answers: Answers, keys: UnitKeys, family: FamilyUnits, name: str) -> None:
        own = family.only_while_one | {family.velocity_step}
        self.answers = {key: value for key, value in answers.items() if key[0] not in family.ignores | own}
        self.own_ratios = {index: _ratio(answers, index) for index in own}
        """Objects the overlay explains."""
        self.keys = keys
        self.family = family
        self.name = name
        self.increments = self._increments()
        self.gear = self._gear()
        self.position_unit = self._position_unit()
        self.counts = self._counts()
        self.metres = self._metres()

    def number(self, index: int) -> int | None:
        return self.answers.get((index, 0))

    def ratio(self, index: int) -> Fraction | None:
        """Sub-index 1 over sub-index 2; None where one of them is missing, 0 or negative."""
        return _ratio(self.answers, index)

    def unit(self, order: int, configured: str, key: str, own: str) -> Unit | _Unknown | None:
        """The unit of positions, velocities or accelerations from all sources but the factor group."""
        if configured:
            return parse_unit(configured, order, key)
        return self.told_unit(order) or self.noted_unit(order) or (parse_unit(own, order, self.name) if own else None)

    def told_unit(self, order: int) -> Unit | _Unknown | None:
        """60A8h to 60AAh; a unit that is told and not known here is not guessed from elsewhere."""
        index, value = _SI_UNITS[order], self.number(_SI_UNITS[order])
        if not value:
            return None
        unit = si_unit(value, order)
        if unit is None:
            return _Unknown(f"{index:04X}h = {value & 0xFFFF_FFFF:08X}h is no unit known here")
        return Unit(unit.factor, unit.kind, order, f"{index:04X}h = {unit}")

    def noted_unit(self, order: int) -> Unit | _Unknown | None:
        """6089h to 608Eh; the notation index is a signed byte."""
        notation, dimension = (self.number(index) for index in _NOTATIONS[order])
        if notation is None or not dimension:
            return None
        where = "{:04X}h, {:04X}h".format(*_NOTATIONS[order])
        unit = dimension_unit(notation - (0x100 if notation > 0x7F else 0), dimension, order)
        if unit is None:
            return _Unknown(f"{where}: {notation}, {dimension & 0xFF:02X}h is no unit known here")
        return Unit(unit.factor, unit.kind, order, f"{where}: {unit}")

    def _increments(self) -> _Known | None:
        fixed = self.family.increments_per_revolution
        if fixed is not None:
            return _Known(fixed, f"{self.name}: {_amount(fixed)} inc/rev")
        ratio = self.resolution(POSITION_ENCODER_RESOLUTION)
        return None if ratio is None else _Known(ratio, f"608Fh: {_amount(ratio)} inc/rev")

    def resolution(self, index: int) -> Fraction | None:
        """An encoder resolution; one increment a revolution is the default of a drive that does not tell."""
        ratio = self.ratio(index)
        return None if ratio == 1 else ratio

    def _gear(self) -> _Known:
        if self.keys.gear is not None:
            return _Known(self.keys.gear, "gear")
        ratio = self.ratio(GEAR_RATIO)
        return _Known(Fraction(1), "") if ratio is None or ratio == 1 else _Known(ratio, "6091h")

    def _position_unit(self) -> Unit | _Unknown | None:
        return self.unit(0, self.keys.position_unit, "position_unit", self.family.position)

    def _counts(self) -> _Found:
        """Position units in a revolution of the motor."""
        keys, increments = self.keys, self.increments
        if keys.counts_per_revolution is not None:
            counts = keys.counts_per_revolution
            return _Known(counts, f"counts_per_revolution = {_amount(counts)}")
        unit, factor, feed = self.position_unit, self.ratio(POSITION_FACTOR), self.ratio(FEED_CONSTANT)
        if isinstance(unit, _Unknown):
            return unit
        if unit is not None and unit.kind is Kind.TURN:
            return self._geared(1 / unit.factor, str(unit))
        if unit is not None and unit.kind is Kind.METRE:
            # 6092h is in position units, as far as it is anything but its default.
            if feed is not None:
                return self._geared(feed, "6092h")
            return _Unknown(f"positions are in {unit} and no feed constant 6092h says how far a revolution goes")
        if increments is not None and unit is not None and unit.kind is Kind.INCREMENT:
            return _Known(increments.value / unit.factor, increments.source)
        if factor is not None and increments is not None and factor != 1:
            return _Known(increments.value / factor, f"{increments.source}, 6093h")
        if feed is not None and (feed != 1 or increments is None):
            return self._geared(feed, "6092h")
        if feed is not None and increments is not None and increments.value != 1:
            return _Unknown(f"6092h says one position unit a revolution, {increments.source}")
        if increments is not None:
            return increments
        if self.family.counts_per_revolution is not None:
            counts = self.family.counts_per_revolution
            return _Known(counts, f"{self.name}: {_amount(counts)} counts/rev")
        return _Unknown("no source tells the position units of a revolution")

    def _geared(self, per_turn: Fraction, source: str) -> _Known:
        gear = self.gear
        return _Known(per_turn / gear.value, f"{source}, {gear.source}" if gear.source else source)

    def _metres(self) -> _Found:
        unit, counts = self.position_unit, self.counts
        if isinstance(counts, _Unknown):
            return counts
        if not isinstance(unit, Unit) or unit.kind is not Kind.METRE:
            return _Unknown("positions are not in a unit of length")
        return _Known(counts.value * unit.factor, f"{unit}, {counts.source}")

    def turn(self, kind: Kind) -> _Found:
        """What one revolution of the motor is in this kind."""
        if kind is Kind.TURN:
            return _Known(1 / self.gear.value, self.gear.source)
        if kind is Kind.POSITION:
            return self.counts
        if kind is Kind.METRE:
            return self.metres
        return self.increments or _Unknown("608Fh does not tell the increments of a revolution")

    def per_rpm(self, unit: Unit | _Unknown, what: str) -> _Found:
        """So many of this unit are one rpm (velocity) or rpm/s (acceleration) of the motor."""
        if isinstance(unit, _Unknown):
            return unit
        turn = self.turn(unit.kind)
        if isinstance(turn, _Unknown):
            return _Unknown(f"{what} in {unit}: {turn.why}")
        source = f"{unit}, {turn.source}" if turn.source else str(unit)
        return _Known(turn.value / SECONDS_PER_MINUTE / unit.factor, source)


def _velocity(mechanics: _Mechanics) -> _Found:
    """Velocity units of one rpm of the motor."""
    keys, family = mechanics.keys, mechanics.family
    if keys.velocity_unit:
        unit = parse_unit(keys.velocity_unit, 1, "velocity_unit")
        return mechanics.per_rpm(Unit(unit.factor, unit.kind, 1, f"velocity_unit = {unit}"), "velocities")
    told = mechanics.told_unit(1)
    if told is not None:
        return mechanics.per_rpm(told, "velocities")
    group = _velocity_by_factors(mechanics)
    if isinstance(group, _Known):
        return group
    noted = mechanics.noted_unit(1)
    if noted is not None:
        return mechanics.per_rpm(noted, "velocities")
    if family.velocity:
        return _velocity_of_family(mechanics)
    return group


def _velocity_by_factors(mechanics: _Mechanics) -> _Found:
    encoder = mechanics.resolution(VELOCITY_ENCODER_RESOLUTION)
    increments = mechanics.increments if encoder is None else _Known(encoder, f"6090h: {_amount(encoder)} inc/rev")
    step = mechanics.ratio(VELOCITY_ENCODER_FACTOR)
    if step is not None and increments is not None:
        return _Known(increments.value / SECONDS_PER_MINUTE / step, f"6094h, {increments.source}")
    factor = mechanics.ratio(VELOCITY_FACTOR)
    counts = mechanics.counts
    if factor is not None and isinstance(counts, _Known):
        source = f"6096h, {counts.source}" if factor != 1 else counts.source
        return _Known(counts.value / SECONDS_PER_MINUTE * factor, source)
    if encoder is not None and increments is not None:
        return _Known(increments.value / SECONDS_PER_MINUTE, increments.source)
    if mechanics.increments is not None:
        if isinstance(counts, _Unknown):
            return counts
        return _Known(counts.value / SECONDS_PER_MINUTE, counts.source)
    if step is not None:
        return _Unknown("6094h alone does not tell the unit (rpm, increments/s and 1/4096 rpm are in use)")
    return _Unknown("no object of the drive and no overlay tells the velocity unit")


def _velocity_of_family(mechanics: _Mechanics) -> _Found:
    family, name = mechanics.family, mechanics.name
    unit = parse_unit(family.velocity, 1, name)
    for index in sorted(family.only_while_one):
        if mechanics.own_ratios[index] not in {None, Fraction(1)}:
            return _Unknown(f"{name}: {index:04X}h is not 1")
    if not family.velocity_step:
        return mechanics.per_rpm(Unit(unit.factor, unit.kind, 1, f"{name}: {unit}"), "velocities")
    step = mechanics.own_ratios[family.velocity_step]
    if step is None:
        return _Unknown(f"{family.velocity_step:04X}h is 0 or missing")
    text = f"{family.velocity_step:04X}h: {step} {unit}"
    return mechanics.per_rpm(Unit(unit.factor * step, unit.kind, 1, text), "velocities")


def _vl_velocity(mechanics: _Mechanics) -> _Found:
    """Units of 6042h of one rpm: rpm by the profile, unless a factor makes them something else."""
    if mechanics.keys.velocity_unit:
        return _velocity(mechanics)
    for index in _VL_FACTORS:
        if mechanics.ratio(index) not in {None, Fraction(1)}:
            return _Unknown(f"{index:04X}h is not 1")
    return _Known(1 / mechanics.gear.value, "6042h is in rpm")


def _acceleration(mechanics: _Mechanics) -> _Found:
    """Acceleration units of one rpm/s of the motor."""
    keys, family = mechanics.keys, mechanics.family
    unit = mechanics.unit(2, keys.acceleration_unit, "acceleration_unit", "")
    if unit is not None:
        return mechanics.per_rpm(unit, "accelerations")
    factor, counts = mechanics.ratio(ACCELERATION_FACTOR), mechanics.counts
    if factor is not None and isinstance(counts, _Known):
        return _Known(counts.value / SECONDS_PER_MINUTE * factor, f"6097h, {counts.source}")
    if family.acceleration:
        return mechanics.per_rpm(parse_unit(family.acceleration, 2, mechanics.name), "accelerations")
    return _Unknown("no source tells the acceleration unit")


def _rated_speed(mechanics: _Mechanics, *, vl: bool) -> _Found:
    """100 % of a speed in rpm of the motor."""
    rated = mechanics.keys.rated_speed_rpm
    if rated is not None:
        return _Known(rated, "rated_speed_rpm")
    speed = mechanics.number(MAX_MOTOR_SPEED)
    if speed is not None and 0 < speed < _NO_LIMIT:
        return _Known(Fraction(speed), "6080h")
    highest = mechanics.answers.get((VL_MIN_MAX, 2), 0)
    if vl and 0 < highest < _NO_LIMIT and isinstance(_vl_velocity(mechanics), _Known):
        return _Known(Fraction(highest), "6046h/2")
    told = "the drive has no Max Motor Speed 6080h" if speed is None else f"Max Motor Speed 6080h is {speed}"
    return _Unknown(f"{told}, which would be 100 %")


def find_scaling(
    answers: Answers,
    keys: UnitKeys | None = None,
    family: FamilyUnits | None = None,
    *,
    name: str = "overlay",
    vl: bool = False,
    range_is_limit: bool = False,
) -> Scaling:
    """The scaling of a drive that gave these answers (``SCALING_OBJECTS``).

    ``name``: the overlay's, for messages. ``vl``: the speed setpoint is 6042h, not 60FFh. ``range_is_limit``: 607Bh limits the
    targets. Dsp402Error for a key that is no unit.
    """
    mechanics = _Mechanics(answers, keys or UnitKeys(), family or FamilyUnits(), name)
    known: dict[Quantity, Reference] = {}
    unknown: dict[Quantity, str] = {}

    def settle(quantity: Quantity, found: Reference | str) -> None:
        if isinstance(found, Reference):
            known[quantity] = found
        else:
            unknown[quantity] = f"{quantity.value}: {found}"

    rated = _rated_speed(mechanics, vl=vl)
    velocity = _vl_velocity(mechanics) if vl else _velocity(mechanics)
    speed = _speed(rated, velocity, VL_TARGET_VELOCITY if vl else TARGET_VELOCITY)
    settle(Quantity.SPEED, speed)
    settle(Quantity.PROFILE_VELOCITY, _profile_velocity(mechanics, speed))
    acceleration = _rate(mechanics, (MAX_ACCELERATION,), PROFILE_ACCELERATION)
    settle(Quantity.ACCELERATION, acceleration)
    settle(Quantity.DECELERATION, _rate(mechanics, (MAX_DECELERATION, MAX_ACCELERATION), PROFILE_DECELERATION))
    limits, wraps, position = _position(mechanics, range_is_limit)
    settle(Quantity.POSITION, position)
    counts, unit, per_rpm_s = mechanics.counts, mechanics.position_unit, _acceleration(mechanics)
    return Scaling(
        MappingProxyType(known),
        MappingProxyType(unknown),
        rated_speed_rpm=rated.value if isinstance(rated, _Known) else None,
        position_range=limits,
        position_wraps=wraps,
        position_unit=str(unit) if isinstance(unit, Unit) else "counts",
        counts_per_revolution=counts.value if isinstance(counts, _Known) else None,
        velocity_per_rpm=velocity.value if isinstance(velocity, _Known) else None,
        acceleration_per_rpm_s=per_rpm_s.value if isinstance(per_rpm_s, _Known) else None,
    )


def _speed(rated: _Found, velocity: _Found, index: int) -> Reference | str:
    if isinstance(rated, _Unknown):
        return f"{rated.why}: rated_speed_rpm settles it"
    if isinstance(velocity, _Unknown):
        return f"{velocity.why}: velocity_unit settles it"
    value = rated.value * velocity.value
    text = f"100 % = {_amount(rated.value)} rpm = {index:04X}h {_amount(value)} (from {_sources(rated, velocity)})"
    return Reference(value, text)


def _sources(*found: _Known) -> str:
    """Where it was learned, each once."""
    return ", ".join(dict.fromkeys(part for item in found for part in item.source.split(", ") if part))


def _profile_velocity(mechanics: _Mechanics, speed: Reference | str) -> Reference | str:
    """The smaller of Max Profile Velocity and the rated speed, in velocity units."""
    if isinstance(speed, str):
        return speed
    limit = mechanics.number(MAX_PROFILE_VELOCITY)
    if limit is not None and 0 < limit < min(speed.value, Fraction(_NO_LIMIT)):
        return Reference(Fraction(limit), f"100 % = 6081h {limit} (from 607Fh)")
    if limit == 0:
        return "Max Profile Velocity 607Fh is 0: a value above 0 is needed"
    return Reference(speed.value, f"100 % = 6081h {_amount(speed.value)} (as speed)")


def _rate(mechanics: _Mechanics, limits: Iterable[int], index: int) -> Reference | str:
    """Acceleration or deceleration: the key, else the first of these limits the drive has."""
    rated = mechanics.keys.rated_acceleration
    if rated is not None:
        unit = _acceleration(mechanics)
        if isinstance(unit, _Unknown):
            return f"{unit.why}: acceleration_unit settles it"
        value = rated * unit.value
        text = f"100 % = {_amount(rated)} rpm/s = {index:04X}h {_amount(value)} (from {unit.source})"
        return Reference(value, text)
    for limit in limits:
        value_of = mechanics.number(limit)
        if value_of is not None and 0 < value_of < _NO_LIMIT:
            return Reference(Fraction(value_of), f"100 % = {index:04X}h {value_of} (from {limit:04X}h)")
        if value_of is not None:
            return f"{limit:04X}h is {value_of}, no reference: rated_acceleration_rpm_s settles it"
    return f"the drive has no {MAX_ACCELERATION:04X}h: rated_acceleration_rpm_s settles it"


def _position(mechanics: _Mechanics, range_is_limit: bool) -> tuple[tuple[int, int] | None, bool, Reference | str]:
    """Targets allowed, whether the position wraps, and 100 %."""
    answers = mechanics.answers
    low, high = answers.get((POSITION_RANGE_LIMIT, 1)), answers.get((POSITION_RANGE_LIMIT, 2))
    software = answers.get((SOFTWARE_POSITION_LIMIT, 1), 0), answers.get((SOFTWARE_POSITION_LIMIT, 2), 0)
    limits = software if software[0] < software[1] else None
    if low is None or high is None or low == high == 0 or (low, high) == _ALL_POSITIONS:
        return limits, False, _NO_RANGE
    if high <= 0 or low >= high:
        return (
            limits,
            False,
            f"Position Range Limit 607Bh is {low} to {high}: a maximum above 0 and the minimum is needed",
        )
    if limits is not None:
        low_target, high_target = max(low, limits[0]), min(high, limits[1])
        limits = (low_target, high_target) if low_target < high_target else (low, high)
    return limits or (low, high), not range_is_limit, Reference(Fraction(high), f"100 % = 607Ah {high} (from 607Bh/2)")
