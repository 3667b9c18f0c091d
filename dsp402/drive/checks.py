"""Checks of a drive in operation: mode of operation, TPDOs, units."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from pdgw.ds301.aborts import NOT_THERE, SdoAbortedError
from pdgw.ds301.configuration import SdoStep
from pdgw.ds301.node.configuring import ConfiguringAccess
from pdgw.ds301.node.node import TpdoSlot
from pdgw.ds301.node.planner import DeviceMapping
from pdgw.ds301.node.sdo import SdoAccess
from pdgw.ds301.objects import CanType, Entry, ObjectAddress
from pdgw.ds301.sdo_transfer import Upload
from pdgw.dsp402.drive.images import DriveFeedback
from pdgw.dsp402.drive_type import Dsp402Error
from pdgw.dsp402.identification.describe import signed
from pdgw.dsp402.modes import MODE_CONFIRM_NS, Mode
from pdgw.dsp402.objects import MODE, MODE_DISPLAY, POSITION_ACTUAL
from pdgw.dsp402.states import State, state_of
from pdgw.dsp402.units.units import UnitWatch
from pdgw.durations import MS, SECOND

# The mode of operation of a drive: written to 6060h and checked in 6061h, which some drives show in operation only.
#
# Source: CiA 402-2 (modes of operation). For the node's task.


_SPEED_MODES: Final = (Mode.VELOCITY, Mode.CYCLIC_VELOCITY, Mode.VL_VELOCITY)
_NO_MODE: Final = 0


class ModeCheck:
    """Checks the mode of one drive. ``notify`` is called with kind and text of an event of the node."""

    def __init__(self, sdo: ConfiguringAccess, feedback: DriveFeedback, notify: Callable[[str, str], None]) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._notify = notify
        self.awaited: int | None = None
        """A mode that 6061h has not shown yet; no speed is sent meanwhile."""
        self.wrong = ""
        """Empty, or how 6061h shows another mode in operation: the drive counts as lost."""
        self._operating_since = -1

    def set(self, mode: int, *, late: bool) -> None:
        """Write a mode and wait until 6061h shows it; Dsp402Error if it does not.

        A speed mode may be shown later, in operation: the drive is known for it (``late``), or shows no mode at all.
        """
        sdo = self._sdo
        self.awaited, self.wrong, self._operating_since = None, "", -1
        sdo.do(SdoStep(*MODE, CanType.I8, mode, "mode of operation"))
        deadline = sdo.loop.now() + MODE_CONFIRM_NS
        while (shown := sdo.require(*MODE_DISPLAY, signed=True)) != mode:
            if mode in _SPEED_MODES and (late or (shown == _NO_MODE and sdo.loop.now() > deadline)):
                self.awaited = mode
                self._notify(
                    "status", f"6061h shows {shown}: mode {mode} is checked again when the operation is enabled"
                )
                return
            if sdo.loop.now() > deadline:
                raise Dsp402Error("6061h", shown, f"{mode} within {MODE_CONFIRM_NS / SECOND:g} s of 6060h")
            sdo.loop.sleep(10 * MS)

    def check(self, now: int) -> None:
        """In operation 6061h must show the mode that is awaited."""
        mode = self.awaited
        if mode is None:
            return
        if state_of(self._feedback.statusword) is not State.OPERATION_ENABLED:
            self._operating_since = -1
            return
        if self._operating_since < 0:
            self._operating_since = now
        shown = self._sdo.read_number(*MODE_DISPLAY, signed=True)
        if shown == mode:
            self.awaited = None
        elif now - self._operating_since > MODE_CONFIRM_NS:
            self.wrong = f"6061h shows {shown} for {MODE_CONFIRM_NS / SECOND:g} s in operation, not {mode}"


# Find an object that a drive accepts in a TPDO's mapping but does not send: its place in the TPDO never changes.
#
# While the drive is in operation; for the node's task. A place that has changed once is trusted until the next bring-up.
# Source: none; CiA 301 does not cover this.


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


class TpdoCheck:
    """Of one drive. An object that is found is dropped from the ``mapping``."""

    def __init__(self, sdo: SdoAccess, mapping: DeviceMapping) -> None:
        self._sdo = sdo
        self._mapping = mapping
        self._places: list[Place] = []
        self._due = 0
        self.dropped = ""
        """Empty, or the object that the drive does not send: the drive counts as lost and is mapped without it."""

    def begin(self, slots: Iterable[TpdoSlot]) -> None:
        """Another mapping: nothing of it has been compared yet."""
        self._places = []
        for slot in slots:
            begin = 0
            for entry in slot.pdo.entries:
                end = begin + entry.type.bits // 8
                if entry.attribute in _MOTION:
                    self._places.append(Place(slot, entry, begin, end))
                begin = end
        self._due = self._sdo.loop.now() + _PERIOD_NS
        self.dropped = ""

    def is_due(self, now: int) -> bool:
        """Whether objects have to be read."""
        return now >= self._due and bool(self._places)

    def check(self, now: int, timeout_ns: int) -> None:
        """Once a second; where a TPDO showed something else than its object, after its time-out.

        A TPDO that is later than that is a lost drive.
        """
        if not self.is_due(now):
            return
        self._due = now + _PERIOD_NS
        for place in tuple(self._places):
            entry, held = place.entry, None
            if not place.confirmed:
                with suppress(SdoAbortedError):  # trusted: it cannot be read
                    held = self._sdo.read(*entry.address)
            if held is None or place.confirmed:
                self._places.remove(place)
            elif place.compare(held, self._sdo.loop.now()):
                self._mapping.drop(entry.address)
                shown, there = (int.from_bytes(data, "little") for data in (place.shown, held))
                found = f"{place.slot.pdo} accepts {entry} but does not send it"
                self.dropped = f"{found}: it shows {shown}, the object contains {there}"
        if any(place.contradicted_ns for place in self._places):
            self._due = now + timeout_ns


# Read the units of a drive again in operation, and its position if no TPDO contains it.
#
# One request after the other, without a task: an answer is processed when it arrives. Which object is next, and when, is
# ``UnitWatch``.


_POSITION: Final = (POSITION_ACTUAL, 0)
_SDO_STEP: Final = 5
"""A step between two positions by SDO is at least this factor longer than an answer takes. The moment of the reading within
that time is unknown.
"""


class UnitCheck:
    """Of one drive. ``acyclic_read``: when the objects without TPDO were read last.

    ``changed`` gets the text of a unit that another tool has changed.
    """

    def __init__(
        self,
        sdo: SdoAccess,
        feedback: DriveFeedback,
        acyclic_read: Callable[[], int],
        changed: Callable[[str], None],
    ) -> None:
        self._sdo = sdo
        self._feedback = feedback
        self._acyclic_read = acyclic_read
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

    def check(self, now: int, *, operates: bool, moves: bool) -> bool:
        """Send the next request when it is due, while the task has no access; True if it is. See ``UnitWatch.is_due``."""
        watch = self.watch
        if not watch.is_due(now, operates=operates, moves=moves):
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
            velocity_ns = max((slot.time for slot in self._velocities), default=self._acyclic_read())
            since = watch.asked_ns - watch.read_ns
            if (now - watch.asked_ns) * _SDO_STEP <= since and velocity_ns > watch.read_ns:
                self._feedback.position_actual, watch.read_ns = value, watch.asked_ns
            return
        if value != (last := watch.last_values[address]):
            watch.changed = True
            name = f"{address[0]:04X}h" + (f"/{address[1]}" if address[1] else "")
            self._changed(f"{name} was {last:X}h and is {value:X}h now: another tool has changed the units")
