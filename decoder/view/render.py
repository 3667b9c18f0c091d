"""Records as text: one line, or the full tree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pdgw.decoder.frames.canopen.records import CanRecord, PdoRecord
from pdgw.decoder.frames.profinet.records import StationRecord
from pdgw.decoder.frames.records import AcyclicRecord, CyclicRecord, ProcessData, Record
from pdgw.durations import SECOND
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Direction


def unit_head(unit: ProcessData) -> str:
    """Whose process data it is."""
    if unit.layout.direction is None:
        return ""
    head = f"axis {unit.axis} T{unit.layout.telegram}"
    if unit.iops != IOPS_GOOD:
        head += f" IOPS {unit.iops:02X}h"
    if unit.iocs != IOPS_GOOD:
        head += f" IOCS {unit.iocs:02X}h"
    return head


def source_text(record: Record) -> str:
    """The source: direction of a frame, COB-ID and node of a CAN frame."""
    if isinstance(record, CyclicRecord):
        if record.direction is None:
            return "frame"
        return "PLC ->" if record.direction is Direction.SETPOINT else "PLC <-"
    if isinstance(record, CanRecord):
        return f"{record.cob_id:03X}" + (f" n{record.node}" if record.node else "")
    if isinstance(record, AcyclicRecord) and not isinstance(record, StationRecord):
        return "acyclic"
    return record.kind


def line_parts(record: Record, units: Sequence[ProcessData] | None = None) -> tuple[str, str, str]:
    """Source, kind's text and values of the one line; ``units`` replaces the record's own."""
    values = []
    for unit in record.units if units is None else units:
        shown = [unit_head(unit), *(item.text(raw) for item, raw in unit.items())]
        values.append(" ".join(part for part in shown if part))
    text = record.summary
    if isinstance(record, CanRecord):
        text = f"{record.kind.upper()} {text}".rstrip() if not isinstance(record, PdoRecord) else text
        if type(record) is CanRecord:
            text = f"{record.text + ' ' if record.text else ''}[{record.data.hex(' ')}]"
    return source_text(record), text, " | ".join(values)


def record_line(record: Record, zero_ns: int, units: Sequence[ProcessData] | None = None) -> str:
    """One line: number, seconds since ``zero_ns``, bus, source, content."""
    source, text, values = line_parts(record, units)
    said = " | ".join(part for part in (text, values) if part)
    seconds = (record.time_ns - zero_ns) / SECOND
    return f"{record.number:6d} {seconds:12.6f} {record.bus.value} {source:<7} {said}"


def record_tree(record: Record, units: Sequence[ProcessData] | None = None) -> Iterator[str]:
    """Further lines of a record with ``-v``: every field, every bit."""
    details = record.details()
    for key, value in details.items():
        if key != "text":
            yield from _branch(key, value, 1)
    for unit in record.units if units is None else units:
        head = unit_head(unit)
        if head:
            yield f"         {head}"
        for item, raw in unit.items():
            yield f"           {item.text(raw)}  ({item.description})"
            if isinstance(raw, int):
                for bit in item.bits:
                    yield f"             {bit.name} = {bit.of(raw)}  ({bit.meaning})"


_HEXADECIMAL = {"frame_id": 4, "cob_id": 3, "index": 4, "code": 4, "register": 2, "abort": 8, "command": 2, "state": 2}
"""Number of hexadecimal digits of fields."""


def _branch(key: str, value: Any, depth: int) -> Iterator[str]:
    indent = "  " * depth + "       "
    if isinstance(value, dict):
        yield f"{indent}{key}"
        for name, item in value.items():
            yield from _branch(name, item, depth + 1)
    elif isinstance(value, list):
        for position, item in enumerate(value):
            yield from _branch(f"{key}[{position}]", item, depth)
    elif key in _HEXADECIMAL and isinstance(value, int):
        yield f"{indent}{key}: {value:0{_HEXADECIMAL[key]}X}h"
    else:
        yield f"{indent}{key}: {value}"
