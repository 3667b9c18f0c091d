"""Calm days: short ones of each telegram, what is drawn, and what the rules find."""

from __future__ import annotations

import re
from collections.abc import Callable
from random import Random

import pytest

from pdgw.durations import SECOND
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from tests.long.rules import Rule
from tests.long.soak.__main__ import main
from tests.long.soak.calm import CALM_TELEGRAMS, LATENCY_MAX_MS, CalmRun, calm_shapes, draw_calm
from tests.long.soak.plan import parts
from tests.long.soak.planted import search
from tests.long.soak.watch import ViolationError


def calm_run(number: int, seed: int = 1) -> CalmRun:
    return CalmRun(next(parts(seed, 1, [number], draw_calm)))


@pytest.mark.parametrize("number", CALM_TELEGRAMS)
def test_short_calm_day_of_each_telegram_finds_nothing(number: int) -> None:
    run = calm_run(number, 7)
    while run.tasks < 2:
        run.play(run.loop.now() + 4 * SECOND)
    run.close()


@pytest.mark.planted
def test_calm_day_finds_a_value_that_is_never_trusted() -> None:
    found = search("a TPDO that shows every motion counts as not sent", 1)
    assert found.time_ns is not None
    assert found.time_ns < 60 * SECOND
    assert "but does not send it" in found.message


def _fault(run: CalmRun) -> None:
    run.axes[0].drive.do(lambda node: node.model.inject(2))


def _refusal(run: CalmRun) -> None:
    run.program.values["OVERRIDE"] = 0


def _lost(run: CalmRun) -> None:
    run.axes[0].drive.do(lambda node: node.restart())


@pytest.mark.parametrize(
    ("happens", "said"),
    [
        (_fault, f"{Rule.CALM.sentence}|{Rule.RUNS.sentence}"),
        (_refusal, f"{Rule.ALLOWED.sentence}.*OVERRIDE is 0: the task waits"),
        (_lost, f"{Rule.CALM.sentence}|{Rule.RUNS.sentence}"),
    ],
)
def test_whatever_is_not_calm_is_a_violation(happens: Callable[[CalmRun], None], said: str) -> None:
    run = calm_run(111)
    run.loop.call_at(2 * SECOND, lambda: happens(run))
    with pytest.raises(ViolationError, match=said):
        run.play(30 * SECOND)


@pytest.mark.parametrize(("number", "task", "end"), [(111, "relative", "at"), (1, "profile", "reached")])
def test_task_without_its_end_is_a_violation(number: int, task: str, end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = calm_run(number)
    monkeypatch.setattr(type(run.program), end, lambda *_: False)
    run.program.tasks = {task: run.program.tasks[task]}
    with pytest.raises(ViolationError, match=r"(target|rpm).* does not end: axis 1: drive in Operation Enabled"):
        run.play(60 * SECOND)


@pytest.mark.parametrize("number", CALM_TELEGRAMS)
def test_calm_parts_draw_every_healthy_shape_and_latencies_up_to_20_ms(number: int) -> None:
    plans = [draw_calm(Random(n), 1, [number]) for n in range(400)]
    assert {plan.direct for plan in plans} == {False, True}
    axes = [axis for plan in plans for axis in plan.axes]
    if number in ENCODER_TELEGRAM_NUMBERS:
        assert {plan.encoder for plan in plans} == {number}
        return
    assert {axis.shape for axis in axes} == set(calm_shapes(number))
    latencies = [latency for axis in axes for latency in (axis.latency.command_ms, axis.latency.status_ms)]
    assert (min(latencies), max(latencies)) == (0, LATENCY_MAX_MS)


def test_command_prints_the_table_of_calm_days(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--calm", "--hours", "0.001", "--telegrams", "1,83"]) == 0
    rows = re.findall(r"^\| (\d+) \| 0.001 \| \d+ \| 0 \| \d+ \| \d+ \|$", capsys.readouterr().out, re.MULTILINE)
    assert rows == ["1", "83"]
