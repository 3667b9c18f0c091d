"""Context management: Connect, Release, Control and records by RPC, and the relationships they make.

Source: IEC 61158-5-10/-6-10 (CMRPC, CMSU). A refused call changes nothing. Release, Control and Write count only from the
relationship's own IP address and session.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.alarms.diagnosis import AlarmSource, Diagnosis
from pdgw.profinet.blocks.connect_blocks import (
    ADVANCED_STARTUP,
    LT_RT,
    AlarmCrBlockRes,
    ArBlockRes,
    ArServerBlockRes,
    IocrBlockRes,
)
from pdgw.profinet.blocks.control import ANSWERS, COMMANDS, ControlBlock, ControlCommand, PrmEndReq, ReleaseReq
from pdgw.profinet.connection.application_relation import Address, ApplicationRelation, CyclicCounters, Output
from pdgw.profinet.connection.cmdev import Event
from pdgw.profinet.connection.connect import (
    AR_UNKNOWN,
    ARGS_LENGTH,
    NO_AR_FREE,
    UNKNOWN_BLOCK,
    WRONG_STATE,
    ConnectPlan,
    ConnectRefused,
    plan,
    refuse_call,
)
from pdgw.profinet.model import DeviceModel
from pdgw.profinet.records.device_records import Access, DeviceRecords, LogItem
from pdgw.profinet.rpc import dcerpc, epm
from pdgw.profinet.rpc.dcerpc import RejectStatus, RpcHeader
from pdgw.profinet.rpc.epm import EndpointMapper
from pdgw.profinet.rpc.records import (
    CMRPC,
    PNIO,
    Operation,
    PnioStatus,
    decode_arguments,
    encode_arguments,
)
from pdgw.profinet.rpc.server import RECORD_OPERATIONS, RecordHandler, RpcServer, serve_record
from pdgw.profinet.station import Station
from pdgw.profinet.wire import WireError, number_of

ACCESS_RELATIONS: Final = 2
"""Device access relationships beside the one of the IO controller."""
_CALL_MAX = 1 << 15
"""Longest arguments of a call: a Connect of 254 drive objects fits."""
_RELEASE_ERROR, _CONTROL_ERROR = 0xDC, 0xDD
_WORD = 0xFFFF
_NONE: tuple[ApplicationRelation, ...] = ()


class _Refused(ProfidriveError):  # noqa: N818 (an answer, not a fault of the program)
    """A call that is refused, with its PNIO status."""

    def __init__(self, status: PnioStatus, field: str, value: object, allowed: str) -> None:
        self.status = status
        super().__init__(field, value, allowed)


class ContextManager:
    """All relationships of a device and the RPC server that makes them."""

    def __init__(
        self,
        model: DeviceModel,
        station: Station,
        diagnosis: Diagnosis,
        application: Callable[[str], RecordHandler],
        output: Output,
        *,
        seed: UUID,
        boot_time: int,
    ) -> None:
        identity = model.identity
        self._model = model
        self._station = station
        self._diagnosis = diagnosis
        self._output = output
        self._seed = seed.int
        self._made = 0
        self._object = dcerpc.object_uuid(identity.instance, identity.device_id, identity.vendor_id)
        self._mapper = EndpointMapper(self._object, identity.annotation)
        self._afterwards: list[Callable[[int], object]] = []
        self._ended: list[ApplicationRelation] = []
        self.relations: dict[UUID, ApplicationRelation] = {}
        """Relationships by ARUUID."""
        self.records = DeviceRecords(model, station, diagnosis, application, self.relations.values)
        self.io: ApplicationRelation | None = None
        """That of the IO controller."""
        self.server: RpcServer[Address] = RpcServer(
            {
                (dcerpc.DEVICE_INTERFACE, dcerpc.INTERFACE_VERSION): self._execute,
                epm.INTERFACE: self._lookup,
            },
            _CALL_MAX,
            boot_time,
        )
        self._services = {
            int(Operation.CONNECT): self._connect,
            int(Operation.RELEASE): self._release,
            int(Operation.CONTROL): self._control,
        }
        self.cyclic = CyclicCounters()
        self.refusals = 0
        """Connects that were refused."""
        self.refused: tuple[Address, ConnectRefused] | None = None
        """The last of them, until it is reported."""

    def replug(self, model: DeviceModel) -> None:
        """Other modules are plugged; only while there is no relationship."""
        self._model = model
        self.records.replug(model)

    # -- calls --------------------------------------------------------------------------------------------------------

    def _lookup(self, header: RpcHeader, body: bytes, source: Address, now: int) -> bytes | RejectStatus:
        address = self._station.ip.address
        return self._mapper.execute(header.operation, body, address, little=header.little_endian)

    def _execute(self, header: RpcHeader, body: bytes, source: Address, now: int) -> bytes | RejectStatus:
        if header.object != self._object:
            return RejectStatus.UNKNOWN_INTERFACE
        operation = header.operation
        if operation in RECORD_OPERATIONS:
            access = Access(self.records, self.relations.get, source[0], now, lambda item: self._used(item, now))
            return serve_record(access, header, body)
        serve = self._services.get(operation)
        if serve is None:
            return RejectStatus.OPERATION_OUT_OF_RANGE
        try:
            maximum, arguments = decode_arguments(body, little=header.little_endian)
        except ProfidriveError:
            return RejectStatus.PROTOCOL_ERROR
        try:
            answer, status = serve(arguments, maximum, source, now), PnioStatus()
        except (ConnectRefused, _Refused) as refusal:
            answer, status = b"", refusal.status
        most = max(maximum, len(answer))
        return encode_arguments(status.value, answer, most, little=header.little_endian)

    def _used(self, relation: ApplicationRelation, now: int) -> None:
        relation.handle(Event.RECORD, now)

    def after_answer(self, now: int) -> None:
        """Actions of a call after its answer was sent."""
        for action in self._afterwards:
            action(now)
        self._afterwards.clear()

    # -- Connect ------------------------------------------------------------------------------------------------------

    def _connect(self, arguments: bytes, maximum: int, source: Address, now: int) -> bytes:
        try:
            granted = plan(arguments, self._model)
            replaced = self._check_free(granted, source)
            relation = self._new(granted, source, now)
            answer = self._grant(relation)
            if len(answer) > maximum:
                raise refuse_call(ARGS_LENGTH, "ArgsMaximum", maximum, f"at least {len(answer)}")
        except ConnectRefused as refusal:
            self.refusals += 1
            self.refused = source, refusal
            raise
        if replaced is not None:
            replaced.handle(Event.RESTARTED, now)
            self._discard(replaced, now)
        self.relations[granted.ar.ar_uuid] = relation
        if relation.provider is not None:
            self.io = relation
            relation.provider.set_problem(self._diagnosis.has_fault)
        return answer

    def _check_free(self, granted: ConnectPlan, source: Address) -> ApplicationRelation | None:
        """The relationship that the new one takes the place of: that of the same controller before it restarted."""
        if granted.ar.ar_uuid in self.relations:
            raise refuse_call(WRONG_STATE, "ARUUID", str(granted.ar.ar_uuid), "one that is not connected already")
        if granted.inputs is None:
            access = [item for item in self.relations.values() if not item.has_data]
            if len(access) >= ACCESS_RELATIONS:
                raise refuse_call(
                    NO_AR_FREE, "device access relationship", len(access) + 1, f"at most {ACCESS_RELATIONS}"
                )
            return None
        present = self.io
        if present is not None and (
            source[0] != present.source[0] or granted.ar.initiator_mac != present.plan.ar.initiator_mac
        ):
            raise refuse_call(NO_AR_FREE, "IO controller", source[0], f"{present.source[0]}, which is connected")
        return present

    def _new(self, granted: ConnectPlan, source: Address, now: int) -> ApplicationRelation:
        self._made += 1
        return ApplicationRelation(
            granted,
            source,
            self._station.identity.mac,
            self._made & _WORD,
            UUID(int=(self._seed + self._made) % (1 << 128)),
            AlarmSource(self._diagnosis, self._model, granted.proper),
            self._output,
            now,
            self.cyclic,
        )

    def _grant(self, relation: ApplicationRelation) -> bytes:
        granted = relation.plan
        ar = granted.ar
        blocks = ArBlockRes(
            ar_type=ar.ar_type,
            ar_uuid=ar.ar_uuid,
            session_key=ar.session_key,
            responder_mac=self._station.identity.mac,
            rt_port=LT_RT,
        ).encode()
        for item in (granted.inputs, granted.outputs):
            if item is not None:
                block = item.block
                blocks += IocrBlockRes(
                    iocr_type=block.iocr_type, reference=block.reference, frame_id=item.frame_id
                ).encode()
        if granted.alarm is not None:
            blocks += AlarmCrBlockRes(
                cr_type=granted.alarm.cr_type, reference=relation.reference, max_length=granted.alarm.max_length
            ).encode()
        if granted.diff is not None:
            blocks += granted.diff.encode()
        if relation.has_data and ar.properties & ADVANCED_STARTUP:
            blocks += ArServerBlockRes(station_name=self._station.name).encode()
        return blocks

    # -- Release and Control ------------------------------------------------------------------------------------------

    def _release(self, arguments: bytes, maximum: int, source: Address, now: int) -> bytes:
        block, relation = self._service(ReleaseReq, ControlCommand.RELEASE, _RELEASE_ERROR, arguments, source)
        self._afterwards.append(lambda when: relation.handle(Event.RELEASE, when))
        return self._done(block)

    def _control(self, arguments: bytes, maximum: int, source: Address, now: int) -> bytes:
        kind = int.from_bytes(arguments[:2], "big")
        cls, command = COMMANDS.get(kind, (None, None))
        if cls is None or command is None:
            status = PnioStatus(_CONTROL_ERROR, PNIO, CMRPC, UNKNOWN_BLOCK)
            raise _Refused(status, "BlockType", f"{kind:04X}h", "PrmEnd or PrmBegin")
        block, relation = self._service(cls, command, _CONTROL_ERROR, arguments, source)
        event = Event.PRM_END if cls is PrmEndReq else Event.PRM_BEGIN
        if not relation.accepts(event):
            status = PnioStatus(_CONTROL_ERROR, PNIO, CMRPC, WRONG_STATE)
            raise _Refused(status, cls.__name__, relation.state.value, "another state")
        # Send it after the answer: ApplicationReady must not overtake it.
        self._afterwards.append(lambda when: relation.handle(event, when))
        return self._done(block)

    def _service(
        self, cls: type[ControlBlock], command: ControlCommand, code: int, arguments: bytes, source: Address
    ) -> tuple[ControlBlock, ApplicationRelation]:
        try:
            block = cls.decode(arguments)
        except WireError as error:
            status = PnioStatus(code, PNIO, cls.ERROR_CODE1, error.number)
            raise _Refused(status, error.field, error.value, error.allowed) from error
        if block.command != command:
            status = PnioStatus(code, PNIO, cls.ERROR_CODE1, number_of(cls, "command"))
            raise _Refused(status, "ControlCommand", block.command, f"{command:#x}")
        relation = self.relations.get(block.ar_uuid)
        if relation is None or not relation.belongs_to(source[0], block.session_key):
            status = PnioStatus(code, PNIO, CMRPC, AR_UNKNOWN)
            raise _Refused(status, "ARUUID, session and address", str(block.ar_uuid), "those of a connected AR")
        return block, relation

    def _done(self, block: ControlBlock) -> bytes:
        answer = ANSWERS[type(block)]
        return answer(ar_uuid=block.ar_uuid, session_key=block.session_key, command=ControlCommand.DONE).encode()

    # -- answers to own calls, and ends -------------------------------------------------------------------------------

    def answer(self, header: RpcHeader, body: bytes, host: str, now: int) -> None:
        """An RPC packet that answers a call of our own."""
        for relation in self.relations.values():
            if relation.activity == header.activity:
                relation.answer(header, body, host, now)
                return

    def sweep(self, now: int) -> Sequence[ApplicationRelation]:
        """Forget the relationships that ended; they are returned once."""
        if not self._ended and all(item.alive for item in self.relations.values()):
            return _NONE
        for relation in [item for item in self.relations.values() if not item.alive]:
            self._discard(relation, now)
        ended, self._ended = self._ended, []
        return ended

    def _discard(self, relation: ApplicationRelation, now: int) -> None:
        ar_uuid = relation.plan.ar.ar_uuid
        del self.relations[ar_uuid]
        if relation is self.io:
            self.io = None
        if relation.ended is not None:
            self.records.log.append(LogItem(now, ar_uuid, relation.ended.status.value))
        self._ended.append(relation)
