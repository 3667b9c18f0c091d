"""The IO controller, sans-I/O: frames, datagrams and time in; frames, datagrams and data of the device out.

Source: IEC 61158-5-10/-6-10. The order of services is that of real controllers in captures: Identify by name, IP by DCP,
Connect, Write, PrmEnd, ApplicationReady, cyclic data, Release. One call is active at a time; it is repeated three times.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from uuid import UUID

from pdgw.base.durations import SECOND
from pdgw.peers.controller.project import INPUT_FRAME_ID, Project
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import HEADER, IOPS_GOOD
from pdgw.profinet import ethernet
from pdgw.profinet.alarms import apmx
from pdgw.profinet.alarms.apmx import PDU, PduType
from pdgw.profinet.blocks.alarm import ACKS, NOTIFICATIONS, AlarmNotification, Priority
from pdgw.profinet.blocks.connect_blocks import AlarmCrBlockRes, ArBlockRes, IocrBlockRes, IocrType, ModuleDiffBlock
from pdgw.profinet.blocks.control import ApplicationReadyReq, ApplicationReadyRes, ControlCommand, PrmEndReq, ReleaseReq
from pdgw.profinet.connection.application_relation import Address
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.connection.ppm import Provider
from pdgw.profinet.discovery import dcp
from pdgw.profinet.model import Subslot
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.client import RecordCaller, RecordResult, RpcCall, ServiceResult
from pdgw.profinet.rpc.dcerpc import PacketType, RpcHeader
from pdgw.profinet.rpc.records import Operation, PnioStatus, decode_arguments, encode_arguments
from pdgw.profinet.rpc.server import RpcServer
from pdgw.profinet.station import IpSuite, Station
from pdgw.profinet.wire import split

_REPEAT_NS = SECOND
_ATTEMPTS = 4
_ARGS_MAX = 16_384
_PRIORITIES = {frame_id: priority for priority, frame_id in apmx.ALARM_FRAME_IDS.items()}


class Phase(enum.Enum):
    """Steps of the connection."""

    IDLE = "idle"
    IDENTIFY = "sends a DCP request for the name"
    ADDRESS = "sets the IP address"
    CONNECT = "connects"
    WRITE = "writes parameters"
    PRM_END = "ends the parameterisation"
    READY = "waits for ApplicationReady"
    DATA = "exchanges data"
    RELEASE = "releases"
    ENDED = "ended"


@dataclass
class _Call:
    """A call, sent again while no answer comes. ``done`` gets the answer and the time."""

    call: RpcCall[Any]
    done: Callable[[Any, int], None]
    service: bool = False
    due: int = 0
    attempts: int = 0


@dataclass
class Learned:
    """Data reported by the device."""

    mac: bytes = b""
    ip: IpSuite = field(default_factory=IpSuite)
    status: PnioStatus = field(default_factory=PnioStatus)
    """Status of the last rejected call."""
    diff: ModuleDiffBlock | None = None
    alarms: list[AlarmNotification] = field(default_factory=list)
    error: int | None = None
    """Status of an alarm ERR PDU that ended the relationship."""
    ended: str = ""


class IoController:
    """A controller with one device. ``provider`` has the output data, ``consumer`` the input data."""

    def __init__(self, station: Station, project: Project, ip: IpSuite, *, seed: int = 1) -> None:
        self.station = station
        self.project = project
        self.phase = Phase.IDLE
        self.learned = Learned()
        self.provider: Provider | None = None
        self.consumer: Consumer | None = None
        self.answer_alarms = True
        self.silent = False
        """Send no cyclic frames."""
        self._ip = ip
        self._seed = seed
        self._starts = 0
        self._active: list[_Call] = []
        """At most one service and one record."""
        self._waiting: deque[_Call] = deque()
        self._due: int | None = None
        self._attempts = 0
        self._outgoing: list[tuple[Address | None, bytes | bytearray]] = []
        self._alarm_reference = 0
        self._sequences: dict[Priority, tuple[int, int]] = {}
        interface = (dcerpc.CONTROLLER_INTERFACE, dcerpc.INTERFACE_VERSION)
        self._server: RpcServer[Address] = RpcServer({interface: self._serve}, _ARGS_MAX)
        self._new_session()

    def _new_session(self) -> None:
        self._starts += 1
        base = (self._seed << 64) + (self._starts << 32)
        self.ar_uuid = UUID(int=base + 1)
        self.session = self._starts & 0xFFFF
        self.initiator = dcerpc.object_uuid(1, 1, 1)
        identity = self.station.identity
        self.device_object = dcerpc.object_uuid(identity.instance, identity.device_id, identity.vendor_id)
        self._services = RecordCaller(UUID(int=base + 2), self.device_object, self.ar_uuid, _ARGS_MAX)
        self._records = RecordCaller(UUID(int=base + 3), self.device_object, self.ar_uuid)

    # -- requests -----------------------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Find the device and connect."""
        self._new_session()
        self.provider = self.consumer = None
        self._alarm_reference = 0
        self.learned = Learned()
        self._attempts = 0
        self._identify(now)

    def release(self, now: int) -> None:
        """End the relationship."""
        self.phase = Phase.RELEASE
        block = ReleaseReq(ar_uuid=self.ar_uuid, session_key=self.session, command=ControlCommand.RELEASE)
        self._send_call(Operation.RELEASE, block.encode(), self._released, now)

    def read(
        self, place: tuple[int, int, int], index: int, done: Callable[[RecordResult], None], *, implicit: bool = False
    ) -> None:
        """Read a record of (API, slot, subslot)."""
        self._waiting.append(
            _Call(self._records.read(*place, index, implicit=implicit), lambda result, _: done(result))
        )

    def write(self, place: tuple[int, int, int], index: int, data: bytes, done: Callable[[RecordResult], None]) -> None:
        """Write a record of (API, slot, subslot)."""
        self._waiting.append(_Call(self._records.write(*place, index, data), lambda result, _: done(result)))

    def set_output(self, place: Subslot, data: bytes, *, good: bool = True) -> None:
        """Set the output data of a submodule."""
        if self.provider is not None:
            self.provider.set(place, data, good=good)

    def input(self, place: Subslot) -> bytes | None:
        """The input data of a submodule; None while it is not GOOD."""
        return None if self.consumer is None else self.consumer.output(place)

    def uses(self, place: Subslot) -> bool:
        """Whether the device uses the output data of a submodule (its IOCS)."""
        consumer = self.consumer
        offset = None if consumer is None else consumer.plan.iocs.get(place)
        return consumer is not None and offset is not None and bool(consumer.payload[HEADER.size + offset] & IOPS_GOOD)

    # -- finding the device -------------------------------------------------------------------------------------------

    def _identify(self, now: int) -> None:
        self.phase = Phase.IDENTIFY
        self._attempts += 1
        self._due = now + _REPEAT_NS
        block = dcp.encode_block(dcp.Option.NAME, self.project.station_name.encode())
        request = dcp.encode(
            dcp.FRAME_ID_IDENTIFY, dcp.Service.IDENTIFY, dcp.ServiceType.REQUEST, self._attempts, block, 1
        )
        self._frame(ethernet.frame(ethernet.DCP_MULTICAST, self.station.identity.mac, request))

    def _dcp(self, data: bytes, start: int, now: int) -> None:
        if len(data) - start < dcp.HEADER.size:
            return
        frame_id, service, kind, _, _, length = dcp.HEADER.unpack_from(data, start)
        if kind != dcp.ServiceType.SUCCESS:
            return
        at = start + dcp.HEADER.size
        try:
            blocks = dict(dcp.split(data[at : at + length]))
        except ProfidriveError:
            return
        if self.phase is Phase.IDENTIFY and frame_id == dcp.FRAME_ID_IDENTIFY_RESPONSE:
            self.learned.mac = data[6:12]
            self.learned.ip = IpSuite.decode(blocks[dcp.Option.IP.value][2:])
            ids = blocks[dcp.Option.DEVICE_ID.value][2:]
            vendor, device = int.from_bytes(ids[:2], "big"), int.from_bytes(ids[2:], "big")
            self.device_object = dcerpc.object_uuid(1, device, vendor)
            self._services.device = self._records.device = self.device_object
            if self.learned.ip == self._ip:
                self._connect(now)
            else:
                self._set_address(now)
        elif self.phase is Phase.ADDRESS and service == dcp.Service.SET:
            result = blocks.get(dcp.Option.RESPONSE.value, b"")
            if result[-1:] == bytes((dcp.SetError.OK,)):
                self.learned.ip = self._ip
                self._connect(now)
            else:
                self._end(f"the device rejects the IP address: {result.hex()}")

    def _set_address(self, now: int) -> None:
        self.phase = Phase.ADDRESS
        self._due = now + _REPEAT_NS
        block = dcp.encode_block(dcp.Option.IP, bytes(2) + self._ip.encode())
        request = dcp.encode(dcp.FRAME_ID_GET_SET, dcp.Service.SET, dcp.ServiceType.REQUEST, 99, block)
        self._frame(ethernet.frame(self.learned.mac, self.station.identity.mac, request))

    # -- calls --------------------------------------------------------------------------------------------------------

    @property
    def device_address(self) -> Address:
        return str(self.learned.ip.address), dcerpc.ACYCLIC_PORT

    def _send_call(
        self, operation: Operation, arguments: bytes, done: Callable[[ServiceResult, int], None], now: int
    ) -> None:
        records = [active for active in self._active if not active.service]
        self._active = [_Call(self._services.service(operation, arguments), done, service=True), *records]
        self._poll_calls(now)

    def _datagrams(self, packets: list[bytes]) -> None:
        self._outgoing += [(self.device_address, packet) for packet in packets]

    def _connect(self, now: int) -> None:
        self.phase = Phase.CONNECT
        self._due = None
        station = self.station
        name = station.name or "controller"
        ar = self.project.ar(self.ar_uuid, self.session, station.identity.mac, self.initiator, name)
        arguments = b"".join(block.encode() for block in self.project.blocks(ar))
        self._send_call(Operation.CONNECT, arguments, self._connected, now)

    def _connected(self, result: ServiceResult, now: int) -> None:
        if result.status.value:
            self._refused("Connect", result.status)
            return
        frame_id = INPUT_FRAME_ID
        output_id = 0
        for kind, data in split(result.arguments):
            if kind == ArBlockRes.TYPE:
                ArBlockRes.decode(data)
            elif kind == IocrBlockRes.TYPE:
                block = IocrBlockRes.decode(data)
                if block.iocr_type == IocrType.INPUT:
                    frame_id = block.frame_id
                else:
                    output_id = block.frame_id
            elif kind == AlarmCrBlockRes.TYPE:
                self._alarm_reference = AlarmCrBlockRes.decode(data).reference
            elif kind == ModuleDiffBlock.TYPE:
                self.learned.diff = ModuleDiffBlock.decode(data)
        outputs = self.project.plan(IocrType.OUTPUT, output_id)
        places = frozenset(self.project.submodules)
        self.provider = Provider(outputs, self.learned.mac, self.station.identity.mac, places)
        self.provider.start(now)
        self.provider.open()
        self.consumer = Consumer(self.project.plan(IocrType.INPUT, frame_id))
        self._sequences = dict.fromkeys(Priority, (0xFFFF, 0xFFFE))
        self.phase = Phase.WRITE
        for api, slot, subslot, index, data in self.project.records:
            self.write((api, slot, subslot), index, data, self._written)
        self._poll_calls(now)

    def _written(self, result: RecordResult) -> None:
        if result.status.value:
            self.learned.status = result.status

    def _prm_end(self, now: int) -> None:
        self.phase = Phase.PRM_END
        block = PrmEndReq(ar_uuid=self.ar_uuid, session_key=self.session, command=ControlCommand.PRM_END)
        self._send_call(Operation.CONTROL, block.encode(), self._ended_parameters, now)

    def _ended_parameters(self, result: ServiceResult, _: int) -> None:
        if result.status.value:
            self._refused("PrmEnd", result.status)
        elif self.phase is Phase.PRM_END:
            self.phase = Phase.READY

    def _released(self, result: ServiceResult, _: int) -> None:
        self._end("released" if not result.status.value else f"Release refused: {result.status.text}")

    def _refused(self, what: str, status: PnioStatus) -> None:
        self.learned.status = status
        self._end(f"{what} refused: {self.learned.status.text}")

    def _end(self, why: str) -> None:
        self.phase = Phase.ENDED
        self.learned.ended = why
        self.provider = self.consumer = None
        self._due = None
        self._active.clear()
        self._waiting.clear()

    def _serve(self, header: RpcHeader, body: bytes, source: Address, now: int) -> bytes | dcerpc.RejectStatus:
        try:
            maximum, arguments = decode_arguments(body, little=header.little_endian)
            blocks = list(split(arguments))
            block = ApplicationReadyReq.decode(blocks[0][1])
            if len(blocks) > 1:
                self.learned.diff = ModuleDiffBlock.decode(blocks[1][1])
        except (ProfidriveError, IndexError):
            return dcerpc.RejectStatus.PROTOCOL_ERROR
        answer = ApplicationReadyRes(ar_uuid=block.ar_uuid, session_key=block.session_key, command=ControlCommand.DONE)
        if self.phase in {Phase.PRM_END, Phase.READY}:
            self.phase = Phase.DATA
        return encode_arguments(0, answer.encode(), maximum, little=header.little_endian)

    # -- input --------------------------------------------------------------------------------------------------------

    def on_datagram(self, data: bytes, address: Address, now: int) -> None:
        """Process a UDP datagram received on port 34964."""
        try:
            header, body = dcerpc.decode_packet(data)
        except ProfidriveError:
            return
        if header.packet_type in {PacketType.REQUEST, PacketType.PING}:
            for answer in self._server.serve(header, body, address, now):
                self._outgoing.append((address, answer))
            return
        for active in list(self._active):
            try:
                result = active.call.receive(data)
            except ProfidriveError as error:
                self._end(f"call rejected: {error}")
                return
            if isinstance(result, list):
                self._datagrams(result)
            elif result is not None:
                self._active.remove(active)
                active.done(result, now)
                return

    def on_frame(self, data: bytes, now: int) -> bool:
        """Process an Ethernet frame; True when it has new input data."""
        ethertype, start = ethernet.payload_of(data)
        if ethertype != ethernet.ETHERTYPE_PROFINET or data[:6] != self.station.identity.mac:
            return False
        frame_id = int.from_bytes(data[start : start + 2], "big")
        if frame_id in {dcp.FRAME_ID_GET_SET, dcp.FRAME_ID_IDENTIFY_RESPONSE}:
            self._dcp(data, start, now)
        elif data[6:12] != self.learned.mac:
            return False
        elif frame_id in _PRIORITIES:
            self._alarm(_PRIORITIES[frame_id], data, start)
        elif self.consumer is not None and frame_id == self.consumer.frame_id:
            return self.consumer.receive(data, start, now).value == "accepted"
        return False

    def _alarm(self, priority: Priority, data: bytes, start: int) -> None:
        _, _, reference, kind, _, sequence, _, length = PDU.unpack_from(data, start)
        content = data[start + PDU.size : start + PDU.size + length]
        kind &= 0x0F
        if reference != self._alarm_reference:
            return
        if kind == PduType.ERR:
            self.learned.error = int.from_bytes(content[:4], "big")
            self._end(f"aborted by the device: {PnioStatus.of(self.learned.error).text}")
        if kind != PduType.DATA or not self.answer_alarms:
            return
        own, accepted = self._sequences[priority]
        repeated = sequence == accepted
        mac = self.station.identity.mac
        tag = 0xC000 if priority is Priority.HIGH else 0xA000

        def send(pdu: PduType, number: int, body: bytes = b"") -> None:
            payload = apmx.encode(priority, reference, self.project.alarm().reference, pdu, number, sequence, body)
            self._frame(ethernet.frame(self.learned.mac, mac, payload, tag=tag))

        send(PduType.ACK, own)
        if repeated:
            return
        block = NOTIFICATIONS[priority].decode(content)
        self.learned.alarms.append(block)
        answer = ACKS[priority](
            alarm_type=block.alarm_type,
            api=block.api,
            slot=block.slot,
            subslot=block.subslot,
            specifier=block.specifier,
            status=0,
        )
        send(PduType.DATA, own, answer.encode())
        self._sequences[priority] = (apmx.following(own), sequence)

    # -- time and output ----------------------------------------------------------------------------------------------

    def next_deadline(self) -> int | None:
        """Next time at which ``poll`` must be called."""
        if self._waiting and not self._recording:
            return 0
        due = [self._due, *(active.due for active in self._active)]
        if self.provider is not None and self.consumer is not None:
            due += [self.provider.due, self.consumer.deadline]
        return min((when for when in due if when is not None), default=None)

    def poll(self, now: int) -> None:
        """Send what is due and check timeouts."""
        if self._due is not None and now >= self._due:
            if self._attempts >= _ATTEMPTS:
                self._end(f"no device has the name {self.project.station_name}")
            else:
                self._identify(now)
        self._poll_calls(now)
        if self.provider is not None and self.consumer is not None:
            deadline = self.consumer.deadline
            if deadline is not None and now >= deadline:
                self._end("data hold time expired: no frame from the device")
                return
            frame = self.provider.poll(now)
            if frame is not None and not self.silent:
                self._frame(frame)

    @property
    def _recording(self) -> bool:
        return not all(active.service for active in self._active)

    def _poll_calls(self, now: int) -> None:
        if not self._recording and self._waiting:
            self._active.append(self._waiting.popleft())
        elif not self._active and self.phase is Phase.WRITE:
            self._prm_end(now)
        for active in self._active:
            if now >= active.due:
                if active.attempts >= _ATTEMPTS:
                    self._end("the device does not answer")
                    return
                active.attempts += 1
                active.due = now + _REPEAT_NS
                self._datagrams(active.call.packets)

    def _frame(self, data: bytes | bytearray) -> None:
        self._outgoing.append((None, data))

    def outgoing(self) -> list[tuple[Address | None, bytes | bytearray]]:
        """The datagrams and frames to send, in order."""
        ready, self._outgoing = self._outgoing, []
        return ready
