"""The check of speed against position and setpoint: what is a contradiction, and what is not."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from fractions import Fraction
from types import MappingProxyType

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import Quantity, Reference, Scaling
from pdgw.gateway.axis.supervision.growth import Growth
from pdgw.gateway.axis.supervision.torque_evidence import TorqueEvidence
from pdgw.gateway.axis.supervision.velocity_check import VelocityCheck
from pdgw.gateway.axis.values import Inputs, Outputs
from pdgw.gateway.base.fault_numbers import FaultNumber

CYCLE = 10 * MS
COUNTS = 4096
STOP_TIME = 10 * SECOND


def scaling(*, counts: int | None = COUNTS, wraps: tuple[int, int] | None = None, same_signs: bool = True) -> Scaling:
    """rpm, 3000 of them are 100 %."""
    return Scaling(
        MappingProxyType({Quantity.SPEED: Reference(Fraction(3000), "")}),
        counts_per_revolution=None if counts is None else Fraction(counts),
        velocity_per_rpm=Fraction(1),
        position_range=wraps,
        position_wraps=wraps is not None,
        same_signs=same_signs,
    )


def made_check() -> VelocityCheck:
    """Of a drive that shows no limit."""
    return VelocityCheck(STOP_TIME, TorqueEvidence(Inputs(DriveFeedback()), Outputs(0, None)))


class Axis:
    """Turns at a speed that depends on time; can show a wrong one."""

    def __init__(self, **options: object) -> None:
        self.check = made_check()
        self.check.set_drive(scaling(**options), 30)  # type: ignore[arg-type]
        self.now = SECOND
        self.turns = 0.0
        self.jump = 0

    def run(
        self,
        seconds: float,
        rpm: Callable[[float], float],
        *,
        target: Callable[[float], float] | None = None,
        shown: Callable[[float], float] | None = None,
        span: int = 1 << 32,
    ) -> tuple[FaultNumber, str, float] | None:
        begun = self.now
        while self.now < begun + seconds * SECOND:
            at = (self.now - begun) / SECOND
            self.now += CYCLE
            self.turns += rpm(at) * CYCLE / SECOND / 60
            position = (round(self.turns * COUNTS) + self.jump + span // 2) % span - span // 2
            wanted = (target or rpm)(at)
            velocity = round((shown or rpm)(at))
            if not self.check.is_due(True, velocity, self.now):
                continue
            speeds = None if wanted is None else (round(wanted), round(wanted))
            found = self.check.step(speeds, velocity, position, self.now, self.now)
            if found is not None:
                return *found, at
        return None


@pytest.mark.parametrize("rpm", [60, -120, 3000])
def test_matching_speed_is_not_a_contradiction(rpm: int) -> None:
    axis = Axis()
    assert axis.run(5, lambda at: rpm) is None


@pytest.mark.parametrize(
    ("factor", "number"),
    [
        (0.1, FaultNumber.VELOCITY),
        (0.19, FaultNumber.VELOCITY),
        (0.5, FaultNumber.VELOCITY_DEVIATES),
        (0.85, None),
        (1.2, None),
        (1.5, FaultNumber.VELOCITY_DEVIATES),
        (5.5, FaultNumber.VELOCITY),
        (17_476, FaultNumber.VELOCITY),
    ],
)
def test_contradiction_of_position_and_606ch_is_detected_within_a_second(
    factor: float, number: FaultNumber | None
) -> None:
    axis = Axis()
    found = axis.run(3, lambda at: 120 * factor, shown=lambda at: 120, target=lambda at: 120)
    if number is None:
        assert found is None
        return
    assert found is not None
    assert found[0] is number
    assert "6064h moves at" in found[1]
    assert "606Ch reports 120 rpm" in found[1]
    assert found[2] < 1


@pytest.mark.parametrize(
    ("turns", "shown", "found"), [(38, 30, False), (30, 41, False), (100, 65, True), (65, 100, True)]
)
def test_deviation_within_the_standstill_window_may_be_that_of_a_dither(turns: int, shown: int, found: bool) -> None:
    """Samples of a speed that have the period of the dither are all of one place of it."""
    deviation = Axis().run(3, lambda _: turns, target=lambda _: turns, shown=lambda _: shown)
    assert (deviation is not None and deviation[0] is FaultNumber.VELOCITY_DEVIATES) is found


def test_deviation_is_reported_once() -> None:
    axis = Axis()
    assert axis.run(2, lambda at: 180, shown=lambda at: 120, target=lambda at: 120) is not None
    assert axis.run(5, lambda at: 180, shown=lambda at: 120, target=lambda at: 120) is None


@pytest.mark.parametrize("rpm", [60, -1500])
def test_opposite_directions_of_position_and_606ch_are_a_contradiction(rpm: int) -> None:
    axis = Axis()
    found = axis.run(3, lambda at: -rpm, shown=lambda at: rpm, target=lambda at: rpm)
    assert found is not None
    assert found[0] is FaultNumber.VELOCITY
    assert found[1].endswith(f"606Ch reports {abs(rpm)} rpm: factor -1, opposite directions: check the polarity 607Eh")
    assert found[2] < 1


@pytest.mark.parametrize("factor", [1, 2])
def test_directions_are_not_compared_with_different_polarities(factor: int) -> None:
    axis = Axis(same_signs=False)
    found = axis.run(3, lambda at: -120 * factor, shown=lambda at: 120, target=lambda at: 120)
    assert (found and found[0]) is (None if factor == 1 else FaultNumber.VELOCITY_DEVIATES)


@pytest.mark.parametrize("late_ms", [0, 20, 100, 200])
@pytest.mark.parametrize("half_ms", [50, 100, 200, 300, 400, 500, 700, 1000])
@pytest.mark.parametrize("ramp_ms", [0, 10, 50])
def test_reversals_are_not_contradictions(late_ms: int, half_ms: int, ramp_ms: int) -> None:
    """To and fro, also with a position that arrives later than the speed."""

    def rpm(at: float) -> float:
        at, sign = at % (half_ms / 500), 1
        if at >= half_ms / 1000:
            at, sign = at - half_ms / 1000, -1
        return 1500 * sign * (1 if not ramp_ms else min(1.0, 2 * at * 1000 / ramp_ms - 1))

    axis = Axis()
    found = axis.run(5, lambda at: rpm(at - late_ms / 1000), shown=rpm)
    assert found is None


@pytest.mark.parametrize(("turns", "shown"), [(-29, 29), (-34, 25)])
def test_speed_in_the_standstill_window_has_no_direction(turns: int, shown: int) -> None:
    axis = Axis()
    assert axis.run(3, lambda at: turns, shown=lambda at: shown, target=lambda at: shown) is None


def test_606ch_above_150_percent_of_the_setpoint_is_a_contradiction() -> None:
    found = Axis(counts=None).run(3, lambda at: 250, target=lambda at: 120)
    assert found is not None
    assert found[0] is FaultNumber.VELOCITY
    assert "606Ch is 250 with a setpoint of 120, above 150 %" in found[1]


@pytest.mark.parametrize(("cycles", "found"), [(50, False), (51, True)])
def test_overspeed_is_an_overshoot_for_less_than_500_ms(cycles: int, found: bool) -> None:
    axis = Axis(counts=None)
    assert axis.run(1, lambda at: 120) is None
    overshoot = axis.run(cycles / 100, lambda at: 250, target=lambda at: 120)
    assert (overshoot is not None) is found
    assert axis.run(1, lambda at: 120) is None


@pytest.mark.parametrize(("steps", "found"), [(4, False), (5, True)])
def test_five_steps_of_growing_speed_are_a_contradiction(steps: int, found: bool) -> None:
    """Each step of 0.1 s is 2 % above the last one, below the limit of 150 %; then the speed stays."""
    axis = Axis(counts=None)
    grown = axis.run(2, lambda at: 1300 * 1.02 ** min(round(at * 100) // 10, steps), target=lambda at: 1000)
    assert (grown is not None) is found


@pytest.mark.parametrize("target", [0, 20, 150])
def test_runaway_is_found_at_any_setpoint_after_half_a_second(target: int) -> None:
    """0 to 3000 rpm in a second: wrong motor phases, or direction of the encoder."""
    found = Axis(counts=None).run(1, lambda at: at * 3000, target=lambda at: target)
    assert found is not None
    assert found[0] is FaultNumber.VELOCITY
    assert 0.5 <= found[2] <= 0.56


def test_growth_is_found_while_the_setpoint_changes_in_each_cycle() -> None:
    targets = itertools.cycle((1000, 990, 1010))
    found = Axis(counts=None).run(9, lambda at: 1000 * (1 + at / 4), target=lambda at: next(targets))
    assert found is not None
    assert "keeps growing" in found[1]


@pytest.mark.parametrize(
    ("target", "seconds"),
    [(-3000.0, 5.7), (-1500.0, 5.7), (500.0, 5.7), (40.0, 5.7)],
    ids=["other sign", "equal, other sign", "smaller", "just outside the window"],
)
def test_drive_that_keeps_its_speed_is_found_on_a_ramp_of_twice_the_stop_time(target: float, seconds: float) -> None:
    """From 150 % of the setpoint before: 2280 rpm become 1500 after 5.2 s, and 0.5 s are an overshoot."""
    axis = Axis(counts=None)
    assert axis.run(1, lambda at: 1500) is None
    found = axis.run(9, lambda at: 1500, target=lambda at: target)
    assert found is not None
    assert found[2] == pytest.approx(seconds, abs=0.02)


def test_alternating_setpoints_do_not_begin_the_time_again() -> None:
    axis = Axis(counts=None)
    assert axis.run(1, lambda at: 1500) is None
    found = axis.run(9, lambda at: 1500, target=lambda at: 500 if at % 0.2 < 0.1 else -500)
    assert found is not None


def test_a_speed_that_does_not_approach_its_setpoint_lags_and_is_late_until_it_follows() -> None:
    axis = Axis()

    def state(rpm: float, seconds: float) -> tuple[bool, bool]:
        assert axis.run(seconds, lambda at: rpm, target=lambda at: 1000) is None
        return axis.check.lags_since(axis.now) > 0, axis.check.is_late(axis.now)

    assert [state(1000, 1), state(800, 0.9), state(800, 1), state(800, 20), state(1000, 2)] == [
        *((False, False), (False, False), (True, False), (True, True), (False, False))
    ]


def test_a_speed_as_near_as_the_standstill_window_follows_a_slow_setpoint() -> None:
    axis = Axis()
    assert axis.run(3, lambda at: 45, target=lambda at: 20) is None
    assert not axis.check.lags_since(axis.now), "30 rpm count as standstill"


def test_load_that_swings_back_after_a_stop_is_accepted() -> None:
    axis = Axis()
    assert axis.run(1, lambda at: 1000) is None
    assert axis.run(2, lambda at: -800 if 0.1 < at < 1.5 else 800, target=lambda at: 0) is None


@pytest.mark.parametrize(("speed", "setpoint"), [(2000, 100), (-2000, -200)])
def test_the_setpoint_of_the_direction_is_named(speed: int, setpoint: int) -> None:
    check, now = made_check(), SECOND
    check.set_drive(scaling(), 30)
    found = None
    while found is None:
        now += 2 * CYCLE
        assert check.is_due(True, speed, now)
        found = check.step((-200, 100), speed if now > 2 * SECOND else 0, 0, 0, now)
    assert found[1] == f"606Ch is {speed} with a setpoint of {setpoint}, above 150 %"


def test_answer_to_a_setpoint_of_the_last_step_does_not_count() -> None:
    growth = Growth(100 * MS)
    growth.restart(1000, 0)
    found = [growth.step(1000 + 20 * step, 2000 if step == 1 else 500, step * 100 * MS) for step in range(1, 9)]
    assert found == [False] * 7 + [True]


def test_growing_speed_at_a_constant_setpoint_is_a_contradiction() -> None:
    found = Axis(counts=None).run(9, lambda at: 1000 * (1 + at / 4), target=lambda at: 1000)
    assert found is not None
    assert "keeps growing with a setpoint of 1000" in found[1]


@pytest.mark.parametrize(
    ("rpm", "target"),
    [
        (lambda at: 3000 - min(at, 9) * 300, lambda at: 300.0),  # the drive's own slow ramp
        (lambda at: 120 * (1.9 if 0.2 < at < 0.5 else 1), lambda at: 120.0),  # overshoot
        (lambda at: min(at * 100, 3000), lambda at: 3000.0),
        (lambda at: 0.0, lambda at: 3000.0),  # blocked
        (lambda at: 25.0, lambda at: 0.0),  # dragged inside the standstill window
        (lambda at: 60.0 if at % 1 < 0.3 else 0.0, lambda at: 0.0),  # swings
        (lambda at: 20.0 * (-1) ** round(at * 100), lambda at: 0.0),  # noise
    ],
)
def test_ramps_overshoot_and_load_are_not_contradictions(
    rpm: Callable[[float], float], target: Callable[[float], float]
) -> None:
    axis = Axis()
    assert axis.run(1, lambda at: rpm(0), target=lambda at: rpm(0)) is None
    assert axis.run(12, rpm, target=target) is None


def test_position_jump_is_not_a_speed() -> None:
    axis = Axis()
    assert axis.run(1, lambda at: 300) is None
    axis.jump = 1_000_000
    assert axis.run(3, lambda at: 300) is None


def test_position_overflow_is_followed() -> None:
    axis = Axis(wraps=(-2048, 2048))
    assert axis.run(5, lambda at: 120, span=4096) is None
    fast = Axis(wraps=(-2048, 2048))
    assert fast.run(5, lambda at: min(at, 3) * 1000, span=4096) is None
    counter = Axis()
    counter.turns = (2**31 - 5000) / COUNTS
    assert counter.run(5, lambda at: 300) is None


def test_without_counts_or_position_nothing_is_compared() -> None:
    assert Axis(counts=None).run(3, lambda at: 1200, shown=lambda at: 120, target=lambda at: 120) is None
    check = made_check()
    check.set_drive(scaling(), 30)
    assert all(check.step((120, 120), 120, 0, 0, SECOND + cycle * CYCLE) is None for cycle in range(500))


def test_check_restarts_with_each_operation() -> None:
    axis = Axis()
    for _ in range(20):
        assert axis.run(0.3, lambda at: 1200, shown=lambda at: 120, target=lambda at: 120) is None
        assert not axis.check.is_due(False, 0, axis.now)


def test_a_speed_from_before_the_operation_does_not_count() -> None:
    """Read by SDO: a flying shaft was still slow when it was requested, and gets 7130 ms for its ramp to 0."""
    check, begun = made_check(), SECOND
    check.set_drive(scaling(), 30)
    for now in range(begun, begun + 3 * SECOND, CYCLE):
        asked = begun - 80 * MS + (now - begun) // (100 * MS) * 100 * MS
        speed = 140 if asked < begun else 300 - 42 * (asked - begun) // (100 * MS)
        if check.is_due(True, max(speed, 0), now):
            assert check.step((0, 0), max(speed, 0), 0, 0, asked) is None


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_jerky_motion_whose_period_equals_the_comparison_is_not_a_contradiction(resting: int) -> None:
    """DSC with few position updates jumps and rests, in the rhythm in which speeds are compared."""
    check = made_check()
    check.set_drive(scaling(), 30)
    position, now, speed, found = 0.0, SECOND, 0, []
    for cycle in range(1000):
        now += 4 * MS
        position += speed / 60 * COUNTS * 0.004
        if check.is_due(True, speed, now):
            found.append(check.step(None, speed, round(position), now, now))
        speed = 0 if cycle % 3 == resting else 1500
    assert not any(found)


def test_speed_that_jumps_between_samples_is_not_compared() -> None:
    """Position control over a slow link: each cycle jumps to its position and shows the speed of an arbitrary moment."""
    axis = Axis()
    shown = itertools.cycle((6000, 0, -6000, 15, 2000))
    assert axis.run(5, lambda at: 20, shown=lambda at: next(shown)) is None


def test_wrong_speed_is_found_once_jumping_ends() -> None:
    axis = Axis()
    shown = itertools.cycle((6000, 0, -6000, 15, 2000))
    assert axis.run(1, lambda at: 20, shown=lambda at: next(shown)) is None
    found = axis.run(1, lambda at: 20, shown=lambda at: 300)
    assert found is not None
    assert found[0] is FaultNumber.VELOCITY
