"""Breadth-first search to the fixpoint: each state of a walk once, with every input."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol, TypeVar

from tests.long.rules import Rule
from tests.long.walk.machine import Transducer
from tests.long.walk.values import Numbered, Output, Plc, Shown

Node = TypeVar("Node", bound=Hashable)
"""A state of machine, drive and rules."""
Move = TypeVar("Move")
"""The choices of one step."""


class Checks(Protocol):
    """A monitor: safety rules with a memory between steps."""

    @property
    def first(self) -> Hashable:
        """The memory before the first step."""

    def step(self, memory: Any, plc: Plc, shown: Shown, output: Output, /) -> tuple[Hashable, Sequence[Rule]]:
        """The memory after a step, and the broken rules."""


class Walk(Protocol[Node, Move]):
    """What can be searched."""

    first: Node

    def moves(self, node: Node, /) -> Iterable[Move]:
        """All choices of a step."""

    def go(self, node: Node, move: Move, /) -> tuple[Node, Sequence[Rule]]:
        """The node after a step, and the broken rules."""

    def line(self, node: Node, move: Move, /) -> str:
        """A step in a trace."""


@dataclass(slots=True)
class Result:
    """Result of a walk. ``violations``: for each broken rule the shortest trace."""

    states: int = 0
    machine_states: int = 0
    transitions: int = 0
    violations: dict[Rule, Sequence[str]] = field(default_factory=dict)

    def __str__(self) -> str:
        numbers = f"{self.machine_states} states of the machine, {self.states} of machine and monitor"
        return f"{numbers}, {self.transitions} transitions, {len(self.violations)} violations"

    def traces(self) -> Iterator[str]:
        """The violations with their traces."""
        for rule, trace in self.violations.items():
            yield "\n".join([f"broken: {rule.sentence}", *(f"{i:3} {step}" for i, step in enumerate(trace, 1))])


def search(walk: Walk[Node, Move], machine: Transducer, until: Collection[Rule] = ()) -> Result:
    """Visit everything that can be reached. ``until``: end when one of these rules is broken."""
    result = Result()
    came_from: dict[Node, tuple[Node, Move] | None] = {walk.first: None}
    front = [walk.first]
    while front:
        following = []
        for node in front:
            for move in walk.moves(node):
                reached, broken = walk.go(node, move)
                result.transitions += 1
                for rule in broken:
                    if rule not in result.violations:
                        result.violations[rule] = _trace(walk, came_from, (node, move))
                if reached not in came_from:
                    came_from[reached] = node, move
                    following.append(reached)
            if not result.violations.keys().isdisjoint(until):
                return result
        front = following
    result.states, result.machine_states = len(came_from), len(machine)
    return result


def _trace(
    walk: Walk[Node, Move], came_from: dict[Node, tuple[Node, Move] | None], last: tuple[Node, Move] | None
) -> list[str]:
    path = []
    while last is not None:
        path.append(walk.line(*last))
        last = came_from[last[0]]
    return path[::-1]


class PowerWalk:
    """A walk of a machine with all its inputs, and a monitor. A node has the numbers of a state and of a memory."""

    first = (0, 0)

    def __init__(self, machine: Transducer, monitor: Checks) -> None:
        self._machine = machine
        self._monitor = monitor
        self._memories = Numbered[Hashable]()
        self._memories.number(monitor.first)
        self._judge = cache(self._checked)

    def moves(self, _: tuple[int, int]) -> Iterable[int]:
        return range(len(self._machine.inputs))

    def go(self, node: tuple[int, int], move: int) -> tuple[tuple[int, int], Sequence[Rule]]:
        after, output = self._machine.step(node[0], move)
        memory, broken = self._judge(node[1], move, output)
        return (after, memory), broken

    def _checked(self, memory: int, number: int, output: int) -> tuple[int, Sequence[Rule]]:
        machine = self._machine
        after, broken = self._monitor.step(self._memories[memory], *machine.inputs[number], machine.outputs[output])
        return self._memories.number(after), broken

    def line(self, node: tuple[int, int], move: int) -> str:
        plc, shown = self._machine.inputs[move]
        out = self._machine.outputs[self._machine.step(node[0], move)[1]]
        sent = f"CW {out.controlword:04X} speed {out.velocity:5} ZSW1 {out.zsw1:04X} {out.reason}"
        return f"{plc.name:24} | {shown.name:34} | {sent}"
