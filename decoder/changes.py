"""Only what changed: ``--changes-only`` over the packets of each stream."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from decoder.records import HeartbeatRecord, Record, SyncRecord, Unit, UnitLayout


class Changes:
    """Remembers the last values of every stream (FrameID, COB-ID); memory grows with their number only."""

    def __init__(self) -> None:
        self._last: dict[object, Unit] = {}
        self._seen: set[object] = set()

    def select(self, record: Record, units: tuple[Unit, ...]) -> tuple[Unit, ...] | None:
        """The units reduced to the signals that changed; None when the packet says nothing new.

        A heartbeat is new with another state, SYNC only the first time; services and errors always are.
        """
        if isinstance(record, HeartbeatRecord):
            return units if record.changed else None
        if isinstance(record, SyncRecord):
            known = record.stream in self._seen
            self._seen.add(record.stream)
            return None if known else units
        if not units:
            return units
        changed = tuple(part for unit in units if (part := self._unit(record, unit)) is not None)
        return changed or None

    def _unit(self, record: Record, unit: Unit) -> Unit | None:
        key = (record.stream, unit.axis, unit.node)
        before = self._last.get(key)
        self._last[key] = unit
        if before is None or before.layout is not unit.layout:
            return unit
        changed = [i for i, (old, new) in enumerate(zip(before.values, unit.values, strict=True)) if old != new]
        if not changed and (before.iops, before.iocs) == (unit.iops, unit.iocs):
            return None
        return reduced(unit, changed)


@lru_cache(maxsize=4096)
def _reduced_layout(layout: UnitLayout, positions: tuple[int, ...]) -> UnitLayout:
    return UnitLayout(tuple(layout.fields[i] for i in positions), layout.telegram, layout.direction)


def reduced(unit: Unit, positions: Sequence[int]) -> Unit:
    """The unit with only these of its values."""
    chosen = tuple(positions)
    layout = _reduced_layout(unit.layout, chosen)
    return Unit(unit.axis, unit.node, layout, tuple(unit.values[i] for i in chosen), unit.iops, unit.iocs)
