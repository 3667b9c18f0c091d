"""Faults of simulated CANopen nodes, like those of real devices.

A fault is a class. Its docstring describes the behaviour of the device, its fields are the parameters (default, limits,
unit), its hooks act on one ``Device``. ``SimulatedNode.start_fault`` and ``end_fault`` switch faults by name at run time. The
faults of any node are in ``faults``; a device profile adds its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, ClassVar

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import Entry
from pdgw.durations import MS
from pdgw.peers.node.device import Device

HEX = "hex"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a fault: an integer with its limits."""

    name: str
    default: int
    low: int
    high: int
    unit: str
    meaning: str

    def text(self, value: int) -> str:
        """A value as in documents. The unit "hex" only marks codes and bit patterns."""
        return f"{value:04X}h" if self.unit == HEX else f"{value} {self.unit}".rstrip()


def parameter(default: int, low: int, high: int, meaning: str, unit: str = "") -> Any:
    """A field of a fault that the user can set."""
    return field(default=default, metadata={"low": low, "high": high, "meaning": meaning, "unit": unit})


@dataclass(kw_only=True, eq=False)
class Misbehaviour:
    """An active fault of one node. ``node`` is set before the first hook. The hooks of the base class change nothing."""

    name: ClassVar[str]
    at_configuration: ClassVar[bool] = False
    """Visible only while a master configures the node: set it before power-on, or restart the node."""

    node: Device = field(init=False, repr=False)

    def begin(self) -> None:
        """Start the fault; at power-on before the boot-up message."""

    def end(self) -> None:
        """End the fault."""

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

    def writing(self, entry: Entry, data: bytes) -> None:
        """Start of an SDO download to the entry; raises ``SdoAbortedError`` to abort it."""

    @classmethod
    def description(cls) -> str:
        """The docstring as one line."""
        return " ".join((cls.__doc__ or "").split())

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """The parameters in the order of declaration."""
        found = []
        for item in fields(cls):
            if item.metadata:
                about = item.metadata
                default = int(item.default)  # type: ignore[arg-type]  # `parameter` gives each one
                found.append(Parameter(item.name, default, **about))
        return tuple(found)

    @property
    def values(self) -> dict[str, int]:
        """The active parameter values."""
        return {item.name: getattr(self, item.name) for item in self.parameters()}


Catalogue = Mapping[str, type[Misbehaviour]]


def catalogue(*groups: Iterable[type[Misbehaviour]]) -> Catalogue:
    """Faults by name."""
    return MappingProxyType({item.name: item for group in groups for item in group})


def make(known: Catalogue, name: str, values: Mapping[str, object]) -> Misbehaviour:
    """Create a fault of the catalogue with these parameters. CanopenError names an unknown name or a value out of range."""
    kind = known.get(name)
    if kind is None:
        raise CanopenError("fault", name, f"one of {', '.join(known)}")
    allowed = {item.name: item for item in kind.parameters()}
    chosen: dict[str, int] = {}
    for key, value in values.items():
        item = allowed.get(key)
        if item is None:
            raise CanopenError(f"fault {name} parameter", key, ", ".join(allowed) or "no parameter")
        if not isinstance(value, int) or isinstance(value, bool) or not item.low <= value <= item.high:
            raise CanopenError(f"fault {name} {key}", value, f"{item.text(item.low)} to {item.text(item.high)}")
        chosen[key] = value
    return kind(**chosen)


# -- common parts of faults -----------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class Late(Misbehaviour):
    """Delays frames by ``delay_ms`` and keeps their order. A subclass selects them in ``outgoing`` and ``incoming``."""

    _held: deque[tuple[int, bool, int, bytes]] = field(init=False, repr=False, default_factory=deque)

    delay_ms: int = parameter(1, 1, 10_000, "delay of each frame", "ms")

    def _hold(self, out: bool, can_id: int, data: bytes) -> bool:
        self._held.append((self.node.now + self.delay_ms * MS, out, can_id, data))
        return False

    def poll(self, now: int) -> None:
        while self._held and now >= self._held[0][0]:
            self._release()

    def next_event(self, now: int) -> int | None:
        return self._held[0][0] if self._held else None

    def end(self) -> None:
        while self._held:
            self._release()

    def _release(self) -> None:
        _, out, can_id, data = self._held.popleft()
        if out:
            self.node.transmit(can_id, data, past=self)
        else:
            self.node.receive(can_id, data, self.node.now, past=self)
