"""The check of an encoder's speed against its position: what is a contradiction, and what a healthy encoder may do."""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.axis.supervision.encoder_speed import EncoderSpeedCheck

CYCLE = 10 * MS
STEPS = 4096
FULL = 50
"""100 %: 3000 rpm, in revolutions a second."""
Speed = Callable[[float], float]
"""Revolutions a second at a time in seconds."""


class Encoder:
    """Turns at a speed that depends on time, and shows a mean speed.

    ``gate_s``: time of the mean, which ends with it if ``block``; ``late_s``: age of the position; ``every``: cycles between two
    positions; ``noise``: largest error of a position, in steps.
    """

    def __init__(
        self,
        steps: int = STEPS,
        turns: int = 4096,
        gate_s: float = 0.0,
        late_s: float = 0.0,
        every: int = 1,
        noise: int = 0,
        *,
        block: bool = False,
    ) -> None:
        self.steps, self.span = steps, steps * turns
        self.gate, self.late = max(1, round(gate_s * SECOND / CYCLE)), round(late_s * SECOND / CYCLE)
        self.every, self.noise, self.block = every, noise, block
        self.check = EncoderSpeedCheck()
        self.check.set_scaling(1.0, FULL * steps, self.span)
        self.now = SECOND
        self.offset = 0
        self.cycles = 0
        self.way = [0.25 * steps] * (self.gate + self.late + 2)
        """The true positions, one for each cycle."""
        self._shown = 0.0
        self._chance = Random(1)

    def run(self, seconds: float, speed: Speed, shown: Callable[[float], float] = lambda right: right) -> float | None:
        """Turn; the time until a contradiction is reported, None without one. ``shown``: from the right speed in steps/s."""
        begun, position, position_ns, reported = self.now, 0, 0, 0.0
        while self.now < begun + seconds * SECOND:
            at = (self.now - begun) / SECOND
            self.now += CYCLE
            self.cycles += 1
            self.way.append(self.way[-1] + speed(at) * self.steps * CYCLE / SECOND)
            if not self.block or self.cycles % self.gate == 0:
                self._shown = (self.way[-1] - self.way[-1 - self.gate]) / (self.gate * CYCLE) * SECOND
            if self.cycles % self.every == 0:
                error = self._chance.randint(-self.noise, self.noise)
                position = (math.floor(self.way[-1 - self.late]) + error + self.offset) % self.span
                position_ns = self.now
                reported = shown(self._shown)
            if position_ns and self.check.step(int(reported), position, position_ns, self.now):
                return at
        return None


@pytest.mark.parametrize(
    ("factor", "rpm"),
    [
        *((factor, rpm) for factor in (0, 0.0146, 0.146, 1.3, 2, 6.8) for rpm in (60, -150, 400)),
        *((factor, rpm) for factor in (0.5, 0.75) for rpm in (-150, 400)),
    ],
)
def test_speed_in_another_unit_or_frozen_is_found_within_six_seconds(factor: float, rpm: float) -> None:
    encoder = Encoder()
    found = encoder.run(10, lambda _: rpm / 60, lambda right: right * factor)
    assert found is not None
    assert found < 6.2
    assert encoder.check.deviates


@pytest.mark.parametrize("factor", [0.85, 1, 1.2])
def test_speed_within_the_tolerance_is_right(factor: float) -> None:
    assert Encoder().run(10, lambda _: 5, lambda right: right * factor) is None


def test_speed_that_stays_at_an_old_value_is_found_in_uneven_motion() -> None:
    """The shaft never stops, and its speed varies."""
    found = Encoder().run(20, lambda at: 5 + 3 * math.sin(at), lambda _: 300)
    assert found is not None


def test_text_has_both_speeds() -> None:
    encoder = Encoder()
    texts = []
    for cycle in range(700):
        now = SECOND + cycle * CYCLE
        texts.append(encoder.check.step(60, round(STEPS * cycle / 100) % encoder.span, now, now))
    (text,) = filter(None, texts)
    assert text == "the position moves at 4096 steps/s, 6030h reports 60"


def test_contradiction_is_reported_once_and_ends_when_both_agree_in_even_motion() -> None:
    encoder = Encoder()
    assert encoder.run(10, lambda _: 5, lambda _: 0) is not None
    assert encoder.run(10, lambda _: 5, lambda _: 0) is None
    assert encoder.run(10, lambda _: 0) is None
    assert encoder.check.deviates, "at standstill, both are 0"
    assert encoder.run(10, lambda _: 5) is None
    assert not encoder.check.deviates
    assert encoder.run(10, lambda _: 5, lambda _: 0) is not None


def test_speed_that_stays_at_a_value_does_not_agree_in_uneven_motion() -> None:
    encoder = Encoder()
    assert encoder.run(10, lambda _: 1, lambda _: 5 * STEPS) is not None
    assert encoder.run(20, lambda at: 5 + 3 * math.sin(at), lambda _: 5 * STEPS) is None
    assert encoder.check.deviates


def swings(period: float, speed: float = 10) -> Speed:
    return lambda at: speed * math.sin(2 * math.pi * at / period)


def reverses(period: float, speed: float = 10) -> Speed:
    return lambda at: speed if at % period < period / 2 else -speed


def stops(period: float, share: float = 0.5, speed: float = 10) -> Speed:
    return lambda at: speed if at % period > period * (1 - share) else 0


MOTIONS: dict[str, Speed] = {
    "standstill": lambda _: 0,
    "even": lambda _: 10,
    "slow": lambda _: 0.4,
    "starts": lambda at: 0 if at < 6 else 20,
    "slows down": lambda at: 20 if at < 6 else 0.6,
    "accelerates": lambda at: 3 * at,
    "sawtooth of 8 s": lambda at: 20 * (at % 8) / 8,
    "jumps each 3 s": lambda at: 2 if at % 6 < 3 else 20,
    "indexes each second": stops(1, 0.25),
    "indexes a little more than each second": stops(1.02, 0.25),
    "stops each 4 s": stops(8),
    "reverses 5 times a second": reverses(0.4),
    "reverses each second": reverses(2),
    "reverses each 6 s": reverses(12),
    "swings each second": swings(1),
    "swings a little more than each second": swings(1.03),
    "swings each 7 s": swings(7),
    "swings in motion": lambda at: 10 + 9 * math.sin(5 * at),
}
HABITS: dict[str, dict[str, float]] = {
    "none": {},
    "gate of 0.1 s": {"gate_s": 0.1},
    "gate of 1 s": {"gate_s": 1},
    "gate of 2 s, value changes at its end": {"gate_s": 2, "block": True},
    "gate of 3 s": {"gate_s": 3},
    "position 0.2 s old": {"late_s": 0.2},
    "position 1 s old": {"late_s": 1},
    "position 1 s old, gate of 1 s": {"late_s": 1, "gate_s": 1, "block": True},
    "16 steps": {"steps": 16},
    "100 steps, gate of 0.5 s": {"steps": 100, "gate_s": 0.5, "block": True},
    "single turn": {"turns": 1},
    "position each 50 ms": {"every": 5},
    "position each 100 ms": {"every": 10},
    "position each 512 ms": {"every": 51},
    "noise of 3 steps": {"noise": 3},
    "noise at 16 steps": {"noise": 2, "steps": 16},
}


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("habit", HABITS)
def test_healthy_encoder_has_no_contradiction(habit: str, motion: str) -> None:
    encoder = Encoder(**HABITS[habit])  # type: ignore[arg-type]
    assert encoder.run(25, MOTIONS[motion]) is None


SHOWN: dict[str, Callable[[float], float]] = {
    "without a sign": abs,
    "with the other sign": lambda right: -right,
    "in steps of 1 rpm": lambda right: math.trunc(right / STEPS * 60) * STEPS / 60,
    "0 below 1 % of the reference speed": lambda right: right if abs(right) > 0.01 * FULL * STEPS else 0,
}


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("shown", SHOWN)
def test_speed_may_be_shown(shown: str, motion: str) -> None:
    assert Encoder().run(25, MOTIONS[motion], SHOWN[shown]) is None


@pytest.mark.parametrize("phase", [0, 1.5, 3, 4.5])
def test_motion_between_two_positions_is_not_compared(phase: float) -> None:
    """A position each 200 ms, in the rhythm of the motion: each speed is that of the same moment of it."""
    assert Encoder(every=20).run(25, lambda at: 10 + 9 * math.sin(2 * math.pi * 5 * at + phase)) is None


def test_presets_and_jumps_of_the_position_are_not_motion() -> None:
    encoder, chance = Encoder(), Random(1)
    for _ in range(20):
        assert encoder.run(1.3, lambda _: 2) is None
        encoder.offset = chance.randrange(encoder.span)


def test_vibration_at_standstill_is_not_motion() -> None:
    """Aliases of a vibration look like a slow motion."""
    assert (
        Encoder().run(60, lambda at: 2 * math.pi * 9.97 * 0.1 * math.cos(2 * math.pi * 9.97 * at), lambda _: 0) is None
    )


def test_motion_before_a_restart_does_not_count() -> None:
    encoder = Encoder()
    for _ in range(10):
        assert encoder.run(4, lambda _: 5, lambda _: 0) is None
        encoder.check.restart()
    encoder.check.set_scaling(1.0, FULL * STEPS, encoder.span)
    assert encoder.run(4, lambda _: 5, lambda _: 0) is None


def test_new_references_end_a_contradiction() -> None:
    encoder = Encoder()
    assert encoder.run(10, lambda _: 5, lambda _: 0) is not None
    encoder.check.set_scaling(1.0, FULL * STEPS, encoder.span)
    assert not encoder.check.deviates


def test_unit_of_a_linear_encoder_counts() -> None:
    """One step of the speed is ten of the position."""
    encoder = Encoder()
    encoder.check.set_scaling(10.0, FULL * STEPS, encoder.span)
    assert encoder.run(10, lambda _: 5, lambda right: right / 10) is None
    assert encoder.run(10, lambda _: 5) is not None
