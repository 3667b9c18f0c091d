"""Breadth first to the fixpoint: each pair of a machine's state and the monitor's memory once, with every input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pdgw.workshop.walk.machine import Transducer
from pdgw.workshop.walk.monitor import Memory, Monitor, Rule
from pdgw.workshop.walk.recovery import Stuck
from pdgw.workshop.walk.values import Output, Plc, Shown

_Node = tuple[int, Memory]


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
    """A broken rule with the shortest way to it."""

    rule: Rule
    trace: list[Step]

    def __str__(self) -> str:
        lines = [f"broken: {self.rule.value}", *(f"{i:3} {step}" for i, step in enumerate(self.trace, 1))]
        return "\n".join(lines)


@dataclass(slots=True)
class Result:
    """What a walk found."""

    states: int = 0
    machine_states: int = 0
    transitions: int = 0
    violations: dict[Rule, Violation] = field(default_factory=dict)
    stuck: Stuck | None = None
    """Where the axis does not come back to operation, or an OFF not to power off."""

    def __str__(self) -> str:
        numbers = f"{self.machine_states} states of the machine, {self.states} of machine and monitor"
        found = len(self.violations) + (self.stuck is not None)
        return f"{numbers}, {self.transitions} transitions, {found} violations"


def walk(
    machine: Transducer, monitor: Monitor, inputs: Sequence[tuple[Plc, Shown]], *, first_only: bool = False
) -> Result:
    """Everything that is reachable; of each rule that is broken the shortest trace, or ``first_only`` the first violation."""
    result = Result()
    first: _Node = (0, Memory())
    came_from: dict[_Node, tuple[_Node, int]] = {}
    known = {first}
    front = [first]
    while front:
        following = []
        for node in front:
            state, memory = node
            for number, (plc, shown) in enumerate(inputs):
                after, output = machine.step(state, plc, shown)
                remembered, broken = monitor.step(memory, plc, shown, output)
                result.transitions += 1
                for rule in broken:
                    if rule not in result.violations:
                        path = _path(came_from, node, number)
                        result.violations[rule] = Violation(rule, _trace(machine, inputs, path))
                if broken and first_only:
                    return result
                reached = (after, remembered)
                if reached not in known:
                    known.add(reached)
                    came_from[reached] = node, number
                    following.append(reached)
        front = following
    result.states, result.machine_states = len(known), len(machine)
    return result


def _path(came_from: dict[_Node, tuple[_Node, int]], node: _Node, last: int) -> list[int]:
    path = [last]
    while node in came_from:
        node, number = came_from[node]
        path.append(number)
    return path[::-1]


def _trace(machine: Transducer, inputs: Sequence[tuple[Plc, Shown]], path: list[int]) -> list[Step]:
    state, steps = 0, []
    for number in path:
        plc, shown = inputs[number]
        state, output = machine.step(state, plc, shown)
        steps.append(Step(plc, shown, output))
    return steps
