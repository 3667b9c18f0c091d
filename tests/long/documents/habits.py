"""The table of habits in docs/habits.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from pdgw.peers.habits import HABITS, Habit
from tests.conformance.fault_cases import CASES, Case, Device
from tests.support.documents.parts import table

PLACE: Final = ("habits.md", "habits")
_TITLES: Final = {"node": "Habits of any device", "drive": "Habits of drives", "encoder": "Habits of encoders"}


def generate() -> str:
    """A table for each kind of device."""
    return "\n".join(_tables())


def _tables() -> Iterator[str]:
    header = ("name", "what the device does", "parameters", "legal", "source", "what the gateway does")
    for device, title in _TITLES.items():
        rows = (_row(habit) for habit in HABITS.values() if habit.device == device)
        yield f"## {title}\n\n" + table(header, rows)


def _row(habit: Habit) -> tuple[str, ...]:
    parameters = "; ".join(
        f"`{name}` = {item.text(item.default)} ({item.text(item.low)} to {item.text(item.high)}): {item.meaning}"
        for name, item in habit.parameters.items()
    )
    reactions = dict.fromkeys(_reaction(habit, case) for case in CASES if case.fault == habit.name)
    return f"`{habit.name}`", habit.text, parameters, _legal(habit), habit.source, "; ".join(reactions)


def _legal(habit: Habit) -> str:
    if not habit.legal_for:
        return "no"
    parts = ["with a warning" if habit.warns else "yes"]
    parts += [f"for {name}s" for name in habit.legal_for if len(habit.legal_for) == 1 and habit.device == "node"]
    for name, (low, high) in habit.legal.items():
        text = habit.parameters[name].text
        parts.append(f"`{name}` {text(low)}" + (f" to {text(high)}" if high > low else ""))
    return ", ".join(parts)


def _reaction(habit: Habit, case: Case) -> str:
    chosen = [f"{key} = {habit.parameters[key].text(value)}" for key, value in case.values.items()]
    chosen += [f"beside `{name}`" for name in case.beside]
    device = "as G1 of a drive" if case.device is Device.SENSOR else case.device.value
    situation = ", ".join([device, case.activity.value, *chosen])
    numbers = ", ".join(map(str, case.numbers))
    return f"{situation}: {case.reaction.value}" + (f" (fault {numbers} within {case.within_ms} ms)" if numbers else "")
