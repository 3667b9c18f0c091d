"""Gateways with defects: the soak finds each, and its rules find what no gateway shows; calm days and what their rules find."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import State
from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.gateway.axis.supervision.stop_supervision import StopWatch
from pdgw.gateway.axis.telegrams import ENCODER_TELEGRAM_NUMBERS
from pdgw.gateway.axis.values import FaultRecord
from tests.conformance.rig import COMPLETE
from tests.long.rules import Rule
from tests.long.soak.__main__ import main
from tests.long.soak.calm import (
    CALM_TELEGRAMS,
    NEEDED_OBJECTS,
    UNFIT,
    CalmRun,
    calm_plan,
    calm_shapes,
    draw_calm,
    legal_habits,
)
from tests.long.soak.emcy_check import PendingEmcys
from tests.long.soak.plan import Part, parts
from tests.long.soak.planted import DEFECTS, LIMIT_NS, search
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.watch import SoakAxis, ViolationError
from tests.long.soak.words import Words

_PIECE_CYCLE_MS = 32
FOUND_SOON = {
    "an ON without an OFF before it starts the drive": f"{Rule.ON.sentence}|{Rule.RELEASED.sentence}",
}
"""What is found within seconds of virtual time, and by which rule; ``soak --planted`` searches for all."""


@pytest.mark.planted
@pytest.mark.parametrize("name", FOUND_SOON)
def test_soak_finds_planted_defect(name: str) -> None:
    found = search(name, 1)
    assert found.time_ns is not None
    assert found.time_ns < LIMIT_NS
    assert re.search(FOUND_SOON[name], found.message)


def test_document_has_each_of_sixteen_defects_found_within_two_hours() -> None:
    document = Path(__file__).with_name("planted-defects.md").read_text(encoding="utf-8")
    found = dict(re.findall(r"^\| (.+?) \| (\d+) s \| .+ \|$", document, re.MULTILINE))
    assert found.keys() == DEFECTS.keys(), "run: make long LONG=planted"
    assert len(found) == 16
    assert all(int(seconds) * SECOND < LIMIT_NS for seconds in found.values())


@pytest.mark.planted
def test_task_that_the_plc_did_not_give_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Words, "set_word", lambda self, word: self.values.update({self.name: word}))
    with pytest.raises(ViolationError, match=rf"{Rule.MOVES.sentence}: .* \d+ motions for 0 orders"):
        SoakRun(next(parts(1, 1, [9])), keep_telegrams=True).run_to(300 * SECOND)


def test_zsw1_that_shows_another_state_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SoakRun, "_shown", lambda self, axis: 0x0007)
    with pytest.raises(ViolationError, match=rf"({Rule.OPERATES.sentence}|{Rule.FAULT.sentence}): .*ZSW1 0007h"):
        SoakRun(next(parts(1, 1, [1])), keep_telegrams=True).run_to(300 * SECOND)


def asked_axis(word: int) -> SoakAxis:
    """An axis of telegram 1 with its drive at standstill, commanded to full speed with this STW1 for a long time."""
    soak_run = SoakRun(next(parts(7, 1, [1])), keep_telegrams=True)
    soak_run.run_to(SECOND)
    (axis,) = soak_run.axes
    axis.asked(SECOND, word.to_bytes(2, "big") + b"\x40\x00", certain=True)
    return axis


def test_speed_reached_is_compared_only_after_shaft_had_time() -> None:
    """A limit switch may just have begun to stop it."""
    axis = asked_axis(0x047F)
    axis.drive.model.state = State.OPERATION_ENABLED
    axis.check(11 * SECOND, reached=True, zsw1=0x0707)
    with pytest.raises(ViolationError, match=f"{Rule.REACHED.sentence}: .* with 0 of 3000 rpm"):
        axis.check(12 * SECOND, reached=True, zsw1=0x0707)


def test_stop_has_its_time_after_drive_is_reached_again() -> None:
    axis = asked_axis(0x047D)
    axis.commanded(SECOND, 0x0002)
    axis.check(10 * SECOND, reached=False, zsw1=None)
    axis.check(10 * SECOND + 100 * MS, reached=True, zsw1=None)
    with pytest.raises(ViolationError, match=f"{Rule.OFF2.sentence}: .*Controlword 2h"):
        axis.check(11 * SECOND, reached=True, zsw1=None)


def test_quick_stop_is_not_an_answer_to_off2_unless_the_plc_may_be_lost() -> None:
    axis = asked_axis(0x047D)
    axis.plan = replace(axis.plan, on_plc_loss=PlcLossReaction.QUICK_STOP)
    axis.commanded(SECOND, 0x0002)
    axis.asked(10 * SECOND, b"\x04\x7d\x40\x00", certain=False)
    axis.check(10 * SECOND + 400 * MS, reached=True, zsw1=None)
    with pytest.raises(ViolationError, match=f"{Rule.OFF2.sentence}: .*Controlword 2h"):
        axis.check(10 * SECOND + 500 * MS, reached=True, zsw1=None)
    axis.plan = replace(axis.plan, on_plc_loss=PlcLossReaction.COAST)
    axis.asked(11 * SECOND, b"\x04\x7d\x40\x00", certain=False)
    with pytest.raises(ViolationError, match=f"{Rule.OFF2.sentence}: .*Controlword 2h"):
        axis.check(11 * SECOND, reached=True, zsw1=None)


# -- EMCYs in the fault buffer ------------------------------------------------------------------------------------------------

EMCY = bytes.fromhex("30 81 11 00 00 00 00 00")
NOTHING = [0] * 64


def pending(*sent_ms: int) -> PendingEmcys:
    pending = PendingEmcys("axis 1")
    for moment in sent_ms:
        pending.sent(moment * MS, EMCY)
    return pending


def test_emcy_without_an_entry_is_found() -> None:
    with pytest.raises(ViolationError, match="EMCY 8130h was sent 400 ms before"):
        pending(1000).read(1400 * MS, 0, NOTHING, NOTHING)


def test_emcy_that_is_a_warning_is_reported() -> None:
    warning = FaultRecord(12, 0x8130, 0, "", 1000 * MS, is_warning=True)
    waiting = pending(1000)
    waiting.read(1400 * MS, 0, NOTHING, NOTHING, [warning])
    assert not waiting.due(2000 * MS)


@pytest.mark.parametrize("entered_ms", [1000, 1100, 200])
def test_emcy_with_its_entry_is_reported(entered_ms: int) -> None:
    """The same EMCY is entered once in a second."""
    waiting = pending(1000)
    waiting.read(1400 * MS, 0, [0x8130, *NOTHING[1:]], [entered_ms, *NOTHING[1:]])
    assert not waiting.due(2000 * MS)


def test_entry_of_an_older_emcy_counts_only_while_it_is_not_acknowledged() -> None:
    pending(5000).read(5400 * MS, 0, [0x8130, *NOTHING[1:]], [1000, *NOTHING[1:]])
    with pytest.raises(ViolationError):
        pending(5000).read(5400 * MS, 0, [*NOTHING[:8], 0x8130, *NOTHING[9:]], [*NOTHING[:8], 1000, *NOTHING[9:]])
    for place in (8, 16):  # after one acknowledge, and after two with another fault between
        repeated = PendingEmcys("axis 1")
        repeated.sent(5000 * MS, EMCY, {0x8130})
        codes, times = [*NOTHING], [*NOTHING]
        codes[place], times[place] = 0x8130, 1000
        repeated.read(5400 * MS, 0, codes, times)


def test_emcy_waits_for_its_bound_and_without_error_register_is_a_warning() -> None:
    waiting = pending(1000)
    assert not waiting.due(1200 * MS)
    assert waiting.due(1300 * MS)
    warning = PendingEmcys("axis 1")
    warning.sent(0, bytes.fromhex("30 81 00 00 00 00 00 00"))
    assert not warning.due(SECOND)


# -- calm days --------------------------------------------------------------------------------------------------------


def calm_run(number: int, seed: int = 1) -> CalmRun:
    return CalmRun(next(parts(seed, 1, [number], draw_calm)))


def calm_piece(number: int, piece: int) -> CalmRun:
    """A part of a calm day with its own legal habits, with a cycle that needs little CPU."""
    part = next(parts(piece, 1, [number], draw_calm))
    return CalmRun(replace(part, plan=replace(part.plan, cycle_ms=_PIECE_CYCLE_MS)))


@pytest.mark.parametrize("piece", range(16 if COMPLETE else 2))
@pytest.mark.parametrize("number", CALM_TELEGRAMS)
def test_piece_of_a_calm_hour_with_its_own_legal_habits_finds_nothing(number: int, piece: int) -> None:
    """20 s of each telegram with each combination: 7 minutes in the suite (25 s of CPU), an hour with ``make conformance``."""
    run = calm_piece(number, piece)
    run.run_to(20 * SECOND)
    assert run.tasks
    run.close()


@pytest.mark.planted
def test_calm_day_finds_a_stop_of_a_drive_whose_brake_closes_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StopWatch, "_is_still", lambda self, *_: False)

    def run_pieces() -> None:
        for run in (calm_piece(1, piece) for piece in range(100)):
            if "brake-closes" in run.plan.axes[0].habits:
                run.run_to(20 * SECOND)

    with pytest.raises(ViolationError, match=r"drive does not stop: .*brake-closes delay_ms="):
        run_pieces()


def test_violation_of_a_calm_day_names_the_combination_of_habits() -> None:
    run = CalmRun(Part(1, 0, 0, calm_plan(1, 16, "rpm", {"velocity-noise": {"rpm": 2}, "sdo-segmented": {}})))
    run.loop.call_at(2 * SECOND, lambda: _fault(run))
    with pytest.raises(ViolationError, match=r"drive rpm, .*, velocity-noise rpm=2, sdo-segmented"):
        run.run_to(30 * SECOND)


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
        run.run_to(30 * SECOND)


@pytest.mark.parametrize(("number", "task", "end"), [(111, "relative", "at"), (1, "profile", "reached")])
def test_task_without_its_end_is_a_violation(number: int, task: str, end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run = calm_run(number)
    monkeypatch.setattr(type(run.program), end, lambda *_: False)
    run.program.tasks = {task: run.program.tasks[task]}
    with pytest.raises(ViolationError, match=r"(target|rpm).* does not end: axis 1: drive in Operation Enabled"):
        run.run_to(60 * SECOND)


@pytest.mark.parametrize("number", CALM_TELEGRAMS)
def test_calm_parts_draw_every_healthy_shape_and_legal_habit(number: int) -> None:
    plans = [draw_calm(Random(n), 1, [number]) for n in range(400)]
    assert {plan.direct for plan in plans} == {False, True}
    axes = [axis for plan in plans for axis in plan.axes]
    encoder = number in ENCODER_TELEGRAM_NUMBERS
    drawn = [axis.habits for axis in axes] or [plan.encoder_habits for plan in plans]
    known = {habit.name for habit in legal_habits("encoder" if encoder else "drive")}
    shapes = set() if encoder else set(calm_shapes(number))
    of_all = set.intersection(*(NEEDED_OBJECTS.get(shape, set()) for shape in shapes)) if shapes else set()
    assert {name for habits in drawn for name in habits} == known - NEEDED_OBJECTS.get(number, set()) - UNFIT.get(
        number, set()
    ) - of_all
    assert encoder or {axis.shape for axis in axes} == shapes
    assert {plan.encoder for plan in plans} == {number if encoder else 0}


def test_command_prints_the_table_of_calm_days(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--calm", "--hours", "0.001", "--telegrams", "1,83"]) == 0
    rows = re.findall(r"^\| (\d+) \| 0.001 \| \d+ \| 0 \| \d+ \| \d+ \|$", capsys.readouterr().out, re.MULTILINE)
    assert rows == ["1", "83"]
