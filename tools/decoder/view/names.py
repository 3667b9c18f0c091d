"""The names of fields of packets, signals, objects and bits, and how to look up each.

Names are identifiers, case ignored: ``stw1.on``, ``target_velocity``, ``frame_id``. A name that the packet lacks is ``None``;
an unknown name is an error that contains it.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram
from pdgw.tools.decoder.frames.canopen.objects import ObjectNames, any_drive, encoder_catalogue
from pdgw.tools.decoder.frames.fields import Field, Raw, half_fields, identifier
from pdgw.tools.decoder.frames.records import ProcessData, Record

Value = int | float | str | bool | None
Getter = Callable[[Record, ProcessData | None], Value]

TEXT_PART: Final = "text"
"""``statusword.text`` is the text of a value, in the notation of bits."""


def _attribute(name: str) -> Getter:
    def get(record: Record, _unit: ProcessData | None) -> Value:
        value: Value = getattr(record, name, None)
        return value

    return get


def _of_unit_or_record(name: str) -> Getter:
    def get(record: Record, unit: ProcessData | None) -> Value:
        value: Value = getattr(unit, name) if unit is not None else getattr(record, name, None)
        return value

    return get


def _of_layout(name: str) -> Getter:
    def get(_record: Record, unit: ProcessData | None) -> Value:
        value = getattr(unit.layout, name) if unit is not None else None
        return value or None

    return get


def _direction(record: Record, _unit: ProcessData | None) -> Value:
    direction = getattr(record, "direction", None)
    return direction.value if direction is not None else None


def _milliseconds(name: str) -> Getter:
    def get(record: Record, _unit: ProcessData | None) -> Value:
        duration_ns = getattr(record, name, None)
        return None if duration_ns is None else duration_ns / MS

    return get


def _pdo(record: Record, _unit: ProcessData | None) -> Value:
    layout = getattr(record, "layout", None)
    return getattr(layout, "name", None)


RECORD_NAMES: Final[dict[str, Getter]] = {
    "number": _attribute("number"),
    "time": lambda record, _: record.time_ns / SECOND,
    "bus": lambda record, _: record.bus.value,
    "channel": _attribute("channel"),
    "kind": _attribute("kind"),
    "length": lambda record, _: len(record.data),
    "axis": _of_unit_or_record("axis"),
    "node": _of_unit_or_record("node"),
    "iops": _of_unit_or_record("iops"),
    "iocs": _of_unit_or_record("iocs"),
    "telegram": _of_layout("telegram"),
    "direction": _direction,
    "frame_id": _attribute("frame_id"),
    "cycle_counter": _attribute("cycle_counter"),
    "data_status": _attribute("data_status"),
    "transfer_status": _attribute("transfer_status"),
    "tick": lambda record, _: getattr(record, "tick", 0) or None,
    "age_ms": _milliseconds("age_ns"),
    "cob_id": _attribute("cob_id"),
    "pdo": _pdo,
    "command": _attribute("command"),
    "state": _attribute("state"),
    "previous": _attribute("previous"),
    "code": _attribute("code"),
    "register": _attribute("register"),
    "step": _attribute("step"),
    "index": _attribute("index"),
    "subindex": _attribute("subindex"),
    "object": lambda record, _: getattr(record, "name", None) or None,
    "abort": _attribute("abort"),
    "latency_ms": _milliseconds("latency_ns"),
    "text": lambda record, _: record.summary or None,
}
"""Fields of packets; the others come from telegrams and objects."""
_TEXTS: Final = frozenset(("bus", "channel", "kind", "direction", "pdo", "step", "object", "text"))


def part_value(field: Field, raw: Raw, part: str) -> Value:
    """The value of a field, of one of its bits, or its text."""
    if isinstance(raw, bytes):
        return raw.hex() if not part else None
    if not part:
        value = field.value(raw)
        return None if isinstance(value, bytes) else value
    if not isinstance(raw, int):
        return None
    if part == TEXT_PART:
        return field.explain(raw) if field.explain else None
    bit = field.bit(part)
    return None if bit is None else bit.of(raw)


class Names:
    """All valid names: fields of packets, signals of the telegrams, objects of the given dictionaries."""

    def __init__(
        self,
        dictionaries: Iterable[ObjectNames] = (),
        telegrams: Iterable[Telegram] = TELEGRAMS.values(),
        families: Families = NO_CHOICE,
    ) -> None:
        self._parts: dict[str, set[str]] = {}
        for telegram in telegrams:
            for direction in Direction:
                for field in half_fields(telegram.half(direction), families):
                    self._add(field)
        for names in (any_drive(families), encoder_catalogue(), *dictionaries):
            for field in names.fields():
                self._add(field)

    def _add(self, field: Field) -> None:
        parts = self._parts.setdefault(field.identifier, set())
        parts.update(bit.name.lower() for bit in field.bits)
        if field.explain:
            parts.add(TEXT_PART)

    def getter(self, text: str) -> Getter:
        """A function that reads ``name`` or ``name.part``; ProfidriveError names an unknown one."""
        name, part = self.split(text)
        if name in RECORD_NAMES:
            return RECORD_NAMES[name]

        def get(_record: Record, unit: ProcessData | None) -> Value:
            if unit is None:
                return None
            position = unit.layout.positions.get(name)
            return None if position is None else part_value(unit.layout.fields[position], unit.values[position], part)

        return get

    def is_text(self, text: str) -> bool:
        """Whether the values of a name are texts."""
        name, part = self.split(text)
        return part == TEXT_PART or name in _TEXTS

    def split(self, text: str) -> tuple[str, str]:
        """Identifier and part of a name, checked; ProfidriveError names an unknown one."""
        head, _, part = text.strip().partition(".")
        name, part = identifier(head), part.strip().lower()
        if name in RECORD_NAMES:
            if part:
                raise ProfidriveError("name", text, f"{name} alone, it has no parts")
            return name, ""
        parts = self._parts.get(name)
        if parts is None:
            raise ProfidriveError("name", text, _suggest(name, [*self._parts, *RECORD_NAMES]))
        if part and part not in parts:
            raise ProfidriveError(f"part of {head}", part, _suggest(part, sorted(parts)) if parts else "no part")
        return name, part


def _suggest(name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return ", ".join(close) if close else "a field of a packet, a signal or an object"
