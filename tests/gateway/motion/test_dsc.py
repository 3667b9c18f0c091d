"""DSC in both forms: the worked example, the clamped gain, the start near the axis, missing frames."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import e, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.motion.dsc_setpoint import (
    Dsc,
    DscChoices,
    DscForm,
    DscSettings,
    dead_time_ns,
    highest_gain,
    longest_hold_ns,
)
from pdgw.gateway.motion.modulo import difference

BY_SPEED = DscChoices(DscForm.SPEED, following_window=4096, delay_cycles=0)
SPEED = DscSettings(BY_SPEED, 4096, Fraction(3000), Fraction(2), 2 * MS)
POSITION = replace(SPEED, choices=replace(BY_SPEED, form=DscForm.POSITION))


def chosen(settings: DscSettings, **changes: int) -> DscSettings:
    return replace(settings, choices=replace(settings.choices, **changes))  # type: ignore[arg-type]


def test_worked_example_105_speed() -> None:
    """KPC 50 1/s, XERR 2048 of 4096 increments: 25 revolutions a second."""
    result = Dsc(SPEED).step(0, 0x0800, 50_000, 1_000_000)
    assert (result.velocity, result.position) == (3000, None)


def test_kpc_0_is_dsc_off_and_the_speed_is_nsoll_b() -> None:
    for settings in (SPEED, POSITION):
        result = Dsc(settings).step(1 << 28, 1 << 30, 0, 0)
        assert (result.velocity, result.position, result.active) == (1500, None, False), "25 % of 3000 rpm in 0.5 rpm"


def test_the_speed_counts_what_the_axis_moved_since_the_position_the_plc_used() -> None:
    dsc = Dsc(chosen(SPEED, delay_cycles=1))
    dsc.step(0, 0, 50_000, 1000)
    assert dsc.step(0, 2048, 50_000, 3048).velocity == 0, "the axis is there already"


def test_the_speed_counts_what_the_axis_moved_across_the_wrap_of_the_drive() -> None:
    dsc = Dsc(replace(chosen(SPEED, delay_cycles=1), position_span=4096))
    dsc.step(0, 0, 50_000, 4000)
    assert dsc.step(0, 100, 50_000, 4).velocity == 0, "100 increments, over the end at 4095"


def test_the_gain_is_clamped_where_it_does_not_overshoot() -> None:
    dsc = Dsc(SPEED)
    assert dsc.dead_time_ns == 5 * MS
    assert dsc.gain_limit // 1000 == 73
    at_limit = dsc.step(0, 2048, dsc.gain_limit, 0)
    assert not at_limit.gain_clamped
    velocity = at_limit.velocity
    beyond = dsc.step(0, 2048, 10 * dsc.gain_limit, 0)
    assert (beyond.velocity, beyond.gain_clamped) == (velocity, True)


@given(period=st.integers(250_000, 100 * MS))
def test_the_highest_gain_is_1_over_e_times_the_dead_time_and_below_oscillation(period: int) -> None:
    dead_time = dead_time_ns(period)
    gain = highest_gain(dead_time) / 1000
    seconds = dead_time / 1e9
    assert gain <= 1 / (e * seconds) < gain + 0.0011
    assert gain < pi / (2 * seconds)


@given(period=st.integers(250_000, 100 * MS))
def test_a_setpoint_is_held_no_longer_than_the_loop_with_the_highest_gain_is_stable(period: int) -> None:
    dead_time = dead_time_ns(period)
    gain = 1 / (e * dead_time)
    oscillates_from = pi / (2 * (dead_time + longest_hold_ns(dead_time)))
    assert gain == pytest.approx(oscillates_from, rel=1e-5)


@pytest.mark.parametrize("settings", [SPEED, POSITION])
def test_dsc_that_starts_far_from_the_axis_waits_until_it_is_near(settings: DscSettings) -> None:
    dsc = Dsc(settings)
    result = dsc.step(1 << 28, 5000, 50_000, 0)
    assert (result.velocity, result.position, result.reason) == (0, None, Reason.DSC_FAR_FROM_AXIS)
    result = dsc.step(0, 4000, 50_000, 0)
    assert (result.active, result.reason) == (True, None)
    assert dsc.step(0, 9000, 50_000, 0).active, "the window is for the start"
    dsc.stop()
    assert not dsc.step(0, 9000, 50_000, 0).active


def test_position_is_the_one_the_plc_answers_plus_its_error() -> None:
    dsc = Dsc(chosen(POSITION, delay_cycles=2))
    for position in (0, 100, 200):
        result = dsc.step(1 << 27, 500, 1, position)
    assert (result.position, result.velocity) == (500, 750), "position of two cycles ago, NSOLL_B as feed-forward"


def test_a_missing_frame_keeps_the_speed_and_carries_the_position_on_by_one_cycle() -> None:
    speed = Dsc(SPEED)
    velocity = speed.step(0, 2048, 50_000, 0).velocity
    assert [speed.step(0, 0, 0, 9, fresh=False).velocity for _ in range(3)] == [velocity] * 3
    position = Dsc(POSITION)
    position.step(0, 100, 1, 0)
    position.step(0, 130, 1, 0)
    assert [position.step(0, 0, 0, 0, fresh=False).position for _ in range(3)] == [160, 160, 160]


def test_positions_count_round() -> None:
    top = (1 << 31) - 1
    assert difference(-(1 << 31), top) == 1
    assert Dsc(POSITION).step(0, 10, 1, top).position == -(1 << 31) + 9


@given(
    error=st.integers(-(1 << 20), 1 << 20),
    kpc=st.integers(1, 73_000),
    moved=st.integers(-4000, 4000),
    nsoll=st.integers(-(1 << 30), 1 << 30),
)
def test_the_speed_is_the_rule_to_the_nearest_unit(error: int, kpc: int, moved: int, nsoll: int) -> None:
    dsc = Dsc(chosen(SPEED, delay_cycles=1, following_window=1 << 30))
    dsc.step(0, 0, 1, 0)
    result = dsc.step(nsoll, error, kpc, moved)
    exact = Fraction(nsoll, 1 << 30) * 6000 + Fraction(kpc, 1000) * (error - moved) / 4096 * 60 * 2
    assert abs(result.velocity - exact) <= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"increments_per_revolution": 0}, "increments per revolution: 0"),
        ({"sync_period_ns": 0}, "SYNC period: 0"),
        ({"reference_speed": Fraction(0)}, "reference speed"),
    ],
)
def test_values_that_make_no_sense_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        replace(SPEED, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"following_window": 0}, "following_window: 0"),
        ({"delay_cycles": 9}, r"dsc_delay_cycles: 9 is not allowed, expected 0\.\.8"),
    ],
)
def test_choices_that_make_no_sense_are_refused(changes: dict[str, int], message: str) -> None:
    with pytest.raises(GatewayError, match=message):
        chosen(SPEED, **changes)


def follow(gain: int, clamped: bool, cycles: int = 1500) -> list[int]:
    """A step of 1000 increments closed over CAN: a velocity drive with two and a half periods of dead time; its errors."""
    dsc = Dsc(chosen(SPEED, following_window=1 << 30))
    if not clamped:
        dsc.gain_limit = 1 << 30
    position = 0.0
    pipeline = [0.0] * 3
    errors = []
    for _ in range(cycles):
        error = 1000 - int(position)
        errors.append(error)
        pipeline.append(dsc.step(0, error, gain, int(position)).velocity / 2 / 60 * 4096)
        position += pipeline.pop(0) * 0.002
    return errors


def test_the_clamped_loop_does_not_oscillate_where_the_unclamped_one_does() -> None:
    assert max(map(abs, follow(400_000, clamped=False)[-50:])) > 1000
    settled = follow(400_000, clamped=True)
    assert max(map(abs, settled[-50:])) <= 15
    assert min(settled) >= -80, "hardly any overshoot"
