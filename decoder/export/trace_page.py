"""A trace of both buses as one HTML file without other files: curves, states, words with their bits, the timeline at each
mark.

``TracePage`` takes the records and entries of ``decoder.timeline.builder`` in the order of time. Repetitions are omitted.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from pdgw.decoder.export.plot import Curve, States, quantity_of
from pdgw.decoder.frames.fields import Document
from pdgw.decoder.frames.records import CyclicRecord, Record
from pdgw.decoder.timeline.entries import Anomaly, Edge, Entry
from pdgw.decoder.timeline.text import entry_lines
from pdgw.durations import SECOND
from pdgw.gateway.errors import writing

_TEMPLATE: Final = Path(__file__).parent / "trace_page.html"
_PLACE: Final = "/*DATA*/"
MAX_POINTS: Final = 50_000
"""Most points of a curve; a longer one is thinned out."""
MAX_ENTRIES: Final = 50_000


class _Changes(Curve):
    """Values over time without repetitions."""

    def __init__(self) -> None:
        super().__init__(MAX_POINTS)

    def add(self, seconds: float, value: float) -> None:
        if not self.values or self.values[-1] != value:
            super().add(seconds, value)

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
                quantity = quantity_of(field.identifier)
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
