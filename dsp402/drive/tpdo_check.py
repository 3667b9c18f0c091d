"""Compare the TPDOs of a drive with their objects: finds an object that a drive accepts in the mapping but does not send.

While the drive moves; the comparison itself is ``dsp402.pdo.value_check``. For the node's task.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen.sdo import SdoAbortedError

from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.dsp402.pdo.mapping import DriveMapping
from pdgw.dsp402.pdo.value_check import PdoValueCheck
from pdgw.durations import SECOND

_PERIOD_NS: Final = SECOND
"""So often is a TPDO that does not change compared with its objects."""


class TpdoCheck:
    """Of one drive. An object that is found is dropped from the ``mapping``."""

    def __init__(self, sdo: SdoAccess, mapping: DriveMapping) -> None:
        self._sdo = sdo
        self._mapping = mapping
        self._slots: tuple[TpdoSlot, ...] = ()
        self._values = PdoValueCheck(())
        self._due = 0
        self.dropped = ""
        """Empty, or the object that the drive does not send: the drive counts as lost and is mapped without it."""

    def begin(self, slots: Iterable[TpdoSlot]) -> None:
        """Another mapping: nothing of it has been compared yet."""
        self._slots = tuple(slots)
        self._values = PdoValueCheck(slot.pdo for slot in self._slots)
        self._due = self._sdo.loop.now() + _PERIOD_NS
        self.dropped = ""

    @property
    def has_unconfirmed(self) -> bool:
        """There are objects to compare."""
        return self._values.has_unconfirmed

    def check(self, now: int, timeout_ns: int) -> None:
        """Once a second; where a TPDO showed something else than its object, after its time-out.

        A TPDO that is later than that is a lost drive.
        """
        values = self._values
        for slot in self._slots:
            if slot.data is not None:
                values.see(slot.pdo, slot.data, slot.time)
        if now < self._due:
            return
        for suspect in values.unconfirmed:
            entry = suspect.entry
            try:
                held = self._sdo.read(*entry.address)
            except SdoAbortedError:
                values.trust(suspect)
                continue
            if values.compare(suspect, held, now):
                self._mapping.drop(entry.address)
                shown, there = (int.from_bytes(data, "little") for data in (suspect.first, held))
                self.dropped = (
                    f"{suspect.pdo} accepts {entry} but does not send it: it shows {shown}, the object contains {there}"
                )
        self._due = now + (timeout_ns if values.contradicted else _PERIOD_NS)
