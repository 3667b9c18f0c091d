"""100 % in a drive's own units: where it is learned, and what is refused; units in the notation of users and of drives.

The drives of the property are computed forward, from a commanded value to the revolutions of the motor, as the profile describes
each factor; the scaling under test goes the other way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pdgw.dsp402.drive_type import Dsp402Error, Quantity
from pdgw.dsp402.units.mechanics import FamilyUnits, UnitKeys
from pdgw.dsp402.units.scaling import find_scaling
from pdgw.dsp402.units.units import Kind, dimension_unit, parse_unit, si_unit
from pdgw.profidrive.datatypes import N2_100_PERCENT, n2, n4

SPEED = Quantity.SPEED
INT32 = (-(1 << 31), (1 << 31) - 1)
RPM_3000 = {(0x6080, 0): 3000}
ENGEL = FamilyUnits(velocity="rpm", velocity_step=0x6094, acceleration="10 rpm/s")


def ratio(index: int, numerator: int, denominator: int = 1) -> dict[tuple[int, int], int]:
    return {(index, 1): numerator, (index, 2): denominator}


ENCODER = ratio(0x608F, 4096)


def fastest(units: int) -> dict[tuple[int, int], int]:
    """607Fh: the speed limit in the drive's units, which confirms what 608Fh, 6091h and 6092h make of them."""
    return {(0x607F, 0): units}


COUNTS = ENCODER | fastest(204_800)
"""A drive in increments per second."""


@pytest.mark.parametrize(
    ("answers", "keys", "value", "text"),
    [
        (COUNTS, {}, 204_800, "100 % = 3000 rpm = 60FFh 204800 (from 6080h, 608Fh: 4096 inc/rev)"),
        ({(0x60A9, 0): 0x00B4_4700}, {}, 3000, "60A9h = 00B44700h"),
        ({(0x60A9, 0): 0xFFB4_4700}, {}, 30_000, "60A9h = FFB44700h"),
        ({(0x60A9, 0): 0x00B5_0300} | COUNTS, {}, 204_800, "608Fh"),
        (ratio(0x6091, 10) | {(0x60A9, 0): 0x00B4_4700} | fastest(300), {}, 300, "6091h"),
        (ENCODER | ratio(0x6096, 60, 4096) | fastest(3000), {}, 3000, "6096h"),
        (ratio(0x6090, 8192) | ratio(0x6094, 1, 4), {}, 1_638_400, "6094h"),
        ({(0x608B, 0): 0, (0x608C, 0): 0xA4}, {}, 3000, "608Bh, 608Ch"),
        ({(0x608B, 0): 0xFD, (0x608C, 0): 0xA3}, {}, 50_000, "608Bh, 608Ch"),
        (
            {(0x60A8, 0): 0xFA01_0000, (0x60A9, 0): 0xFD01_0300} | ratio(0x6092, 5000) | fastest(250),
            {},
            250,
            "60A9h = FD010300h, 60A8h = FA010000h, 6092h",
        ),
        ({}, {"velocity_unit": "rpm"}, 3000, "velocity_unit = rpm"),
        (ENCODER, {"velocity_unit": "0.1 rpm"}, 30_000, "velocity_unit = 0.1 rpm"),
        ({}, {"velocity_unit": "counts/s", "counts_per_revolution": Fraction(2000)}, 100_000, "counts_per_revolution"),
        ({}, {"velocity_unit": "rpm", "gear": Fraction(5)}, 600, "gear"),
        (
            {},
            {"velocity_unit": "mm/s", "position_unit": "0.01 mm", "counts_per_revolution": Fraction(500)},
            250,
            "velocity_unit = mm/s",
        ),
        ({}, {"velocity_unit": "rpm", "rated_speed_rpm": Fraction(1500)}, 1500, "rated_speed_rpm"),
    ],
)
def test_sources_of_the_speed(answers: object, keys: dict[str, object], value: int, text: str) -> None:
    scaling = find_scaling({**RPM_3000, **answers}, UnitKeys(**keys))  # type: ignore[arg-type, dict-item]
    assert scaling.reference(SPEED) == value
    assert text in scaling.references[SPEED].source


NOTED_RPM = {(0x608B, 0): 0, (0x608C, 0): 0xA4}
SI_RPM = {(0x60A9, 0): 0x00B4_4700}
SI_TENTH = {(0x60A9, 0): 0xFFB4_4700}


@pytest.mark.parametrize(
    ("answers", "family", "one", "other"),
    [
        (NOTED_RPM | ratio(0x6090, 1 << 20), None, "608Bh, 608Ch", "17476.3 by 6090h"),
        (SI_RPM | {(0x608B, 0): 0xFF, (0x608C, 0): 0xA4}, None, "60A9h", "608Bh, 608Ch"),
        (SI_TENTH | ENCODER | ratio(0x6096, 60, 4096), None, "60A9h", "6096h"),
        (SI_RPM | ratio(0x6090, 8192) | ratio(0x6094, 1, 4), None, "60A9h", "6094h"),
        (SI_RPM, FamilyUnits(velocity="0.1 rpm"), "60A9h", "overlay: 0.1 rpm"),
        (SI_RPM | ratio(0x6094, 1, 2), ENGEL, "60A9h", "6094h: 1/2 rpm"),
    ],
)
def test_two_sources_that_differ_are_refused_with_both_sentences(
    answers: dict[tuple[int, int], int], family: FamilyUnits | None, one: str, other: str
) -> None:
    refusal = find_scaling(RPM_3000 | answers, None, family).refusal(SPEED)
    assert "sources differ: 1 rpm is 60FFh" in refusal
    assert refusal.index(one) < refusal.index(other)
    assert "set velocity_unit" in refusal
    for unit, reference in (("rpm", 3000), ("0.1 rpm", 30_000)):
        settled = find_scaling(RPM_3000 | answers, UnitKeys(velocity_unit=unit), family)
        if SPEED in settled.references:
            assert settled.reference(SPEED) == reference
            break
    else:
        pytest.fail("no velocity_unit defines it")


def test_sources_that_agree_are_one() -> None:
    answers = RPM_3000 | SI_RPM | NOTED_RPM | ENCODER | ratio(0x6096, 60, 4096)
    scaling = find_scaling(answers, UnitKeys(velocity_unit="rpm"), FamilyUnits(velocity="rpm"))
    assert scaling.reference(SPEED) == 3000


def test_configuration_against_all_sources_of_the_drive_is_rejected() -> None:
    keys = UnitKeys(velocity_unit="0.1 rpm")
    refusal = find_scaling(RPM_3000 | SI_RPM, keys).refusal(SPEED)
    assert "10 by velocity_unit = 0.1 rpm, and 1 by 60A9h" in refusal
    assert "set ignored_unit_objects" in refusal
    ignoring = replace(keys, ignored_unit_objects=frozenset({0x60A9}))
    assert find_scaling(RPM_3000 | SI_RPM, ignoring).reference(SPEED) == 30_000


def test_configuration_decides_between_sources_of_the_drive() -> None:
    answers = RPM_3000 | NOTED_RPM | ratio(0x6090, 1 << 20)
    assert find_scaling(answers, UnitKeys(velocity_unit="rpm")).reference(SPEED) == 3000
    assert SPEED in find_scaling(answers, UnitKeys(velocity_unit="0.1 rpm")).unknown


@pytest.mark.parametrize("index", [0x608F, 0x6090, 0x6091, 0x6092, 0x6093, 0x6094, 0x6096, 0x6097])
def test_ratio_of_one_gives_no_information(index: int) -> None:
    told = find_scaling(RPM_3000 | COUNTS | ratio(index, 1) if index != 0x608F else RPM_3000 | ratio(index, 1))
    if index == 0x608F:
        assert "set velocity_unit" in told.refusal(SPEED)
    else:
        assert told == find_scaling(RPM_3000 | COUNTS)


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        (None, "607Fh has no limit"),
        (0xFFFF_FFFF, "607Fh has no limit"),
        (3000, "607Fh 3000 may be in rpm"),
        (12_800_000, "607Fh 12800000 would be 187500 rpm"),
    ],
)
def test_unconfirmed_position_resolution_is_not_a_velocity_unit(limit: int | None, said: str) -> None:
    answers = RPM_3000 | ENCODER | ({} if limit is None else fastest(limit))
    refusal = find_scaling(answers).refusal(SPEED)
    assert said in refusal
    assert "set velocity_unit" in refusal


def test_position_resolution_in_a_configured_unit_needs_confirmation_too() -> None:
    keys = UnitKeys(velocity_unit="counts/s")
    assert "set counts_per_revolution" in find_scaling(RPM_3000 | ENCODER, keys).refusal(SPEED)
    assert find_scaling(RPM_3000 | COUNTS, keys).reference(SPEED) == 204_800
    told = replace(keys, counts_per_revolution=Fraction(4096))
    assert find_scaling(RPM_3000 | ENCODER, told).reference(SPEED) == 204_800


def test_family_that_requires_the_unit_is_rejected_until_it_is_set() -> None:
    family = FamilyUnits(ask="it moves in mm/s")
    answers = RPM_3000 | COUNTS | SI_RPM
    assert "overlay: it moves in mm/s: set velocity_unit" in find_scaling(answers, None, family).refusal(SPEED)
    assert find_scaling(answers, UnitKeys(velocity_unit="0.1 rpm"), family).reference(SPEED) == 30_000


def test_an_overlay_says_which_objects_its_family_does_not_apply() -> None:
    answers = RPM_3000 | ENCODER | ratio(0x6096, 1)
    family = FamilyUnits(velocity="rpm", ignores=frozenset({0x608F, 0x6096}))
    assert find_scaling(answers, None, family).reference(SPEED) == 3000


def test_the_engel_factor_is_the_speed_of_one_unit() -> None:
    scaling = find_scaling(RPM_3000 | ratio(0x6094, 1, 2), None, ENGEL)
    assert scaling.reference(SPEED) == 6000
    assert scaling.references[SPEED].source == "100 % = 3000 rpm = 60FFh 6000 (from 6080h, 6094h: 1/2 rpm)"


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ({}, "neither an object of the drive nor an overlay defines the velocity unit: set velocity_unit"),
        (ratio(0x6094, 1, 2), "6094h alone does not define the unit"),
        ({(0x60A9, 0): 0x00AC_0300} | ENCODER, "60A9h = 00AC0300h is an unknown unit"),
        ({(0x608B, 0): 0, (0x608C, 0): 0x77}, "608Bh, 608Ch: 0, 77h is an unknown unit"),
        ({(0x60A9, 0): 0x00B5_0300}, "608Fh does not define the increments of a revolution"),
        ({(0x60A9, 0): 0xFD01_0300}, "no source defines the position units of a revolution"),
        ({(0x60A9, 0): 0xFD01_0300, (0x60A8, 0): 0xFD01_0000}, "no feed constant 6092h"),
    ],
)
def test_unknown_velocity_unit_is_rejected_with_the_key_to_set(answers: object, said: str) -> None:
    scaling = find_scaling({**RPM_3000, **answers})  # type: ignore[dict-item]
    refusal = scaling.refusal(SPEED)
    assert said in refusal
    assert "set velocity_unit" in refusal
    with pytest.raises(Dsp402Error):
        scaling.reference(SPEED)
    assert find_scaling({**RPM_3000, **answers}, UnitKeys(velocity_unit="rpm")).reference(SPEED) == 3000  # type: ignore[dict-item]


@pytest.mark.parametrize("speed", [None, 0, 0x7FFF_FFFF, 0xFFFF_FFFF])
def test_a_max_motor_speed_that_is_not_a_reference_is_refused_with_its_key(speed: int | None) -> None:
    answers = COUNTS if speed is None else COUNTS | {(0x6080, 0): speed}
    assert "set rated_speed_rpm" in find_scaling(answers).refusal(SPEED)
    assert find_scaling(answers, UnitKeys(rated_speed_rpm=Fraction(1200))).reference(SPEED) == 81_920


def test_velocity_mode_is_in_rpm_unless_a_factor_says_otherwise() -> None:
    answers = {(0x6046, 2): 1500}
    scaling = find_scaling(answers, vl=True)
    assert scaling.reference(SPEED) == 1500
    assert scaling.references[SPEED].source == "100 % = 1500 rpm = 6042h 1500 (from 6046h/2, 6042h is in rpm)"
    assert "604Ch is not 1" in find_scaling(RPM_3000 | ratio(0x604C, 1, 60), vl=True).refusal(SPEED)
    assert find_scaling(RPM_3000 | ratio(0x604C, 4, 4), vl=True).reference(SPEED) == 3000


def test_a_telegram_for_speed_needs_no_other_reference() -> None:
    scaling = find_scaling(RPM_3000 | COUNTS)
    assert scaling.refusal(SPEED) == ""
    assert "set rated_acceleration_rpm_s" in scaling.refusal(SPEED, Quantity.ACCELERATION)


def test_the_profile_velocity_is_limited_by_607fh() -> None:
    base = RPM_3000 | ratio(0x6090, 4096)
    assert find_scaling(base).reference(Quantity.PROFILE_VELOCITY) == 204_800
    assert find_scaling(base | {(0x607F, 0): 100_000}).reference(Quantity.PROFILE_VELOCITY) == 100_000
    assert find_scaling(base | {(0x607F, 0): 300_000}).reference(Quantity.PROFILE_VELOCITY) == 204_800
    assert find_scaling(base | {(0x607F, 0): 0xFFFF_FFFF}).reference(Quantity.PROFILE_VELOCITY) == 204_800
    assert "607Fh is 0" in find_scaling(base | {(0x607F, 0): 0}).refusal(Quantity.PROFILE_VELOCITY)


def test_accelerations_are_those_of_the_drives_limits_or_of_the_keys() -> None:
    limits = {(0x60C5, 0): 500, (0x60C6, 0): 400}
    scaling = find_scaling(limits)
    assert scaling.reference(Quantity.ACCELERATION) == 500
    assert scaling.reference(Quantity.DECELERATION) == 400
    assert find_scaling({(0x60C5, 0): 500}).reference(Quantity.DECELERATION) == 500
    keys = UnitKeys(rated_acceleration=Fraction(6000), acceleration_unit="10 rpm/s")
    assert find_scaling(limits, keys).reference(Quantity.ACCELERATION) == 600
    assert find_scaling({(0x60AA, 0): 0x00B4_0303}, replace(keys, acceleration_unit="")).reference(
        Quantity.DECELERATION
    ) == Fraction(100)
    by_factor = find_scaling(ENCODER | ratio(0x6097, 1, 4096), replace(keys, acceleration_unit=""))
    assert by_factor.reference(Quantity.ACCELERATION) == 100
    assert "set acceleration_unit" in find_scaling({}, UnitKeys(rated_acceleration=Fraction(1))).refusal(
        Quantity.ACCELERATION
    )
    assert "not usable as a reference" in find_scaling({(0x60C5, 0): 0xFFFF_FFFF}).refusal(Quantity.ACCELERATION)


@pytest.mark.parametrize("limits", [{}, ratio(0x607B, 0, 0), ratio(0x607B, *INT32)])
def test_without_a_range_limit_positions_pass_in_position_units(limits: dict[tuple[int, int], int]) -> None:
    scaling = find_scaling(limits)
    conversion = n4(scaling.reference(Quantity.POSITION), INT32)
    assert [conversion.to_value(wire) for wire in (-70_000, 1, 123_456_789)] == [-70_000, 1, 123_456_789]
    assert scaling.position_range is None
    assert not scaling.position_wraps


def test_a_range_wraps_and_software_limits_do_not() -> None:
    ranged = find_scaling(ratio(0x607B, 0, 3600))
    assert (ranged.position_range, ranged.position_wraps) == ((0, 3600), True)
    assert ranged.reference(Quantity.POSITION) == 3600
    software = find_scaling(ratio(0x607D, -500, 900))
    assert (software.position_range, software.position_wraps) == ((-500, 900), False)
    assert find_scaling(ratio(0x607B, -1000, 1000) | ratio(0x607D, -500, 2000)).position_range == (-500, 1000)
    assert not find_scaling(ratio(0x607B, -1000, 1000), range_is_limit=True).position_wraps
    assert find_scaling(ratio(0x607B, 0, 3600) | ratio(0x607D, 0, 0)).position_range == (0, 3600)


@pytest.mark.parametrize(
    ("answers", "is_limit", "said"),
    [
        ({}, None, "positions have no range (607Bh)"),
        (
            ratio(0x607B, 0, 3600),
            None,
            "positions wrap at 607Bh 0 to 3600, as CiA 402 says (not confirmed: range_is_limit of the family)",
        ),
        (ratio(0x607B, 0, 3600), False, "positions wrap at 607Bh 0 to 3600"),
        (ratio(0x607B, 0, 3600) | ratio(0x607D, *INT32), False, "positions wrap at 607Bh 0 to 3600"),
        (ratio(0x607B, 0, 3600), True, "positions end at 607Bh 0 to 3600"),
        (ratio(0x607D, -500, 900), None, "positions end at 607Dh -500 to 900"),
        (
            ratio(0x607B, -1000, 1000) | ratio(0x607D, -500, 2000),
            False,
            "positions end at 607Bh -1000 to 1000 and 607Dh -500 to 2000",
        ),
    ],
)
def test_range_of_positions_wraps_or_ends_where_its_objects_say(
    answers: dict[tuple[int, int], int], is_limit: bool | None, said: str
) -> None:
    scaling = find_scaling(answers, range_is_limit=is_limit)
    assert scaling.lines[-1] == scaling.range_text == said
    assert scaling.position_span == (3601 if "wrap" in said else 1 << 32), "also of a speed axis"


@pytest.mark.parametrize("limits", [(-500, 0), (5, 5), (900, 100)])
def test_invalid_range_is_rejected(limits: tuple[int, int]) -> None:
    assert "607Bh" in find_scaling(ratio(0x607B, *limits)).refusal(Quantity.POSITION)


# -- any factor group -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """Its answers, and how fast its motor turns (rpm) for a value of 60FFh, by the profile's own words."""

    answers: dict[tuple[int, int], int]
    turns: Callable[[int], float]
    by_position: bool = True
    """Its factors are used only with a velocity limit in its units (607Fh)."""


factors = st.integers(1, 1 << 20)
resolutions = st.integers(16, 1 << 23)


@st.composite
def drives(draw: st.DrawFn) -> Drive:
    shape = draw(st.sampled_from(["si", "feed", "factor", "encoder factor", "dimension", "position factor"]))
    resolution, revolutions = draw(resolutions), draw(st.integers(1, 8))
    motor, shaft = draw(st.integers(1, 1000)), draw(st.integers(1, 100))
    numerator, denominator = draw(factors), draw(factors)
    increments = resolution / revolutions
    encoder = ratio(0x608F, resolution, revolutions)
    if shape == "si":
        exponent = draw(st.integers(-6, 0))
        value = (exponent & 0xFF) << 24 | 0x00B4_4700
        return Drive(
            ratio(0x6091, motor, shaft) | {(0x60A9, 0): value},
            lambda v: v * 10.0**exponent * motor / shaft,
        )
    if shape == "feed":
        feed = draw(st.integers(2, 1 << 20))
        return Drive(
            encoder | ratio(0x6091, motor, shaft) | ratio(0x6092, feed, 1) | ratio(0x6096, numerator, denominator),
            lambda v: v * denominator / numerator / feed * motor / shaft * 60,
        )
    if shape == "factor":
        return Drive(
            encoder | ratio(0x6096, numerator, denominator),
            lambda v: v * denominator / numerator / increments * 60,
        )
    if shape == "encoder factor":
        return Drive(
            ratio(0x6090, resolution, revolutions) | ratio(0x6094, numerator, denominator),
            lambda v: v * numerator / denominator / increments * 60,
        )
    if shape == "position factor":
        assume(numerator != denominator)
        return Drive(
            encoder | ratio(0x6093, numerator, denominator),
            lambda v: v * numerator / denominator / increments * 60,
        )
    return Drive({(0x608B, 0): 0xFE, (0x608C, 0): 0xA4}, lambda v: v / 100, by_position=False)


@given(drives(), st.integers(100, 20_000), st.integers(-0x8000, 0x7FFF))
def test_the_reached_speed_is_the_commanded_one_for_any_factor_group(drive: Drive, rated: int, setpoint: int) -> None:
    limit = round(rated / drive.turns(1))
    assume(0 < limit < INT32[1] and abs(drive.turns(limit) / rated - 1) < 0.1)
    answers = drive.answers | {(0x6080, 0): rated}
    scaling = find_scaling(answers | {(0x607F, 0): limit})
    if drive.by_position and not 0.19 < limit / rated < 5.1:
        assert SPEED in scaling.references or "sources differ" in scaling.refusal(SPEED)
    assume(SPEED in scaling.references)
    reference = scaling.reference(SPEED)
    assume(2 * reference < INT32[1])
    value = n2(reference, INT32).to_value(setpoint)
    wanted = setpoint / N2_100_PERCENT * rated
    half_a_unit = abs(drive.turns(1)) / 2
    assert drive.turns(value) == pytest.approx(wanted, rel=1e-9, abs=half_a_unit * (1 + 1e-9))
    if reference >= 1000:
        assert abs(drive.turns(value) - wanted) <= rated / 1000


# -- notations of units -----------------------------------------------------------------------------------------------


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
