"""One application relationship: its states, its timers, its protocol machines; sans-I/O.

Source: IEC 61158-5-10/-6-10 (CMDEV, CMSM, CMPBE). Its states are those of ``cmdev.TABLE``. An ended relationship stays ended:
the controller must connect again, and drives start only by the rules of the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Protocol
from uuid import UUID

from pdgw.base.durations import MS, SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import HEADER
from pdgw.profinet import ethernet
from pdgw.profinet.alarms.apmx import AlarmMachine, AlarmRelation
from pdgw.profinet.alarms.diagnosis import AlarmSource
from pdgw.profinet.blocks.alarm import Priority
from pdgw.profinet.blocks.connect_blocks import ArType
from pdgw.profinet.blocks.control import ApplicationReadyReq, ApplicationReadyRes, ControlCommand
from pdgw.profinet.connection.cmdev import ABORTS, TABLE, Action, Event, State
from pdgw.profinet.connection.connect import ConnectPlan
from pdgw.profinet.connection.cpm import Consumer, Verdict
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.model import Subslot
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, RpcHeader
from pdgw.profinet.rpc.records import PnioStatus, decode_arguments, encode_arguments

Address = tuple[str, int]
_ACCEPTED, _PROVIDER_STOP = Verdict.ACCEPTED, Verdict.PROVIDER_STOP
_DATA = State.DATA

ACTIVITY_UNIT_NS: Final = 100 * MS
RTA_UNIT_NS: Final = 100 * MS
READY_INTERVAL_NS: Final = 2 * SECOND
READY_ATTEMPTS: Final = 3
CONTROL_OPERATION: Final = 4
_ARGS_MAX = 4096


@dataclass(frozen=True, slots=True)
class Ended:
    """Reasons for the end of a relationship."""

    event: Event
    status: PnioStatus
    """That of an error from the controller as it was received, else that of the own ERR."""
    state: State
    """The state that has ended."""

    @property
    def text(self) -> str:
        return f"{self.event.value} ({self.status.codes})"


@dataclass(slots=True)
class CyclicCounters:
    """Cyclic frames of all relationships of a device, one after the other."""

    received: dict[Verdict, int] = field(default_factory=lambda: dict.fromkeys(Verdict, 0))
    sent: int = 0
    missed: int = 0
    """Cycles without a frame: this side was late."""


class Output(Protocol):
    """Output of frames and datagrams."""

    def frame(self, data: bytes | bytearray) -> None:
        """Send an Ethernet frame."""

    def datagram(self, data: bytes, address: Address) -> None:
        """Send a UDP datagram from the RPC port."""


class ApplicationRelation:
    """One AR from the granted Connect to its end. ``activity``: UUID of the calls of its own."""

    def __init__(
        self,
        plan: ConnectPlan,
        source: Address,
        own_mac: bytes,
        own_reference: int,
        activity: UUID,
        alarms: AlarmSource,
        output: Output,
        now: int,
        cyclic: CyclicCounters | None = None,
    ) -> None:
        ar = plan.ar
        self.plan = plan
        self.source = source
        self.activity = activity
        self.reference = own_reference
        """Reference of the alarm relationship on this side."""
        self.ended: Ended | None = None
        self.has_data = ar.ar_type != ArType.DEVICE_ACCESS
        self.state = State.PARAMETERISING if self.has_data else State.ACCESS
        self.since_ns = now
        """When the state began."""
        self.stored: dict[tuple[Subslot, int], bytes] = {}
        """Records written to interface and port, by place and index."""
        self._output = output
        self._cyclic = cyclic or CyclicCounters()
        self.alarms = alarms
        """Pending notifications to the controller."""
        self._activity_ns = ar.activity_timeout * ACTIVITY_UNIT_NS
        self._activity_due: int | None = now + self._activity_ns
        self._ready_due: int | None = None
        self._ready_attempts = 0
        self._ready_sequence = -1
        self.provider: Provider | None = None
        self.consumer: Consumer | None = None
        self.machines: dict[Priority, AlarmMachine] = {}
        self.head = b""
        """First bytes of an untagged frame with output data; empty without data."""
        if plan.inputs is not None and plan.outputs is not None and plan.alarm is not None:
            self.provider = Provider(plan.inputs, ar.initiator_mac, own_mac, plan.proper)
            self.provider.start(now)
            self.consumer = Consumer(plan.outputs, self._cyclic.received)
            self.head = ethernet.header(own_mac, ar.initiator_mac) + HEADER.pack(plan.outputs.frame_id)
            relation = AlarmRelation(
                ar.initiator_mac,
                own_mac,
                plan.alarm.reference,
                own_reference,
                plan.alarm.rta_timeout * RTA_UNIT_NS,
                plan.alarm.rta_retries,
            )
            self.machines = {priority: AlarmMachine(relation, priority) for priority in Priority}

    @property
    def alive(self) -> bool:
        return self.state is not State.CLOSED

    @property
    def connected(self) -> bool:
        """Output data counts."""
        return self.state is State.DATA

    def belongs_to(self, host: str, session_key: int) -> bool:
        """Whether a service comes from this relationship's controller and session."""
        return host == self.source[0] and session_key == self.plan.ar.session_key

    def accepts(self, event: Event) -> bool:
        """Whether a service is possible in this state."""
        return TABLE[self.state, event][1] is not Action.REFUSE

    # -- events -------------------------------------------------------------------------------------------------------

    def handle(self, event: Event, now: int, received: PnioStatus | None = None) -> bool:
        """Let something happen; False when a service is refused in this state. ``received``: the status of an error that
        the controller has sent."""
        before = self.state
        self.state, action = TABLE[before, event]
        if self.state is not before:
            self.since_ns = now
        match action:
            case Action.REFUSE:
                return False
            case Action.RESTART_ACTIVITY:
                self._activity_due = now + self._activity_ns
            case Action.SEND_READY:
                self._activity_due = None
                self._open()
                self._ready_attempts = 0
                self._ready_sequence += 1
                self._send_ready(now)
            case Action.AWAIT_DATA:
                self._ready_due = None
                self._activity_due = now + self._activity_ns
                if self.consumer is not None and self.consumer.last_ns is not None:
                    self.handle(Event.DATA_RECEIVED, now)
            case Action.CONNECT:
                self._activity_due = None
            case Action.HOLD_BACK:
                self._activity_due = now + self._activity_ns
                if self.provider is not None:
                    self.provider.close()
            case Action.ABORT:
                if self.machines:
                    error = ABORTS[event].status.value
                    self._output.frame(self.machines[Priority.LOW].error(error))
                self._end(event, before, received)
            case Action.CLOSE:
                self._end(event, before, received)
        return True

    def _open(self) -> None:
        if self.provider is not None:
            self.provider.open()

    def _end(self, event: Event, state: State, received: PnioStatus | None) -> None:
        self.ended = Ended(event, received or ABORTS[event].status, state)
        self._activity_due = self._ready_due = None

    # -- ApplicationReady ---------------------------------------------------------------------------------------------

    def _send_ready(self, now: int) -> None:
        ar = self.plan.ar
        block = ApplicationReadyReq(
            ar_uuid=ar.ar_uuid, session_key=ar.session_key, command=ControlCommand.APPLICATION_READY
        ).encode()
        if self.plan.diff is not None:
            block += self.plan.diff.encode()
        header = RpcHeader(
            PacketType.REQUEST,
            ar.initiator_object,
            self.activity,
            self._ready_sequence,
            CONTROL_OPERATION,
            interface=dcerpc.CONTROLLER_INTERFACE,
            flags=Flags.IDEMPOTENT,
        )
        ndr = encode_arguments(_ARGS_MAX, block, max(_ARGS_MAX, len(block)), little=header.little_endian)
        for packet in dcerpc.encode_fragments(header, ndr):
            self._output.datagram(packet, (self.source[0], dcerpc.ACYCLIC_PORT))
        self._ready_attempts += 1
        self._ready_due = now + READY_INTERVAL_NS

    def answer(self, header: RpcHeader, body: bytes, host: str, now: int) -> None:
        """An RPC packet with this relationship's own activity; only the answer to the present call counts."""
        if self.state is not State.CONFIRMING or host != self.source[0] or header.sequence != self._ready_sequence:
            return
        if header.packet_type in {PacketType.REJECT, PacketType.FAULT}:
            self.handle(Event.UNCONFIRMED, now)
            return
        if header.packet_type is not PacketType.RESPONSE:
            return
        try:
            status, arguments = decode_arguments(body, little=header.little_endian)
            confirmed = status == 0 and self._is_confirmation(ApplicationReadyRes.decode(arguments))
        except ProfidriveError:
            return
        received = PnioStatus.of(status) if status else None
        self.handle(Event.CONFIRMED if confirmed else Event.UNCONFIRMED, now, received)

    def _is_confirmation(self, block: ApplicationReadyRes) -> bool:
        ar = self.plan.ar
        return (block.ar_uuid, block.session_key, block.command) == (ar.ar_uuid, ar.session_key, ControlCommand.DONE)

    # -- cyclic data and alarms ---------------------------------------------------------------------------------------

    def receive(self, frame: bytes, start: int, now: int) -> bool:
        """A frame with the output FrameID from the controller's MAC; True when the data counts now."""
        if self.consumer is None or self.state is State.CLOSED:
            return False
        verdict = self.consumer.receive(frame, start, now)
        if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
            if self.state is _DATA:
                return True
            self.handle(Event.DATA_RECEIVED, now)
            return self.connected
        return False

    def receive_alarm(self, priority: Priority, frame: bytes, start: int, now: int) -> None:
        """An alarm PDU from the controller's MAC."""
        machine = self.machines.get(priority)
        if machine is None or not self.alive:
            return
        error = machine.receive(frame, start, now)
        if error is not None:
            self.handle(Event.PEER_ERROR, now, PnioStatus(*error[:4]))
        self._flush(machine)

    def _flush(self, machine: AlarmMachine) -> None:
        for frame in machine.frames:
            self._output.frame(frame)
        machine.frames.clear()

    def send_alarms(self, now: int) -> None:
        """Send changes, one notification at a time."""
        if not self.alarms.pending:
            return
        machine = self.machines.get(Priority.LOW)
        if machine is None or self.state not in {State.AWAITING_DATA, State.DATA} or not machine.idle:
            return
        notification = self.alarms.next()
        if notification is not None:
            machine.send(notification, now)
            self._flush(machine)

    # -- time ---------------------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int | None:
        """When ``poll`` has something to do."""
        if self.state is State.CLOSED:
            return None
        watched = self.watch_deadline
        if self.provider is None:
            return watched
        return self.provider.due if watched is None else min(self.provider.due, watched)

    @property
    def watch_deadline(self) -> int | None:
        """When ``poll`` has something else to do than to send input data. Frames that come postpone it at most."""
        nearest: int | None = None
        if self.consumer is not None:
            nearest = self.consumer.deadline
            for machine in self.machines.values():
                alarm = machine.deadline
                if alarm is not None and (nearest is None or alarm < nearest):
                    nearest = alarm
        for due in (self._activity_due, self._ready_due):
            if due is not None and (nearest is None or due < nearest):
                nearest = due
        return nearest

    def provide(self, now: int) -> bytearray | None:
        """The frame with input data when it is due; its buffer is reused."""
        provider = self.provider
        if provider is None:
            return None
        frame = provider.poll(now)
        if frame is not None:
            self._cyclic.sent += 1
            self._cyclic.missed += provider.skipped
        return frame

    def poll(self, now: int) -> None:
        """Send what is due and check timeouts."""
        if self.state is State.CLOSED:
            return
        consumer, provider = self.consumer, self.provider
        if consumer is not None and provider is not None:
            if consumer.last_ns is not None and now - consumer.last_ns >= consumer.hold_ns:
                self.handle(Event.HOLD_EXPIRED, now)
                return
            frame = self.provide(now)
            if frame is not None:
                self._output.frame(frame)
            for machine in self.machines.values():
                if machine.deadline is not None:
                    machine.poll(now)
                    self._flush(machine)
                    if machine.failed:
                        self.handle(Event.ALARM_UNACKNOWLEDGED, now)
                        return
        if self._activity_due is not None and now >= self._activity_due:
            self.handle(Event.ACTIVITY_TIMEOUT, now)
        elif self._ready_due is not None and now >= self._ready_due:
            if self._ready_attempts < READY_ATTEMPTS:
                self._send_ready(now)
            else:
                self.handle(Event.UNCONFIRMED, now)
