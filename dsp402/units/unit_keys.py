"""What a configuration and the overlay of a family say about the units of a drive; ``scaling`` makes its scaling of them.

Source: docs/devices.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from pdgw.dsp402.units.units import parse_unit


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


KEY_LINES: Mapping[str, str] = {
    "rated_speed_rpm": "rated_speed_rpm = 0  # 100 % of the speed in rpm of the motor",
    "velocity_unit": 'velocity_unit = "?"  # of 60FFh, such as "rpm", "0.1 rpm", "counts/s", "mm/s"',
    "ignored_unit_objects": 'ignored_unit_objects = ["?"]  # objects with wrong units, such as "60A9h"',
    "counts_per_revolution": "counts_per_revolution = 0  # position units in one revolution of the motor",
    "acceleration_unit": 'acceleration_unit = "?"  # of 6083h, such as "rpm/s"',
    "rated_acceleration_rpm_s": "rated_acceleration_rpm_s = 0  # 100 % of accelerations in rpm/s of the motor",
}
"""For each key that may be missing, the line to paste; its value is refused until it is replaced."""


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
