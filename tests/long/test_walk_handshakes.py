"""The walk of the handshakes, and defects planted in the gateway that it finds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pdgw.dsp402.states import StatusBit
from pdgw.gateway.axis.executors.positions.halt import Halt
from pdgw.gateway.axis.executors.positions.handshake import Handshake
from pdgw.gateway.axis.executors.positions.homing import Homing
from pdgw.gateway.axis.executors.positions.tasks import PositionerExecutor
from pdgw.gateway.motion.basic_positioner import BasicPositioner
from pdgw.gateway.motion.positioner import ACTIVATE
from pdgw.gateway.motion.requests import HomingResult, Seen
from pdgw.gateway.motion.travel import Course
from tests.long.planted import Patch, Plant, replaced, wrapped
from tests.long.rules import Rule
from tests.long.walk.handshakes import Handshakes, Orders, every, short
from tests.long.walk.shaft import Character, Signal, Wrong

FIGURES = Path(__file__).parents[2] / "docs" / "walk.txt"


@pytest.mark.parametrize("case", list(short()), ids=lambda case: case.name)
def test_no_reachable_handshake_breaks_a_rule(case: Handshakes) -> None:
    result = case.run()
    print(f"{case.name}: {result}")
    assert not result.violations, "\n".join(result.traces())
    assert f"{case.name}: {result}\n" in FIGURES.read_text(encoding="utf-8"), "run: make docs"


def test_each_handshake_has_another_name() -> None:
    names = [case.name for case in every()]
    assert len(set(names)) == len(names)


def probe_counts_when_armed(method: Any, self: BasicPositioner) -> None:
    method(self)
    self.home_set = self.home_set or self.armed


def standing_task_bit_starts(method: Any, self: BasicPositioner) -> None:
    self._commands &= ~ACTIVATE
    method(self)


def seen_by_the_statusword(method: Any, self: PositionerExecutor) -> int:
    bits = int(method(self)) & ~Seen.REACHED
    return bits | Seen.REACHED if self.feedback.statusword & StatusBit.TARGET_REACHED else bits


def reached_by_the_statusword(patch: Patch) -> None:
    wrapped(PositionerExecutor, "_read_state", seen_by_the_statusword)(patch)
    arrived = lambda self: self.goal is not None and self.sent > 0 and self.seen.bits & Seen.REACHED  # noqa: E731
    replaced(Course, "arrived", arrived)(patch)


PLANTED: dict[str, tuple[Handshakes, Rule, Plant]] = {
    "reached by the Statusword alone": (
        Handshakes(110, Orders.TASKS, Character(wrong=Wrong.EARLY)),
        Rule.REACHED,
        reached_by_the_statusword,
    ),
    "a drive that goes on is not held": (
        Handshakes(110, Orders.TASKS, Character(keeps=True)),
        Rule.STOPS,
        replaced(Halt, "_stays", lambda _: False),
    ),
    "intermediate stop ignored": (
        Handshakes(110, Orders.TASKS),
        Rule.STOPS,
        replaced(Course, "_hold", lambda *_: None),
    ),
    "no reason without an acknowledge": (
        Handshakes(110, Orders.TASKS, Character(signal=Signal.ANSWER, wrong=Wrong.NEVER)),
        Rule.WAITS,
        replaced(Handshake, "_await", lambda _: None),
    ),
    "homing ends at once": (
        Handshakes(9, Orders.HOMING),
        Rule.HOMED,
        replaced(Homing, "run", lambda _: HomingResult.ATTAINED),
    ),
    "probe counts when it is armed": (
        Handshakes(111, Orders.PROBE),
        Rule.HOMED,
        wrapped(BasicPositioner, "_home_on_the_fly", probe_counts_when_armed),
    ),
    "standing task bit starts": (
        Handshakes(7, Orders.TASKS),
        Rule.MOVES,
        wrapped(BasicPositioner, "_read_request", standing_task_bit_starts),
    ),
}


@pytest.mark.planted
@pytest.mark.parametrize("name", PLANTED)
def test_the_walk_of_handshakes_finds_a_planted_defect(name: str, monkeypatch: Patch) -> None:
    case, rule, plant = PLANTED[name]
    plant(monkeypatch)
    result = case.run(until={rule})
    assert rule in result.violations
    print(*result.traces(), sep="\n")
