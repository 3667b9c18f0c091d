"""Length units: the worked examples of telegram 111, and exactness."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.motion.units import DriveUnits, LengthUnits
from pdgw.profidrive.datatypes import N2_100_PERCENT

DRIVE = DriveUnits(Fraction(4096), Fraction(2), Fraction(1, 10))
"""4096 units a revolution, 6094h = 1/2 (0.5 rpm a unit), 6083h in 10 rpm/s."""
UNITS = LengthUnits(10_000, 2000, 2000, DRIVE)


def test_worked_example_111_absolute_to_50000_lu_at_12000() -> None:
    assert UNITS.to_drive(50_000) == 20_480
    assert UNITS.velocity(12_000) == 2400, "1200 rpm"
    assert (UNITS.acceleration(0x4000), UNITS.deceleration(0x4000)) == (1200, 1200)
    assert UNITS.to_length(20_480) == 50_000


def test_worked_example_111_with_override_2000h() -> None:
    assert UNITS.velocity(12_000, 0x2000) == 1200


def test_a_speed_above_0_never_becomes_0_and_0_stays_0() -> None:
    assert (UNITS.velocity(1, 1), UNITS.velocity(-1, 1)) == (1, -1)
    assert (UNITS.velocity(0), UNITS.velocity(5, 0)) == (0, 0)
    assert UNITS.acceleration(0) == 1


@given(position=st.integers(-(1 << 31), (1 << 31) - 1), turn=st.integers(1, 100_000))
def test_positions_of_a_finer_drive_come_back_as_themselves(position: int, turn: int) -> None:
    units = LengthUnits(turn, 1, 1, DriveUnits(Fraction(turn + 1), Fraction(1), Fraction(1)))
    assert units.to_length(units.to_drive(position)) == position


@given(position=st.integers(-(1 << 31), (1 << 31) - 1))
def test_positions_are_rounded_to_the_nearest_and_alike_on_both_sides(position: int) -> None:
    exact = Fraction(position * 4096, 10_000)
    assert abs(UNITS.to_drive(position) - exact) <= Fraction(1, 2)
    assert UNITS.to_drive(-position) == -UNITS.to_drive(position)


@given(velocity=st.integers(0, (1 << 32) - 1), override=st.integers(0, 0x7FFF))
def test_the_override_is_exact(velocity: int, override: int) -> None:
    exact = Fraction(velocity * 1000, 10_000) * Fraction(override, N2_100_PERCENT) * 2
    assert abs(UNITS.velocity(velocity, override) - exact) <= 1


@pytest.mark.parametrize("place", range(6))
def test_a_scaling_that_is_not_above_0_is_refused_by_name(place: int) -> None:
    values = [Fraction(1)] * 6
    values[place] = Fraction(0)
    with pytest.raises(GatewayError, match="0 is not allowed, expected a value above 0"):
        LengthUnits(int(values[0]), int(values[1]), int(values[2]), DriveUnits(*values[3:]))
