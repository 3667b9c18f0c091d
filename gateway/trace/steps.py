"""Steps of drive objects as bytes, and values of the gateway as JSON."""

from __future__ import annotations

import enum
import importlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from typing import Any, Final, cast

from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.gateway.axis.encoder_machine import EncoderInputs
from pdgw.gateway.axis.values import EncoderInput, Events, Inputs, Outputs
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.objects.axis import Axis
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.objects.encoder import EncoderObject
from pdgw.gateway.trace.pcapng import GROUPS, HAS_EVENTS, LENGTH, MASK, NO_SETPOINTS, TracedObject

# Values of the gateway as JSON with named fields: frozen dataclasses, enums, fractions, bytes, tuples and mappings of them.
#
# A value has the name of its class, so a recording does not depend on the module that defines it. A reader ignores a field
# that this version does not have, and gives a new one its default.


_KIND: Final = ""
"""Key of the kind of a value that JSON does not have."""
_VALUE: Final = "is"
HOMES: Final = (
    "pdgw.ds301.objects",
    "pdgw.ds301.pdo",
    "pdgw.dsp402.drive_type",
    "pdgw.gateway.axis.executors.sensor",
    "pdgw.gateway.axis.settings",
    "pdgw.gateway.axis.values",
    "pdgw.gateway.motion.blocks",
    "pdgw.gateway.motion.dsc_setpoint",
    "pdgw.gateway.motion.requests",
    "pdgw.gateway.reasons",
    "pdgw.gateway.trace.pcapng",
)
"""Modules with the classes of recorded values."""


def to_json(value: object) -> Any:
    """Plain data for ``json.dumps``; TypeError for a value of another kind."""
    kind = type(value)
    if isinstance(value, enum.Enum):
        return {_KIND: kind.__name__, _VALUE: value.name}
    if value is None or isinstance(value, str | int | float):
        return value
    if is_dataclass(value):
        return {_KIND: kind.__name__} | {item.name: to_json(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {_KIND: "dict", _VALUE: [[to_json(key), to_json(item)] for key, item in value.items()]}
    if isinstance(value, tuple | list):
        return [to_json(item) for item in value]
    if isinstance(value, frozenset):
        return {_KIND: "frozenset", _VALUE: [to_json(item) for item in sorted(value)]}
    if isinstance(value, bytes):
        return {_KIND: "bytes", _VALUE: value.hex()}
    if isinstance(value, Fraction):
        return {_KIND: "Fraction", _VALUE: str(value)}
    raise TypeError(f"{kind.__name__} cannot be recorded")


def from_json(value: Any) -> Any:
    """The value of plain data; lists become tuples. GatewayError for a kind that this version does not have."""
    if isinstance(value, list):
        return tuple(from_json(item) for item in value)
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind in _BUILT_IN:
        return _BUILT_IN[kind](from_json(value[_VALUE]))
    made = recorded_class(kind)
    if issubclass(made, enum.Enum):
        return made[value[_VALUE]]
    return made(**{item.name: from_json(value[item.name]) for item in fields(made) if item.name in value})


_BUILT_IN: Final[dict[str, Any]] = {
    "dict": dict,
    "frozenset": frozenset,
    "bytes": bytes.fromhex,
    "Fraction": Fraction,
}


def recorded_class(name: str) -> Any:
    """The dataclass or enum with this name. GatewayError: there is none."""
    kind = name.rpartition(".")[2]  # 0.9.0 wrote the module before it
    for home in HOMES:
        found = getattr(importlib.import_module(home), kind, None)
        if is_dataclass(found) or (isinstance(found, type) and issubclass(found, enum.Enum)):
            return found
    raise GatewayError(f"{name}: this version has no such value")


# The step of a drive object as bytes: what its machine was given and what it decided, as far as it changed.


_SENSOR: Final = (
    "position",
    "position_time",
    "speed",
    "alarms",
    "warnings",
    "error_register",
    "error_code",
    "valid",
)
"""The values of an encoder, as ``EncoderInput`` has them."""
NO_SPEED: Final = -(1 << 63)
"""Recorded speed of an encoder without a speed."""
_SETPOINTS: Final = 1
_NOTHING: Final = MASK.pack(0)
_UNKNOWN: Final[tuple[Any, ...]] = (0, *([None] * len(GROUPS)))
"""The values before the first step: setpoints are None where there is no PLC."""


EVENTS: Final = tuple(sorted(item.name for item in fields(Events)))
"""What a step reports in ``Outputs.events``."""


def _numbers(item: object) -> dict[str, type]:
    """The attributes with a number, by name; of a new object, because this makes all later accesses to its attributes slow."""
    kinds = ((name, type(getattr(item, name))) for name in dir(item) if name.islower() and not name.startswith("_"))
    return {name: kind for name, kind in kinds if issubclass(kind, int)}


def _given(item: object) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of flags and of numbers."""
    found = _numbers(item)
    flags = tuple(name for name, kind in found.items() if kind is bool)
    return flags, tuple(name for name in found if name not in {*flags, "now"})


_AXIS: Final = _given(Inputs(DriveFeedback()))
_ENCODER: Final = _given(EncoderInputs(cast("EncoderInput", None)))
_DECIDED: Final = tuple(name for name in _numbers(Outputs(0, None)) if name != "saturations")


class StepRecord:
    """Records one drive object until its telegram changes."""

    def __init__(self, item: DriveObject) -> None:
        assert isinstance(item, Axis | EncoderObject)
        self._item = item
        machine = item.machine
        self._outputs: Outputs = machine.outputs
        setpoints = item.telegram.setpoints
        flags, numbers = _AXIS if isinstance(item, Axis) else _ENCODER
        decided = _DECIDED
        given: dict[str, object] = {"i": machine.inputs, "o": machine.outputs, "log": item.fault_log}
        names = {"flags": flags, "numbers": numbers, "decided": (*decided, "reason", "faults")}
        terms = {
            "flags": [f"i.{name}" for name in flags],
            "numbers": [f"i.{name}" for name in numbers],
            "decided": [
                *(f"o.{name}" for name in decided),
                "0 if o.reason is None else o.reason.code",
                "log.count",
            ],
        }
        sources: list[object] = []
        if isinstance(item, Axis):
            layout = item.drive.layout
            given |= {"f": item.drive.feedback, "c": machine.outputs.command}
            mapped = [name for pdo in layout.tpdos for name in pdo.attributes]
            names["feedback"] = tuple(dict.fromkeys((*mapped, "position_actual")))
            names["command"] = tuple(dict.fromkeys(name for pdo in layout.rpdos for name in pdo.attributes))
            for group, letter in (("feedback", "f"), ("command", "c")):
                terms[group] = [f"{letter}.{name}" for name in names[group]]
            sources = list(item.machine.inputs.encoders)
        else:
            sources = [item.machine.inputs.source]
        found = [(place, source) for place, source in enumerate(sources) if source is not None]
        given |= {f"e{place}": source for place, source in found}
        names["sensors"] = tuple(f"{place}.{name}" for place, _ in found for name in (*_SENSOR, "ok"))
        terms["sensors"] = [
            term
            for place, _ in found
            for term in (*(_sensor_term(f"e{place}", name) for name in _SENSOR), _ok_term(item, place))
        ]
        names["setpoints"] = setpoints.names
        texts = [f"({''.join(f'{term},' for term in terms.get(group, ()))})" for group in GROUPS[1:]]
        # Generated, because a loop over names takes three times as long.
        orders = "(o.writes, o.probe, *o.presets)"
        self._read: Callable[[], tuple[Any, ...]] = eval(f"lambda: (i.setpoints, {', '.join(texts)}, {orders})", given)
        self.traced = TracedObject(
            item.do_id,
            item.kind,
            item.node_id,
            item.network.name,
            item.telegram.number,
            {group: tuple(names.get(group, ())) for group in GROUPS},
        )
        self._pack_setpoints = setpoints.struct.pack
        self._packs = [
            (1 << number, number, struct.Struct(f">{len(names.get(group, ()))}q").pack)
            for number, group in enumerate(GROUPS)
            if number
        ]
        self._last = _UNKNOWN
        self._orders: tuple[Any, ...] = (None, None, None, None)

    @property
    def machine(self) -> object:
        """The machine whose steps are recorded."""
        return self._outputs

    def forget(self) -> None:
        """The next step is recorded with all of its values."""
        self._last = _UNKNOWN

    def take(self) -> bytes:
        """The last step; the recorder calls it in each cycle."""
        outputs, item, last = self._outputs, self._item, self._last
        values = self._last = self._read()
        mask, parts = 0, [b""]
        setpoints = values[0]
        if setpoints != last[0]:
            if setpoints is None:
                mask = NO_SETPOINTS
            else:
                mask = _SETPOINTS
                parts.append(self._pack_setpoints(*setpoints))
        for bit, number, pack in self._packs:
            group = values[number]
            if group != last[number]:
                mask |= bit
                parts.append(pack(*group))
        orders = values[-1]
        if outputs.events is not None or item.given or orders != self._orders:
            events = self._events(orders)
            if events:
                mask |= HAS_EVENTS
                parts += (LENGTH.pack(len(events)), events)
        if not mask:
            return _NOTHING
        parts[0] = MASK.pack(mask)
        return b"".join(parts)

    def _events(self, orders: tuple[Any, ...]) -> bytes:
        outputs, item = self._outputs, self._item
        document: dict[str, Any] = {}
        if item.given:
            document["given"] = [[kind, to_json(value)] for kind, value in item.given]
            item.given.clear()
        if outputs.events is not None:
            document |= {name: to_json(value) for name in EVENTS if (value := getattr(outputs.events, name))}
        if orders != self._orders:
            document["orders"] = to_json(orders)
            self._orders = orders
        return json.dumps(document).encode() if document else b""

    def begin(self) -> None:
        """The machine and its settings, before its first step."""
        item = self._item
        assert item.given is not None
        machine = item.machine
        known = [("machine", machine.settings), ("tolerate", item.sign_of_life_tolerance)]
        item.given[:0] = known


def _sensor_term(source: str, name: str) -> str:
    return f"({NO_SPEED} if {source}.speed is None else {source}.speed)" if name == "speed" else f"{source}.{name}"


def _ok_term(item: DriveObject, place: int) -> str:
    return f"i.encoders_ok[{place}]" if isinstance(item, Axis) else "i.ok"
