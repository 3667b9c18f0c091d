"""The PDOs of a simulated CANopen node: run-time mapping, reception, and transmission on SYNC, by event and on request.

Source: CiA DS 301 V4.01. The node defines the meaning of a value and detects its change.
"""

from __future__ import annotations

from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.communication import NmtState
from pdgw.ds301.configuration import EVENT_DRIVEN, SYNC_TYPES
from pdgw.ds301.emcy import COMMUNICATION_ERROR, PDO_LENGTH_ERROR
from pdgw.ds301.objects import Access, Entry
from pdgw.ds301.pdo import (
    COB_ID_INVALID,
    COB_ID_NO_REMOTE,
    PDOS_MAX,
    Pdo,
    PdoDirection,
    direction_of,
    is_communication_parameter,
    is_mapping_parameter,
)
from pdgw.peers.node.device import Device

NEVER: Final = 1 << 62
_OPERATIONAL: Final = NmtState.OPERATIONAL
_TRANSMISSION_SYNC_MAX: Final = SYNC_TYPES[-1]
_UNSEEN_MS: Final = 10
"""Interval of updating a device while no TPDO would show a change."""


def _communication(index: int) -> int:
    """The communication parameter of the PDO that a communication or a mapping parameter belongs to."""
    return index - PDOS_MAX if is_mapping_parameter(index) else index


class _Tpdo:
    """An active transmit PDO and its last transmission."""

    def __init__(self, pdo: Pdo, cob_id: int, type_: int, inhibit_ns: int, event_ns: int) -> None:
        self.pdo = pdo
        self.cob_id = cob_id & STANDARD_ID
        self.remote = not cob_id & COB_ID_NO_REMOTE
        self.type = type_
        self.inhibit_ns = inhibit_ns
        self.event_ns = event_ns
        self.last = b""
        self.last_time = -NEVER
        self.due = -NEVER
        self.sync_count = 0
        self.held = False
        """To be checked at the end of the inhibit time."""
        self.on_change = False
        """Whether a changed value is an event."""


class NodePdos:
    """The PDOs of one node, from its parameters 1400h to 1BFFh."""

    def __init__(self, node: Device) -> None:
        self.node = node
        self.received: dict[int, Pdo] = {}
        """RPDOs by COB-ID."""
        self._types: dict[int, int] = {}
        self._waiting: dict[int, bytes] = {}
        """Data to apply at the next SYNC."""
        self._tpdos: list[_Tpdo] = []
        self._events: list[_Tpdo] = []
        """Event-driven TPDOs."""
        self._communication = [i for i, sub in node.entries if sub == 1 and is_communication_parameter(i)]
        """Indices of the communication parameters."""
        self._made: dict[tuple[int, ...], Pdo] = {}
        """PDOs by index and mapped objects. A write to one object creates all PDOs again, and most are unchanged."""

    def get(self, can_id: int) -> Pdo | None:
        """The mapping of a PDO of either direction by its identifier; None without one."""
        transmitted = (tpdo.pdo for tpdo in self._tpdos if tpdo.cob_id == can_id)
        return self.received.get(can_id) or next(transmitted, None)

    def discard(self) -> None:
        """The NMT state has changed: no data waits for SYNC, and in operation every TPDO is sent."""
        self._waiting.clear()
        if self.node.state is _OPERATIONAL:
            for tpdo in self._tpdos:
                tpdo.last = b""

    def next_event(self, now: int) -> int:
        """Time of the next TPDO: its timer, the end of its inhibit time, or a change of the image."""
        soonest = changed = NEVER
        change = self.node.next_change(now)
        if self.node.state is _OPERATIONAL:
            for tpdo in self._events:
                free = tpdo.last_time + tpdo.inhibit_ns
                if tpdo.held and free < soonest:
                    soonest = free
                if tpdo.event_ns:
                    due = tpdo.due if tpdo.due > free else free
                    soonest = min(soonest, due)
                if change is not None and tpdo.on_change and free < changed and not self._unchanged(tpdo):
                    changed = free
        if change is not None:
            seen = change + _UNSEEN_MS * MS if changed == NEVER else max(change, changed)
            soonest = min(soonest, seen)
        return soonest

    def _unchanged(self, tpdo: _Tpdo) -> bool:
        """Whether none of its values changes before the next update of the device."""
        return self.node.steady(tpdo.pdo, _UNSEEN_MS + 1) and self.node.packed(tpdo.pdo) == tpdo.last

    def check(self, entry: Entry, value: int) -> None:
        """Check that the mapping changes only while the PDO is invalid and its count is 0 (CiA 301 chapter 7.5.2.36)."""
        index, subindex = entry.address
        direction = direction_of(index)
        communication = _communication(index)
        valid = self._valid(communication)
        if index == communication:
            if subindex == 1 and valid and not value & COB_ID_INVALID and int(self.node.values[index, 1]) != value:
                raise SdoAbortedError(Abort.VALUE_RANGE)
            if subindex == 2 and _TRANSMISSION_SYNC_MAX < value < EVENT_DRIVEN[0]:
                raise SdoAbortedError(Abort.VALUE_RANGE)  # reserved, or only on remote request
            return
        if valid:
            raise SdoAbortedError(Abort.UNSUPPORTED_ACCESS)
        if subindex:
            if self.node.values[index, 0]:
                raise SdoAbortedError(Abort.UNSUPPORTED_ACCESS)
            self._mappable(value, direction)
            return
        self._pdo_of(index, value, direction)

    def written(self, entry: Entry) -> None:
        """A parameter was written. The parameters of an invalid PDO take effect with its COB-ID."""
        communication = _communication(entry.index)
        if entry.address == (communication, 1) or self._valid(communication):
            self.map()

    def _valid(self, communication: int) -> bool:
        return not int(self.node.values[communication, 1]) & COB_ID_INVALID

    def _mappable(self, mapping: int, direction: PdoDirection) -> Entry:
        entry = self.node.entries.get((mapping >> 16, mapping >> 8 & 0xFF))
        if entry is None:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)
        writable = entry.access is Access.RW
        if not entry.pdo or entry.type.bits != mapping & 0xFF or (direction is PdoDirection.RPDO and not writable):
            raise SdoAbortedError(Abort.NOT_MAPPABLE)
        return entry

    def _pdo_of(self, index: int, count: int, direction: PdoDirection) -> Pdo | None:
        if not count:
            return None
        mapped = [int(self.node.values.get((index, sub), 0)) for sub in range(1, count + 1)]
        key = (index, *mapped)
        if key not in self._made:
            entries = tuple(self._mappable(mapping, direction) for mapping in mapped)
            try:
                self._made[key] = Pdo(direction, index - direction.mapping_index + 1, entries)
            except CanopenError:
                raise SdoAbortedError(Abort.PDO_LENGTH) from None
        return self._made[key]

    def map(self) -> None:
        """Create the PDOs from their parameters."""
        self.received = {}
        self._types = {}
        self._waiting = {}
        old = {(tpdo.cob_id, tpdo.pdo.attributes): tpdo for tpdo in self._tpdos}
        self._tpdos, self._events = [], []
        for index in self._communication:
            cob_id = self.node.values.get((index, 1), COB_ID_INVALID)
            if int(cob_id) & COB_ID_INVALID:
                continue
            direction = direction_of(index)
            pdo = self._pdo_of(index + PDOS_MAX, int(self.node.values[index + PDOS_MAX, 0]), direction)
            if pdo is None:
                continue
            identifier = int(cob_id) & STANDARD_ID
            if direction is PdoDirection.RPDO:
                self.received[identifier] = pdo
                self._types[identifier] = int(self.node.values[index, 2])
            else:
                inhibit = max(int(self.node.values.get((index, 3), 0)) * 100_000, self.node.inhibit_ms * MS)
                event = self.node.event_timer(index) * MS
                tpdo = _Tpdo(pdo, int(cob_id), int(self.node.values[index, 2]), inhibit, event)
                if (previous := old.get((identifier, pdo.attributes))) is not None:
                    tpdo.last, tpdo.last_time = previous.last, previous.last_time
                    tpdo.due = previous.last_time + event
                self._tpdos.append(tpdo)
                if tpdo.type in EVENT_DRIVEN:
                    tpdo.on_change = self.node.sent_on_change(tpdo.type)
                    self._events.append(tpdo)

    def receive(self, can_id: int, data: bytes) -> None:
        """An RPDO arrived in operation."""
        pdo = self.received[can_id]
        if len(data) < pdo.size:
            self.node.send_emcy(PDO_LENGTH_ERROR, COMMUNICATION_ERROR)
            return
        if self._types[can_id] <= _TRANSMISSION_SYNC_MAX:
            self._waiting[can_id] = data
            return
        self.node.apply(pdo, data)
        self.send_due(self.node.now)

    def sync(self) -> None:
        """A SYNC has arrived."""
        if self.node.state is not _OPERATIONAL:
            return
        self.node.on_poll(self.node.now)
        for can_id, data in self._waiting.items():
            self.node.apply(self.received[can_id], data)
        self._waiting.clear()
        self.node.on_sync()
        for tpdo in self._tpdos:
            if tpdo.type > _TRANSMISSION_SYNC_MAX:
                continue
            data = self.node.packed(tpdo.pdo)
            tpdo.sync_count += 1
            due = data != tpdo.last if tpdo.type == 0 else tpdo.sync_count >= tpdo.type
            if due:
                tpdo.sync_count = 0
                self._send(tpdo, data)

    def send_remote(self, can_id: int) -> None:
        """Send the TPDO of a remote request, if its parameters permit it."""
        for tpdo in self._tpdos:
            if tpdo.cob_id == can_id and tpdo.remote:
                self._send(tpdo, self.node.packed(tpdo.pdo))

    def send_due(self, now: int) -> None:
        """Send the event-driven TPDOs with a changed value or an expired timer."""
        for tpdo in self._events:
            tpdo.held = now - tpdo.last_time < tpdo.inhibit_ns
            if tpdo.held:
                continue
            data = self.node.packed(tpdo.pdo)
            changed = tpdo.on_change and data != tpdo.last
            if changed or (tpdo.event_ns and now >= tpdo.due):
                self._send(tpdo, data)
                if changed and self.node.changes_are_sent_twice:
                    self._send(tpdo, data)

    def _send(self, tpdo: _Tpdo, data: bytes) -> None:
        tpdo.last = data
        tpdo.last_time = self.node.now
        # The timer starts again at its due time, so that late polls do not extend the period.
        on_time = tpdo.due <= self.node.now < tpdo.due + tpdo.event_ns
        tpdo.due = (tpdo.due if on_time else self.node.now) + tpdo.event_ns
        self.node.transmit(tpdo.cob_id, data)
