"""Read the objects of a node that are in no TPDO by SDO, one after the other, and forget values that are old."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from pdgw.ds301.aborts import SdoCommunicationError
from pdgw.ds301.node.operation import Operation, Part
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.polling import POLL_NS, Polling
from pdgw.ds301.node.sdo import LONGEST_UPLOAD_NS, SdoAccess

FAILURES: Final = 3
"""So often in a row may an object not be read before the node is lost."""


class PolledObjects(Part):
    """Of one node. ``image`` takes the values; ``unknown`` has those of old objects, by attribute; ``wake`` wakes the task."""

    def __init__(
        self, sdo: SdoAccess, polling: Polling, image: object, unknown: Mapping[str, int], wake: Callable[[], None]
    ) -> None:
        self._sdo = sdo
        self._polling = polling
        self._image = image
        self._unknown = unknown
        self._wake = wake

    @property
    def has_work(self) -> bool:
        return bool(self._polling.objects)

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        sdo = self._sdo
        self._polling.begin(plan.read, sdo.loop.now())
        # A client that reads a long object must not delay what the owner commands and reads by SDO.
        sdo.longest_upload_ns = sdo.timeout_ns if plan.read or plan.written else LONGEST_UPLOAD_NS

    def read_all(self) -> None:
        """Read each object once."""
        for _ in self._polling.objects:
            self._read()

    def due(self, now: int) -> bool:
        return now >= self._polling.due

    def work(self, now: int) -> None:
        self._read()
        if now >= self._polling.due:
            self._wake()

    def _read(self) -> None:
        sdo = self._sdo
        item = self._polling.next(sdo.loop.now())
        entry = item.entry
        try:
            value = sdo.require(*entry.address, signed=entry.type.char.islower())
        except SdoCommunicationError:
            item.miss(sdo.begun_ns)
            raise
        setattr(self._image, entry.attribute, value)
        self._polling.answered(item, sdo.begun_ns, sdo.loop.now())

    def forget_old(self, now: int) -> None:
        """Give old values their unknown one."""
        for item in self._polling.objects:
            if now > item.until_ns and (name := item.entry.attribute) in self._unknown:
                setattr(self._image, name, self._unknown[name])

    def unread(self, now: int) -> str:
        """Why the objects are so old that the node is lost; empty if it is not."""
        return self._polling.unread(FAILURES, FAILURES * (POLL_NS + self._sdo.timeout_ns), now)
