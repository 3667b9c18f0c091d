"""The faults of any simulated CANopen node, each declared once.

Source: CiA DS 301, whose communication rules they violate.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field

from pdgw.ds301 import communication as com
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.bus.can_frame import STANDARD_ID
from pdgw.ds301.communication import ERROR_CONTROL, SDO_REQUEST, SDO_RESPONSE
from pdgw.ds301.emcy import BUS_OFF_RECOVERED, COMMUNICATION_ERROR, ERROR_PASSIVE
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.ds301.pdo import PDO_PARAMETERS, PDOS_MAX, is_mapping_parameter
from pdgw.durations import MS
from pdgw.peers.node.misbehaviour import HEX, Late, Misbehaviour, catalogue, parameter

# -- SDO ------------------------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class SlowSdo(Late):
    """Every SDO answer is late, as from a device that serves SDOs with low priority."""

    name = "slow-sdo"
    delay_ms: int = parameter(50, 1, 10_000, "between request and answer", "ms")

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return can_id != SDO_RESPONSE + self.node.node_id or self._hold(True, can_id, data)


@dataclass(kw_only=True, eq=False)
class SdoTimeout(Misbehaviour):
    """No answer to SDO requests, to all of them or to each n-th."""

    name = "sdo-timeout"
    at_configuration = True
    every: int = parameter(1, 1, 1000, "1: no answer at all; n: each n-th is missing")
    _count: int = field(init=False, repr=False, default=0)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_RESPONSE + self.node.node_id:
            return True
        self._count += 1
        return self._count % self.every != 0


_SEGMENT = 0x60
_TOGGLE = 0x10
_EXPEDITED_UPLOAD = 0x42
_SEGMENTED_UPLOAD = 0x41
_COMMAND = 0xE0


@dataclass(kw_only=True, eq=False)
class SdoToggleError(Misbehaviour):
    """Every upload is segmented, short values too, and the toggle bit of each segment is wrong."""

    name = "sdo-toggle-error"
    at_configuration = True
    _pending: bytes = field(init=False, repr=False, default=b"")

    def outgoing(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_RESPONSE + self.node.node_id:
            return True
        command = data[0]
        if command & (_COMMAND | 0x02) == _EXPEDITED_UPLOAD:
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            self._pending = data[4 : 4 + size]
            header = struct.pack("<B3sI", _SEGMENTED_UPLOAD, data[1:4], size)
            self.node.transmit(can_id, header, past=self)
            return False
        if command & _COMMAND <= 0x20:  # a segment of either direction
            self.node.transmit(can_id, bytes([command ^ _TOGGLE]) + data[1:], past=self)
            return False
        return True

    def incoming(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_REQUEST + self.node.node_id or not data or not self._pending:
            return True
        pending, self._pending = self._pending, b""
        if data[0] & _COMMAND != _SEGMENT:
            return True
        command = (data[0] & _TOGGLE ^ _TOGGLE) | (7 - len(pending)) << 1 | 1
        self.node.transmit(SDO_RESPONSE + self.node.node_id, bytes([command]) + pending.ljust(7, b"\0"), past=self)
        return False


# -- object dictionary ----------------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class WrongIdentity(Misbehaviour):
    """The identity object 1018h has another vendor-ID, as from a different device."""

    name = "wrong-identity"
    at_configuration = True
    vendor_id: int = parameter(0x0BAD, 0, 0xFFFF_FFFF, "vendor-ID in 1018h/1", HEX)

    def reading(self, entry: Entry, data: bytes) -> bytes:
        if entry.address == com.IDENTITY_VENDOR:
            return self.vendor_id.to_bytes(4, "little")
        return data


@dataclass(kw_only=True, eq=False)
class ObjectMissing(Misbehaviour):
    """An object of the data sheet does not exist in the device (abort 06020000h)."""

    name = "object-missing"
    at_configuration = True
    index: int = parameter(com.CONSUMER_HEARTBEAT, 0x1000, 0xFFFF, "index of the object", HEX)

    def reading(self, entry: Entry, data: bytes) -> bytes:
        self.writing(entry, data)
        return data

    def writing(self, entry: Entry, data: bytes) -> None:
        if entry.index == self.index:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)


@dataclass(kw_only=True, eq=False)
class FixedPdoMapping(Misbehaviour):
    """The PDO mapping is fixed: writes to it are aborted (06010002h)."""

    name = "fixed-pdo-mapping"
    at_configuration = True

    def writing(self, entry: Entry, data: bytes) -> None:
        if is_mapping_parameter(entry.index):
            raise SdoAbortedError(Abort.READ_ONLY)


@dataclass(kw_only=True, eq=False)
class MappingAbort(Misbehaviour):
    """The mapping can be cleared, but a write of the number of mapped objects is aborted (06040043h)."""

    name = "mapping-abort"
    at_configuration = True

    def writing(self, entry: Entry, data: bytes) -> None:
        if is_mapping_parameter(entry.index) and entry.subindex == 0 and any(data):
            raise SdoAbortedError(Abort.PARAMETER_INCOMPATIBLE)


@dataclass(kw_only=True, eq=False)
class FewPdos(Misbehaviour):
    """The device has fewer PDOs than its data sheet; the parameters of the others do not exist."""

    name = "two-pdos"
    at_configuration = True
    pdos: int = parameter(2, 0, 4, "number of RPDOs and TPDOs")

    def reading(self, entry: Entry, data: bytes) -> bytes:
        self.writing(entry, data)
        return data

    def writing(self, entry: Entry, data: bytes) -> None:
        if entry.index in PDO_PARAMETERS and entry.index % PDOS_MAX >= self.pdos:
            raise SdoAbortedError(Abort.NO_SUCH_OBJECT)


@dataclass(kw_only=True, eq=False)
class SyncCounter(Misbehaviour):
    """1019h is 10, so each SYNC without a counter is ignored. It can be written while 1006h is 0."""

    name = "sync-counter"
    at_configuration = True
    fixed: int = parameter(0, 0, 1, "1: it cannot be written")

    def begin(self) -> None:
        entry = Entry(com.SYNC_COUNTER, 0, "Synchronous counter", CanType.U8, Access.RW, default=10)
        self.node.entries[entry.address] = entry
        self.node.values[entry.address] = 10

    def end(self) -> None:
        del self.node.entries[com.SYNC_COUNTER, 0]

    def writing(self, entry: Entry, data: bytes) -> None:
        if entry.index == com.SYNC_COUNTER:
            if self.fixed:
                raise SdoAbortedError(Abort.READ_ONLY)
            if self.node.values.get((com.SYNC_PERIOD, 0)):
                raise SdoAbortedError(Abort.CANNOT_STORE_DEVICE_STATE)

    def incoming(self, can_id: int, data: bytes) -> bool:
        return can_id != com.SYNC or bool(data) or not self.node.values[com.SYNC_COUNTER, 0]


# -- PDO ------------------------------------------------------------------------------------------------------------------


_COB_ID_OF_TPDO1, _TYPE_OF_TPDO1 = (0x1800, 1), (0x1800, 2)


@dataclass(kw_only=True, eq=False)
class PolledTpdo(Misbehaviour):
    """The transmission type of TPDO1 is fixed to FDh: it is sent on remote request only, here never."""

    name = "polled-tpdo"
    at_configuration = True

    def reading(self, entry: Entry, data: bytes) -> bytes:
        return b"\xfd" if entry.address == _TYPE_OF_TPDO1 else data

    def writing(self, entry: Entry, data: bytes) -> None:
        if entry.address == _TYPE_OF_TPDO1:
            raise SdoAbortedError(Abort.READ_ONLY)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return can_id != int(self.node.values.get(_COB_ID_OF_TPDO1, 0)) & STANDARD_ID


@dataclass(kw_only=True, eq=False)
class LostPdos(Misbehaviour):
    """PDOs are lost in both directions: all of them, or each n-th."""

    name = "lost-pdos"
    every: int = parameter(3, 1, 1000, "1: all are lost; n: each n-th")
    _counts: Counter[int] = field(init=False, repr=False, default_factory=Counter)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        if not self.node.is_pdo(can_id):
            return True
        self._counts[can_id] += 1
        return self._counts[can_id] % self.every != 0

    def incoming(self, can_id: int, data: bytes) -> bool:
        return self.outgoing(can_id, data)


@dataclass(kw_only=True, eq=False)
class DuplicatedPdos(Misbehaviour):
    """Each PDO is sent several times, in both directions."""

    name = "duplicated-pdos"
    copies: int = parameter(1, 1, 10, "repetitions of each frame")

    def outgoing(self, can_id: int, data: bytes) -> bool:
        for _ in range(self.copies if self.node.is_pdo(can_id) else 0):
            self.node.transmit(can_id, data, past=self)
        return True

    def incoming(self, can_id: int, data: bytes) -> bool:
        for _ in range(self.copies if self.node.is_pdo(can_id) else 0):
            self.node.receive(can_id, data, self.node.now, past=self)
        return True


@dataclass(kw_only=True, eq=False)
class LatePdos(Late):
    """Each PDO is late, in both directions, in the right order."""

    name = "late-pdos"
    delay_ms: int = parameter(40, 1, 10_000, "delay of each PDO", "ms")

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return not self.node.is_pdo(can_id) or self._hold(True, can_id, data)

    def incoming(self, can_id: int, data: bytes) -> bool:
        return not self.node.is_pdo(can_id) or self._hold(False, can_id, data)


# -- error control, EMCY, bus ---------------------------------------------------------------------------------------------


@dataclass(kw_only=True, eq=False)
class HeartbeatStops(Misbehaviour):
    """The heartbeat stops; everything else continues."""

    name = "heartbeat-stops"

    def outgoing(self, can_id: int, data: bytes) -> bool:
        # The boot-up message has the same COB-ID but is not a heartbeat.
        return can_id != ERROR_CONTROL + self.node.node_id or data == b"\0"


@dataclass(kw_only=True, eq=False)
class EmcyBurst(Misbehaviour):
    """The same emergency message is sent repeatedly, as from a loose contact."""

    name = "emcy-burst"
    code: int = parameter(0x5000, 1, 0xFFFF, "error code", HEX)
    register: int = parameter(0x01, 0, 0xFF, "error register; 0: no error", HEX)
    count: int = parameter(50, 1, 10_000, "number of messages")
    period_ms: int = parameter(2, 1, 10_000, "time between two of them", "ms")
    _due: int = field(init=False, repr=False, default=0)
    _sent: int = field(init=False, repr=False, default=0)

    def begin(self) -> None:
        self._due = self.node.now

    def poll(self, now: int) -> None:
        while self._sent < self.count and now >= self._due:
            self._sent += 1
            self._due += self.period_ms * MS
            self.node.send_emcy(self.code, self.register)

    def next_event(self, now: int) -> int | None:
        return self._due if self._sent < self.count else None


@dataclass(kw_only=True, eq=False)
class BusOff(Misbehaviour):
    """The node is bus-off: it does not send or receive. Afterwards it reports EMCY 8140h."""

    name = "bus-off"
    recovery_ms: int = parameter(1000, 0, 3_600_000, "time until recovery; 0: only when the fault is removed", "ms")
    _since: int = field(init=False, repr=False, default=0)
    _off: bool = field(init=False, repr=False, default=True)

    def begin(self) -> None:
        self._since = self.node.now

    def incoming(self, can_id: int, data: bytes) -> bool:
        return not self._off

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return not self._off

    def poll(self, now: int) -> None:
        if self._off and self.recovery_ms and now - self._since >= self.recovery_ms * MS:
            self._recover()

    def next_event(self, now: int) -> int | None:
        return self._since + self.recovery_ms * MS if self._off and self.recovery_ms else None

    def end(self) -> None:
        if self._off:
            self._recover()

    def _recover(self) -> None:
        self._off = False
        self.node.send_emcy(BUS_OFF_RECOVERED, 0)


@dataclass(kw_only=True, eq=False)
class ErrorPassive(Late):
    """The node is error-passive: it reports EMCY 8120h, and its frames are late."""

    name = "error-passive"
    delay_ms: int = parameter(5, 1, 1000, "delay of each frame the node sends", "ms")

    _reported: bool = field(init=False, repr=False, default=False)

    def poll(self, now: int) -> None:
        if not self._reported and self.node.running:
            self._reported = True
            self.node.send_emcy(ERROR_PASSIVE, COMMUNICATION_ERROR)
        super().poll(now)

    def next_event(self, now: int) -> int | None:
        return now if not self._reported and self.node.running else super().next_event(now)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        return self._hold(True, can_id, data)

    def end(self) -> None:
        super().end()
        self.node.send_emcy(0, 0)


@dataclass(kw_only=True, eq=False)
class Reboot(Misbehaviour):
    """The node restarts once: it is silent, then sends its boot-up message and has power-on values."""

    name = "reboot"
    off_ms: int = parameter(20, 0, 60_000, "silent before the boot-up message", "ms")
    _back_at: int | None = field(init=False, repr=False, default=None)

    def begin(self) -> None:
        self._go()

    def _go(self) -> None:
        self.node.power_off()
        self._back_at = self.node.now + self.off_ms * MS

    def poll(self, now: int) -> None:
        if self._back_at is not None and now >= self._back_at:
            self._back_at = None
            self.node.restart()

    def next_event(self, now: int) -> int | None:
        return self._back_at

    def end(self) -> None:
        if self._back_at is not None:
            self.poll(self._back_at)


NODE_MISBEHAVIOURS = catalogue(
    (
        SlowSdo,
        SdoTimeout,
        SdoToggleError,
        WrongIdentity,
        ObjectMissing,
        FixedPdoMapping,
        MappingAbort,
        FewPdos,
        PolledTpdo,
        SyncCounter,
        LostPdos,
        DuplicatedPdos,
        LatePdos,
        HeartbeatStops,
        EmcyBurst,
        BusOff,
        ErrorPassive,
        Reboot,
    )
)
"""All faults of any CANopen device."""
