"""Read the units of a drive again in operation, and its position if no TPDO contains it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pdgw.ds301.aborts import NOT_THERE
from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.operation import Operation, Part
from pdgw.ds301.node.plan import PdoPlan
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.objects import ObjectAddress
from pdgw.ds301.sdo_transfer import Upload
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive.rpdos import RpdoSender
from pdgw.dsp402.identification.describe import signed
from pdgw.dsp402.objects import POSITION_ACTUAL
from pdgw.dsp402.units.unit_watch import UnitWatch

_POSITION: Final = (POSITION_ACTUAL, 0)
_SDO_STEP: Final = 5
"""A step between two positions by SDO is at least this factor longer than an answer takes. The moment of the reading within
that time is unknown.
"""


class UnitCheck(Part):
    """Of one drive. ``velocity_asked``: when a speed without TPDO was requested last.

    ``changed`` gets the text of a unit that another tool has changed; ``read_again`` reads all of them in the node's task.
    """

    def __init__(
        self,
        sdo: SdoAccess,
        feedback: DriveFeedback,
        rpdos: RpdoSender,
        velocity_asked: Callable[[], int],
        changed: Callable[[str], None],
        read_again: Callable[[], None],
    ) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._velocity_asked = velocity_asked
        self._rpdos = rpdos
        self._changed = changed
        self._read_again = read_again
        self.watch = UnitWatch({})
        self._position: TpdoSlot | None = None
        self._velocities: tuple[TpdoSlot, ...] = ()

    def configure(self, plan: PdoPlan, operation: Operation) -> None:
        slots = operation.slots
        self._position = next((slot for slot in slots if "position_actual" in slot.pdo.attributes), None)
        self._velocities = tuple(slot for slot in slots if "velocity_actual" in slot.pdo.attributes)

    @property
    def position_ns(self) -> int:
        """When the newest position came, monotonic nanoseconds; 0 never."""
        return self.watch.read_ns if self._position is None else self._position.time

    def due(self, now: int) -> bool:
        return self.watch.changed

    def work(self, now: int) -> None:
        self._read_again()

    def ask(self, now: int) -> bool:
        """Send the next request when it is due, while the task has no access; True if it is. See ``UnitWatch.is_due``."""
        watch, rpdos = self.watch, self._rpdos
        if not watch.is_due(now, operates=rpdos.operates, moves=rpdos.moves):
            return False
        if self._position is not None:
            watch.position_missing = True
        if (following := watch.next_object(now)) is not None:
            self._sdo.ask(*following, self._answered)
        return True

    def _answered(self, upload: Upload) -> None:
        watch, address = self.watch, (upload.index, upload.subindex)
        if address != watch.asked:
            return
        watch.asked = None
        if upload.sink.complete:
            self._take(
                address, self._sdo.integer(upload, signed=address == _POSITION or signed(self._sdo.dictionary, address))
            )
        elif upload.code in NOT_THERE:
            watch.discard(address)

    def _take(self, address: ObjectAddress, value: int) -> None:
        watch, now = self.watch, self._sdo.loop.now()
        if address not in watch.last_values:
            # A drive that has left Operational still answers SDOs, but its last TPDO, with 606Ch, is outdated.
            velocity_ns = max((slot.time for slot in self._velocities), default=self._velocity_asked())
            since = watch.asked_ns - watch.read_ns
            if (now - watch.asked_ns) * _SDO_STEP <= since and velocity_ns > watch.read_ns:
                self._feedback.position_actual, watch.read_ns = value, watch.asked_ns
            return
        if value != (last := watch.last_values[address]):
            watch.changed = True
            name = f"{address[0]:04X}h" + (f"/{address[1]}" if address[1] else "")
            self._changed(f"{name} was {last:X}h and is {value:X}h now: another tool has changed the units")
