"""100 % of a speed, an acceleration or a position in a drive's own units, or why it is unknown.

``dsp402.units.velocity`` finds the unit of velocities, ``dsp402.units.mechanics`` the units of a revolution. Exact rational
arithmetic. Nothing is assumed: an unknown value is refused with the key that sets it. Source: CiA 402, docs/devices.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from types import MappingProxyType
from typing import NamedTuple

from pdgw.base.durations import SECONDS_PER_MINUTE
from pdgw.ds301.objects import ObjectAddress
from pdgw.dsp402 import objects
from pdgw.dsp402.drive_type import Quantity, Reference, Scaling
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.units.mechanics import (
    NO_LIMIT,
    NOTATIONS,
    SI_UNITS,
    UNIT_RATIOS,
    Answers,
    FamilyUnits,
    Found,
    Known,
    Mechanics,
    UnitKeys,
    Unknown,
    amount,
)
from pdgw.dsp402.units.units import Unit, parse_unit
from pdgw.dsp402.units.velocity import VL_FACTORS, velocity

_RATIOS = (*UNIT_RATIOS, *VL_FACTORS, objects.POSITION_RANGE_LIMIT, objects.SOFTWARE_POSITION_LIMIT, objects.VL_MIN_MAX)
_NUMBERS = (
    objects.POLARITY,
    objects.MAX_MOTOR_SPEED,
    objects.MAX_PROFILE_VELOCITY,
    objects.MAX_ACCELERATION,
    objects.MAX_DECELERATION,
    *SI_UNITS,
    *(index for pair in NOTATIONS for index in pair),
)
SCALING_OBJECTS: tuple[ObjectAddress, ...] = (
    *((index, 0) for index in _NUMBERS),
    *((index, subindex) for index in _RATIOS for subindex in (1, 2)),
)
"""Objects to read for the scaling, if the drive has them."""
_INVERTS = 0b1100_0000
"""607Eh: bits of position (7) and velocity (6)."""
_ALL_POSITIONS = DRIVE_OBJECTS.attribute("target_position").limits
_NO_RANGE = Reference(
    Fraction(-_ALL_POSITIONS[0], 2),
    f"100 % = 607Ah {-_ALL_POSITIONS[0] // 2} (no range limit in 607Bh: 200 % is the range of 607Ah)",
)


def _acceleration(mechanics: Mechanics) -> Found:
    """Acceleration units of one rpm/s of the motor."""
    keys, family = mechanics.keys, mechanics.family
    unit = mechanics.unit(2, keys.acceleration_unit, "acceleration_unit", "")
    if unit is not None:
        found = mechanics.per_rpm(unit, "accelerations")
        return found if isinstance(found, Known) else Unknown(found.why, "acceleration_unit")
    factor, counts = mechanics.ratio(objects.ACCELERATION_FACTOR), mechanics.counts
    if factor is not None and isinstance(counts, Known):
        return Known(counts.value / SECONDS_PER_MINUTE * factor, ("6097h", *counts.sources))
    if family.acceleration:
        return mechanics.per_rpm(parse_unit(family.acceleration, 2, mechanics.name), "accelerations")
    return Unknown("no source defines the acceleration unit", "acceleration_unit")


class _Lacking(NamedTuple):
    """Why a quantity has no 100 %, and the keys that give it."""

    why: str
    keys: tuple[str, ...] = ()


def _lacking(*unknown: Unknown) -> _Lacking:
    text = "; ".join(f"{item.why}: set {item.key}" for item in unknown)
    return _Lacking(text, tuple(item.key for item in unknown))


def _rated_speed(mechanics: Mechanics, velocity: Found, *, vl: bool) -> Found:
    """100 % of a speed in rpm of the motor."""
    rated = mechanics.keys.rated_speed_rpm
    if rated is not None:
        return Known(rated, ("rated_speed_rpm",))
    speed = mechanics.limit(objects.MAX_MOTOR_SPEED)
    if speed is not None:
        return Known(Fraction(speed), ("6080h",))
    highest = mechanics.limit(objects.VL_MIN_MAX, 2)
    if vl and highest is not None and isinstance(velocity, Known):
        return Known(highest / velocity.value, ("6046h/2",))
    value = mechanics.number(objects.MAX_MOTOR_SPEED)
    source_text = "the drive has no Max Motor Speed 6080h" if value is None else f"Max Motor Speed 6080h is {value}"
    return Unknown(f"{source_text}, the source of 100 %", "rated_speed_rpm")


def find_scaling(
    answers: Answers,
    keys: UnitKeys | None = None,
    family: FamilyUnits | None = None,
    *,
    name: str = "overlay",
    vl: bool = False,
    range_is_limit: bool | None = None,
) -> Scaling:
    """The scaling of a drive with these answers (``SCALING_OBJECTS``).

    ``name``: the overlay's, for messages. ``vl``: the speed setpoint is 6042h, not 60FFh. ``range_is_limit``: as in ``Quirks``.
    Dsp402Error for a key with an invalid unit.
    """
    mechanics = Mechanics(answers, keys or UnitKeys(), family or FamilyUnits(), name)
    known: dict[Quantity, Reference] = {}
    unknown: dict[Quantity, str] = {}
    missing: dict[Quantity, tuple[str, ...]] = {}

    def decide(quantity: Quantity, found: Reference | _Lacking) -> None:
        if isinstance(found, Reference):
            known[quantity] = found
        else:
            unknown[quantity] = f"{quantity.value}: {found.why}"
            missing[quantity] = found.keys

    unit_of_velocity = velocity(mechanics, vl=vl)
    rated = _rated_speed(mechanics, unit_of_velocity, vl=vl)
    speed = _speed(rated, unit_of_velocity, objects.VL_TARGET_VELOCITY if vl else objects.TARGET_VELOCITY)
    decide(Quantity.SPEED, speed)
    decide(Quantity.PROFILE_VELOCITY, _profile_velocity(mechanics, speed))
    acceleration = _rate(mechanics, (objects.MAX_ACCELERATION,), objects.PROFILE_ACCELERATION)
    decide(Quantity.ACCELERATION, acceleration)
    decide(
        Quantity.DECELERATION,
        _rate(mechanics, (objects.MAX_DECELERATION, objects.MAX_ACCELERATION), objects.PROFILE_DECELERATION),
    )
    limits, wraps, source, position = _position(mechanics, range_is_limit)
    decide(Quantity.POSITION, position)
    counts, unit, per_rpm_s = mechanics.counts, mechanics.position_unit, _acceleration(mechanics)
    return Scaling(
        MappingProxyType(known),
        MappingProxyType(unknown),
        MappingProxyType(missing),
        rated_speed_rpm=rated.value if isinstance(rated, Known) else None,
        position_range=limits,
        position_wraps=wraps,
        wrap_confirmed=range_is_limit is False,
        range_source=source,
        same_signs=answers.get((objects.POLARITY, 0), 0) & _INVERTS in (0, _INVERTS),
        position_unit=str(unit) if isinstance(unit, Unit) else "counts",
        counts_per_revolution=counts.value if isinstance(counts, Known) else None,
        velocity_per_rpm=unit_of_velocity.value if isinstance(unit_of_velocity, Known) else None,
        acceleration_per_rpm_s=per_rpm_s.value if isinstance(per_rpm_s, Known) else None,
    )


def _speed(rated: Found, velocity: Found, index: int) -> Reference | _Lacking:
    if isinstance(rated, Unknown) or isinstance(velocity, Unknown):
        return _lacking(*(item for item in (rated, velocity) if isinstance(item, Unknown)))
    value = rated.value * velocity.value
    sources = ", ".join(dict.fromkeys(rated.sources + velocity.sources))
    text = f"100 % = {amount(rated.value)} rpm = {index:04X}h {amount(value)} (from {sources})"
    return Reference(value, text)


def _profile_velocity(mechanics: Mechanics, speed: Reference | _Lacking) -> Reference | _Lacking:
    """The smaller of Max Profile Velocity and the rated speed, in velocity units."""
    if isinstance(speed, _Lacking):
        return _Lacking("as speed", speed.keys)
    limit = mechanics.number(objects.MAX_PROFILE_VELOCITY)
    if limit is not None and 0 < limit < min(speed.value, Fraction(NO_LIMIT)):
        return Reference(Fraction(limit), f"100 % = 6081h {limit} (from 607Fh)")
    if limit == 0:
        return _Lacking("Max Profile Velocity 607Fh is 0: a value above 0 is needed")
    return Reference(speed.value, f"100 % = 6081h {amount(speed.value)} (as speed)")


def _rate(mechanics: Mechanics, limits: Iterable[int], index: int) -> Reference | _Lacking:
    """Acceleration or deceleration: the key, else the first of these limits the drive has."""
    rated = mechanics.keys.rated_acceleration
    if rated is not None:
        unit = _acceleration(mechanics)
        if isinstance(unit, Unknown):
            return _lacking(unit)
        value = rated * unit.value
        text = f"100 % = {amount(rated)} rpm/s = {index:04X}h {amount(value)} (from {unit.source})"
        return Reference(value, text)
    for limit in limits:
        value_of = mechanics.number(limit)
        if value_of is not None and 0 < value_of < NO_LIMIT:
            return Reference(Fraction(value_of), f"100 % = {index:04X}h {value_of} (from {limit:04X}h)")
        if value_of is not None:
            return _no_rate(mechanics, f"{limit:04X}h is {value_of}, not usable as a reference")
    return _no_rate(mechanics, f"the drive has no {objects.MAX_ACCELERATION:04X}h")


def _no_rate(mechanics: Mechanics, why: str) -> _Lacking:
    unit = _acceleration(mechanics)
    more = [unit] if isinstance(unit, Unknown) else []
    return _lacking(Unknown(why, "rated_acceleration_rpm_s"), *more)


def _position(
    mechanics: Mechanics, range_is_limit: bool | None
) -> tuple[tuple[int, int] | None, bool, str, Reference | _Lacking]:
    """Targets allowed, whether the position wraps there, the objects that say so, and 100 %."""
    answers = mechanics.answers
    low, high = answers.get((objects.POSITION_RANGE_LIMIT, 1)), answers.get((objects.POSITION_RANGE_LIMIT, 2))
    least = answers.get((objects.SOFTWARE_POSITION_LIMIT, 1), 0)
    most = answers.get((objects.SOFTWARE_POSITION_LIMIT, 2), 0)
    limits = (least, most) if least < most else None
    source = f"607Dh {least} to {most}" if limits else ""
    if low is None or high is None or low == high == 0 or (low, high) == _ALL_POSITIONS:
        return limits, False, source, _NO_RANGE
    if high <= 0 or low >= high:
        text = f"Position Range Limit 607Bh is {low} to {high}: the maximum must be above 0 and above the minimum"
        return limits, False, source, _Lacking(text)
    found = Reference(Fraction(high), f"100 % = 607Ah {high} (from 607Bh/2)")
    of_range = f"607Bh {low} to {high}"
    inside = max(low, least), min(high, most)
    if limits and inside != (low, high) and inside[0] < inside[1]:
        return inside, False, f"{of_range} and {source}", found  # software limits prevent the wrap
    return (low, high), not range_is_limit, of_range, found
