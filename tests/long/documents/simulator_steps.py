"""Generate the actions and keys of ``pdgw sim plc`` in ``docs/simulation.md``, from their declarations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import yaml

from pdgw.durations import MS
from pdgw.gateway.configuration.defaults import USUAL_CYCLE_MS
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.keyboard import ALL, EXIT, KEYS, LIST, TYPE, Keyboard, shown
from pdgw.peers.plc.scenario import ACTIONS, Step, examples
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.profidrive.telegrams import TELEGRAMS, telegram
from tests.long.documents.markdown import table

_CYCLE_NS = USUAL_CYCLE_MS * MS
_OF_A_TELEGRAM = frozenset({"set", "expect"})
"""Their examples use signals that every telegram has."""


@cache
def _takes(number: int, action: str) -> bool:
    """Whether one of the examples of an action fits the telegram."""
    return any(_possible(number, step) for step in examples(action))


def _possible(number: int, step: Mapping[str, Any]) -> bool:
    try:
        Engine(scenario_of([number], [step]), PlcEndpoint([telegram(number)], _CYCLE_NS))
    except GatewayError:
        return False
    return True


def _numbers(found: Sequence[int]) -> str:
    return "any" if len(found) == len(TELEGRAMS) else ", ".join(map(str, found))


def _actions() -> Iterable[Sequence[object]]:
    for action in ACTIONS:
        numbers = list(TELEGRAMS) if action in _OF_A_TELEGRAM else [n for n in TELEGRAMS if _takes(n, action)]
        texts = (f"`{_as_yaml(step)}`" for step in examples(action))
        does = (Step.model_fields[action].description or "").replace("``", "`")
        yield action, ", ".join(texts), _numbers(numbers), does


def _as_yaml(step: Mapping[str, Any]) -> str:
    """Format a step as a person writes it: like JSON, but mostly without quotes."""
    quoted = ", ".join(f"{name}: {json.dumps(value)}" for name, value in step.items())
    plain = quoted.replace('"', "")
    try:
        same = yaml.safe_load("{" + plain + "}") == step
    except yaml.YAMLError:
        same = False
    return plain if same else quoted


def _keys() -> Iterable[Sequence[object]]:
    having = {n: Keyboard(PlcEndpoint([telegram(n)], _CYCLE_NS), print).keys_of(1) for n in TELEGRAMS}
    for key, item in KEYS.items():
        changes = (
            f"`{_as_yaml(item.step)}`" if item.step else "10 % of the speed setpoint, or of a positioner's override"
        )
        yield f"`{shown(key)}`", item.text, changes, _numbers([n for n in TELEGRAMS if key in having[n]])


def generate_steps() -> str:
    """Generate the tables."""
    general = (
        ("1..9", "selects an axis"),
        (ALL, "all axes"),
        (TYPE, "type a step and Enter: `:override 50 %`, `:tracking`, `:mdi {to: 5000}`, `:reject`; Esc cancels"),
        (LIST, "the words of the telegram"),
        (EXIT, "ends"),
    )
    return "\n".join(
        (
            "### Actions\n",
            table(("action", "example", "telegrams", "what the PLC does"), _actions()),
            "### Keys\n",
            "The screen shows the keys of the telegram. Some keys switch back when you press them again.\n",
            table(("key", "does", "step", "telegrams"), _keys()),
            table(("key", "does"), ((f"`{key}`", text) for key, text in general)),
        )
    )
