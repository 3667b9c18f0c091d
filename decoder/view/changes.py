"""Only what changed: ``--changes-only`` over the packets of each stream."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from pdgw.decoder.frames.canopen.records import CanRecord, HeartbeatRecord, SyncRecord
from pdgw.decoder.frames.records import CyclicRecord, ProcessData, ProcessDataLayout, Record
from pdgw.profidrive.frame import TRAILER


class Changes:
    """Remembers the last values of every stream (FrameID, COB-ID); memory grows with their number only."""

    def __init__(self) -> None:
        self._last: dict[object, ProcessData] = {}
        self._rest: dict[object, object] = {}
        """The compared data besides the units."""

    def select(self, record: Record, units: tuple[ProcessData, ...]) -> tuple[ProcessData, ...] | None:
        """The units reduced to the signals that changed; None when the packet says nothing new.

        New is another value, IOPS, IOCS or status of a cyclic frame, another NMT state, other bytes where no layout is known,
        and the first SYNC; services and errors always are.
        """
        changed = tuple(part for unit in units if (part := self._unit(record, unit)) is not None)
        rest = _compared(record, bool(units))
        if rest is None:
            return changed or (None if units else ())
        key = (record.channel, record.stream)
        before = self._rest.get(key)
        self._rest[key] = rest
        return changed or (None if before == rest else ())

    def _unit(self, record: Record, unit: ProcessData) -> ProcessData | None:
        key = (record.channel, record.stream, unit.axis, unit.node)
        before = self._last.get(key)
        self._last[key] = unit
        if before is None or before.layout is not unit.layout:
            return unit
        changed = [i for i, (old, new) in enumerate(zip(before.values, unit.values, strict=True)) if old != new]
        if not changed and (before.iops, before.iocs) == (unit.iops, unit.iocs):
            return None
        return reduced(unit, changed)


def _compared(record: Record, has_units: bool) -> object | None:
    """Data whose change makes a packet new besides its units; None if it is always new or never."""
    if isinstance(record, CyclicRecord):
        status = (record.data_status, record.transfer_status)
        return status if has_units else (*status, record.data[: -TRAILER.size])
    if isinstance(record, HeartbeatRecord):
        return record.state
    if isinstance(record, SyncRecord):
        return "sync"
    return record.data if type(record) is CanRecord else None


@lru_cache(maxsize=4096)
def _reduced_layout(layout: ProcessDataLayout, positions: tuple[int, ...]) -> ProcessDataLayout:
    return ProcessDataLayout(tuple(layout.fields[i] for i in positions), layout.telegram, layout.direction)


def reduced(unit: ProcessData, positions: Sequence[int]) -> ProcessData:
    """The unit with only these of its values."""
    chosen = tuple(positions)
    layout = _reduced_layout(unit.layout, chosen)
    return ProcessData(unit.axis, unit.node, layout, tuple(unit.values[i] for i in chosen), unit.iops, unit.iocs)
