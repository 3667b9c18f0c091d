"""Restore a machine to a moment, and compare two moments, for the walk.

A machine is made of parts: objects with attributes of their own that live as long as the machine does, or, where an attribute was
none of them at first, as long as the drive's configuration (DSC). Everything else an attribute can be is an
immutable value, or a container of such. ``declarations`` lists the attributes that are not plain state.
"""

from __future__ import annotations

import copy
import enum
from collections import deque
from collections.abc import Callable, Collection, Hashable, Iterable
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.gateway.axis.machine import AxisMachine
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.values import Outputs
from pdgw.profidrive.normalisation import Normalisation
from pdgw.profidrive.telegrams import Telegram
from tests.long.walk.declarations import OF, kept

_CONTAINERS = (list, dict, deque)
_PACKAGE = "pdgw."
_VALUES = (enum.Enum, Normalisation, DriveFeedback)
"""Objects that no step changes."""
_FIXED = (Telegram, AxisSettings, DriveFeedback, MappingProxyType)
"""Attributes of a part that never change."""


def _names(item: object) -> tuple[str, ...]:
    """The attributes of an object."""
    kinds = type(item).__mro__
    # Compiled classes list their attributes under another name.
    declared = [name for kind in kinds for name in getattr(kind, "__slots__", getattr(kind, "__mypyc_attrs__", ()))]
    names = dict.fromkeys([*declared, *getattr(item, "__dict__", ())])
    return tuple(name for name in names if not name.startswith("__") and hasattr(item, name))


@cache
def _is_kind_of_part(kind: Any) -> bool:
    # Objects compared only by content are values, and are replaced as a whole.
    by_identity = kind.__hash__ is None or kind.__hash__ is object.__hash__
    frozen = getattr(getattr(kind, "__dataclass_params__", None), "frozen", False)
    return (
        kind.__module__.startswith(_PACKAGE) and by_identity and not issubclass(kind, (*_VALUES, type)) and not frozen
    )


def _is_part(value: object) -> bool:
    kind: Any = type(value)
    return _is_kind_of_part(kind) and not callable(value)


def _is_fixed(value: object) -> bool:
    """Whether an attribute keeps this value permanently."""
    return _is_part(value) or callable(value) or isinstance(value, _FIXED)


@cache
def _declared(kind: Any, declaration: str) -> frozenset[str]:
    """The attributes that a class and its bases list in one of these declarations."""
    return frozenset(name for base in kind.__mro__ for name in OF.get(base, {}).get(declaration, ()))


@cache
def _access(*names: str) -> tuple[Callable[[Any], tuple[Any, ...]], Callable[[Any, tuple[Any, ...]], None]]:
    """Generated functions that get and set these attributes of an object: loops over names take five times as long."""
    attributes = "".join(f"item.{name}," for name in names)
    made: dict[str, Any] = {}
    exec(f"def get(item): return ({attributes})\ndef put(item, values): ({attributes}) = values", made)
    return made["get"], made["put"]


@cache
def _picking(*terms: str) -> Callable[[Any, tuple[Any, ...]], tuple[Hashable, ...]]:
    """A generated function that collects the compared values of a part."""
    made: dict[str, Any] = {}
    exec(f"def pick(kind, values): return (kind, {''.join(f'{term},' for term in terms)})", made)
    pick: Callable[[Any, tuple[Any, ...]], tuple[Hashable, ...]] = made["pick"]
    return pick


class _Part:
    """One part of the machine. ``names``: saved attributes; ``values``: their values at the last comparison; ``number``: of the
    compared state."""

    __slots__ = (
        "_always",
        "_awake",
        "_children",
        "_compared",
        "_containers",
        "_counters",
        "_kind",
        "_looked_through",
        "_masks",
        "_pick",
        "_put",
        "get",
        "instants",
        "item",
        "names",
        "number",
        "serials",
        "values",
    )

    def __init__(self, item: object, *, any_counter: bool, stops: bool, data: bool) -> None:
        self.item = item
        kind: Any = type(item)
        self._kind = kind
        passing, aside = _declared(kind, "PASSING"), _declared(kind, "ASIDE")
        awake: tuple[str, Collection[object]] | None = None
        if not stops:
            aside |= _declared(kind, "SUPERVISION")
            awake = OF.get(kind, {}).get("WHILE")
        if not data:
            aside |= _declared(kind, "DATA")
        every = [name for name in _names(item) if name not in passing]
        self._always = [value for value in (getattr(item, name) for name in every) if _is_part(value)]
        """Permanent parts of the machine."""
        self._looked_through: object = None
        self._children: list[object] = []
        names = self.names = tuple(name for name in every if not _is_fixed(getattr(item, name)))
        self.get, self._put = _access(*names)
        self._awake = None if awake is None else (names.index(awake[0]), awake[1])
        self.values: tuple[Any, ...] = ()
        self.number = -1
        values = self.get(item)
        self._containers = tuple(i for i, value in enumerate(values) if isinstance(value, _CONTAINERS))
        ages: dict[str, int] = {}
        for base in kind.__mro__ if "*" not in aside else ():
            instants = OF.get(base, {}).get("INSTANTS", {})
            ages |= instants(item) if callable(instants) else instants
        self.instants = tuple((i, ages[name]) for i, name in enumerate(names) if name in ages)
        serials = _declared(kind, "SERIALS")
        self.serials = tuple(i for i, name in enumerate(names) if name in serials)
        counters = _declared(kind, "COUNTERS") if any_counter else frozenset()
        self._counters = [i for i, name in enumerate(names) if name in counters]
        apart = aside | serials | counters | set(ages)
        self._compared = [] if "*" in aside else [i for i, name in enumerate(names) if name not in apart]
        bits = {name: mask for base in kind.__mro__ for name, mask in OF.get(base, {}).get("BITS", {}).items()}
        self._masks = {i: bits[name] for i, name in enumerate(names) if name in bits}
        self._make_pick()

    def _make_pick(self) -> None:
        terms = [f"values[{i}]" + (f" & {self._masks[i]}" if i in self._masks else "") for i in self._compared]
        for place, i in enumerate(self._compared):
            if i in self._containers:
                items = ".items()" if isinstance(getattr(self.item, self.names[i]), dict) else ""
                terms[place] = f"tuple(values[{i}]{items})"
        self._pick = _picking(*terms, *(f"values[{i}] != 0" for i in self._counters))

    @property
    def is_compared(self) -> bool:
        """Its values count at the moment."""
        return self._awake is None or self.values[self._awake[0]] in self._awake[1]

    def take(self, values: tuple[Any, ...], numbers: dict[Hashable, int]) -> None:
        """Take note of other values. ``numbers``: of every content that there was."""
        if self._containers:
            copied = list(values)
            for place in self._containers:
                copied[place] = copy.copy(copied[place])
            values = tuple(copied)
        self.values = values
        content = self._pick(self._kind, values) if self.is_compared else (self._kind,)
        number = numbers.get(content)
        if number is None:
            number = numbers[content] = len(numbers)
        self.number = number

    def children(self) -> list[object]:
        """The parts it has now. One in the place of None is compared as a part from then on."""
        if self._looked_through is not self.values:
            self._looked_through = self.values
            places = [i for i, value in enumerate(self.values) if _is_part(value)]
            if not set(places).isdisjoint(self._compared):
                self._compared = [i for i in self._compared if i not in places]
                self._make_pick()
                self.number = -1
            self._children = [*self._always, *(self.values[i] for i in places)]
        return self._children

    def put(self, values: tuple[Any, ...], number: int) -> None:
        """Store the present values."""
        item = self.item
        if self._containers:
            # A container stays the same object for all its users.
            present = list(values)
            for i in self._containers:
                container, value = getattr(item, self.names[i]), values[i]
                container.clear()
                container.update(value) if isinstance(container, dict) else container.extend(value)
                present[i] = container
            self._put(item, tuple(present))
        else:
            self._put(item, values)
        self.values, self.number = values, number


class Checkpoint(NamedTuple):
    """The parts of a moment, and what each of them had."""

    parts: tuple[_Part, ...]
    values: tuple[tuple[Any, ...], ...]
    numbers: tuple[int, ...]


class Checkpoints:
    """Step, save and restore one machine that nothing else changes; the feedback it reads is not part of it.

    ``any_counter``: every input is relative to the machine's counters (``COUNTERS``), so one counter represents all others.
    ``stops``: the supervision of stops is compared too (``SUPERVISION``). ``data``: so is what the last motion leaves in the
    RPDOs (``DATA``).
    """

    def __init__(
        self, machine: AxisMachine, *, any_counter: bool = False, stops: bool = False, data: bool = True
    ) -> None:
        self._machine = machine
        self._stops = stops
        self._data = data
        self._any_counter = any_counter
        self._numbers: dict[Hashable, int] = {}
        self._tree: dict[int, _Part] = {}
        self._parts: tuple[_Part, ...] = ()
        self._instants: tuple[tuple[_Part, int, int], ...] = ()
        self._serials: tuple[tuple[_Part, int], ...] = ()
        self._look_again()
        self._is_fresh = False
        """Whether the stored values are the present ones."""

    def step(self) -> Outputs:
        """One step of the machine. After a step in which the drive became known, the machine may have new parts."""
        self._is_fresh = False
        learns = bool(self._machine.inputs.news)
        outputs = self._machine.step()
        if learns:
            self._look_again()
        return outputs

    def _look_again(self) -> None:
        known, found = self._tree, dict[int, _Part]()
        waiting: list[object] = [self._machine]
        while waiting:
            item = waiting.pop()
            if id(item) not in found:
                part = found[id(item)] = known.get(id(item)) or _Part(
                    item, any_counter=self._any_counter, stops=self._stops, data=self._data
                )
                self._look([part])
                waiting += part.children()
                self._look([part])  # its content has another number if a part has come to the place of None
        self._tree = found
        parts = tuple(part for part in found.values() if part.names)
        if parts != self._parts:
            self._take(parts)
        self._is_fresh = True

    def _take(self, parts: tuple[_Part, ...]) -> None:
        self._parts = parts
        self._instants = tuple((part, i, age) for part in parts for i, age in part.instants)
        self._serials = tuple((part, i) for part in parts for i in part.serials)

    def _look(self, parts: Iterable[_Part]) -> None:
        for part in parts:
            values = part.get(part.item)
            if values != part.values or part.number < 0:
                part.take(values, self._numbers)

    def save(self) -> Checkpoint:
        """Everything a step may change."""
        parts = self._parts
        self._look(parts)
        self._is_fresh = True
        return Checkpoint(parts, tuple([part.values for part in parts]), tuple([part.number for part in parts]))

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go back; the checkpoint can be used again."""
        parts = checkpoint.parts
        if parts is not self._parts:
            self._take(parts)
            self._is_fresh = False
        fresh = self._is_fresh
        for part, values, number in zip(parts, checkpoint.values, checkpoint.numbers, strict=True):
            if part.values is not values if fresh else part.get(part.item) != values:
                part.put(values, number)
            else:
                part.values, part.number = values, number
        self._is_fresh = True

    def fingerprint(self) -> tuple[Hashable, ...]:
        """Equal for two moments of the machine after which its words and commands are equal, whatever the time of day. Values
        of two machines are not comparable."""
        if not self._is_fresh:
            self._look(self._parts)
            self._is_fresh = True
        now, demand = self._machine.inputs.now, self._machine.demand
        found: list[Any] = []
        for item in kept(self._machine.adapter, demand):
            found += [getattr(item, name) for name in _names(item)] if _is_part(item) else [item]
        found = [tuple(found)]
        found += [part.number for part in self._parts]
        for part, i, age in self._instants:
            instant: int = part.values[i] if part.is_compared else -1
            found.append(min(now - instant, age) if instant > 0 else instant - 1)
        if self._serials:
            serials = [part.values[i] for part, i in self._serials]
            ranks = {serial: rank for rank, serial in enumerate(sorted({0, *serials}))}
            found += [ranks[serial] for serial in serials]
        return tuple(found)
