"""A PROFINET IO device as one object: frames, datagrams and time in; frames, datagrams and events out.

Source: IEC 61158-5-10/-6-10. ``on_frame``, ``on_datagram`` and ``poll`` take what happens, ``outgoing`` hands out what is to be
sent, ``events`` what the application should know. Input data is set at any time; output data is asked for after ``on_frame`` said
that there is new data. One IO controller is served; another one is refused meanwhile.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet import ethernet
from pdgw.profinet.alarms.apmx import ALARM_FRAME_IDS
from pdgw.profinet.alarms.diagnosis import NO_SUBTYPE, Diagnosis
from pdgw.profinet.blocks.alarm import Severity
from pdgw.profinet.cm import ContextManager
from pdgw.profinet.connection.application_relation import Address, ApplicationRelation, Ended
from pdgw.profinet.connection.cmdev import Event
from pdgw.profinet.discovery import dcp, lldp
from pdgw.profinet.discovery.dcp import DcpResponder, Flash, IpSet, NameSet, ResetToFactory
from pdgw.profinet.model import DeviceModel, Subslot
from pdgw.profinet.records import physical_device
from pdgw.profinet.records.physical_device import PORT, PortFault
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import PacketType
from pdgw.profinet.rpc.records import PnioStatus
from pdgw.profinet.rpc.server import RecordHandler
from pdgw.profinet.station import IpSuite, Station

_FRAME_ID = struct.Struct(">H")
_ALARM_IDS = {frame_id: priority for priority, frame_id in ALARM_FRAME_IDS.items()}
_DCP_IDS = frozenset({dcp.FRAME_ID_GET_SET, dcp.FRAME_ID_IDENTIFY})
_CYCLIC_HEAD: Final = ethernet.HEADER_SIZE + _FRAME_ID.size
_CALLS: Final = frozenset({PacketType.REQUEST, PacketType.PING})


@dataclass(frozen=True, slots=True)
class Connected:
    """A relationship exchanges data."""

    relation: ApplicationRelation


@dataclass(frozen=True, slots=True)
class Disconnected:
    """A relationship with data has ended, before or after its data counted."""

    relation: ApplicationRelation
    ended: Ended


@dataclass(frozen=True, slots=True)
class Refused:
    """A Connect was refused; the same controller mostly asks again every few seconds."""

    host: str
    status: PnioStatus
    field: str
    """Such as ``IocrBlockReq.data_hold``."""
    reason: str

    @property
    def text(self) -> str:
        return f"Connect from {self.host} rejected, {self.status.text}: {self.reason}"


DeviceEvent = Connected | Disconnected | Refused | NameSet | IpSet | Flash | ResetToFactory
Outgoing = tuple[Address | None, bytes | bytearray]
"""An Ethernet frame (no address) or a datagram from the RPC port. A frame's buffer is reused in the next cycle."""


class ProfinetDevice:
    """The device. ``seed`` makes the UUIDs of its own calls unique: random at each start.

    ``records`` serves I&M and parameter access for a host, ``give_ip`` gives the interface an address (False: it keeps its own).
    Times are monotonic nanoseconds.
    """

    def __init__(
        self,
        model: DeviceModel,
        station: Station,
        records: Callable[[str], RecordHandler],
        *,
        seed: UUID,
        now: int,
        boot_time: int = 1,
        give_ip: Callable[[IpSuite], bool] = lambda suite: True,
    ) -> None:
        self.model = model
        self.station = station
        self.diagnosis = Diagnosis()
        self._outgoing: list[Outgoing] = []
        self._events: list[DeviceEvent] = []
        self.cm = ContextManager(model, station, self.diagnosis, records, self, seed=seed, boot_time=boot_time)
        self._octets = self.cm.records.octets
        self._port_faults: set[PortFault] = set()
        station.link_since_ns = now
        self.dcp = DcpResponder(station, lambda: self.cm.io is not None, give_ip)
        self._lldp_due = now
        self._reported: ApplicationRelation | None = None
        self._next: int | None = now
        self._watch_due = now
        """When ``poll`` has something else to do than to send input data."""
        self.foreign = 0
        """Real-time frames outside all relationships."""

    # -- in -----------------------------------------------------------------------------------------------------------

    def on_frame(self, data: bytes, now: int) -> bool:
        """An Ethernet frame; True when there is new output data."""
        io = self.cm.io
        if io is not None and data[:_CYCLIC_HEAD] == io.head:
            return self._cyclic(io, data, ethernet.HEADER_SIZE, now)
        ethertype, start = ethernet.payload_of(data)
        if ethertype == ethernet.ETHERTYPE_PROFINET and len(data) >= start + _FRAME_ID.size:
            (frame_id,) = _FRAME_ID.unpack_from(data, start)
            if io is not None and data[6:12] == io.plan.ar.initiator_mac and data[:6] == self.station.identity.mac:
                if io.consumer is not None and frame_id == io.consumer.frame_id:
                    return self._cyclic(io, data, start, now)
                if frame_id in _ALARM_IDS:
                    self._octets[0] += len(data)
                    io.receive_alarm(_ALARM_IDS[frame_id], data, start, now)
                    self._next = now
                    self._report_relations(now)
                    return False
            self._octets[0] += len(data)
            if frame_id in _DCP_IDS:
                self._dcp(data, start, now)
            else:
                self.foreign += 1
        elif ethertype == ethernet.ETHERTYPE_LLDP and data[6:12] != self.station.identity.mac:
            self._lldp(data, start, now)
        return False

    def _cyclic(self, relation: ApplicationRelation, data: bytes, start: int, now: int) -> bool:
        self._octets[0] += len(data)
        fresh = relation.receive(data, start, now)
        if relation is not self._reported:
            self._report_relations(now)
        return fresh

    def _dcp(self, data: bytes, start: int, now: int) -> None:
        answer = self.dcp.receive(data, start, now)
        if answer is not None:
            self.frame(answer)
        for event in self.dcp.events:
            self._events.append(event)
        self.dcp.events.clear()
        self._next = now

    def _lldp(self, data: bytes, start: int, now: int) -> None:
        try:
            neighbour = lldp.decode(data, start, now)
        except ProfidriveError:
            return
        self.station.neighbour = neighbour if neighbour.lifetime_ns else None
        self._check_port(now)

    def on_datagram(self, data: bytes, address: Address, now: int) -> None:
        """A UDP datagram that came to the RPC port."""
        try:
            header, body = dcerpc.decode_packet(data)
        except ProfidriveError:
            self.cm.server.malformed += 1
            return
        if header.packet_type in _CALLS:
            for answer in self.cm.server.serve(header, body, address, now):
                self.datagram(answer, address)
            self.cm.after_answer(now)
            if self.cm.refused is not None:
                (host, _), refusal = self.cm.refused
                self.cm.refused = None
                self._events.append(Refused(host, refusal.status, refusal.field, str(refusal)))
        else:
            self.cm.answer(header, body, address[0], now)
        self._report_relations(now)
        self._check_port(now)

    def on_link(self, up: bool, now: int) -> None:
        """The cable is on or off."""
        self.station.link_up = up
        self.station.link_since_ns = now
        if not up:
            self.station.neighbour = None
            self.end(Event.LINK_DOWN, now)

    def end(self, event: Event, now: int) -> None:
        """End all relationships, for example with ``Event.STOPPED``."""
        for relation in list(self.cm.relations.values()):
            relation.handle(event, now)
        self._report_relations(now)

    # -- time ---------------------------------------------------------------------------------------------------------

    def next_deadline(self) -> int:
        """When ``poll`` has something to do. Ask again after everything that happened but cyclic frames."""
        due = self._lldp_due
        for relation in self.cm.relations.values():
            deadline = relation.watch_deadline
            if deadline is not None and deadline < due:
                due = deadline
        neighbour = self.station.neighbour
        for other in (self.dcp.deadline, self._next, None if neighbour is None else neighbour.expiry_ns):
            if other is not None and other < due:
                due = other
        self._watch_due = due
        return self.cyclic_deadline

    @property
    def cyclic_deadline(self) -> int:
        """As ``next_deadline``, when nothing happened since it was asked but cyclic frames."""
        io, due = self.cm.io, self._watch_due
        return due if io is None or io.provider is None else min(io.provider.due, due)

    def provide(self, now: int) -> bytearray | None:
        """The frame with input data, to be sent now; None when that is not all there is to do, or nothing: see ``poll``."""
        io = self._reported
        if io is None or now >= self._watch_due or self._next is not None or io.alarms.pending:
            return None
        frame = io.provide(now)
        if frame is not None:
            self._octets[1] += len(frame)
        return frame

    def poll(self, now: int) -> None:
        """Send what is due and check timeouts."""
        self._next = None
        for relation in self.cm.relations.values():
            relation.poll(now)
            relation.send_alarms(now)
        if self.dcp.deadline is not None:
            for frame in self.dcp.poll(now):
                self.frame(frame)
        if now >= self._lldp_due:
            self._lldp_due = now + lldp.INTERVAL_NS
            if not self.station.lldp_silent:
                self.frame(lldp.encode(self.station))
            self._check_port(now)
        neighbour = self.station.neighbour
        if neighbour is not None and now >= neighbour.expiry_ns:
            self.station.neighbour = None
            self._check_port(now)
        self._report_relations(now)

    def _check_port(self, now: int) -> None:
        """Compare the port with the project of the controller, and adjust it."""
        io = self.cm.io
        written = {} if io is None else io.stored
        if not written and not self._port_faults and not self.station.lldp_adjusted:
            return
        physical_device.adjust(written, self.station)
        found = physical_device.faults(written, self.station, now)
        for fault in self._port_faults - found:
            self.clear_diagnosis(PORT, *fault.value)
        for fault in found - self._port_faults:
            self.set_diagnosis(PORT, *fault.value)
        self._port_faults = found

    def _report_relations(self, now: int) -> None:
        """Report the results of relationships, remove ended ones."""
        for relation in self.cm.sweep(now):
            if relation.has_data and relation.ended is not None:
                self._events.append(Disconnected(relation, relation.ended))
            if relation is self._reported:
                self._reported = None
            self._check_port(now)
        io = self.cm.io
        if io is not None and io.connected and io is not self._reported:
            self._reported = io
            self._events.append(Connected(io))

    # -- out ----------------------------------------------------------------------------------------------------------

    def frame(self, data: bytes | bytearray) -> None:
        """Output: an Ethernet frame."""
        self._octets[1] += len(data)
        self._outgoing.append((None, data))

    def datagram(self, data: bytes, address: Address) -> None:
        """Output: a datagram."""
        self._outgoing.append((address, data))

    @property
    def quiet(self) -> bool:
        """Nothing to send or report, and no deadline is nearer."""
        return not self._outgoing and not self._events and self._next is None

    def outgoing(self) -> Sequence[Outgoing]:
        """The frames and datagrams to send, in order. Send them before the next ``poll``: buffers are reused."""
        if not self._outgoing:
            return ()
        ready, self._outgoing = self._outgoing, []
        return ready

    def events(self) -> Sequence[DeviceEvent]:
        """Events since the last call."""
        if not self._events:
            return ()
        happened, self._events = self._events, []
        return happened

    def replug(self, model: DeviceModel) -> None:
        """Other modules are plugged; ProfidriveError while a controller has a relationship with the present ones."""
        if self.cm.io is not None:
            raise ProfidriveError("modules", "changed", "a change while no controller is connected")
        self.model = model
        self.cm.replug(model)

    # -- the application ----------------------------------------------------------------------------------------------

    @property
    def relation(self) -> ApplicationRelation | None:
        """The IO controller's relationship."""
        return self.cm.io

    @property
    def connected(self) -> bool:
        """A controller exchanges data."""
        return self.cm.io is not None and self.cm.io.connected

    @property
    def running(self) -> bool:
        """The controller is in RUN: its output data counts."""
        relation = self.cm.io
        return relation is not None and relation.consumer is not None and relation.consumer.running

    def output(self, place: Subslot) -> bytes | None:
        """Output data of a submodule; None unless a controller in RUN says it is GOOD and projects this submodule."""
        relation = self.cm.io
        if relation is None or not relation.connected or relation.consumer is None or place not in relation.plan.proper:
            return None
        return relation.consumer.output(place)

    def set_input(self, place: Subslot, data: bytes, *, good: bool) -> None:
        """Input data of a submodule; not good: IOPS BAD."""
        relation = self.cm.io
        if relation is not None and relation.provider is not None:
            relation.provider.set(place, data, good=good)

    def set_diagnosis(
        self, place: Subslot, error_type: int, subtype: int = NO_SUBTYPE, *, severity: Severity = Severity.FAULT
    ) -> None:
        """A diagnosis of a submodule appears. ``error_type``: for drive objects a ``MessageClass``, without ``subtype``."""
        self.diagnosis.set(place, error_type, severity, subtype)
        self._diagnosis_changed()

    def clear_diagnosis(self, place: Subslot, error_type: int | None = None, subtype: int = NO_SUBTYPE) -> None:
        """Remove a diagnosis; None: all of the submodule."""
        self.diagnosis.clear(place, error_type, subtype)
        self._diagnosis_changed()

    def _diagnosis_changed(self) -> None:
        relation = self.cm.io
        if relation is not None and relation.provider is not None:
            relation.provider.set_problem(self.diagnosis.has_fault)
            self._next = 0

    def returned(self, place: Subslot) -> None:
        """A lost submodule has valid data again: report it to its controller."""
        relation = self.cm.io
        if relation is not None:
            relation.alarms.returned(place)
            self._next = 0
