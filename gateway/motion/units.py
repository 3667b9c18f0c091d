"""Length units (LU), and the modulo correction of rotary axes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction

from pdgw.durations import SECONDS_PER_MINUTE
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.datatypes import N2_100_PERCENT

# Modulo correction: positions of a rotary axis that wrap after a range, and the way to a position.
#
# Source: modulo axes of public basic positioners (docs/motion.md). A ``Ring`` counts the position of any drive beyond its
# wrap, at 607Bh or at 32 bit. Pure; integers in any unit.


class Direction(IntEnum):
    """Direction of a modulo axis to an absolute target."""

    SHORTEST = 0
    POSITIVE = 1
    NEGATIVE = 2


def way(start: int, target: int, modulo: int, direction: Direction, window: int) -> int:
    """The way from a position (across any number of turns) to one in 0..``modulo`` - 1, signed.

    A target within ``window`` is reached by the shortest way in any direction, so an axis slightly beside its target does not
    turn round. Half a turn is forward.
    """
    forward = (target - start) % modulo
    shortest = forward if 2 * forward <= modulo else forward - modulo
    if direction is Direction.SHORTEST or abs(shortest) <= window:
        return shortest
    return forward if direction is Direction.POSITIVE else forward - modulo


def difference(newer: int, older: int, span: int = 1 << 32) -> int:
    """``newer`` - ``older`` of positions that start again after ``span``, the shorter way."""
    half = span // 2
    return (newer - older + half) % span - half


@dataclass(slots=True, eq=False)
class Ring:
    """The position of one axis."""

    low: int
    """The first position that the drive shows,"""
    size: int
    """and how many there are."""
    base: int = 0
    """The count at the drive's position 0."""
    wrapped: bool = False
    """The drive has wrapped there."""
    _raw: int = 0
    """The last position that the drive showed."""
    _known: bool = False
    """The drive has shown a position in its present coordinates."""

    def reset(self) -> None:
        """The drive's coordinates are new: the next position counts from 0."""
        self._known = False

    def follow(self, raw: int) -> int:
        """The count of a position the drive shows, less than half a ring after the last."""
        if not self._known:
            self.base = 0
            self._known = True
        elif raw != self._raw and (turn := self._turn(raw)):
            self.base += turn
            self.wrapped = True
        self._raw = raw
        return self.base + raw

    def near(self, raw: int) -> int:
        """The count of a position the drive latched, less than half a ring from where it is."""
        return self.base + self._turn(raw) + raw

    def _turn(self, raw: int) -> int:
        """Turns of the count besides the difference of the positions."""
        return difference(raw, self._raw, self.size) - (raw - self._raw)

    @property
    def turn(self) -> tuple[int, int]:
        """First and last count that the drive shows without a wrap from where it is."""
        first = self.base + self.low
        return first, first + self.size - 1

    def shown(self, count: int) -> int:
        """A count as the drive shows it."""
        return (count - self.low) % self.size + self.low

    @property
    def position(self) -> int:
        """Where the drive is, as it shows it."""
        return self._raw


# Length units (LU) of the positioner to the drive's units and back, in exact integer arithmetic.
#
# Source: the units of telegrams 110 and 111 (docs/telegrams.md "Sources"). Positions are INTEGER32 in LU, speeds in 1000
# LU/min, accelerations N2 fractions of the axis' maxima, the override N2 with 4000h = 100 %.


LU_PER_VELOCITY_UNIT = 1000
"""MDI_VELOCITY and the velocities of blocks and jogging count 1000 LU/min."""


def round_half_away(numerator: int, denominator: int) -> int:
    """The integer nearest to a quotient, half away from zero; ``denominator`` > 0."""
    if numerator >= 0:
        return (2 * numerator + denominator) // (2 * denominator)
    return -((-2 * numerator + denominator) // (2 * denominator))


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """One revolution and one rpm in the units of a drive; all values above 0, none by default."""

    positions_per_revolution: Fraction
    """Units of 607Ah and 6064h (608Fh; 6091h and 6092h where present)."""
    velocities_per_rpm: Fraction
    """Units of 6081h and 60FFh."""
    accelerations_per_rpm_s: Fraction
    """Units of 6083h and 6084h in one rpm/s."""


class LengthUnits:
    """Conversion for one axis.

    ``lu_per_revolution``: LU of one turn of the motor. ``max_acceleration``, ``max_deceleration``: 1000 LU/s2, 100 % of MDI_ACC
    and MDI_DEC. GatewayError for a value that is not above 0.
    """

    def __init__(self, lu_per_revolution: int, max_acceleration: int, max_deceleration: int, drive: DriveUnits) -> None:
        for name, value in (
            ("lu_per_revolution", lu_per_revolution),
            ("max_acceleration", max_acceleration),
            ("max_deceleration", max_deceleration),
            ("position units per revolution", drive.positions_per_revolution),
            ("velocity units per rpm", drive.velocities_per_rpm),
            ("acceleration units per rpm/s", drive.accelerations_per_rpm_s),
        ):
            if value <= 0:
                raise GatewayError(f"{name}: {value} is not allowed, expected a value above 0")
        self._position = (drive.positions_per_revolution / lu_per_revolution).as_integer_ratio()
        rpm = Fraction(LU_PER_VELOCITY_UNIT, lu_per_revolution)
        self._velocity = (rpm / N2_100_PERCENT * drive.velocities_per_rpm).as_integer_ratio()
        step = rpm * SECONDS_PER_MINUTE / N2_100_PERCENT * drive.accelerations_per_rpm_s
        self._acceleration = (step * max_acceleration).as_integer_ratio()
        self._deceleration = (step * max_deceleration).as_integer_ratio()

    def to_drive(self, position: int) -> int:
        """LU to the drive's position units, to the nearest."""
        numerator, denominator = self._position
        return round_half_away(position * numerator, denominator)

    def to_length(self, position: int) -> int:
        """The drive's position units to LU, to the nearest."""
        numerator, denominator = self._position
        # ``round_half_away`` inlined, because every cycle needs it.
        doubled = 2 * position * denominator
        if doubled >= 0:
            return (doubled + numerator) // (2 * numerator)
        return -((numerator - doubled) // (2 * numerator))

    def velocity(self, velocity: int, override: int = N2_100_PERCENT) -> int:
        """1000 LU/min under an override (N2, 0 or above) to the drive's velocity units; 0 only for 0."""
        numerator, denominator = self._velocity
        product = velocity * override
        return round_half_away(product * numerator, denominator) or (product > 0) - (product < 0)

    def to_length_speed(self, velocity: int) -> int:
        """The drive's velocity units to LU/min, to the nearest."""
        numerator, denominator = self._velocity
        return round_half_away(velocity * denominator * LU_PER_VELOCITY_UNIT, numerator * N2_100_PERCENT)

    def acceleration(self, fraction: int) -> int:
        """MDI_ACC (N2) to the drive's units; at least 1."""
        numerator, denominator = self._acceleration
        return max(1, round_half_away(fraction * numerator, denominator))

    def deceleration(self, fraction: int) -> int:
        """MDI_DEC (N2) to the drive's units; at least 1."""
        numerator, denominator = self._deceleration
        return max(1, round_half_away(fraction * numerator, denominator))
