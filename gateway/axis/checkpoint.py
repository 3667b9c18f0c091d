"""Take a machine back to a moment, and tell whether two moments are the same state: for replays and for the walk.

A machine is made of parts: objects with attributes of their own that live as long as the machine does, or, where an attribute was
none of them at first, as long as the drive's configuration (DSC, interpolation). Everything else an attribute can be is an
immutable value, or a container of such. A class declares beside its attributes which of them are no plain state:

| declaration | attributes |
| --- | --- |
| ``INSTANTS`` | monotonic times, each with the age in ns from which on it makes no more difference; 0 or below is "none" |
| ``PASSING`` | every step sets them before it reads them, they only count, or never change: neither saved nor compared |
| ``ASIDE`` | saved, but not compared: no word and no command depends on them (caches, what the log has had); ``*``: all |
"""

from __future__ import annotations

import copy
import enum
from collections import deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import cache
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NamedTuple

from pdgw.dsp402.images import DriveFeedback
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import Outputs
from pdgw.profidrive.normalisation import Normalisation
from pdgw.profidrive.telegrams import Telegram

_CONTAINERS = (list, dict, deque)
_PACKAGE = __name__.partition(".")[0]
_VALUES = (enum.Enum, Normalisation, DriveFeedback)
"""Objects that no step changes."""
_FIXED = (Telegram, AxisSettings, DriveFeedback, MappingProxyType)
"""What a part keeps for ever."""


def _names(item: object) -> tuple[str, ...]:
    """The attributes of an object."""
    kinds = type(item).__mro__
    # Compiled classes list theirs under another name.
    declared = [name for kind in kinds for name in getattr(kind, "__slots__", getattr(kind, "__mypyc_attrs__", ()))]
    names = dict.fromkeys([*declared, *getattr(item, "__dict__", ())])
    return tuple(name for name in names if not name.startswith("__") and hasattr(item, name))


@cache
def _is_kind_of_part(kind: Any) -> bool:
    frozen = getattr(getattr(kind, "__dataclass_params__", None), "frozen", False)
    return kind.__module__.startswith(_PACKAGE) and not issubclass(kind, (*_VALUES, type)) and not frozen


def _is_part(value: object) -> bool:
    kind: Any = type(value)
    return _is_kind_of_part(kind) and not callable(value)


def _has_identity(value: object) -> bool:
    """A part that is replaced as a whole: it has no value of its own."""
    return _is_part(value) and type(value).__hash__ is object.__hash__


def _is_fixed(value: object) -> bool:
    """Whether an attribute keeps this value for ever."""
    return _is_part(value) or callable(value) or isinstance(value, _FIXED)


def _nothing(_: object) -> tuple[()]:
    return ()


def _parts(item: object, seen: dict[int, object]) -> Iterator[object]:
    if id(item) in seen:
        return
    seen[id(item)] = item
    yield item
    for name in _names(item):
        value = getattr(item, name)
        if _is_part(value):
            yield from _parts(value, seen)


@cache
def _declared(kind: Any, declaration: str) -> frozenset[str]:
    """The attributes that a class and its bases list in ``PASSING`` or ``ASIDE``."""
    return frozenset(name for base in kind.__mro__ for name in base.__dict__.get(declaration, ()))


def _getter(names: Sequence[str]) -> Callable[[Any], Any]:
    return attrgetter(*names) if names else _nothing


def _content(container: Any) -> tuple[Hashable, ...]:
    return tuple(container.items()) if isinstance(container, dict) else tuple(container)


class _Part:
    """One part: ``names`` are saved, ``containers`` are the places of those that are changed in place."""

    __slots__ = ("_contents", "_get", "_instants", "_plain", "containers", "is_compared", "item", "names")

    def __init__(self, item: object, names: tuple[str, ...] | None = None) -> None:
        self.item = item
        kind: Any = type(item)
        if names is None:
            passing = _declared(kind, "PASSING")
            names = tuple(name for name in _names(item) if name not in passing and not _is_fixed(getattr(item, name)))
        self.names = names
        self._get = _getter(names)
        values = dict(zip(names, self.values(), strict=True))
        self.containers = tuple(i for i, name in enumerate(names) if isinstance(values[name], _CONTAINERS))
        instants: Mapping[str, int] = getattr(item, "INSTANTS", {})
        self._instants = tuple((name, instants[name]) for name in names if name in instants)
        aside = _declared(kind, "ASIDE")
        compared = [name for name in names if not {name, "*"} & aside and name not in instants]
        self._contents = tuple(name for name in compared if isinstance(values[name], _CONTAINERS))
        # A part is compared by what is in it.
        plain = [name for name in compared if name not in self._contents and not _has_identity(values[name])]
        self._plain = _getter(plain)
        self.is_compared = bool(plain or self._instants or self._contents)

    def values(self) -> tuple[Any, ...]:
        found = self._get(self.item)
        return found if len(self.names) != 1 else (found,)

    def fingerprint(self, now: int) -> tuple[Hashable, ...]:
        item = self.item
        found: list[Hashable] = [self._plain(item)]
        for name, age in self._instants:
            instant: int = getattr(item, name)
            found.append(min(now - instant, age) if instant > 0 else None)
        found += [_content(getattr(item, name)) for name in self._contents]
        return tuple(found)


class Checkpoint(NamedTuple):
    """The parts of a moment and what each of them had."""

    parts: tuple[_Part, ...]
    values: tuple[tuple[Any, ...], ...]


class Checkpoints:
    """Steps, saves and restores one machine; the feedback it reads is not part of it."""

    def __init__(self, machine: AxisMachine) -> None:
        self._machine = machine
        self._items = tuple(_Part(part) for part in _parts(machine, {}))

    def step(self) -> Outputs:
        """One step of the machine; behind one in which it got to know its drive it may have parts that it had not before."""
        learns = bool(self._machine.inputs.news)
        outputs = self._machine.step()
        if learns:
            self._look_again()
        return outputs

    def _look_again(self) -> None:
        names = {id(part.item): part.names for part in self._items}
        self._items = tuple(_Part(item, names.get(id(item))) for item in _parts(self._machine, {}))

    def save(self) -> Checkpoint:
        """Everything a step may change."""
        saved = []
        for part in self._items:
            values = part.values()
            if part.containers:
                copied = list(values)
                for place in part.containers:
                    copied[place] = copy.copy(copied[place])
                values = tuple(copied)
            saved.append(values)
        return Checkpoint(self._items, tuple(saved))

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back; the checkpoint can be used again."""
        self._items = checkpoint.parts
        for part, values in zip(self._items, checkpoint.values, strict=True):
            present = part.values()
            if present == values:
                continue
            item = part.item
            for name, kept, value in zip(part.names, present, values, strict=True):
                if kept is value:
                    continue
                if isinstance(kept, _CONTAINERS):
                    # The container stays the same object for whoever holds it.
                    kept.clear()
                    kept.update(value) if isinstance(kept, dict) else kept.extend(value)
                else:
                    setattr(item, name, value)

    def fingerprint(self) -> tuple[Hashable, ...]:
        """Equal for two moments of the machine from which its words and commands go on alike, whatever the time of day."""
        now = self._machine.inputs.now
        demand = self._machine.demand
        kept = self._machine.adapter.kept(demand)
        if kept is demand:
            kept = tuple([getattr(demand, name) for name in _names(demand)])
        return (kept, *[part.fingerprint(now) for part in self._items if part.is_compared])
