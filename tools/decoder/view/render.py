"""Records as text (one line, or the full tree), and chosen names of every packet as rows for tables and curves.

There is one row for each unit (each packet without units) that has at least one of the chosen signals or of the fields not
every packet has; when only such common fields are chosen, for all. Where no filter selects units, rows come straight from the
unpacked frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pdgw.base.durations import SECOND
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord, PdoRecord
from pdgw.tools.decoder.frames.profinet.connect import StationRecord
from pdgw.tools.decoder.frames.records import AcyclicRecord, CyclicRecord, ProcessData, ProcessDataLayout, Record
from pdgw.tools.decoder.view.names import RECORD_NAMES, Getter, Names, Value, part_value

Row = list[Value]
_Cell = tuple[int, int, Callable[[Any], Value] | None]
"""Column, position of the value, and its conversion (None: no conversion)."""
_Plan = tuple[Row, tuple[_Cell, ...], tuple[tuple[int, Getter], ...], ProcessData | None]
"""Row with what never changes, cells to fill, fields to ask for, and the unit it is of."""
_CYCLIC_POSITIONS = {"frame_id": 0, "cycle_counter": -3, "data_status": -2, "transfer_status": -1}
"""Positions of header and trailer in ``CyclicRecord.values``."""
_OF_LAYOUT = frozenset(("axis", "node", "telegram", "direction", "pdo", "kind", "bus"))
"""Fields that all packets of one layout have alike."""
_COMMON = frozenset(
    (
        "number",
        "time",
        "bus",
        "channel",
        "kind",
        "length",
        "text",
        "axis",
        "node",
        "telegram",
        "direction",
        "iops",
        "iocs",
    )
)
"""Fields that make no row where others are chosen."""
_CHANGING = frozenset(("iops", "iocs"))
"""Fields of units that differ from packet to packet."""


class Columns:
    """Rows of the names; ProfidriveError for one that is not known."""

    def __init__(self, titles: Sequence[str], names: Names) -> None:
        self.titles = tuple(titles)
        self._split = [names.split(title) for title in titles]
        self._own = [(i, RECORD_NAMES[name]) for i, (name, _) in enumerate(self._split) if name in RECORD_NAMES]
        self._signals = [(i, name, part) for i, (name, part) in enumerate(self._split) if name not in RECORD_NAMES]
        self._deciding = [i for i, (name, _) in enumerate(self._split) if name not in _COMMON]
        self._straight = not any(name in _CHANGING for name, _ in self._split)
        self._empty: Row = [None] * len(titles)
        self._plans: dict[int, tuple[object, tuple[_Plan, ...]]] = {}

    def rows(self, record: Record) -> list[tuple[ProcessData | None, Row]]:
        """The rows of a packet, each with the unit it is of (whose values may be those of an earlier packet)."""
        if not self._straight or not isinstance(record, CyclicRecord | PdoRecord):
            return self.unit_rows(record, record.units)
        known = self._plans.get(id(record.layout))
        if known is None or known[0] is not record.layout:
            known = self._plans[id(record.layout)] = (record.layout, self._plan(record))
        if not known[1]:
            return []
        values: Sequence[Any] = record.values if isinstance(record, CyclicRecord) else record.layout.unpack(record.data)
        rows: list[tuple[ProcessData | None, Row]] = []
        for template, cells, own, unit in known[1]:
            row = template.copy()
            for column, position, change in cells:
                row[column] = values[position] if change is None else change(values[position])
            for column, getter in own:
                row[column] = getter(record, unit)
            rows.append((unit, row))
        return rows

    def unit_rows(self, record: Record, units: Sequence[ProcessData]) -> list[tuple[ProcessData | None, Row]]:
        """The rows of these units; of the packet itself when there are none."""
        rows = ((unit, self._row(record, unit)) for unit in units or (None,))
        return [(unit, row) for unit, row in rows if self._worth(row)]

    def _row(self, record: Record, unit: ProcessData | None) -> Row:
        row = self._empty.copy()
        for column, getter in self._own:
            row[column] = getter(record, unit)
        if unit is not None:
            for column, name, part in self._signals:
                position = unit.layout.positions.get(name)
                if position is not None:
                    row[column] = part_value(unit.layout.fields[position], unit.values[position], part)
        return row

    def _worth(self, row: Row) -> bool:
        return not self._deciding or any(row[column] is not None for column in self._deciding)

    def _plan(self, record: CyclicRecord | PdoRecord) -> tuple[_Plan, ...]:
        """Sources of the columns, for all packets of this layout."""
        units: Sequence[ProcessData | None] = record.units or (None,)
        cyclic = isinstance(record, CyclicRecord)
        firsts = [axis[3] for axis in record.layout.axes] if isinstance(record, CyclicRecord) else [0]
        plans: list[_Plan] = []
        for unit, first in zip(units, firsts or [0], strict=True):
            row = self._row(record, unit)
            if not self._worth(row):
                continue
            cells = list(self._cells(unit.layout, first)) if unit is not None else []
            own = []
            template = self._empty.copy()
            for column, getter in self._own:
                name = self._split[column][0]
                if cyclic and name in _CYCLIC_POSITIONS:
                    cells.append((column, _CYCLIC_POSITIONS[name], None))
                elif name in _OF_LAYOUT:
                    template[column] = row[column]
                elif row[column] is not None:
                    own.append((column, getter))
            plans.append((template, tuple(cells), tuple(own), unit))
        return tuple(plans)

    def _cells(self, layout: ProcessDataLayout, first: int) -> Iterator[_Cell]:
        for column, name, part in self._signals:
            position = layout.positions.get(name)
            if position is None:
                continue
            field = layout.fields[position]
            change: Callable[[Any], Value] | None = field.convert
            if part:
                change = lambda raw, field=field, part=part: part_value(field, raw, part)  # noqa: E731
            yield column, first + position, change


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
