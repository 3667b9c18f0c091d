"""The base of what simulated CANopen nodes do besides or against the rules, see ``peers.habits``.

A behaviour is a class. Its attributes are the parameters, its hooks act on one ``Device``. ``SimulatedNode.start_fault`` and
``end_fault`` switch habits by name at run time. The behaviours of any node are in ``node_behaviours``; a device profile adds
its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import NamedTuple

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import Entry
from pdgw.peers.habits import HABITS, Habit
from pdgw.peers.node.device import Device

HabitValues = Mapping[str, Mapping[str, int]]
"""Habits by name, each with its parameters."""
NONE: HabitValues = MappingProxyType({})


class Behaviour:
    """An active habit of one node. ``node`` is set before the first hook. The hooks of the base class change nothing."""

    habit: Habit
    node: Device

    def __init__(self, **values: object) -> None:
        vars(self).update(values)

    @property
    def values(self) -> dict[str, int]:
        """The active parameter values."""
        return {name: getattr(self, name) for name in self.habit.parameters}

    def begin(self) -> None:
        """Start; at power-on before the boot-up message."""

    def end(self) -> None:
        """End the habit."""

    def restarting(self, *, powered: bool) -> None:
        """Before the values of a reset are set. ``powered``: the firmware restarts or power returns, not communication alone."""

    def poll(self, now: int) -> None:
        """Called with the time (monotonic ns), also while the node is silent."""

    def next_event(self, now: int) -> int | None:
        """Next time at which ``poll`` must be called; None: only after another event."""
        return None

    def incoming(self, can_id: int, data: bytes) -> bool:
        """Process a frame for the node; False keeps it from the node."""
        return True

    def outgoing(self, can_id: int, data: bytes) -> bool:
        """Process a frame of the node; False keeps it off the bus."""
        return True

    def reading(self, entry: Entry, data: bytes) -> bytes:
        """The data of an SDO upload of the entry; raises ``SdoAbortedError`` to abort it."""
        return data

    def writing(self, entry: Entry, data: bytes) -> bytes:
        """The data of an SDO download to the entry; raises ``SdoAbortedError`` to abort it."""
        return data


class Kind(NamedTuple):
    """A habit that a device can have."""

    habit: Habit
    behaviour: type[Behaviour]


Catalogue = Mapping[str, Kind]


def catalogue(device: str, behaviours: Iterable[type[Behaviour]]) -> Catalogue:
    """The habits of the table for one kind of device, by name."""
    known = {behaviour.__name__: behaviour for behaviour in behaviours}
    rows = (habit for habit in HABITS.values() if habit.device == device)
    return MappingProxyType({habit.name: Kind(habit, known[habit.does]) for habit in rows})


def make(known: Catalogue, name: str, values: Mapping[str, object]) -> Behaviour:
    """Create a behaviour of the catalogue with these parameters. CanopenError names an unknown name or a value out of range."""
    kind = known.get(name)
    if kind is None:
        nearest = get_close_matches(name, known, 6, 0.5)
        raise CanopenError(
            "fault", name, f"one of {', '.join(nearest or known)}{', see docs/habits.md' * bool(nearest)}"
        )
    allowed = kind.habit.parameters
    chosen: dict[str, object] = {key: item.default for key, item in allowed.items()}
    for key, value in values.items():
        item = allowed.get(key)
        if item is None:
            raise CanopenError(f"fault {name} parameter", key, ", ".join(allowed) or "no parameter")
        if not isinstance(value, int) or isinstance(value, bool) or not item.low <= value <= item.high:
            raise CanopenError(f"fault {name} {key}", value, f"{item.text(item.low)} to {item.text(item.high)}")
        chosen[key] = value
    return kind.behaviour(habit=kind.habit, **kind.habit.fixed, **chosen)


def parse(text: str) -> tuple[str, dict[str, int]]:
    """Name and parameters of a habit in the notation of the console: ``slow-sdo delay_ms=100``. CanopenError for another one."""
    name, *pairs = text.split() or [""]
    values: dict[str, int] = {}
    for pair in pairs:
        key, _, value = pair.partition("=")
        try:
            values[key] = int(value, 0)
        except ValueError:
            raise CanopenError("parameter", pair, "name=number, for example delay_ms=100 or bits=0x0004") from None
    return name, values
