"""Breadth-first search to the fixpoint: each pair of machine state and monitor memory once, with every input."""

from __future__ import annotations

import enum
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from tests.long.walk.machine import Transducer
from tests.long.walk.recovery import Stuck
from tests.long.walk.values import Output, Plc, Shown

_Node = tuple[int, int]
"""Numbers of a state and of a memory."""


class Checks(Protocol):
    """A monitor: safety rules with a memory between steps."""

    @property
    def first(self) -> Hashable:
        """The memory before the first step."""

    def step(self, memory: Any, plc: Plc, shown: Shown, output: Output, /) -> tuple[Hashable, Sequence[enum.Enum]]:
        """The memory after a step, and the violated rules."""


@dataclass(slots=True)
class Step:
    """One line of a trace."""

    plc: Plc
    shown: Shown
    output: Output

    def __str__(self) -> str:
        out = self.output
        sent = f"CW {out.controlword:04X} speed {out.velocity:5} ZSW1 {out.zsw1:04X} {out.reason}"
        return f"{self.plc.name:24} | {self.shown.name:34} | {sent}"


@dataclass(slots=True)
class Violation:
    """A violated rule with the shortest trace to it."""

    rule: enum.Enum
    trace: Sequence[object]

    def __str__(self) -> str:
        lines = [f"broken: {self.rule.value}", *(f"{i:3} {step}" for i, step in enumerate(self.trace, 1))]
        return "\n".join(lines)


@dataclass(slots=True)
class Result:
    """Result of a walk."""

    states: int = 0
    machine_states: int = 0
    transitions: int = 0
    violations: dict[enum.Enum, Violation] = field(default_factory=dict)
    stuck: Stuck | None = None
    """Where the axis does not return to operation, or OFF does not remove power."""

    def __str__(self) -> str:
        numbers = f"{self.machine_states} states of the machine, {self.states} of machine and monitor"
        found = len(self.violations) + (self.stuck is not None)
        return f"{numbers}, {self.transitions} transitions, {found} violations"


def walk(machine: Transducer, monitor: Checks, *, first_only: bool = False) -> Result:
    """Visit everything reachable. Each violated rule has its shortest trace; ``first_only``: only the first violation."""
    result = Result()
    first: _Node = (0, 0)
    came_from: dict[_Node, tuple[_Node, int]] = {}
    known = {first}
    front = [first]
    judge = _Judge(machine, monitor)
    numbers = range(len(machine.inputs))
    while front:
        following = []
        for node in front:
            state, memory = node
            for number in numbers:
                after, output = machine.step(state, number)
                remembered, broken = judge(memory, number, output)
                for rule in broken:
                    if rule not in result.violations:
                        path = _path(came_from, node, number)
                        result.violations[rule] = Violation(rule, _trace(machine, path))
                reached = (after, remembered)
                if reached not in known:
                    known.add(reached)
                    came_from[reached] = node, number
                    following.append(reached)
            result.transitions += len(numbers)
            if first_only and result.violations:
                return result
        front = following
    result.states, result.machine_states = len(known), len(machine)
    return result


class _Judge:
    """The monitor with numbered memories; each result is computed once and stored."""

    def __init__(self, machine: Transducer, monitor: Checks) -> None:
        self._machine = machine
        self._monitor = monitor
        self._memories = [monitor.first]
        self._number_of = {monitor.first: 0}
        self._results: dict[tuple[int, int, int], tuple[int, Sequence[enum.Enum]]] = {}

    def __call__(self, memory: int, number: int, output: int) -> tuple[int, Sequence[enum.Enum]]:
        key = (memory, number, output)
        said = self._results.get(key)
        if said is None:
            plc, shown = self._machine.inputs[number]
            after, broken = self._monitor.step(self._memories[memory], plc, shown, self._machine.outputs[output])
            place = self._number_of.setdefault(after, len(self._memories))
            if place == len(self._memories):
                self._memories.append(after)
            said = self._results[key] = place, broken
        return said


def _path(came_from: dict[_Node, tuple[_Node, int]], node: _Node, last: int) -> list[int]:
    path = [last]
    while node in came_from:
        node, number = came_from[node]
        path.append(number)
    return path[::-1]


def _trace(machine: Transducer, path: list[int]) -> list[Step]:
    state, steps = 0, []
    for number in path:
        state, output = machine.step(state, number)
        steps.append(Step(*machine.inputs[number], machine.outputs[output]))
    return steps
