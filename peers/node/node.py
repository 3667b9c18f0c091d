"""A simulated CANopen node, sans-I/O: frames and times in, frames out.

Source: CiA DS 301 V4.01: NMT slave, heartbeat producer and consumer, EMCY, SDO server, PDOs with run-time
mapping: on SYNC, event-driven, on remote request. A device profile derives from it, passes an ``image`` whose attributes are
the values of mappable objects, and overrides the ``on_...`` hooks. LSS is a habit (``lss``). Not simulated: TIME, node guarding.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Final

from pdgw.base.durations import MS
from pdgw.ds301 import communication as com
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.communication import EMCY, ERROR_CONTROL, SDO_REQUEST, SDO_RESPONSE, NmtCommand, NmtState
from pdgw.ds301.objects import COMMUNICATION_AREA, Access, CanType, Entry, ObjectSpec
from pdgw.ds301.pdo import PDO_PARAMETERS, Pdo, is_communication_parameter
from pdgw.ds301.sdo_transfer import SdoServer
from pdgw.peers.node.behaviour import NONE, Behaviour, Catalogue, HabitValues, make
from pdgw.peers.node.device import Device, Value
from pdgw.peers.node.node_behaviours import NODE_HABITS
from pdgw.peers.node.pdos import NEVER, NodePdos

_HEARTBEAT: Final = (com.PRODUCER_HEARTBEAT, 0)
_SYNC: Final = (com.SYNC_COB_ID, 0)
_BOOT_UP: Final = NmtState.BOOT_UP
_OPERATIONAL: Final = NmtState.OPERATIONAL

SendFunction = Callable[[int, bytes], None]


def encode(entry: Entry, value: Value) -> bytes:
    """Convert the value of an object to the bytes of an SDO."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        return value.encode("latin-1")
    return struct.pack("<" + entry.type.char, value)


class SimulatedNode(Device):
    """One node. It calls ``send(can_id, data)`` to transmit."""

    catalogue: ClassVar[Catalogue] = NODE_HABITS
    """The possible habits of this kind of device."""

    def __init__(
        self,
        node_id: int,
        objects: Sequence[ObjectSpec],
        image: object,
        send: SendFunction,
        habits: HabitValues = NONE,
    ) -> None:
        super().__init__(node_id, objects, image)
        self.send = send
        self.switched: Callable[[bool], None] = lambda on: None
        """Called with the supply of the device: on or off."""
        self.pdos = NodePdos(self)
        self._heartbeat_due = 0
        self._consumed: dict[int, tuple[int, int]] = {}
        self._errors: list[int] = []
        self.behaviours: dict[str, Behaviour] = {}
        """The active habits by name. They start when the node is powered."""
        self._powered = False
        self._touched = False
        self._boot_at = -1
        self._sdo = SdoServer(self)
        self._defaults()
        self._own = frozenset(habits)
        for name, values in habits.items():
            self.start_fault(name, **values)

    # -- habits -----------------------------------------------------------------------------------------------------

    def start_fault(self, name: str, /, **values: object) -> Behaviour:
        """Activate a habit of its catalogue; an active one is replaced. CanopenError for a wrong name or value."""
        behaviour = make(self.catalogue, name, values)
        self.end_fault(name)
        behaviour.node = self
        self.behaviours[name] = behaviour
        self.touch()
        if self._powered:
            behaviour.begin()
        return behaviour

    def end_fault(self, name: str | None = None) -> None:
        """End a habit, or without a name all of them except its own; no error if it is not active."""
        for item in self.faults if name is None else [name]:
            behaviour = self.behaviours.pop(item, None)
            self.touch()
            if behaviour is not None and self._powered:
                behaviour.end()

    @property
    def faults(self) -> list[str]:
        """The names of the active habits, without those that it was made with."""
        return [name for name in self.behaviours if name not in self._own]

    def _behaviours_after(self, past: object) -> list[Behaviour]:
        """The behaviours that a frame still has to pass; ``past`` has already passed it."""
        behaviours = list(self.behaviours.values())
        return behaviours[next((place for place, item in enumerate(behaviours, 1) if item is past), 0) :]

    # -- edge -------------------------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Power on: boot-up message, then pre-operational."""
        self.now = now
        self.switched(True)
        self.touch()
        if not self._powered:
            self._powered = True
            for behaviour in self.behaviours.values():
                behaviour.begin()
        self._boot()

    def receive(self, can_id: int, data: bytes, now: int, past: object = None) -> bool:
        """Process a frame from the bus; ``past`` is the behaviour that delayed it. False when ``next_event`` has not changed."""
        self.now = now
        if self.behaviours and not all(item.incoming(can_id, data) for item in self._behaviours_after(past)):
            return True
        if can_id in self.pdos.received:
            if self.state is _OPERATIONAL:
                self.on_poll(now)
                self.pdos.receive(can_id, data)
        elif can_id == SDO_REQUEST + self.node_id:
            if self.state is not NmtState.STOPPED and self.state is not _BOOT_UP and len(data) == 8:
                self.on_poll(now)
                for answer in self._sdo.answer(data):
                    self.transmit(SDO_RESPONSE + self.node_id, answer)
                self.touch()
        elif can_id == 0:
            if len(data) >= 2 and data[1] in {0, self.node_id} and self.state is not _BOOT_UP:
                self.on_poll(now)
                self._nmt(data[0])
                self.touch()
        elif can_id == self.values[_SYNC]:
            self.pdos.sync()
        elif can_id in self._consumed:
            self._consumed[can_id] = (self._consumed[can_id][0], now)
        else:
            return self.on_foreign_frame(can_id, data) or bool(self.behaviours)
        return True

    def receive_remote(self, can_id: int, now: int) -> None:
        """Process a remote frame: send the TPDO with this COB-ID, if its parameters permit it."""
        self.now = now
        if self.state is not _OPERATIONAL:
            return
        self.on_poll(now)
        self.pdos.send_remote(can_id)

    def poll(self, now: int) -> None:
        """Update device, heartbeats and event-driven PDOs to the present time."""
        self.now = now
        if self.behaviours:
            for behaviour in list(self.behaviours.values()):
                behaviour.poll(now)
        if 0 <= self._boot_at <= now:
            self._boot()
        if self.state is _BOOT_UP:
            return
        if self._touched:
            self._touched = False
            self.on_touched()
        self.on_poll(now)
        period = int(self.values.get(_HEARTBEAT, 0)) * MS
        if period and now >= self._heartbeat_due:
            self._heartbeat_due = now + period
            self.send_heartbeat()
        for can_id, (limit, seen) in self._consumed.items():
            if seen >= 0 and now - seen > limit:
                self._consumed[can_id] = (limit, -1)
                self.on_consumer_expired(can_id - ERROR_CONTROL)
        if self.state is _OPERATIONAL:
            self.pdos.send_due(now)

    def catch_up(self, now: int) -> None:
        """Update the device to ``now`` before a command."""
        self.now = now
        if self.state is not _BOOT_UP:
            self.on_poll(now)

    def next_event(self, now: int) -> int | None:
        """Next time at which ``poll`` must be called, after a poll at ``now``.

        A past time means at once. None: only after a frame or a command. Earlier polls have no effect.
        """
        soonest = NEVER
        for behaviour in self.behaviours.values():
            planned = behaviour.next_event(now)
            if planned is not None and planned < soonest:
                soonest = planned
        if self.state is not _BOOT_UP:
            if self._touched:
                return now
            if self._heartbeat_due < soonest and self.values.get(_HEARTBEAT, 0):
                soonest = self._heartbeat_due
            for limit, seen in self._consumed.values():
                if seen >= 0 and seen + limit < soonest:
                    soonest = seen + limit + 1
            event = self.pdos.next_event(now)
            soonest = min(soonest, event)
        elif self._boot_at >= 0:
            soonest = min(soonest, self._boot_at)
        return soonest if soonest < NEVER else None

    def touch(self) -> None:
        """Something outside has changed: the next ``poll`` evaluates it."""
        self._touched = True

    def power_off(self) -> None:
        """Switch off until ``start``."""
        self.state = NmtState.BOOT_UP
        self._boot_at = -1
        self.switched(False)

    def restart(self) -> None:
        """Restart the firmware, or switch on: power-on values, boot-up message."""
        self.switched(True)
        self.on_reset()
        for behaviour in self.behaviours.values():
            behaviour.restarting(powered=True)
        self._defaults()
        self._boot()

    def renumber(self, node_id: int) -> None:
        """Reset communication, with this node-ID from now on."""
        self.node_id = node_id
        self._defaults(COMMUNICATION_AREA[-1])
        self._boot()

    def transmit(self, can_id: int, data: bytes, past: object = None) -> None:
        """Send a frame on the bus; ``past`` is the behaviour that delayed it."""
        if not self.behaviours or all(item.outgoing(can_id, data) for item in self._behaviours_after(past)):
            self.send(can_id, data)

    def send_heartbeat(self, past: object = None) -> None:
        """Send a heartbeat, if the device is a producer of heartbeats."""
        if self.running and self.values.get(_HEARTBEAT, 0):
            self.transmit(ERROR_CONTROL + self.node_id, bytes([self.state]), past)

    def pdo(self, can_id: int) -> Pdo | None:
        """The present mapping of a PDO of either direction by its identifier; None without one."""
        return self.pdos.get(can_id)

    def is_pdo(self, can_id: int) -> bool:
        """Whether a COB-ID is one of the node's valid PDOs."""
        return self.pdos.get(can_id) is not None

    def send_emergencies(self, waiting: list[tuple[int, int]]) -> None:
        """Send the EMCYs of the device's model, (error code, error register) each, and empty the list."""
        if waiting:
            for code, register in waiting:
                self.send_emcy(code, register)
            waiting.clear()

    def send_emcy(self, code: int, register: int, data: bytes = b"") -> None:
        """Send an emergency message and enter it in 1003h."""
        if code:
            self._errors = [code, *self._errors][:8]
        else:
            self._errors = []
        if self.state not in {NmtState.BOOT_UP, NmtState.STOPPED}:
            self.transmit(EMCY + self.node_id, struct.pack("<HB5s", code, register, data))

    # -- object dictionary --------------------------------------------------------------------------------------------

    def entry(self, index: int, subindex: int) -> Entry:
        """The entry, or the SDO abort of a real node."""
        entry = self.entries.get((index, subindex))
        if entry is None:
            raise SdoAbortedError(Abort.NO_SUCH_SUBINDEX if index in self.indices else Abort.NO_SUCH_OBJECT)
        return entry

    def read(self, index: int, subindex: int = 0) -> Value:
        """The present value of an object."""
        entry = self.entry(index, subindex)
        if index == com.PREDEFINED_ERROR_FIELD:
            if subindex == 0:
                return len(self._errors)
            if subindex > len(self._errors):
                raise SdoAbortedError(Abort.NO_DATA)
            return self._errors[subindex - 1]
        if entry.attribute:
            value: Value = getattr(self.image, entry.attribute)
            return value
        return self.values[index, subindex]

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """The data of an SDO upload."""
        entry = self.entry(index, subindex)
        if check_readable and entry.access is Access.WO:
            raise SdoAbortedError(Abort.WRITE_ONLY)
        data = encode(entry, self.read(index, subindex))
        for behaviour in self.behaviours.values():
            data = behaviour.reading(entry, data)
        return data

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Store the data of an SDO download."""
        entry = self.entry(index, subindex)
        if check_writable and entry.access not in {Access.RW, Access.WO}:
            raise SdoAbortedError(Abort.READ_ONLY)
        for behaviour in self.behaviours.values():
            data = behaviour.writing(entry, data)
        self.write(entry, self._decode(entry, data))

    def write(self, entry: Entry, value: Value) -> None:
        """Store a value after the device's checks."""
        address = entry.address
        if entry.index == com.STORE_PARAMETERS or entry.index == com.RESTORE_PARAMETERS:
            self._store(entry, value)
            return
        if entry.index in PDO_PARAMETERS:
            self.pdos.check(entry, int(value))
        self.on_written(entry, value)
        if entry.attribute:
            setattr(self.image, entry.attribute, value)
        else:
            self.values[address] = value
        if entry.index in PDO_PARAMETERS:
            self.pdos.written(entry)
        elif entry.index == com.CONSUMER_HEARTBEAT:
            self._consume_heartbeats()
        elif entry.index == com.PRODUCER_HEARTBEAT:
            self._heartbeat_due = self.now

    def _decode(self, entry: Entry, data: bytes) -> Value:
        if not entry.type.char:
            return data if entry.type is not CanType.VISIBLE_STRING else data.decode("latin-1")
        size = entry.type.bits // 8
        if len(data) != size:
            raise SdoAbortedError(Abort.LENGTH_TOO_HIGH if len(data) > size else Abort.LENGTH_TOO_LOW)
        (value,) = struct.unpack("<" + entry.type.char, data)
        number: int | float = value
        if isinstance(number, int):
            low, high = entry.limits if entry.type is not CanType.BOOLEAN else (0, 1)
            if number > high:
                raise SdoAbortedError(Abort.VALUE_TOO_HIGH)
            if number < low:
                raise SdoAbortedError(Abort.VALUE_TOO_LOW)
        return number

    def _defaults(self, end: int = 0xFFFF) -> None:
        """Set power-on values, or the stored ones, of the objects up to index ``end``."""
        for address, entry in self.entries.items():
            if entry.index > end:
                continue
            value: Any = entry.default
            if value is None:
                value = 0 if entry.type.char else ""
            if entry.index == com.EMCY_COB_ID or address[1] == 1 and is_communication_parameter(entry.index):
                value = int(value) + self.node_id
            if not entry.attribute:
                self.values[address] = self.stored.get(address, value)
            elif address in self.stored:
                setattr(self.image, entry.attribute, self.stored[address])
        self._errors = []
        self.pdos.map()
        self._consume_heartbeats()

    def _store(self, entry: Entry, value: Value) -> None:
        """Save (1010h) or restore (1011h), valid after the next reset."""
        restore = entry.index == com.RESTORE_PARAMETERS
        if value != (com.LOAD_SIGNATURE if restore else com.SAVE_SIGNATURE):
            raise SdoAbortedError(Abort.CANNOT_STORE)
        writable = {a: e for a, e in self.entries.items() if e.access is Access.RW and self.storable(e)}
        self.stored = {} if restore else {address: self.read(*address) for address in writable}

    # -- NMT ----------------------------------------------------------------------------------------------------------

    def _boot(self) -> None:
        if self.boot_ms and self._boot_at < 0:
            self.state = NmtState.BOOT_UP
            self._boot_at = self.now + self.boot_ms * MS
            return
        self._boot_at = -1
        self.state = NmtState.PRE_OPERATIONAL
        self._heartbeat_due = self.now
        self.transmit(ERROR_CONTROL + self.node_id, bytes([NmtState.BOOT_UP]))
        self.on_nmt(self.state)
        if self.starts_itself:
            self._nmt(NmtCommand.START)

    def _nmt(self, command: int) -> None:
        targets = {
            NmtCommand.START: NmtState.OPERATIONAL,
            NmtCommand.STOP: NmtState.STOPPED,
            NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
        }
        if command in {NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION}:
            if command == NmtCommand.RESET_NODE:
                self.restart()
            else:
                for behaviour in self.behaviours.values():
                    behaviour.restarting(powered=False)
                self.renumber(self.node_id)
            return
        target = next((state for key, state in targets.items() if key == command), None)
        if target is None or target is self.state:
            return
        self.state = target
        self.pdos.discard()
        self.on_nmt(target)

    def _consume_heartbeats(self) -> None:
        self._consumed = {}
        for (index, subindex), value in self.values.items():
            if index == com.CONSUMER_HEARTBEAT and subindex and int(value) & 0xFFFF:
                # Monitoring starts with the first heartbeat.
                self._consumed[ERROR_CONTROL + (int(value) >> 16 & 0x7F)] = ((int(value) & 0xFFFF) * MS, -1)
