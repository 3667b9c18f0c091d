"""The exhaustive walk of an axis in its short alphabet, and whether what it leaves out of a state (``ASIDE``) has no influence.

``make long LONG=walk`` walks all choices and telegrams. The walk counts two states as one if they differ only in attributes that
are aside. Random inputs find pairs of such states. Each pair that differs in another attribute than the pairs before is stepped
with every input: words, commands and following states are the same.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from random import Random

import pytest

from pdgw.gateway.axis.settings import PlcLossReaction
from pdgw.profidrive.telegrams import TELEGRAMS
from tests.long.walk.cases import NOT_WALKED, Case, every, short
from tests.long.walk.checkpoint import Checkpoint
from tests.long.walk.machine import Transducer

FIGURES = Path(__file__).parents[2] / "docs" / "walk.txt"


@pytest.mark.parametrize("case", list(short()), ids=lambda case: case.name)
def test_no_reachable_state_breaks_a_rule(case: Case) -> None:
    result = case.run()
    print(f"{case.name}: {result}")
    assert not result.violations, "\n".join(result.traces())
    assert f"{case.name}: {result}\n" in FIGURES.read_text(encoding="utf-8"), "run: make docs"


def test_every_telegram_is_walked_or_has_a_reason_not_to_be() -> None:
    walked = {case.number for case in every()}
    assert walked.isdisjoint(NOT_WALKED)
    assert walked | set(NOT_WALKED) == set(TELEGRAMS)


# -- states that differ only aside ------------------------------------------------------------------------------------


PAIRS = 1
"""Least number of pairs for each attribute."""
Attribute = tuple[str, str]
"""Class and name."""
WALKED = [
    Case(1, PlcLossReaction.RAMP, resume=True, hold=True),
    Case(9),
    Case(100),
]
STEPS = 6000
"""Random inputs of each case."""
LIKELY_FRAMES, LIKELY_DRIVE = ("OFF1", "ON+enable", "task"), ("Ready", "Switched", "Operation Enabled")
"""Names of the inputs that are drawn more often, so that a drive operates and a task runs."""


def difference(one: Checkpoint, other: Checkpoint) -> set[Attribute]:
    """The attributes in which two states differ, but for times."""
    assert len(one.parts) == len(other.parts)
    return {
        (type(part.item).__name__, name)
        for part, a, b in zip(one.parts, one.values, other.values, strict=True)
        if a is not b
        for place, name in enumerate(part.names)
        if a[place] != b[place] and name != "now" and place not in {i for i, _ in part.instants}
    }


class Twins(Transducer):
    """Keeps pairs of states that the walk takes for one."""

    seen: Counter[Attribute]
    pairs: list[tuple[Checkpoint, Checkpoint, set[Attribute]]]

    def _number(self) -> int:
        if not hasattr(self, "seen"):
            self.seen, self.pairs = Counter(), []
        before = len(self)
        number = super()._number()
        if number < before:
            twin = self._checkpoints.save()
            found = difference(self._states[number], twin)
            if any(self.seen[item] < PAIRS for item in found):
                self.seen.update(found)
                self.pairs.append((self._states[number], twin, found))
        return number

    def continues(self, state: Checkpoint, number: int) -> tuple[object, ...]:
        """Result of one step from a state, and the next state."""
        self._checkpoints.restore(state)
        output = self._step(*self.inputs[number])
        return output, self._checkpoints.fingerprint()


DIFFER: set[Attribute] = {
    ("SpeedDemand", "power"),
    ("DriveCommand", "profile_velocity"),
    ("DriveCommand", "target_position"),
    ("DriveWatch", "fault_began"),
    ("Interlock", "_steady"),
    ("Outputs", "actuals"),
    ("RawExecutor", "_last"),
}
"""Among those in which pairs differ."""


def test_states_that_differ_only_aside_continue_alike() -> None:
    stepped, chance = set[Attribute](), Random(1)
    for case in WALKED:
        machine = case.machine(Twins)
        numbers = range(len(machine.inputs))
        likely = [
            number
            for number, (plc, shown) in enumerate(machine.inputs)
            if plc.name.rpartition(" ")[0] in LIKELY_FRAMES and shown.name.startswith(LIKELY_DRIVE)
        ]
        state = 0
        for _ in range(STEPS):
            state, _ = machine.step(state, chance.choice(likely if chance.random() < 0.8 else numbers))
        for one, other, found in machine.pairs:
            for number in numbers:
                assert machine.continues(one, number) == machine.continues(other, number), (
                    found,
                    machine.inputs[number],
                )
        stepped |= set(machine.seen)
    assert stepped >= DIFFER
