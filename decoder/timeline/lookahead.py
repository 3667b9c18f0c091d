"""Facts that a timeline needs before it can begin, from the first part of both captures. Without I/O.

Only the changes of words are kept, so a long part can be read. The offset of the clocks needs edges on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final

from pdgw.decoder.frames.canopen.records import CanRecord, PdoRecord
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.records import BusKind, CyclicRecord, Record
from pdgw.decoder.replay.cycles import median_cycle_ns
from pdgw.decoder.timeline.clocks import AxisWords, Clocks, Word, correlate
from pdgw.dsp402.objects import CONTROLWORD, STATUSWORD
from pdgw.profidrive.telegrams import Direction

ENOUGH: Final = 120
"""Changes of words on each bus that make the offset of the clocks sure."""
_CYCLES: Final = 2000
"""Cycles whose length is measured."""


class Lookahead:
    """Feed it records of both captures, each on its own clock."""

    def __init__(self, axes: Sequence[Axis]) -> None:
        self.words = {axis.do_id: AxisWords() for axis in axes}
        self.begin_ns: int | None = None
        """The first cyclic frame."""
        self.first_ns: int | None = None
        """The first record."""
        self.changes = {BusKind.PLC: 0, BusKind.CAN: 0}
        """Changes of words seen on each bus."""
        self._axes = {axis.do_id: axis for axis in axes}
        self._nodes: dict[int, list[Axis]] = {}
        for axis in axes:
            self._nodes.setdefault(axis.node, []).append(axis)
        self._frames: list[int] = []

    @property
    def enough(self) -> bool:
        """Whether more would not make the clocks surer."""
        return min(self.changes.values()) >= ENOUGH

    def add(self, record: Record) -> None:
        """One more record."""
        if self.first_ns is None:
            self.first_ns = record.time_ns
        if isinstance(record, CyclicRecord):
            self._cyclic(record)
        elif isinstance(record, PdoRecord):
            self._pdo(record)

    def _cyclic(self, record: CyclicRecord) -> None:
        now = record.time_ns
        if self.begin_ns is None or now < self.begin_ns:
            self.begin_ns = now
        to_gateway = record.direction is Direction.SETPOINT
        if to_gateway and len(self._frames) <= _CYCLES:
            self._frames.append(now)
        for do_id, _, _, first, _, _ in record.layout.axes:
            words = self.words.get(do_id)
            if words is not None:
                self._word(words.control if to_gateway else words.status, now, record.values[first], BusKind.PLC)

    def _pdo(self, record: PdoRecord) -> None:
        layout = record.layout
        for axis in self._nodes.get(record.node, ()):
            if axis.bus not in {"", record.channel}:
                continue
            words = self.words[axis.do_id]
            for address, kept in ((CONTROLWORD, words.controlword), (STATUSWORD, words.statusword)):
                if address in layout.addresses:
                    value = layout.unpack(record.data)[layout.addresses.index(address)]
                    if isinstance(value, int):
                        self._word(kept, record.time_ns, value, BusKind.CAN)

    def _word(self, words: list[Word], now: int, value: int, bus: BusKind) -> None:
        if not words or words[-1].value != value:
            self.changes[bus] += bool(words)
            words.append(Word(now, value))

    @cached_property
    def cycle_ns(self) -> int:
        """The PLC's cycle: the median time between its frames."""
        return median_cycle_ns(self._frames)

    def clocks(self, cycle_ns: int) -> Clocks:
        """The offset of the clocks, from the edges."""
        return correlate(self.words, {do_id: axis.telegram for do_id, axis in self._axes.items()}, cycle_ns)


def is_of(record: Record) -> BusKind | None:
    """The bus a record is evidence of; None for packets of neither."""
    return record.bus if isinstance(record, CyclicRecord | CanRecord) else None
