"""The unit of a drive's velocities, by agreement of all sources.

Each source makes a claim: the number of units of 60FFh in one rpm of the motor. Claims that differ are refused with both
texts; the configuration decides between them. Objects that describe only positions (608Fh, 6091h, 6092h) count if 607Fh
confirms them. Source: CiA 402, docs/devices.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

from pdgw.base.durations import SECONDS_PER_MINUTE
from pdgw.dsp402.objects import (
    MAX_PROFILE_VELOCITY,
    TARGET_VELOCITY,
    VELOCITY_ENCODER_FACTOR,
    VELOCITY_ENCODER_RESOLUTION,
    VELOCITY_FACTOR,
    VL_DIMENSION_FACTOR,
    VL_MIN_MAX,
    VL_SETPOINT_FACTOR,
    VL_TARGET_VELOCITY,
)
from pdgw.dsp402.units.mechanics import Found, Known, Mechanics, Unknown, amount
from pdgw.dsp402.units.units import Unit, parse_unit

VL_FACTORS = (VL_SETPOINT_FACTOR, VL_DIMENSION_FACTOR)
_AGREE = Fraction(1, 100)
"""Factors are rounded to whole numbers: claims that differ by less agree."""
_RPM = Fraction(1)


def velocity(mechanics: Mechanics, *, vl: bool = False) -> Found:
    """Velocity units of one rpm of the motor; ``vl``: of 6042h."""
    return _Sources(mechanics, vl).decided()


class _Sources:
    """Everything that speaks of the velocities of one drive."""

    def __init__(self, mechanics: Mechanics, vl: bool) -> None:
        self.mechanics = mechanics
        self.vl = vl
        self.limit = mechanics.limit(VL_MIN_MAX, 2) if vl else mechanics.limit(MAX_PROFILE_VELOCITY)
        self.limit_name = "6046h/2" if vl else "607Fh"

    def decided(self) -> Found:
        mechanics = self.mechanics
        family = mechanics.family
        stated = self._configuration()
        if family.ask:
            return stated or Unknown(f"{mechanics.name}: {family.ask}")
        declared = [*(self._vl() if self.vl else self._objects())]
        # The configuration overrides the profile and the package's table, but not the drive's own values.
        table = [*(self._profile() if self.vl else self._table())]
        if stated is not None:
            return self._agreeing(stated, [claim for claim in declared if isinstance(claim, Known)])
        claims = [*declared, *table]
        for claim in claims:
            if isinstance(claim, Unknown):
                return claim
        known = [claim for claim in claims if isinstance(claim, Known)]
        if not known:
            return self._by_position()
        for claim in known[1:]:
            if not _agree(known[0], claim):
                return Unknown(self._differ(known[0], claim))
        # A source without position objects confirms the others.
        free = [claim for claim in known if not claim.by_position]
        return free[0] if free else self._confirmed(known[0])

    # -- sources --------------------------------------------------------------------------------------------------------

    def _configuration(self) -> Found | None:
        text = self.mechanics.keys.velocity_unit
        if not text:
            return None
        unit = parse_unit(text, 1, "velocity_unit")
        named = Unit(unit.factor, unit.kind, 1, f"velocity_unit = {unit}")
        return self.mechanics.per_rpm(named, "velocities")

    def _objects(self) -> Iterator[Found]:
        mechanics = self.mechanics
        for unit in (mechanics.read_unit(1), mechanics.noted_unit(1)):
            if unit is not None:
                yield mechanics.per_rpm(unit, "velocities")
        yield from self._factors()
        if mechanics.family.velocity and mechanics.family.velocity_step:
            yield self._family()

    def _factors(self) -> Iterator[Found]:
        """6094h, 6090h and 6096h, as far as they are not at their default."""
        mechanics = self.mechanics
        resolution, step, factor = (
            mechanics.ratio(index) for index in (VELOCITY_ENCODER_RESOLUTION, VELOCITY_ENCODER_FACTOR, VELOCITY_FACTOR)
        )
        encoder = None if resolution is None else Known(resolution, (f"6090h: {amount(resolution)} inc/rev",))
        increments = encoder or mechanics.increments
        if step is not None and increments is None:
            yield Unknown("6094h alone does not define the unit (rpm, increments/s and 1/4096 rpm are in use)")
        elif step is not None and increments is not None:
            value = increments.value / SECONDS_PER_MINUTE / step
            yield Known(value, ("6094h", *increments.sources), increments.by_position)
        elif encoder is not None and factor is None:
            yield Known(encoder.value / SECONDS_PER_MINUTE, encoder.sources)
        if factor is not None:
            counts = mechanics.counts if isinstance(mechanics.counts, Known) else encoder
            if counts is None:
                yield Unknown(
                    "6096h applies to position units, and no source defines the position units of a revolution"
                )
            else:
                value = counts.value / SECONDS_PER_MINUTE * factor
                yield Known(value, ("6096h", *counts.sources), counts.by_position)

    def _family(self) -> Found:
        mechanics = self.mechanics
        family, name = mechanics.family, mechanics.name
        unit = parse_unit(family.velocity, 1, name)
        for index in sorted(family.only_while_one):
            if mechanics.own_ratios.get(index) not in {None, Fraction(1)}:
                return Unknown(f"{name}: {index:04X}h is not 1")
        if not family.velocity_step:
            return mechanics.per_rpm(Unit(unit.factor, unit.kind, 1, f"{name}: {unit}"), "velocities")
        step = mechanics.own_ratios.get(family.velocity_step)
        if step is None:
            return Unknown(f"{family.velocity_step:04X}h is 0, missing or ignored")
        text = f"{family.velocity_step:04X}h: {step} {unit}"
        return mechanics.per_rpm(Unit(unit.factor * step, unit.kind, 1, text), "velocities")

    def _table(self) -> Iterator[Found]:
        if self.mechanics.family.velocity and not self.mechanics.family.velocity_step:
            yield self._family()

    def _vl(self) -> Iterator[Found]:
        mechanics = self.mechanics
        for index in VL_FACTORS:
            if mechanics.ratio(index) is not None:
                yield Unknown(f"{index:04X}h is not 1")
        unit = mechanics.read_unit(1)
        if unit is not None:
            yield mechanics.per_rpm(unit, "velocities")

    def _profile(self) -> Iterator[Found]:
        gear = self.mechanics.gear
        yield Known(1 / gear.value, ("6042h is in rpm", *gear.sources), gear.by_position)

    def _by_position(self) -> Found:
        """Nothing speaks of velocities: position units per second, if the limit of the velocity can mean nothing else."""
        counts = self.mechanics.counts
        if isinstance(counts, Unknown):
            return Unknown("neither an object of the drive nor an overlay defines the velocity unit")
        claim = Known(counts.value / SECONDS_PER_MINUTE, counts.sources, True)
        if self.mechanics.limit_confirms(_RPM, self.limit):
            return Unknown(f"{counts.source} applies to positions, and {self.limit_name} {self.limit} may be in rpm")
        return self._confirmed(claim)

    # -- choice of a source -----------------------------------------------------------------------------------------------

    def _confirmed(self, claim: Known) -> Found:
        if not claim.by_position or self.mechanics.limit_confirms(claim.value, self.limit):
            return claim
        limit, name = self.limit, self.limit_name
        seen = f"{name} {limit} would be {amount(limit / claim.value)} rpm" if limit else f"{name} has no limit"
        key = "counts_per_revolution" if self.mechanics.keys.velocity_unit else "velocity_unit"
        return Unknown(f"{claim.source} applies to positions and is not confirmed for velocities ({seen})", key)

    def _agreeing(self, stated: Found, declared: Sequence[Known]) -> Found:
        """The configured value, unless all sources of the drive contradict it."""
        stated = self._confirmed(stated) if isinstance(stated, Known) else stated
        if isinstance(stated, Unknown):
            return stated
        accepted = [claim for claim in declared if isinstance(self._confirmed(claim), Known)]
        if not accepted or any(_agree(stated, claim) for claim in accepted):
            return stated
        return Unknown(f"{self._differ(stated, accepted[0])}; correct velocity_unit, or", "ignored_unit_objects")

    def _differ(self, one: Known, other: Known) -> str:
        index = VL_TARGET_VELOCITY if self.vl else TARGET_VELOCITY
        return (
            f"sources differ: 1 rpm is {index:04X}h {amount(one.value)} by {one.source}, "
            f"and {amount(other.value)} by {other.source}"
        )


def _agree(one: Known, other: Known) -> bool:
    return abs(one.value / other.value - 1) <= _AGREE
