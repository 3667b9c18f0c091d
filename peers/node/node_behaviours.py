"""The behaviours of any simulated CANopen node.

Source: CiA DS 301. ``peers/habits.toml`` has the habits that are made of them.
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Callable, Mapping
from operator import attrgetter
from random import Random
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301 import communication as com
from pdgw.ds301.communication import EMCY, ERROR_CONTROL, NMT, SDO_REQUEST, SDO_RESPONSE, NmtCommand
from pdgw.ds301.emcy import BUS_OFF_RECOVERED, COMMUNICATION_ERROR, ERROR_PASSIVE
from pdgw.ds301.sdo_frames import COMMAND, CONFIRM, DOWNLOAD, EXPEDITED, SEGMENT, SIZE, TOGGLE, UPLOAD
from pdgw.peers.node.behaviour import Behaviour, catalogue
from pdgw.peers.node.lss import LssSlave
from pdgw.peers.node.object_behaviours import OBJECT_BEHAVIOURS

# -- frames ---------------------------------------------------------------------------------------------------------------

_INCOMING: Final = frozenset({"pdo", "rpdo", "nmt"})
_OUTGOING: Final = frozenset({"sdo", "pdo", "tpdo", "heartbeat", "boot-up", "emcy", "sent"})
"""The kinds of frames that a node receives, and those that it sends."""
_COB_IDS: Final = {"sdo": SDO_RESPONSE, "emcy": EMCY, "heartbeat": ERROR_CONTROL, "boot-up": ERROR_CONTROL}


class Frames(Behaviour):
    """Frames of one kind are late (in the same order), repeated or lost: all of them, or each n-th.

    ``index``: only SDO answers that name this object; 0: all.
    """

    kind = "sent"
    index = 0
    every = 1
    delay_ms = 0
    jitter_ms = 0
    copies = 0
    lost = False

    def begin(self) -> None:
        self._counts: Counter[int] = Counter()
        self._waiting: deque[tuple[int, Callable[[], None]]] = deque()
        self._chance = Random(0)

    def incoming(self, can_id: int, data: bytes) -> bool:
        def receive() -> None:
            self.node.receive(can_id, data, self.node.now, past=self)

        return self.kind not in _INCOMING or self._passes(can_id, data, receive)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        def transmit() -> None:
            self.node.transmit(can_id, data, past=self)

        return self.kind not in _OUTGOING or self._passes(can_id, data, transmit)

    def _is_concerned(self, can_id: int, data: bytes) -> bool:
        if self.kind.endswith("pdo"):
            return self.node.is_pdo(can_id)
        if self.kind in _COB_IDS and can_id != _COB_IDS[self.kind] + self.node.node_id:
            return False
        if self.index and int.from_bytes(data[1:3], "little") != self.index:
            return False
        return data == b"\0" if self.kind == "boot-up" else self.kind != "heartbeat" or data != b"\0"

    def _passes(self, can_id: int, data: bytes, go: Callable[[], None]) -> bool:
        if not self._is_concerned(can_id, data):
            return True
        self._counts[can_id] += 1
        if self._counts[can_id] % self.every:
            return True
        for _ in range(self.copies):
            go()
        delay = self.delay_ms + self._chance.randint(0, self.jitter_ms)
        if self.lost or not (delay or self._waiting):
            return not self.lost
        due = self.node.now + delay * MS
        self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, go))
        return False

    def poll(self, now: int) -> None:
        while self._waiting and now >= self._waiting[0][0]:
            self._waiting.popleft()[1]()

    def next_event(self, now: int) -> int | None:
        return self._waiting[0][0] if self._waiting else None

    def end(self) -> None:
        while self._waiting:
            self._waiting.popleft()[1]()


# -- SDO ------------------------------------------------------------------------------------------------------------------

_EXPEDITED_UPLOAD: Final = UPLOAD | EXPEDITED
_SEGMENTED_UPLOAD: Final = UPLOAD | SIZE


def _is_expedited_upload(data: bytes) -> bool:
    return data[0] & (COMMAND | EXPEDITED) == _EXPEDITED_UPLOAD


class SdoSize(Behaviour):
    """Every expedited upload has the same command byte, and four bytes of data."""

    command = 0

    def outgoing(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_RESPONSE + self.node.node_id or not _is_expedited_upload(data) or data[0] == self.command:
            return True
        self.node.transmit(can_id, bytes([self.command]) + data[1:], past=self)
        return False


class SegmentedSdo(Behaviour):
    """Every upload is segmented, short values too. ``toggle`` changes the toggle bit of each segment."""

    toggle = 0
    _pending = b""

    def outgoing(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_RESPONSE + self.node.node_id:
            return True
        command = data[0]
        if _is_expedited_upload(data):
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            self._pending = data[4 : 4 + size]
            header = struct.pack("<B3sI", _SEGMENTED_UPLOAD, data[1:4], size)
            self.node.transmit(can_id, header, past=self)
            return False
        if command & COMMAND in (SEGMENT, DOWNLOAD) and self.toggle:  # a segment of either direction
            self.node.transmit(can_id, bytes([command ^ self.toggle]) + data[1:], past=self)
            return False
        return True

    def incoming(self, can_id: int, data: bytes) -> bool:
        if can_id != SDO_REQUEST + self.node.node_id or not data or not self._pending:
            return True
        pending, self._pending = self._pending, b""
        if data[0] & COMMAND != CONFIRM:
            return True
        command = (data[0] & TOGGLE ^ self.toggle) | (7 - len(pending)) << 1 | 1
        self.node.transmit(SDO_RESPONSE + self.node.node_id, bytes([command]) + pending.ljust(7, b"\0"), past=self)
        return False


# -- settings ------------------------------------------------------------------------------------------------------------


class Setting(Behaviour):
    """Attributes of the node, or of what it has by the name ``of``, have other values. The parameters have their names."""

    of = ""

    def begin(self) -> None:
        owner = attrgetter(self.of)(self.node) if self.of else self.node
        self._owner: object = owner
        settings = {**self.habit.fixed, **self.values}
        self._before = {name: getattr(owner, name) for name in settings.keys() - {"of"}}
        self._set(settings)

    def end(self) -> None:
        self._set(self._before)

    def _set(self, values: Mapping[str, object]) -> None:
        for name in self._before:
            setattr(self._owner, name, values[name])


# -- error control, EMCY, bus ---------------------------------------------------------------------------------------------


class Periodic(Behaviour):
    """``act`` is called repeatedly, ``count`` times at most."""

    period_ms = 1000
    count = 1_000_000_000
    _left = 0

    def begin(self) -> None:
        self._from(self.node.now)

    def _from(self, due: int) -> None:
        """Begin at a time."""
        self._due, self._left = due, self.count

    def poll(self, now: int) -> None:
        while self._left and now >= self._due:
            self._left -= 1
            self._due += self._next_ms() * MS
            self.act(now)

    def next_event(self, now: int) -> int | None:
        return self._due if self._left else None

    def _next_ms(self) -> int:
        return self.period_ms

    def act(self, now: int) -> None:
        """Do it once."""
        raise NotImplementedError


class Heartbeats(Periodic):
    """The heartbeat has its own period, with a random deviation."""

    period_ms = 100
    jitter_ms = 0

    def begin(self) -> None:
        super().begin()
        self._chance = Random(ERROR_CONTROL + self.node.node_id)

    def outgoing(self, can_id: int, data: bytes) -> bool:
        guarded = not self.node.values.get((com.PRODUCER_HEARTBEAT, 0))
        return guarded or can_id != ERROR_CONTROL + self.node.node_id or data == b"\0"

    def _next_ms(self) -> int:
        return self.period_ms + self._chance.randint(-self.jitter_ms, self.jitter_ms)

    def act(self, now: int) -> None:
        self.node.send_heartbeat(past=self)


class HeartbeatsAtChange(Periodic):
    """After each change of the NMT state come heartbeats, one every millisecond."""

    period_ms = 1
    _state: object = None

    def poll(self, now: int) -> None:
        if self._state is not self.node.state:
            self._state = self.node.state
            self._from(now + MS)
        super().poll(now)

    def act(self, now: int) -> None:
        self.node.send_heartbeat()


class Emcys(Periodic):
    """The same emergency message is sent repeatedly. ``then``: a heartbeat, or Pre-operational, follows each."""

    code = 0
    register = 0
    then = ""

    def act(self, now: int) -> None:
        self.node.send_emcy(self.code, self.register)
        if self.then == "heartbeat":
            self.node.send_heartbeat()
        elif self.then == "pre-operational":
            self.node.receive(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, self.node.node_id)), now)


class BusOff(Behaviour):
    """The node does not send or receive for some time."""

    recovery_ms = 0
    _off = True

    def begin(self) -> None:
        self._back_at = self.node.now + self.recovery_ms * MS

    def incoming(self, can_id: int, data: bytes) -> bool:
        return not self._off

    outgoing = incoming

    def poll(self, now: int) -> None:
        if self.recovery_ms and now >= self._back_at:
            self.end()

    def next_event(self, now: int) -> int | None:
        return self._back_at if self._off and self.recovery_ms else None

    def end(self) -> None:
        if self._off:
            self._off = False
            self.node.send_emcy(BUS_OFF_RECOVERED, 0)


class ErrorPassive(Frames):
    """The node reports that it is error-passive, and its frames are late."""

    _reported = False

    def poll(self, now: int) -> None:
        if not self._reported and self.node.running:
            self._reported = True
            self.node.send_emcy(ERROR_PASSIVE, COMMUNICATION_ERROR)
        super().poll(now)

    def next_event(self, now: int) -> int | None:
        return now if not self._reported and self.node.running else super().next_event(now)

    def end(self) -> None:
        super().end()
        self.node.send_emcy(0, 0)


class Reboot(Periodic):
    """The node restarts once: it is silent, then sends its boot-up message and has power-on values."""

    off_ms = 0
    count = 1

    def begin(self) -> None:
        self.node.power_off()
        self._from(self.node.now + self.off_ms * MS)

    def act(self, now: int) -> None:
        self.node.restart()

    def end(self) -> None:
        if self._left:
            self.act(self._due)


NODE_BEHAVIOURS: Final = (
    *OBJECT_BEHAVIOURS,
    Frames,
    SdoSize,
    SegmentedSdo,
    Setting,
    Heartbeats,
    HeartbeatsAtChange,
    Emcys,
    BusOff,
    ErrorPassive,
    Reboot,
    LssSlave,
)
NODE_HABITS: Final = catalogue("node", NODE_BEHAVIOURS)
"""All habits of any CANopen device."""
