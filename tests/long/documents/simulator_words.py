"""Generate ``docs/plc-simulator.md``: actions and keys of ``pdgw sim plc``, from their declarations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import yaml

from pdgw.durations import MS
from pdgw.gateway.configuration.tables.defaults import USUAL_CYCLE_MS
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.keyboard import ALL, BITS, EXIT, KEYS, LIST, TYPE, Keyboard, shown
from pdgw.peers.plc.scenario import ACTIONS, Step, examples
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.peers.plc.vocabulary import Word, telegrams_of, words_of
from pdgw.profidrive.telegrams import TELEGRAMS, telegram
from tests.long.documents.markdown import table

_CYCLE_NS = USUAL_CYCLE_MS * MS
_OF_A_TELEGRAM = frozenset({"set", "expect"})
"""Their examples use signals that every telegram has."""
_INTRODUCTION = """\
# The PLC simulator

Generated from the declarations by `make docs`; do not edit.

`pdgw sim plc SCENARIO` runs the steps of a file. `pdgw sim plc --interactive --telegram 111` reads the keyboard; type `:` and
a step. A scenario is YAML with `telegrams` (one for each axis), `references` (`speed_rpm` and `position` at 100 %,
`increments` of a revolution) and `steps`. A step has one action, or words of the telegram. It may have `axis` (from 1),
`note` and `within` (longest wait, `3 s`):

    steps:
      - {enable: true, within: 10 s}
      - {override: 50 %, tracking: 0}
      - {mdi: {to: 50000, velocity: 12000}, note: "to 50000 LU"}
      - {expect: {XIST_A: "50000 +- 20", ZSW1.TARGET_REACHED: 1}, within: 10 s}

Values: `1234`, `0x4D2`, `2000h`, `50 %`, `1500 rpm`, `2000 inc`. Expected values also: `<= 5`, `100 +- 2`, `& 0x4F = 0x40`.
[Examples](../tools/scenarios).

`--junit FILE` (JUnit XML for CI systems), `--html FILE` (one page without other files) and `--json` write the results: date,
version, the text of the scenario and the measured values, also of failed checks.
"""


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


def _words() -> Iterable[Sequence[object]]:
    """One row for words that are equal in several telegrams. Words named like their action are left out."""
    rows: dict[tuple[str, str, str], list[int]] = {}
    for number in TELEGRAMS:
        for word in words_of(number).values():
            if word.name not in ACTIONS:
                rows.setdefault((word.name, word.key, _meaning(word)), []).append(number)
    order = list(telegrams_of())
    for (name, key, meaning), numbers in sorted(rows.items(), key=lambda item: order.index(item[0][0])):
        yield f"`{name}`", key, _numbers(numbers), meaning


def _meaning(word: Word) -> str:
    unit = word.signal.unit if word.bit is None else ""
    return f"{word.meaning} ({unit})" if unit else word.meaning


def _keys() -> Iterable[Sequence[object]]:
    having = {n: Keyboard(PlcEndpoint([telegram(n)], _CYCLE_NS), print).keys_of(1) for n in TELEGRAMS}
    for key, item in KEYS.items():
        changes = (
            f"`{_as_yaml(item.step)}`" if item.step else "10 % of the speed setpoint, or of a positioner's override"
        )
        yield f"`{shown(key)}`", item.text, changes, _numbers([n for n in TELEGRAMS if key in having[n]])


def generate_words() -> str:
    """Generate the document."""
    general = (
        ("1..9", "selects an axis"),
        (ALL, "all axes"),
        (BITS, "toggle a bit: the screen shows a letter for every bit that the telegram sends"),
        (TYPE, "type a step and Enter: `:override 50 %`, `:mdi {to: 5000}`, `:reject`; Esc cancels"),
        (LIST, "the words of the telegram"),
        (EXIT, "ends"),
    )
    return "\n".join(
        (
            _INTRODUCTION,
            "## Actions\n",
            table(("action", "example", "telegrams", "what the PLC does"), _actions()),
            "## Words of the telegrams\n",
            "Every value and every bit that a telegram sends. Several words in one step are sent in one frame. Bits are 0",
            "and 1. If an action has the same name as a bit, write `set: {POS_STW1.MDI: 1}`.\n",
            table(("word", "is", "telegrams", "meaning (of 1)"), _words()),
            "## Keys\n",
            "The screen shows the keys of the telegram. Some keys switch back when you press them again.\n",
            table(("key", "does", "step", "telegrams"), _keys()),
            table(("key", "does"), ((f"`{key}`", text) for key, text in general)),
        )
    )
