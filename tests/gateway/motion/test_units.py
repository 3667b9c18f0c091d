"""Length units with the worked examples of telegram 111, modulo correction, MOMRED and MELDW."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.dsp402.drive.images import DEMAND_UNKNOWN
from pdgw.gateway.axis.executors.message_words import MessageWord, reduced_torque
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.modulo import Direction, Ring, way
from pdgw.gateway.motion.requests import Seen
from pdgw.gateway.motion.units import DriveUnits, LengthUnits
from pdgw.profidrive.datatypes import N2_100_PERCENT
from pdgw.profidrive.signals import signal
from tests.support.axis.positioner import SETTINGS, PositionerRig

# -- length units -------------------------------------------------------------------------------------------------


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


# -- modulo correction: the way to a position, and a position counted on across its ends --------------------------


RANGE = 36_000
ROTARY = replace(SETTINGS, modulo=RANGE, software_limits=None, waiting_setpoints=False)
positions = st.integers(-(10**7), 10**7)
targets = st.integers(0, RANGE - 1)


@given(positions, targets, st.sampled_from(Direction), st.integers(0, 50))
def test_every_way_ends_at_the_target_in_its_direction_within_a_turn(
    start: int, target: int, direction: Direction, window: int
) -> None:
    distance = way(start, target, RANGE, direction, window)
    assert (start + distance) % RANGE == target
    assert abs(distance) < RANGE
    if abs(distance) > window and direction is not Direction.SHORTEST:
        assert (distance > 0) is (direction is Direction.POSITIVE)
    if direction is Direction.SHORTEST:
        assert 2 * abs(distance) <= RANGE


@pytest.mark.parametrize(
    ("start", "target", "direction", "expected"),
    [
        (35_000, 1000, Direction.SHORTEST, 2000),
        (1000, 35_000, Direction.SHORTEST, -2000),
        (1000, 35_000, Direction.POSITIVE, 34_000),
        (35_000, 1000, Direction.NEGATIVE, -34_000),
        (72_001, 0, Direction.POSITIVE, -1),
        (0, 18_000, Direction.SHORTEST, 18_000),
    ],
)
def test_ways_over_the_end_of_the_range(start: int, target: int, direction: Direction, expected: int) -> None:
    assert way(start, target, RANGE, direction, window=5) == expected


@given(st.integers(-1000, 1000), st.integers(2, 5000), st.lists(st.integers(-2499, 2499), max_size=40), st.data())
def test_a_ring_counts_on_over_its_ends(low: int, size: int, steps: list[int], data: st.DataObject) -> None:
    ring, count = Ring(low, size), low
    assert ring.follow(count) == count
    for step in steps:
        count += step % max(1, size // 2) if step >= 0 else -(-step % max(1, size // 2))
        shown = low + (count - low) % size
        assert ring.follow(shown) == count
        assert ring.near(shown) == count
        other = count + data.draw(st.integers(-2 * size, 2 * size))
        first, last = ring.turn
        same = (other - low) // size == (count - low) // size
        assert (first <= other <= last) is same, "reached without an end between"
        assert ring.shown(other) == low + (other - low) % size
        assert not same or other - ring.base == ring.shown(other)


@given(st.lists(st.tuples(targets, st.sampled_from([(False, False), (True, False), (False, True)])), max_size=5))
def test_tasks_end_at_their_target_and_what_is_shown_is_always_in_range(
    tasks: list[tuple[int, tuple[bool, bool]]],
) -> None:
    rig = PositionerRig(ROTARY)
    for target, (positive, negative) in tasks:
        begin = rig.seen.position
        rig.step(
            mdi=True, absolute=True, target=target, velocity=30_000, positive=positive, negative=negative, activate=True
        )
        rig.step(2, activate=False)
        while rig.speed or not rig.seen.bits & Seen.REACHED or not rig.result.reached:
            rig.step()
            assert 0 <= rig.position < RANGE
            assert abs(rig.seen.position - begin) <= RANGE
        assert rig.position == target
        moved = rig.seen.position - begin
        if abs(moved) > ROTARY.position_window and positive is not negative:
            assert (moved > 0) is positive


def test_a_relative_task_goes_several_turns() -> None:
    rig = PositionerRig(ROTARY)
    rig.step(mdi=True, absolute=False, target=3 * RANGE + 100, velocity=30_000, activate=True)
    rig.run_out(20_000)
    assert (rig.seen.position, rig.position) == (3 * RANGE + 100, 100)


@pytest.mark.parametrize("target", [-1, RANGE])
def test_an_absolute_target_outside_the_range_is_refused(target: int) -> None:
    rig = PositionerRig(ROTARY)
    rig.step(mdi=True, absolute=True, target=target, velocity=3000, activate=True)
    assert rig.result.warning is Reason.TASK_TARGET_RANGE
    assert not rig.run_out().reached or rig.seen.position == 0


def test_both_directions_are_refused() -> None:
    rig = PositionerRig(ROTARY)
    rig.step(mdi=True, absolute=True, target=10, velocity=3000, positive=True, negative=True, activate=True)
    assert rig.result.warning is Reason.TASK_DIRECTION
    assert not rig.starts


def test_the_direction_bits_mean_nothing_to_an_axis_without_a_range() -> None:
    rig = PositionerRig()
    rig.step(mdi=True, absolute=True, target=-900, velocity=3000, positive=True, negative=True, activate=True)
    rig.run_out()
    assert rig.position == -900


def test_the_reference_point_is_the_coordinate_whatever_turn_it_is_in() -> None:
    rig = PositionerRig(replace(ROTARY, reference_coordinate=500))
    rig.step(mdi=True, absolute=False, target=RANGE + 7000, velocity=30_000, activate=True)
    rig.run_out(20_000)
    rig.step(activate=False)
    rig.step(set_reference_point=True)
    assert rig.position == 500
    rig.step(set_reference_point=False, absolute=True, target=0, activate=True)
    rig.run_out()
    assert (rig.position, rig.seen.position) == (0, RANGE + 6500)


# -- MOMRED and MELDW ---------------------------------------------------------------------------------------------


WORD = MessageWord(6000)


def names(velocity: int = 0, demand: int = 0, torque: int = 0, **flags: bool) -> set[str]:
    states = WORD.states(enabled=flags.pop("enabled", False), ready=flags.pop("ready", False))
    word = WORD.word(velocity, demand, torque, states, **{"target_reached": False} | flags)
    fields = signal("MELDW").bits
    assert not word & ~sum(field.mask for field in fields)
    return {field.name for field in fields if field.of(word)}


@pytest.mark.parametrize(
    ("momred", "limit"), [(0, 3000), (0x2000, 1500), (0x4000, 0), (0x7FFF, 0), (-1, 3000), (-0x8000, 3000)]
)
def test_worked_example_102_torque_reduction(momred: int, limit: int) -> None:
    assert reduced_torque(3000, momred) == limit


@given(base=st.integers(0, 0xFFFF), momred=st.integers(-0x8000, 0x7FFF))
def test_a_reduction_only_ever_reduces(base: int, momred: int) -> None:
    assert 0 <= reduced_torque(base, momred) <= base


BELOW = {"TORQUE_BELOW_THRESHOLD", "SPEED_BELOW_THRESHOLD_3", "SPEED_BELOW_THRESHOLD_2"}
COOL = {"NO_MOTOR_OVERTEMPERATURE", "NO_POWER_STAGE_OVERTEMPERATURE"}


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ({}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"}),
        ({"target_reached": True}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE", "RAMP_COMPLETED"}),
        ({"velocity": 61, "target_reached": True}, {*BELOW, *COOL}),
        ({"velocity": 299, "demand": 299}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"}),
        (
            {"velocity": -300, "demand": -300},
            {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"} - {"SPEED_BELOW_THRESHOLD_3"},
        ),
        ({"velocity": 1801, "demand": 1801}, {"TORQUE_BELOW_THRESHOLD", *COOL, "SPEED_WITHIN_TOLERANCE"}),
        ({"torque": -900}, {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE"} - {"TORQUE_BELOW_THRESHOLD"}),
        (
            {"enabled": True, "ready": True},
            {*BELOW, *COOL, "SPEED_WITHIN_TOLERANCE", "CONTROLLER_ENABLED", "PULSES_ENABLED", "DRIVE_READY"},
        ),
        ({"motor_hot": True}, {*BELOW, "NO_POWER_STAGE_OVERTEMPERATURE", "SPEED_WITHIN_TOLERANCE"}),
        ({"stage_hot": True}, {*BELOW, "NO_MOTOR_OVERTEMPERATURE", "SPEED_WITHIN_TOLERANCE"}),
    ],
)
def test_each_message_says_what_its_bit_means(values: dict[str, int], shown: set[str]) -> None:
    assert names(**values) == shown  # type: ignore[arg-type]


@pytest.mark.parametrize("velocity", [0, 1, -60, 3000])
def test_a_bit_made_from_a_missing_object_is_always_0(velocity: int) -> None:
    without_torque = MessageWord(6000, torque=False)
    assert not without_torque.word(velocity, velocity, 0, 0, target_reached=True) & MELDW["TORQUE_BELOW_THRESHOLD"]
    without_demand = WORD.word(velocity, DEMAND_UNKNOWN, 0, 0, target_reached=True)
    assert not without_demand & (MELDW["RAMP_COMPLETED"] | MELDW["SPEED_WITHIN_TOLERANCE"])


MELDW = {bit.name: bit.mask for bit in signal("MELDW").bits}
