"""Length units (LU) of the positioner to the drive's units and back, in exact integer arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from pdgw.base.durations import SECONDS_PER_MINUTE
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.datatypes import N2_100_PERCENT

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
