"""Selection of packets, and of their units and signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pdgw.decoder.frames.records import ProcessData, Record
from pdgw.decoder.view.changes import Changes, reduced
from pdgw.decoder.view.filter import Filter
from pdgw.decoder.view.names import RECORD_NAMES


@dataclass
class Selection:
    """All criteria together; a packet is shown when it meets each of them.

    Times are nanoseconds of the capture's clock, both ends included. ``signals`` are
    identifiers of signals, objects or fields of packets (``Names.split``), of which a packet has to have one.
    """

    begin_ns: int | None = None
    end_ns: int | None = None
    signals: Sequence[str] = ()
    filter: Filter | None = None
    changes: Changes | None = None

    @property
    def everything(self) -> bool:
        """Whether nothing is left out."""
        return not (self.begin_ns is not None or self.end_ns is not None or self.signals or self.filter or self.changes)

    def select(self, record: Record) -> tuple[ProcessData, ...] | None:
        """The units of a packet to show (empty for a packet without units); None to leave the packet out."""
        if self.begin_ns is not None and record.time_ns < self.begin_ns:
            return None
        if self.end_ns is not None and record.time_ns > self.end_ns:
            return None
        units: tuple[ProcessData, ...] | None = self.filter.select(record) if self.filter else record.units
        if units is not None and self.signals:
            units = self._with_signals(record, units)
        if units is not None and self.changes is not None:
            units = self.changes.select(record, units)
        return units

    def _with_signals(self, record: Record, units: tuple[ProcessData, ...]) -> tuple[ProcessData, ...] | None:
        reduced_units = tuple(part for unit in units if (part := self._of_signals(unit)) is not None)
        fields = (RECORD_NAMES[name] for name in self.signals if name in RECORD_NAMES)
        if reduced_units or any(getter(record, None) is not None for getter in fields):
            return reduced_units
        return None

    def _of_signals(self, unit: ProcessData) -> ProcessData | None:
        positions = [unit.layout.positions[name] for name in self.signals if name in unit.layout.positions]
        return reduced(unit, sorted(positions)) if positions else None
