"""The actions of ``pdgw sim plc`` in ``docs/tables.md``, from their declarations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import yaml

from pdgw.base.durations import MS
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import USUAL_CYCLE_MS
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario import ACTIONS, Step, examples
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.profidrive.telegrams import TELEGRAMS, telegram
from tests.support.documents.parts import numbers, table

_CYCLE_NS = USUAL_CYCLE_MS * MS
_OF_A_TELEGRAM = frozenset({"set", "expect"})
"""Their examples use signals that every telegram has."""


@cache
def _takes(number: int, action: str) -> bool:
    """Whether one of the examples of an action fits the telegram."""
    return any(_possible(number, step) for step in examples(action))


def _possible(number: int, step: Mapping[str, Any]) -> bool:
    try:
        Engine(scenario_of([telegram(number)], [step]), PlcEndpoint([telegram(number)], _CYCLE_NS))
    except GatewayError:
        return False
    return True


def _actions() -> Iterable[Sequence[object]]:
    for action in ACTIONS:
        takers = [n for n in TELEGRAMS if action in _OF_A_TELEGRAM or _takes(n, action)]
        telegrams = "any" if len(takers) == len(TELEGRAMS) else numbers(takers)
        texts = (f"`{_as_yaml(step)}`" for step in examples(action))
        does = (Step.model_fields[action].description or "").replace("``", "`")
        yield action, ", ".join(texts), telegrams, does


def _as_yaml(step: Mapping[str, Any]) -> str:
    """Format a step as a person writes it: like JSON, but mostly without quotes."""
    quoted = ", ".join(f"{name}: {json.dumps(value)}" for name, value in step.items())
    plain = quoted.replace('"', "")
    try:
        same = yaml.safe_load("{" + plain + "}") == step
    except yaml.YAMLError:
        same = False
    return plain if same else quoted


def generate_steps() -> str:
    """The table of the actions."""
    return table(("action", "example", "telegrams", "what the PLC does"), _actions())
