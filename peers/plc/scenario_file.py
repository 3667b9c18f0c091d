"""Read scenarios from YAML files. Errors name the step, the key, the value and what is allowed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml
from pydantic import ValidationError

from pdgw.base.durations import MS
from pdgw.base.validation import Problem, problems
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.toml_file import check_depth, read_text
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario import Scenario
from pdgw.profidrive.telegrams import TELEGRAMS, Telegram, by_number, telegram


class _Loader(yaml.SafeLoader):
    """Rejects aliases: a few lines of them can expand to gigabytes."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("anchors and aliases (&name, *name) are not allowed")
        node: yaml.Node | None = super().compose_node(parent, index)
        return node


def _document(text: str) -> Any:
    """Parse YAML; GatewayError for invalid text."""
    try:
        document = yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError) as error:  # an invalid date and a number of 5000 digits are ValueErrors
        raise GatewayError(f"not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError:
        raise GatewayError("not valid YAML: nested too deeply") from None
    check_depth(document, "YAML")
    return document


def parse_step(text: str) -> dict[str, Any]:
    """Parse a typed step: a word and its value, ``override 50 %``; the default value is true. GatewayError for invalid YAML."""
    name, _, value = text.strip().partition(" ")
    return {name.removesuffix(":"): _document(value) if value.strip() else True}


def _validated(document: Any, known: Mapping[int, Telegram] = TELEGRAMS) -> Scenario:
    """The scenario in a document; GatewayError has one line for each error."""
    try:
        return Scenario.model_validate(document, context=known)
    except ValidationError as error:
        raise GatewayError("\n".join(_step_problem(problem) for problem in problems(error, Scenario))) from error


def scenario_of(
    telegrams: Sequence[Telegram],
    steps: Sequence[Mapping[str, Any]],
    references: Mapping[str, float] = MappingProxyType({}),
) -> Scenario:
    """Build a scenario from steps without a file; GatewayError describes errors."""
    numbers = [item.number for item in telegrams]
    return _validated({"telegrams": numbers, "steps": steps, "references": references}, by_number(telegrams))


def load_scenario(path: Path) -> Scenario:
    """Read and validate a file; GatewayError names step, key, value and what is allowed."""
    text = read_text(path)
    try:
        scenario = _validated(_document(text))
        Engine(scenario, PlcEndpoint([telegram(number) for number in scenario.telegrams], MS))
    except GatewayError as error:
        raise GatewayError("\n".join(f"{path}: {line}" for line in str(error).splitlines())) from error
    return scenario


def _step_problem(problem: Problem) -> str:
    """``step 3: move.to = 'x': expected a number``. Steps count from 1, as in the results."""
    section, *place = problem.location or ("",)
    if section != "steps" or not place:
        return problem.line
    return f"step {int(place[0]) + 1}: {problem._replace(location=tuple(place[1:])).line}"
