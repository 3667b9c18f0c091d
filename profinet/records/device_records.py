"""The records a device serves of itself: identification, differences, diagnosis, interface, port, relationships, log.

Source: IEC 61158-6-10 (record indexes). What an application knows better (I&M, parameter access) goes to its own handler.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from uuid import UUID

from pdgw.profinet.blocks import record_blocks as blocks
from pdgw.profinet.blocks.alarm import Severity
from pdgw.profinet.blocks.connect_blocks import LT_RT
from pdgw.profinet.model import (
    ACCESS_POINT_SUBSLOT,
    DAP_SLOT,
    DAP_SUBSLOT,
    DeviceModel,
    Subslot,
)
from pdgw.profinet.records import io_data, physical_device
from pdgw.profinet.records.physical_device import PortIndex
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.records import NIL, PARAMETER_RECORDS, AccessError, RecordBlock, RecordRefused, UnknownArUuid
from pdgw.profinet.rpc.server import RecordHandler
from pdgw.profinet.wire import WireError

if TYPE_CHECKING:
    from pdgw.profinet.alarms.diagnosis import Diagnosis
    from pdgw.profinet.connection.application_relation import ApplicationRelation
    from pdgw.profinet.station import Station

_STORED_MAX = 1024
"""Longest record kept for interface and port."""
_LOG_ENTRIES = 16


class Index(enum.IntEnum):
    """Record indexes with a meaning of their own."""

    EXPECTED_SUBSLOT = 0x8000
    REAL_SUBSLOT = 0x8001
    DIAGNOSIS_CHANNEL_SUBSLOT = 0x800A
    DIAGNOSIS_ALL_SUBSLOT = 0x800B
    DIAGNOSIS_STATUS_SUBSLOT = 0x800C
    MAINTENANCE_REQUIRED_CHANNEL_SUBSLOT = 0x8010
    MAINTENANCE_DEMANDED_CHANNEL_SUBSLOT = 0x8011
    MAINTENANCE_REQUIRED_ALL_SUBSLOT = 0x8012
    MAINTENANCE_DEMANDED_ALL_SUBSLOT = 0x8013
    INPUT_DATA = 0x8028
    OUTPUT_DATA = 0x8029
    PORT_DATA_REAL = 0x802A
    PORT_DATA_CHECK = PortIndex.PORT_DATA_CHECK
    PORT_DATA_ADJUST = PortIndex.PORT_DATA_ADJUST
    NETWORK_COMPONENT_CHECK = PortIndex.NETWORK_COMPONENT_CHECK
    INTERFACE_ADJUST = PortIndex.INTERFACE_ADJUST
    STATISTIC = 0x8072
    INTERFACE_DATA_REAL = 0x8080
    FAST_STARTUP_ADJUST = PortIndex.FAST_STARTUP_ADJUST
    EXPECTED_SLOT = 0xC000
    REAL_SLOT = 0xC001
    DIAGNOSIS_CHANNEL_SLOT = 0xC00A
    DIAGNOSIS_ALL_SLOT = 0xC00B
    DIAGNOSIS_STATUS_SLOT = 0xC00C
    EXPECTED_AR = 0xE000
    REAL_AR = 0xE001
    MODULE_DIFF = 0xE002
    DIAGNOSIS_CHANNEL_AR = 0xE00A
    DIAGNOSIS_ALL_AR = 0xE00B
    DIAGNOSIS_STATUS_AR = 0xE00C
    REAL_API = 0xF000
    DIAGNOSIS_CHANNEL_API = 0xF00A
    DIAGNOSIS_ALL_API = 0xF00B
    DIAGNOSIS_STATUS_API = 0xF00C
    DIAGNOSIS_STATUS_DEVICE = 0xF80C
    AR_DATA = 0xF820
    API_DATA = 0xF821
    LOG_DATA = 0xF830
    IM_FILTER = 0xF840
    REAL_DATA = 0xF841
    EXPECTED_DATA = 0xF842


class Scope(enum.Enum):
    """Required parts of a record's address."""

    SUBSLOT = "subslot"
    SLOT = "slot"
    AR = "relationship"
    API = "API"
    DEVICE = "device"


_SCOPES: Final = {0x8000: Scope.SUBSLOT, 0xC000: Scope.SLOT, 0xE000: Scope.AR, 0xF000: Scope.API}
_SEVERITIES: Final = {
    0x0A: {Severity.FAULT},
    0x0B: {Severity.FAULT},
    0x0C: set(Severity),
    0x10: {Severity.MAINTENANCE_REQUIRED},
    0x11: {Severity.MAINTENANCE_DEMANDED},
    0x12: {Severity.MAINTENANCE_REQUIRED},
    0x13: {Severity.MAINTENANCE_DEMANDED},
}
_DIAGNOSIS: Final = {
    base + number: (scope, severities) for base, scope in _SCOPES.items() for number, severities in _SEVERITIES.items()
} | {int(Index.DIAGNOSIS_STATUS_DEVICE): (Scope.DEVICE, set(Severity))}
"""Records of diagnosis: of which submodules, and of which severities."""
_EXPECTED: Final = {
    Index.EXPECTED_SUBSLOT: Scope.SUBSLOT,
    Index.EXPECTED_SLOT: Scope.SLOT,
    Index.EXPECTED_AR: Scope.AR,
}
_REAL: Final = {
    Index.REAL_SUBSLOT: Scope.SUBSLOT,
    Index.REAL_SLOT: Scope.SLOT,
    Index.REAL_AR: Scope.AR,
    Index.REAL_API: Scope.API,
}
_OF_APPLICATION: Final = PARAMETER_RECORDS | {*identification.INDEXES}


@dataclass(frozen=True, slots=True)
class LogItem:
    """The end of a relationship."""

    time_ns: int
    ar_uuid: UUID
    status: int


class DeviceRecords:
    """Serve records to all callers; each call names the relationship of its caller (None: Read Implicit)."""

    def __init__(
        self,
        model: DeviceModel,
        station: Station,
        diagnosis: Diagnosis,
        application: Callable[[str], RecordHandler],
        relations: Callable[[], Iterable[ApplicationRelation]],
    ) -> None:
        self._model = model
        self._station = station
        self._diagnosis = diagnosis
        self._application = application
        self._relations = relations
        self.log: deque[LogItem] = deque(maxlen=_LOG_ENTRIES)
        self.octets = [0, 0]
        """Received and sent."""

    def replug(self, model: DeviceModel) -> None:
        """Other modules are plugged."""
        self._model = model

    # -- write --------------------------------------------------------------------------------------------------------

    def write(self, relation: ApplicationRelation, block: RecordBlock, data: bytes, host: str) -> None:
        """Take a record of ``host``; RecordRefused."""
        place = self._place(block)
        if block.index in _OF_APPLICATION:
            self._application(host).write(block, data)
            return
        if (place, block.index) not in physical_device.WRITABLE:
            raise RecordRefused(AccessError.INVALID_INDEX)
        if len(data) > _STORED_MAX:
            raise RecordRefused(AccessError.WRITE_LENGTH)
        try:
            physical_device.check(place, block.index, data)
        except WireError as error:
            raise RecordRefused(AccessError.INVALID_PARAMETER) from error
        relation.stored[place, block.index] = data

    # -- read ---------------------------------------------------------------------------------------------------------

    def read(self, relation: ApplicationRelation | None, block: RecordBlock, host: str, now: int) -> bytes:
        """The data of a record for ``host``; RecordRefused."""
        index = block.index
        if index in _DIAGNOSIS:
            scope, severities = _DIAGNOSIS[index]
            return self._diagnosis.record(self._model, self._scope(scope, relation, block), severities)
        if index in _REAL:
            return self._identification(blocks.RealIdentification, self._scope(_REAL[Index(index)], relation, block))
        if index in _EXPECTED:
            return self._expected(_EXPECTED[Index(index)], self._needed(relation), block)
        match index:
            case Index.MODULE_DIFF:
                diff = self._needed(relation).plan.diff
                return b"" if diff is None else diff.encode()
            case Index.AR_DATA:
                return blocks.ArData(ars=tuple(map(self._relation, self._relations()))).encode()
            case Index.API_DATA:
                apis = sorted({module.api for module in self._model.modules.values()})
                return blocks.ApiData(apis=tuple(blocks.Api(api=api) for api in apis)).encode()
            case Index.LOG_DATA:
                return self._log(now)
            case Index.IM_FILTER:
                return self._filter()
            case Index.REAL_DATA:
                return physical_device.real_data(self._station)
            case Index.EXPECTED_DATA:
                return physical_device.expected_data({} if relation is None else relation.stored)
        place = self._place(block)
        if index in _OF_APPLICATION:
            return self._application(host).read(block, implicit=relation is None)
        return self._of_place(relation, place, index)

    def _of_place(self, relation: ApplicationRelation | None, place: Subslot, index: int) -> bytes:
        station = self._station
        match place, index:
            case (physical_device.PORT, Index.PORT_DATA_REAL):
                return physical_device.port_data(station)
            case (physical_device.INTERFACE, Index.INTERFACE_DATA_REAL):
                return physical_device.interface_data(station)
            case (physical_device.PORT | physical_device.INTERFACE, Index.STATISTIC):
                return physical_device.statistic((self.octets[0], self.octets[1]))
            case (_, Index.INPUT_DATA | Index.OUTPUT_DATA):
                return self._exchanged(place, index)
        if (place, index) in physical_device.WRITABLE:
            return b"" if relation is None else relation.stored.get((place, index), b"")
        raise RecordRefused(AccessError.INVALID_INDEX)

    def _exchanged(self, place: Subslot, index: int) -> bytes:
        controller = next((item for item in self._relations() if item.has_data), None)
        if controller is None:
            raise RecordRefused(AccessError.STATE_CONFLICT)
        read = io_data.input_data if index == Index.INPUT_DATA else io_data.output_data
        record = read(controller, place)
        if record is None:
            raise RecordRefused(AccessError.INVALID_INDEX)
        return record

    # -- addresses ----------------------------------------------------------------------------------------------------

    def _api(self, block: RecordBlock) -> None:
        if all(module.api != block.api for module in self._model.modules.values()):
            raise RecordRefused(AccessError.INVALID_AREA)

    def _place(self, block: RecordBlock) -> Subslot:
        self._api(block)
        module = self._model.modules.get(block.slot)
        if module is None or block.subslot not in module.submodules:
            raise RecordRefused(AccessError.INVALID_SLOT)
        # Controllers also use API 0 for I&M and the parameter access of a drive object, as does the UDP link.
        if module.api != block.api and block.index not in _OF_APPLICATION:
            raise RecordRefused(AccessError.INVALID_AREA)
        return block.slot, block.subslot

    def _scope(self, scope: Scope, relation: ApplicationRelation | None, block: RecordBlock) -> list[Subslot]:
        if scope is Scope.SUBSLOT:
            return [self._place(block)]
        everything = [(slot, subslot) for slot, module in self._model.modules.items() for subslot in module.submodules]
        if scope is Scope.AR:
            expected = {
                (slot.slot, item.subslot) for slot in self._needed(relation).plan.expected for item in slot.submodules
            }
            return [place for place in everything if place in expected]
        if scope is Scope.DEVICE:
            return everything
        self._api(block)
        modules = self._model.modules
        if scope is Scope.API:
            return [place for place in everything if modules[place[0]].api == block.api]
        if block.slot not in modules:
            raise RecordRefused(AccessError.INVALID_SLOT)
        if modules[block.slot].api != block.api:
            raise RecordRefused(AccessError.INVALID_AREA)
        return [place for place in everything if place[0] == block.slot]

    def _needed(self, relation: ApplicationRelation | None) -> ApplicationRelation:
        if relation is None:
            raise RecordRefused(AccessError.STATE_CONFLICT)
        return relation

    # -- content ------------------------------------------------------------------------------------------------------

    def _identification(self, kind: type[blocks.IdentificationData], places: Iterable[Subslot]) -> bytes:
        return kind(apis=self._tree(places)).encode()

    def _tree(self, places: Iterable[Subslot]) -> tuple[blocks.IdentApi, ...]:
        apis: dict[int, dict[int, list[blocks.IdentSubmodule]]] = {}
        for slot, subslot in places:
            module = self._model.modules[slot]
            item = blocks.IdentSubmodule(subslot=subslot, ident=module.submodules[subslot].ident)
            apis.setdefault(module.api, {}).setdefault(slot, []).append(item)
        return tuple(
            blocks.IdentApi(
                api=api,
                slots=tuple(
                    blocks.IdentSlot(slot=slot, ident=self._model.modules[slot].ident, submodules=tuple(items))
                    for slot, items in slots.items()
                ),
            )
            for api, slots in apis.items()
        )

    def _expected(self, scope: Scope, relation: ApplicationRelation, block: RecordBlock) -> bytes:
        apis: dict[int, list[blocks.IdentSlot]] = {}
        for slot in relation.plan.expected:
            if scope is not Scope.AR and (slot.api, slot.slot) != (block.api, block.slot):
                continue
            items = tuple(
                blocks.IdentSubmodule(subslot=item.subslot, ident=item.ident)
                for item in slot.submodules
                if scope is not Scope.SUBSLOT or item.subslot == block.subslot
            )
            if items:
                apis.setdefault(slot.api, []).append(
                    blocks.IdentSlot(slot=slot.slot, ident=slot.ident, submodules=items)
                )
        if not apis:
            raise RecordRefused(AccessError.INVALID_SLOT)
        return blocks.ExpectedIdentification(
            apis=tuple(blocks.IdentApi(api=api, slots=tuple(slots)) for api, slots in apis.items())
        ).encode()

    def _relation(self, relation: ApplicationRelation) -> blocks.ArEntry:
        plan = relation.plan
        ar, alarm = plan.ar, plan.alarm
        iocrs = []
        for cyclic, machine in ((plan.inputs, relation.provider), (plan.outputs, relation.consumer)):
            if cyclic is not None and machine is not None:
                counter, data_status, transfer_status = machine.status
                iocrs.append(
                    blocks.ArIocr(
                        iocr_type=cyclic.block.iocr_type,
                        properties=cyclic.block.properties,
                        frame_id=cyclic.frame_id,
                        cycle_counter=counter,
                        data_status=data_status,
                        transfer_status=transfer_status,
                        initiator_port=ar.rt_port,
                        responder_port=LT_RT,
                    )
                )
        return blocks.ArEntry(
            ar_uuid=ar.ar_uuid,
            ar_type=ar.ar_type,
            properties=ar.properties,
            initiator_object=ar.initiator_object,
            station_name=ar.station_name,
            iocrs=tuple(iocrs),
            alarm_type=0 if alarm is None else alarm.cr_type,
            local_reference=0 if alarm is None else relation.reference,
            remote_reference=0 if alarm is None else alarm.reference,
            server_name="",
            apis=tuple(blocks.Api(api=api) for api in sorted({slot.api for slot in plan.expected})),
        )

    def _filter(self) -> bytes:
        points = [(DAP_SLOT, DAP_SUBSLOT)]
        points += [(slot, ACCESS_POINT_SUBSLOT) for slot in self._model.modules if slot != DAP_SLOT]
        submodules = blocks.ImFilterSubmodules(apis=self._tree(points)).encode()
        device = blocks.ImFilterDevice(apis=self._tree(points[:1])).encode()
        return submodules + bytes(-len(submodules) % 4) + device

    def _log(self, now: int) -> bytes:
        entries = tuple(
            blocks.LogEntry(time=item.time_ns.to_bytes(8, "big"), ar_uuid=item.ar_uuid, status=item.status, detail=0)
            for item in self.log
        )
        return blocks.LogData(time=now.to_bytes(8, "big"), entries=entries).encode()


class Access:
    """One call's access to the records: the caller is checked here, the request in ``DeviceRecords``.

    Any caller that names the AR, or uses Read Implicit, may read; writes are accepted only from the relationship's own
    controller.
    """

    def __init__(
        self,
        records: DeviceRecords,
        relations: Callable[[UUID], ApplicationRelation | None],
        host: str,
        now: int,
        used: Callable[[ApplicationRelation], None],
    ) -> None:
        self._records = records
        self._relations = relations
        self._host = host
        self._now = now
        self._used = used

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        """RecordHandler."""
        relation = None
        if not implicit and block.ar_uuid != NIL:
            relation = self._relations(block.ar_uuid)
            if relation is None:
                raise UnknownArUuid
            if self._host == relation.source[0]:
                self._used(relation)
        return self._records.read(relation, block, self._host, self._now)

    def write(self, block: RecordBlock, data: bytes) -> None:
        """RecordHandler."""
        relation = self._relations(block.ar_uuid)
        if relation is None or self._host != relation.source[0]:
            raise UnknownArUuid
        self._used(relation)
        self._records.write(relation, block, data, self._host)
