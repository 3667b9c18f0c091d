"""Units in the notation of users and in the objects of drives."""

from __future__ import annotations

from fractions import Fraction

import pytest

from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.units.units import Kind, dimension_unit, parse_unit, si_unit


@pytest.mark.parametrize(
    ("text", "order", "factor", "kind"),
    [
        ("counts", 0, Fraction(1), Kind.POSITION),
        ("0.01 mm", 0, Fraction(1, 100_000), Kind.METRE),
        ("0.1 deg", 0, Fraction(1, 3600), Kind.TURN),
        ("1/4096 rev", 0, Fraction(1, 4096), Kind.TURN),
        ("rpm", 1, Fraction(1, 60), Kind.TURN),
        ("0.1rpm", 1, Fraction(1, 600), Kind.TURN),
        ("rps", 1, Fraction(1), Kind.TURN),
        ("counts/s", 1, Fraction(1), Kind.POSITION),
        ("10 counts/min", 1, Fraction(1, 6), Kind.POSITION),
        ("inc/s", 1, Fraction(1), Kind.INCREMENT),
        ("mm/s", 1, Fraction(1, 1000), Kind.METRE),
        ("10 rpm/s", 2, Fraction(1, 6), Kind.TURN),
        ("mm/s2", 2, Fraction(1, 1000), Kind.METRE),
        ("um/s²", 2, Fraction(1, 1_000_000), Kind.METRE),
    ],
)
def test_units_in_common_notations(text: str, order: int, factor: Fraction, kind: Kind) -> None:
    unit = parse_unit(text, order, "velocity_unit")
    assert (unit.factor, unit.kind, unit.order) == (factor, kind, order)


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("rpm", 0),
        ("rev", 1),
        ("rpm/s/s", 2),
        ("furlong/s", 1),
        ("0 rpm", 1),
        ("1/0 rpm", 1),
        ("-1 rpm", 1),
        ("", 1),
        ("rpm rpm", 1),
        ("counts/h", 1),
    ],
)
def test_invalid_unit_is_rejected_with_the_key_and_the_allowed_units(text: str, order: int) -> None:
    with pytest.raises(Dsp402Error, match=r"velocity_unit: .*counts"):
        parse_unit(text, order, "velocity_unit")


@pytest.mark.parametrize(
    ("value", "order", "factor", "kind"),
    [
        (0x00B4_4700, 1, Fraction(1, 60), Kind.TURN),  # rpm, the preset of several families
        (0xFFB4_4700, 1, Fraction(1, 600), Kind.TURN),
        (0xFDB4_4700, 1, Fraction(1, 60_000), Kind.TURN),
        (0x00B5_0300, 1, Fraction(1), Kind.INCREMENT),
        (0xFD01_0300, 1, Fraction(1, 1000), Kind.METRE),  # mm/s
        (0xFF41_0000, 0, Fraction(1, 3600), Kind.TURN),  # a tenth of a degree
        (0xFA01_0000, 0, Fraction(1, 1_000_000), Kind.METRE),
        (0x00B5_0000, 0, Fraction(1), Kind.INCREMENT),
        (0x00B4_4703, 2, Fraction(1, 60), Kind.TURN),  # rpm/s
        (0xFD01_0303, 2, Fraction(1, 1000), Kind.METRE),
    ],
)
def test_si_units_of_a_drive(value: int, order: int, factor: Fraction, kind: Kind) -> None:
    unit = si_unit(value, order)
    assert unit is not None
    assert (unit.factor, unit.kind) == (factor, kind)
    assert si_unit(value - (1 << 32), order) == unit, "read as a signed number"


@pytest.mark.parametrize("value", [0x0010_0300, 0x00AC_0300, 0x00C0_0300, 0x00B4_0000, 0x0000_0000, 0x7FB4_4700])
def test_inexact_units_are_not_used(value: int) -> None:
    assert si_unit(value, 1) is None


@pytest.mark.parametrize(
    ("notation", "dimension", "order", "factor"),
    [
        (0, 0xA4, 1, Fraction(1, 60)),
        (-3, 0xA6, 1, Fraction(1, 1000)),
        (-3, 0xA7, 1, Fraction(1, 60_000)),
        (-6, 0x01, 0, Fraction(1, 1_000_000)),
        (-3, 0xA9, 2, Fraction(1, 1000)),
    ],
)
def test_notation_and_dimension_index(notation: int, dimension: int, order: int, factor: Fraction) -> None:
    unit = dimension_unit(notation, dimension, order)
    assert unit is not None
    assert unit.factor == factor
    assert dimension_unit(notation, 0x77, order) is None
