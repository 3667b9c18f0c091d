"""Read the units of a drive again in operation, and its position if no TPDO contains it. For the node's task.

One request after the other without waiting for the answer. Which object is next, and when, is ``dsp402.units.unit_watch``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from pdgw.ds301.aborts import NOT_THERE
from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.sdo_transfer import SdoAbortedError
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.identification.describe import signed
from pdgw.dsp402.indices import POSITION_ACTUAL
from pdgw.dsp402.units.unit_watch import UnitWatch

_SDO_STEP: Final = 5
"""A step between two positions by SDO is at least this factor longer than an answer takes. The moment of the reading within
that time is unknown.
"""


class UnitCheck:
    """Of one drive. ``changed`` gets the text of a unit that another tool has changed, and may replace the ``watch``."""

    def __init__(self, sdo: SdoAccess, feedback: DriveFeedback, changed: Callable[[str], None]) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._changed = changed
        self.watch = UnitWatch({})
        self._position: TpdoSlot | None = None
        self._velocities: tuple[TpdoSlot, ...] = ()

    def begin(self, slots: Sequence[TpdoSlot]) -> None:
        """Another mapping."""
        self._position = next((slot for slot in slots if "position_actual" in slot.pdo.attributes), None)
        self._velocities = tuple(slot for slot in slots if "velocity_actual" in slot.pdo.attributes)

    @property
    def position_ns(self) -> int:
        """When the newest position came, monotonic nanoseconds; 0 never."""
        return self.watch.read_ns if self._position is None else self._position.time

    def check(self, now: int, *, acyclic_read: int) -> None:
        """Process the answer and send the next request, also while jobs wait: a client must not end the check.

        ``acyclic_read``: when the objects without TPDO were read last.
        """
        watch, sdo = self.watch, self._sdo
        if (address := watch.asked) is not None:
            is_position = address == (POSITION_ACTUAL, 0)
            try:
                value = sdo.answered(*address, signed=is_position or signed(sdo.dictionary, address))
            except SdoAbortedError as error:
                if error.code in NOT_THERE:
                    watch.forget(address)
                watch.asked = None
            else:
                if value is None and not watch.has_timed_out(now):
                    return
                if value is not None:
                    self._take(address, value, now, acyclic_read)
        if self._position is not None:
            watch.position_missing = True
        if watch.asked is None and watch.is_next(now) and (following := watch.next_object(now)) is not None:
            sdo.ask(*following)

    def _take(self, address: ObjectAddress, value: int, now: int, acyclic_read: int) -> None:
        watch = self.watch
        watch.asked = None
        if address not in watch.last_values:
            # A drive that has left Operational still answers SDOs, but its last TPDO, with 606Ch, is outdated.
            velocity_ns = max((slot.time for slot in self._velocities), default=acyclic_read)
            since = watch.asked_ns - watch.read_ns
            if (now - watch.asked_ns) * _SDO_STEP <= since and velocity_ns > watch.read_ns:
                self._feedback.position_actual, watch.read_ns = value, watch.asked_ns
            return
        if value != (last := watch.last_values[address]):
            name = f"{address[0]:04X}h" + (f"/{address[1]}" if address[1] else "")
            self._changed(f"{name} was {last:X}h and is {value:X}h now: another tool has changed the units")
