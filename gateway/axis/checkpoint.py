"""Take a machine back to a moment: a replay tries steps and undoes them.

A machine is made of parts: objects with attributes of their own that live as long as the machine does, or, where an attribute was
none of them at first, as long as the drive's configuration (DSC, interpolation). Everything else an attribute can be is an
immutable value, or a container of such.
"""

from __future__ import annotations

import copy
import enum
from collections import deque
from collections.abc import Callable, Hashable, Iterator
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


def _is_part(value: object) -> bool:
    kind = type(value)
    frozen = getattr(getattr(kind, "__dataclass_params__", None), "frozen", False)
    return (
        kind.__module__.startswith(_PACKAGE)
        and not isinstance(value, (*_VALUES, type))
        and not callable(value)
        and not frozen
    )


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


class _Part:
    """One part with its getter; ``containers`` are the places of attributes that are changed in place."""

    __slots__ = ("containers", "get", "item", "names")

    def __init__(self, item: object) -> None:
        self.item = item
        self.names = tuple(name for name in _names(item) if not _is_fixed(getattr(item, name)))
        self.get: Callable[[Any], Any] = attrgetter(*self.names) if self.names else _nothing
        values = self.values()
        self.containers = tuple(i for i, value in enumerate(values) if isinstance(value, _CONTAINERS))

    def values(self) -> tuple[Any, ...]:
        found = self.get(self.item)
        return found if len(self.names) != 1 else (found,)


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
        seen: dict[int, object] = {id(part.item): part.item for part in self._items}
        found = [
            _Part(item)
            for part in self._items
            for value in part.values()
            if _is_part(value)
            for item in _parts(value, seen)
        ]
        self._items = (*self._items, *found)

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
            item = part.item
            for place, (name, value) in enumerate(zip(part.names, values, strict=True)):
                if place in part.containers:
                    # The container stays the same object for whoever holds it.
                    kept = getattr(item, name)
                    kept.clear()
                    kept.update(value) if isinstance(kept, dict) else kept.extend(value)
                else:
                    setattr(item, name, value)

    def fingerprint(self) -> tuple[Hashable, ...]:
        """Equal for two moments of the machine from which its words and commands go on alike."""
        return tuple(
            value for part in self._items for place, value in enumerate(part.values()) if place not in part.containers
        )
