"""The chain from physical position to output, speed, cams and work area: properties and plain models."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.dsp406.kinds import AreaState, Chain, area_state, cam_active, cam_state, chain, speed_value

RANGE = 4096 * 16
PHYSICAL = st.integers(-(10**9), 10**9)
CHAINS = st.builds(Chain, st.booleans(), st.integers(1, 4096), st.integers(1, 4096), st.integers(1, 1 << 32))


@given(CHAINS, PHYSICAL, st.data())
def test_preset_then_read_gives_the_preset_and_the_offset_fits_6509h(
    chain: Chain, physical: int, data: st.DataObject
) -> None:
    preset = data.draw(st.integers(0, chain.total_range - 1))
    offset = chain.offset_for(physical, preset)
    assert chain.output(physical, offset) == preset
    assert -(1 << 31) <= offset < 1 << 31


@given(CHAINS, PHYSICAL, st.integers(0, 10**6), st.integers(-(1 << 31), (1 << 31) - 1))
def test_scaling_is_monotone_and_the_output_wraps_at_the_total_range(
    chain: Chain, physical: int, step: int, offset: int
) -> None:
    before, after = chain.scaled(physical), chain.scaled(physical + step)
    assert (before - after if chain.counterclockwise else after - before) >= 0
    assert 0 <= chain.output(physical, offset) < chain.total_range
    assert (chain.output(physical + step, offset) - chain.output(physical, offset) - (after - before)) % (
        chain.total_range
    ) == 0


@given(st.integers(1, 4096), st.integers(1, 4096), PHYSICAL)
def test_a_whole_turn_is_the_units_per_revolution_whatever_the_resolution(units: int, turns: int, turn: int) -> None:
    rotary = chain(
        counterclockwise=False,
        scaling=True,
        numerator=units,
        denominator=4096,
        wanted_range=1 << 32,
        steps=4096 * turns,
    )
    assert rotary.total_range == units * turns
    assert rotary.output(turn * 4096, 0) == turn * units % (units * turns)


def test_the_chain_of_the_parameters() -> None:
    unscaled = chain(
        counterclockwise=True, scaling=False, numerator=360, denominator=4096, wanted_range=3600, steps=RANGE
    )
    assert unscaled == Chain(True, 1, 1, RANGE)
    assert [unscaled.output(step, 0) for step in (0, 1, 2)] == [0, RANGE - 1, RANGE - 2]
    scaled = chain(
        counterclockwise=False, scaling=True, numerator=360, denominator=4096, wanted_range=3600, steps=RANGE
    )
    assert scaled.total_range == 3600
    assert [scaled.output(4096 * turn, 0) for turn in (1, 9, 10, 11)] == [360, 3240, 0, 360]
    assert scaled.output(-1, 0) == 3599
    assert scaled.output(2048, 0) == 180
    small = chain(counterclockwise=False, scaling=True, numerator=1, denominator=4096, wanted_range=9999, steps=4096)
    assert small.total_range == 1  # a range the hardware does not have is not reached


@pytest.mark.parametrize(("speed", "shown"), [(0.4, 0), (-1.6, -2), (40000.0, 32767), (-40000.0, -32768)])
def test_the_speed_object_saturates(speed: float, shown: int) -> None:
    assert speed_value(speed) == shown


@given(CHAINS, st.floats(-1e6, 1e6))
def test_the_speed_has_the_sign_of_the_growing_position(chain: Chain, speed: float) -> None:
    expected = speed * chain.numerator / chain.denominator
    assert chain.speed(speed) == (-expected if chain.counterclockwise else expected)


class PlainCam:
    """A cam as an engineer would draw it: the set of positions where it switches on, and where it then stays on."""

    def __init__(self, low: int, high: int, hysteresis: int, size: int) -> None:
        inside = {p for p in range(size) if (low <= p <= high if low <= high else not high < p < low)}
        self.on = inside
        self.stay = {(p + d) % size for p in inside for d in range(-hysteresis, hysteresis + 1)}
        self.active = False

    def at(self, position: int) -> bool:
        self.active = position in self.on or (self.active and position in self.stay)
        return self.active


_SMALL = st.integers(0, 39)


@given(_SMALL, _SMALL, st.integers(0, 50), st.lists(_SMALL, min_size=1, max_size=60))
def test_a_cam_is_the_plain_model_over_random_positions(
    low: int, high: int, hysteresis: int, positions: list[int]
) -> None:
    plain = PlainCam(low, high, hysteresis, 40)
    active = False
    for position in positions:
        active = cam_active(position, low, high, hysteresis, active, 40)
        assert active == plain.at(position), position


def test_hysteresis_acts_on_both_edges() -> None:
    way = [9, 10, 20, 23, 24, 23, 20, 10, 7, 6, 7, 10]
    active, seen = False, []
    for position in way:
        active = cam_active(position, 10, 20, 3, active, 1000)
        seen.append(active)
    assert seen == [False, True, True, True, False, False, True, True, True, False, False, True]


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255))
def test_polarity_inverts_and_disabled_cams_read_0(active: int, enable: int, polarity: int) -> None:
    state = cam_state(active, enable, polarity)
    for cam in range(8):
        bit = 1 << cam
        expected = bool(enable & bit) and bool(active & bit) != bool(polarity & bit)
        assert bool(state & bit) == expected


@pytest.mark.parametrize(
    ("position", "low", "high", "state"),
    [
        (9, 10, 20, AreaState.UNDERFLOW),
        (10, 10, 20, AreaState(0)),
        (20, 10, 20, AreaState(0)),
        (21, 10, 20, AreaState.OVERFLOW),
        (21, 20, 10, AreaState(0)),
        (9, 20, 10, AreaState(0)),
        (15, 20, 10, AreaState.OVERFLOW | AreaState.UNDERFLOW),
        (0, -5, 5, AreaState(0)),
    ],
)
def test_work_area(position: int, low: int, high: int, state: AreaState) -> None:
    assert area_state(position, low, high, out_of_range=False) == state
    assert area_state(position, low, high, out_of_range=True) == state | AreaState.OUT_OF_RANGE
