"""Alarm protocol machine, one per priority: the acknowledged exchange of alarm PDUs, sans-I/O.

Source: IEC 61158-6-10 (RTA-PDU, APMS, APMR, ALPMI). One notification is outstanding at a time: DATA is acknowledged by the
peer's ACK, then its application answers with DATA that holds an AlarmAck. The machine is ``TABLE``.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import Final

from pdgw.profinet import ethernet
from pdgw.profinet.alarms.diagnosis import Notification
from pdgw.profinet.blocks.alarm import ACKS, Priority
from pdgw.profinet.blocks.connect_blocks import TAG_HIGH, TAG_LOW
from pdgw.profinet.wire import WireError

ALARM_FRAME_IDS: Final = {Priority.HIGH: 0xFC01, Priority.LOW: 0xFE01}
_TAGS = {Priority.HIGH: TAG_HIGH, Priority.LOW: TAG_LOW}
PDU: Final = struct.Struct(">HHHBBHHH")
"""FrameID, destination and source reference, type and version, flags, SendSeqNum, AckSeqNum, VarPartLen."""
VERSION: Final = 1
_VERSION_SHIFT = 4
FLAGS_WINDOW: Final = 0x01
FLAGS_TACK: Final = 0x11
"""DATA requests an immediate acknowledgement."""
_FIRST_SEQUENCE, _FIRST_ACK = 0xFFFF, 0xFFFE
_SEQUENCE_MASK = 0x7FFF


class PduType(enum.IntEnum):
    """PDU types."""

    DATA = 1
    NACK = 2
    ACK = 3
    ERR = 4


def encode(
    priority: Priority, peer: int, own: int, kind: PduType, sequence: int, ack: int, content: bytes = b""
) -> bytes:
    """An alarm PDU from its FrameID on."""
    flags = FLAGS_TACK if kind is PduType.DATA else FLAGS_WINDOW
    head = PDU.pack(
        ALARM_FRAME_IDS[priority], peer, own, VERSION << _VERSION_SHIFT | kind, flags, sequence, ack, len(content)
    )
    return head + content


def following(sequence: int) -> int:
    """The next sequence number: FFFFh, 0000h .. 7FFFh, 0000h."""
    return (sequence + 1) & _SEQUENCE_MASK


class State(enum.Enum):
    """States of the sending side."""

    IDLE = "idle"
    WAIT_ACK = "waits for ACK"
    WAIT_ALARM_ACK = "waits for the AlarmAck of the peer's application"


class Event(enum.Enum):
    """Events of the alarm machine."""

    SEND = "a notification is to be sent"
    ACK = "ACK of what was sent"
    ALARM_ACK = "DATA with an AlarmAck"
    OTHER_DATA = "DATA with other content"
    REPEATED = "DATA a second time"
    TIMEOUT = "no ACK within the RTA timeout"
    EXHAUSTED = "no ACK after the last repetition"


class Action(enum.Enum):
    """Actions of the alarm machine."""

    NOTHING = "nothing"
    TRANSMIT = "send DATA, start the timer"
    REPEAT = "send DATA again, start the timer"
    STOP_TIMER = "stop the timer"
    ACKNOWLEDGE = "send ACK"
    FINISH = "send ACK; the notification is done"
    ABORT = "the relationship is to be aborted"


_N, _I, _A, _W = Action.NOTHING, State.IDLE, State.WAIT_ACK, State.WAIT_ALARM_ACK
TABLE: Final[dict[tuple[State, Event], tuple[State, Action]]] = {
    (_I, Event.SEND): (_A, Action.TRANSMIT),
    (_I, Event.ACK): (_I, _N),
    (_I, Event.ALARM_ACK): (_I, Action.ACKNOWLEDGE),
    (_I, Event.OTHER_DATA): (_I, Action.ACKNOWLEDGE),
    (_I, Event.REPEATED): (_I, Action.ACKNOWLEDGE),
    (_I, Event.TIMEOUT): (_I, _N),
    (_I, Event.EXHAUSTED): (_I, _N),
    (_A, Event.SEND): (_A, _N),
    (_A, Event.ACK): (_W, Action.STOP_TIMER),
    # The AckSeqNum of the peer's DATA is an acknowledgement, too: its own ACK was lost.
    (_A, Event.ALARM_ACK): (_I, Action.FINISH),
    (_A, Event.OTHER_DATA): (_A, Action.ACKNOWLEDGE),
    (_A, Event.REPEATED): (_A, Action.ACKNOWLEDGE),
    (_A, Event.TIMEOUT): (_A, Action.REPEAT),
    (_A, Event.EXHAUSTED): (_I, Action.ABORT),
    (_W, Event.SEND): (_W, _N),
    (_W, Event.ACK): (_W, _N),
    (_W, Event.ALARM_ACK): (_I, Action.FINISH),
    (_W, Event.OTHER_DATA): (_W, Action.ACKNOWLEDGE),
    (_W, Event.REPEATED): (_W, Action.ACKNOWLEDGE),
    (_W, Event.TIMEOUT): (_W, _N),
    (_W, Event.EXHAUSTED): (_W, _N),
}


@dataclass(frozen=True, slots=True)
class AlarmRelation:
    """Both ends of an alarm relationship and its times."""

    peer_mac: bytes
    own_mac: bytes
    peer_reference: int
    own_reference: int
    timeout_ns: int
    retries: int


class AlarmMachine:
    """One priority of a relationship. Frames to send collect in ``frames``."""

    def __init__(self, relation: AlarmRelation, priority: Priority) -> None:
        self._relation = relation
        self._priority = priority
        self._sequence = _FIRST_SEQUENCE
        self._sent = _FIRST_ACK
        self._expected = _FIRST_SEQUENCE
        self._accepted = _FIRST_ACK
        self._content = b""
        self._alarm: tuple[int, ...] = ()
        self._repetitions = 0
        self.deadline: int | None = None
        """When the RTA time-out is over; None: nothing is being waited for."""
        self.state = State.IDLE
        self.frames: list[bytes] = []
        self.failed = False
        """The peer does not acknowledge: the relationship is to be aborted."""
        self.dropped = 0
        """PDUs that did not count."""
        self.refused = 0
        """Notifications the peer's application answered with an error."""

    @property
    def idle(self) -> bool:
        """A notification can be sent."""
        return self.state is State.IDLE

    def send(self, notification: Notification, now: int) -> bool:
        """Send a notification; False while another one is outstanding."""
        if not self.idle:
            return False
        block = notification.block
        self._content = block.encode()
        self._alarm = (block.alarm_type, block.api, block.slot, block.subslot, block.specifier)
        self._handle(Event.SEND, now)
        return True

    def poll(self, now: int) -> None:
        """The RTA time-out."""
        if self.deadline is not None and now >= self.deadline:
            exhausted = self._repetitions >= self._relation.retries
            self._handle(Event.EXHAUSTED if exhausted else Event.TIMEOUT, now)

    def receive(self, frame: bytes, start: int, now: int) -> bytes | None:
        """A PDU of this priority from the peer's MAC; the status of an ERR, with which the peer has ended the relationship."""
        if len(frame) - start < PDU.size:
            self.dropped += 1
            return None
        _, destination, source, kind, _, sequence, ack, length = PDU.unpack_from(frame, start)
        content = frame[start + PDU.size : start + PDU.size + length]
        relation = self._relation
        known = destination == relation.own_reference and kind >> _VERSION_SHIFT == VERSION and len(content) == length
        kind &= 0x0F
        if known and kind == PduType.ERR:
            return content
        if not known or source != relation.peer_reference:
            self.dropped += 1
        elif kind == PduType.ACK:
            self._ack(ack, now)
        elif kind == PduType.DATA:
            self._data(sequence, ack, content, now)
        else:
            self.dropped += 1
        return None

    def error(self, status: int) -> bytes:
        """The PDU that ends the relationship."""
        return self._frame(PduType.ERR, self._sent, status.to_bytes(4, "big"))

    def _ack(self, ack: int, now: int) -> None:
        if self.state is State.IDLE or ack != self._sequence:
            self.dropped += 1
            return
        self._handle(Event.ACK, now)

    def _data(self, sequence: int, ack: int, content: bytes, now: int) -> None:
        if sequence == self._accepted:
            self._handle(Event.REPEATED, now)
            return
        if sequence != self._expected:
            self.dropped += 1
            return
        self._accepted = sequence
        self._expected = following(sequence)
        acknowledged = self.state is not State.IDLE and ack == self._sequence and self._is_alarm_ack(content)
        self._handle(Event.ALARM_ACK if acknowledged else Event.OTHER_DATA, now)

    def _is_alarm_ack(self, content: bytes) -> bool:
        try:
            block = ACKS[self._priority].decode(content)
        except WireError:
            return False
        found = (block.alarm_type, block.api, block.slot, block.subslot, block.specifier)
        if found != self._alarm:
            return False
        self.refused += block.status != 0
        return True

    def _handle(self, event: Event, now: int) -> None:
        self.state, action = TABLE[self.state, event]
        match action:
            case Action.TRANSMIT:
                self._repetitions = 0
                self._transmit(now)
            case Action.REPEAT:
                self._repetitions += 1
                self._transmit(now)
            case Action.STOP_TIMER:
                self.deadline = None
            case Action.ACKNOWLEDGE:
                self.frames.append(self._frame(PduType.ACK, self._sent))
            case Action.FINISH:
                self.deadline = None
                self.frames.append(self._frame(PduType.ACK, self._sent))
                self._sequence = following(self._sequence)
            case Action.ABORT:
                self.deadline = None
                self.failed = True

    def _transmit(self, now: int) -> None:
        self._sent = self._sequence
        self.deadline = now + self._relation.timeout_ns
        self.frames.append(self._frame(PduType.DATA, self._sequence, self._content))

    def _frame(self, kind: PduType, sequence: int, content: bytes = b"") -> bytes:
        relation = self._relation
        pdu = encode(
            self._priority, relation.peer_reference, relation.own_reference, kind, sequence, self._accepted, content
        )
        return ethernet.frame(relation.peer_mac, relation.own_mac, pdu, tag=_TAGS[self._priority])
