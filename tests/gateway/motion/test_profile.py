"""The profile made cycle by cycle: never faster, never harder than asked, and exactly where it has to be."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pdgw.gateway.motion.profile import Profile, highest_speed, next_speed

SPEEDS = st.integers(1, 10**7)
RAMPS = st.integers(1, 10**6)


def check_step(before: int, after: int, speed: int, acceleration: int, deceleration: int) -> None:
    """The speeds of two cycles one after the other."""
    assert before * after >= 0, "through standstill"
    if abs(after) > abs(before):
        assert abs(after) - abs(before) <= acceleration
        assert abs(after) <= speed
    else:
        assert abs(before) - abs(after) <= deceleration


@given(way=st.integers(0, 10**12), deceleration=RAMPS)
def test_the_highest_speed_is_the_one_from_which_the_ramp_still_ends_at_the_target(way: int, deceleration: int) -> None:
    def braking(speed: int) -> int:
        cycles = speed // deceleration
        return (cycles + 1) * speed - deceleration * cycles * (cycles + 1) // 2

    speed = highest_speed(way, deceleration)
    assert braking(speed) <= way < braking(speed + 1)


@given(
    speed=SPEEDS,
    cruise=st.integers(-300, 300),
    rest=st.integers(0, 10**7),
    speeding_up=st.integers(1, 200),
    slowing_down=st.integers(1, 200),
)
def test_a_target_is_met_exactly_in_its_time_with_no_more_speed_and_acceleration_than_asked(
    speed: int, cruise: int, rest: int, speeding_up: int, slowing_down: int
) -> None:
    target = cruise * speed + rest % speed
    acceleration, deceleration = max(1, speed // speeding_up), max(1, speed // slowing_down)
    profile = Profile()
    # As long as the trapezoid takes, and a cycle for each of its corners.
    cycles = abs(target) // speed + speed // acceleration + speed // deceleration + 5
    for _ in range(cycles):
        before = profile.speed
        profile.toward(target, speed, acceleration, deceleration)
        check_step(before, profile.speed, speed, acceleration, deceleration)
        assert abs(profile.position) <= abs(target), "not beyond"
    assert (profile.position, profile.speed) == (target, 0)


@given(
    tasks=st.lists(
        st.tuples(st.integers(-(10**6), 10**6), st.integers(2000, 10**5), st.integers(1, 40)), min_size=1, max_size=6
    ),
    acceleration=st.integers(500, 10**4),
    deceleration=st.integers(500, 10**4),
)
def test_targets_that_change_at_any_moment_cause_no_step(
    tasks: list[tuple[int, int, int]], acceleration: int, deceleration: int
) -> None:
    profile = Profile()
    for target, speed, cycles in tasks:
        for _ in range(cycles):
            before = profile.speed
            profile.toward(target, speed, acceleration, deceleration)
            check_step(before, profile.speed, max(speed, abs(before)), acceleration, deceleration)
    target, speed, _ = tasks[-1]
    for _ in range(5000):
        profile.toward(target, speed, acceleration, deceleration)
        if profile.position == target and not profile.speed:
            break
    assert (profile.position, profile.speed) == (target, 0)


@given(speed=st.integers(-(10**7), 10**7), deceleration=st.integers(10**4, 10**8))
def test_a_stop_takes_its_ramp_and_not_a_cycle_more(speed: int, deceleration: int) -> None:
    profile = Profile()
    profile.speed = speed
    for _ in range(-(-abs(speed) // deceleration)):
        assert profile.speed
        profile.stop(deceleration)
    assert not profile.speed


@given(speed=SPEEDS, wanted=SPEEDS, acceleration=RAMPS, deceleration=RAMPS)
def test_both_directions_are_alike(speed: int, wanted: int, acceleration: int, deceleration: int) -> None:
    forward = next_speed(speed, wanted, acceleration, deceleration)
    assert next_speed(-speed, -wanted, acceleration, deceleration) == -forward
    assert next_speed(speed, -wanted, acceleration, deceleration) >= 0
