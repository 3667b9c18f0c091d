"""A trace of both buses as one HTML file without other files: curves, states, words with their bits, the timeline at each
mark.

``TracePage`` takes the records and entries of ``decoder.timeline.builder`` in the order of time. Repetitions are omitted.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from pdgw.base.durations import SECOND
from pdgw.dsp402.states import STATE_OF_STATUS, State
from pdgw.gateway.axis.supervision.drive_events import FAULTY
from pdgw.gateway.base.errors import writing
from pdgw.profidrive.signals import CATALOGUE
from pdgw.tools.decoder.frames.fields import Document, Field
from pdgw.tools.decoder.frames.records import CyclicRecord, ProcessData, ProcessDataLayout, Record
from pdgw.tools.decoder.timeline.entries import Anomaly, Edge, Entry
from pdgw.tools.decoder.timeline.text import entry_lines

_QUANTITIES: Final = {item.identifier: item.quantity.value for item in CATALOGUE if item.quantity is not None}
"""Set and actual values of one quantity share a panel if they have one unit. Objects of a drive have names of telegram 100."""
_STATUS_NAMES: Final = ("statusword", "zsw1", "zsw2_enc")
OPERATION, FAULT, OFF = "operation", "fault", "off"
"""States of an axis, shown as the background of its curves."""
_TEMPLATE: Final = Path(__file__).parent / "trace_page.html"
_PLACE: Final = "/*DATA*/"
MAX_POINTS: Final = 50_000
"""Most points of a curve; a longer one is thinned out."""
MAX_ENTRIES: Final = 50_000


def _state_of(layout: ProcessDataLayout) -> Callable[[Sequence[Any]], str] | None:
    """A function that reads the state of an axis from a unit; None without a status word."""
    for name in _STATUS_NAMES:
        position = layout.positions.get(name)
        if position is not None:
            return _reader(layout.fields[position], position)
    return None


def _reader(field: Field, position: int) -> Callable[[Sequence[Any]], str]:
    if field.explain is not None:

        def of_statusword(values: Sequence[Any]) -> str:
            state = STATE_OF_STATUS[values[position] & 0x7F]
            return FAULT if state in FAULTY else OPERATION if state is State.OPERATION_ENABLED else OFF

        return of_statusword
    fault, operation = (bit.mask if (bit := field.bit(name)) else 0 for name in ("fault", "operation_enabled"))

    def of_word(values: Sequence[Any]) -> str:
        word = values[position]
        return FAULT if word & fault else OPERATION if word & operation else OFF

    return of_word


class States:
    """When an axis was in operation, in fault, or off: (begin, end, state) in seconds."""

    def __init__(self) -> None:
        self.spans: dict[str, list[tuple[float, float, str]]] = {}
        self._readers: dict[ProcessDataLayout, Callable[[Sequence[Any]], str] | None] = {}

    def add(self, whose: str, seconds: float, unit: ProcessData) -> None:
        layout = unit.layout
        if layout not in self._readers:
            self._readers[layout] = _state_of(layout)
        reader = self._readers[layout]
        if reader is None:
            return
        state = reader(unit.values)
        spans = self.spans.setdefault(whose, [])
        if spans and spans[-1][2] == state:
            spans[-1] = (spans[-1][0], seconds, state)
        else:
            if spans:
                spans[-1] = (spans[-1][0], seconds, spans[-1][2])
            spans.append((seconds, seconds, state))


class _Changes:
    """Values over time without repetitions; beyond ``MAX_POINTS`` every second one is dropped, repeatedly."""

    def __init__(self) -> None:
        self.times = array("d")
        self.values = array("d")
        self._stride = 1
        self._skipped = 0

    def add(self, seconds: float, value: float) -> None:
        if self.values and self.values[-1] == value:
            return
        self._skipped += 1
        if self._skipped < self._stride:
            return
        self._skipped = 0
        self.times.append(seconds)
        self.values.append(value)
        if len(self.times) >= MAX_POINTS:
            self.times, self.values = self.times[::2], self.values[::2]
            self._stride *= 2

    def document(self) -> Document:
        return {"times": [round(t, 6) for t in self.times], "values": [round(v, 4) for v in self.values]}


class TracePage:
    """``zero_ns``: the time the page counts from."""

    def __init__(self, title: str, zero_ns: int) -> None:
        self._title = title
        self._zero = zero_ns
        self._curves: dict[tuple[int, str, str], dict[str, _Changes]] = {}
        self._words: dict[tuple[int, str], tuple[list[tuple[int, str]], _Changes]] = {}
        self._states = States()
        self._entries: list[Document] = []
        self._end = 0.0

    def take(self, item: Entry | Record) -> None:
        """A packet, or an entry of the timeline."""
        if isinstance(item, Record):
            if isinstance(item, CyclicRecord):
                self._frame(item)
            return
        if len(self._entries) < MAX_ENTRIES:
            seconds = (item.time_ns - self._zero) / SECOND
            text = "\n".join(entry_lines(item, self._zero))
            if text:
                anomaly = isinstance(item, Anomaly)
                self._entries.append({"time": seconds, "axis": item.do_id, "anomaly": anomaly, "text": text})
        if isinstance(item, Edge):
            self._word(item)

    def _frame(self, record: CyclicRecord) -> None:
        seconds = (record.time_ns - self._zero) / SECOND
        self._end = max(self._end, seconds)
        for unit in record.units:
            self._states.add(str(unit.axis), seconds, unit)
            for field, raw in unit.items():
                quantity = _QUANTITIES.get(field.identifier)
                value = field.value(raw)
                if quantity and not isinstance(value, bytes):
                    curves = self._curves.setdefault((unit.axis, quantity, field.unit), {})
                    curves.setdefault(field.name, _Changes()).add(seconds, value)

    def _word(self, edge: Edge) -> None:
        key = (edge.do_id, edge.name)
        if key not in self._words:
            bits = [(bit.mask, bit.name) for bit in edge.field.bits]
            self._words[key] = (bits, _Changes())
            self._words[key][1].add(0.0, edge.before)
        self._words[key][1].add((edge.time_ns - self._zero) / SECOND, edge.after)

    def document(self) -> Document:
        """Everything the page shows, as plain data; times are seconds."""
        panels: list[Document] = []
        for (axis, _, unit), curves in sorted(self._curves.items()):
            spans = [[round(a, 6), round(b, 6), state] for a, b, state in self._states.spans.get(str(axis), [])]
            shown = [{"name": name, **changes.document()} for name, changes in curves.items()]
            panels.append({"axis": axis, "unit": unit, "curves": shown, "spans": spans})
        words: list[dict[str, Any]] = []
        for (axis, name), (bits, changes) in sorted(self._words.items()):
            found = changes.document()
            values = [int(value) for value in found["values"]]
            words.append({"axis": axis, "name": name, "bits": bits, "times": found["times"], "values": values})
        return {
            "title": self._title,
            "range": [0.0, max(self._end, 0.001)],
            "axes": sorted({axis for axis, _, _ in self._curves}),
            "panels": panels,
            "words": words,
            "entries": self._entries,
        }

    def write(self, path: Path) -> None:
        """The file; GatewayError when it cannot be written."""
        # Escape the data, so that no text in it ends its element.
        data = json.dumps(self.document(), separators=(",", ":")).replace("<", "\\u003c")
        page = _TEMPLATE.read_text(encoding="utf-8").replace(_PLACE, data)
        with writing(f"--html {path}"):
            path.write_text(page, encoding="utf-8")
