"""Find an object that a drive accepts in a TPDO's mapping but does not send: its place in the TPDO never changes."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import SdoAbortedError
from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.operation import Operation, Part
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.planner import DeviceMapping
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.objects import Entry
from pdgw.dsp402.drive.rpdos import RpdoSender

_PERIOD_NS: Final = SECOND
"""So often is a place that has not changed compared with its object."""
_MOTION: Final = frozenset({"position_actual", "velocity_actual"})
"""Image attributes of what changes as soon as a drive moves."""
CONTRADICTIONS: Final = 3
"""Number of consecutive readings with another value than a later frame shows."""


@dataclass(slots=True, eq=False)
class Place:
    """An object in a TPDO, and the bytes ``begin`` to ``end`` in which it is sent."""

    slot: TpdoSlot
    entry: Entry
    begin: int
    end: int
    contradicted_ns: int = 0
    """When the object was read with another value; 0: it had the same at the last reading."""
    contradictions: int = 0

    @property
    def confirmed(self) -> bool:
        """It has changed since the bring-up."""
        return self.slot.changed >> 8 * self.begin & (1 << 8 * (self.end - self.begin)) - 1 != 0

    @property
    def shown(self) -> bytes:
        """The value in the newest frame; empty before the first."""
        return (self.slot.data or b"")[self.begin : self.end]

    def compare(self, held: bytes, now: int) -> bool:
        """Compare with the object's value, read at ``now``; True when it is never sent.

        A reading counts when a later frame still shows the old value: frames may be late or lost.
        """
        if held == self.shown or not self.shown:
            self.contradicted_ns = self.contradictions = 0
            return False
        if self.contradicted_ns and self.slot.time > self.contradicted_ns:
            self.contradictions += 1
        self.contradicted_ns = now
        return self.contradictions >= CONTRADICTIONS


class TpdoCheck(Part):
    """Of one drive, while it is commanded to be in operation. An object that is found is dropped from the ``mapping``: the drive
    counts as lost, and is mapped without it."""

    def __init__(self, sdo: SdoAccess, mapping: DeviceMapping, rpdos: RpdoSender) -> None:
        self._sdo = sdo
        self._mapping = mapping
        self._rpdos = rpdos
        self._places: list[Place] = []
        self._due = 0
        self._operation = Operation()

    @property
    def has_work(self) -> bool:
        return bool(self._places)

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        self._places = []
        for slot in operation.slots:
            begin = 0
            for entry in slot.pdo.entries:
                end = begin + entry.type.bits // 8
                if entry.attribute in _MOTION:
                    self._places.append(Place(slot, entry, begin, end))
                    slot.compared = True
                begin = end
        self._due = self._sdo.loop.now() + _PERIOD_NS
        self._operation = operation

    def due(self, now: int) -> bool:
        return now >= self._due and bool(self._places) and self._rpdos.operates

    def work(self, now: int) -> None:
        """Once a second; where a TPDO showed something else than its object, after its time-out.

        A TPDO that is later than that is a lost drive.
        """
        self._due = now + _PERIOD_NS
        for place in tuple(self._places):
            entry, held = place.entry, None
            if not place.confirmed:
                with suppress(SdoAbortedError):  # trusted: it cannot be read
                    held = self._sdo.read(*entry.address)
            if held is None or place.confirmed:
                self._places.remove(place)
                place.slot.compared = any(other.slot is place.slot for other in self._places)
            elif place.compare(held, self._sdo.loop.now()):
                self._mapping.drop(entry.address)
                shown, there = (int.from_bytes(data, "little") for data in (place.shown, held))
                found = f"{place.slot.pdo} accepts {entry} but does not send it"
                self._operation.lost = f"{found}: it shows {shown}, the object contains {there}"
        if any(place.contradicted_ns for place in self._places):
            self._due = now + self._operation.timeout_ns
