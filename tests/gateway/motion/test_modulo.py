"""Modulo correction: the way to a position of a rotary axis, and a drive's position counted on across its ends."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.gateway.motion.units import Direction, Ring, way
from pdgw.gateway.reasons import Reason
from tests.support.axis.positioner import SETTINGS, PositionerRig

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
        inside = ring.target(other)
        turn = (count - low) // size
        assert (inside is not None) is ((other - low) // size == turn), "reached without an end between"
        assert inside in {None, low + (other - low) % size}


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
        while rig.speed or not rig.seen.reached or not rig.result.reached:
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
    rig.settle(20_000)
    assert (rig.seen.position, rig.position) == (3 * RANGE + 100, 100)


@pytest.mark.parametrize("target", [-1, RANGE])
def test_an_absolute_target_outside_the_range_is_refused(target: int) -> None:
    rig = PositionerRig(ROTARY)
    rig.step(mdi=True, absolute=True, target=target, velocity=3000, activate=True)
    assert rig.result.warning is Reason.TASK_TARGET_RANGE
    assert not rig.settle().reached or rig.seen.position == 0


def test_both_directions_are_refused() -> None:
    rig = PositionerRig(ROTARY)
    rig.step(mdi=True, absolute=True, target=10, velocity=3000, positive=True, negative=True, activate=True)
    assert rig.result.warning is Reason.TASK_DIRECTION
    assert not rig.starts


def test_the_direction_bits_mean_nothing_to_an_axis_without_a_range() -> None:
    rig = PositionerRig()
    rig.step(mdi=True, absolute=True, target=-900, velocity=3000, positive=True, negative=True, activate=True)
    rig.settle()
    assert rig.position == -900


def test_the_reference_point_is_the_coordinate_whatever_turn_it_is_in() -> None:
    rig = PositionerRig(replace(ROTARY, reference_coordinate=500))
    rig.step(mdi=True, absolute=False, target=RANGE + 7000, velocity=30_000, activate=True)
    rig.settle(20_000)
    rig.step(activate=False)
    rig.step(set_reference_point=True)
    assert rig.position == 500
    rig.step(set_reference_point=False, absolute=True, target=0, activate=True)
    rig.settle()
    assert (rig.position, rig.seen.position) == (0, RANGE + 6500)
