"""Acyclic PROFINET: the calls that make, confirm and end relationships, record access, parameter requests with their responses.

Cyclic data counts once the controller has confirmed ApplicationReady. Source: IEC 61158-5-10/-6-10 (CMRPC, CMSM), docs/plc.md
"Acyclic channel", docs/parameter-channel.md; the codecs are ``profinet.rpc`` and ``profidrive.parameters.codec``. Left out:
the entries of the endpoint mapper, which is named only.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Final
from uuid import UUID

from pdgw.base.durations import MS
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import (
    Attribute,
    Request,
    RequestId,
    Response,
    Values,
    decode_request,
    decode_response,
)
from pdgw.profidrive.parameters.description import Pnu
from pdgw.profinet.blocks.control import ApplicationReadyRes, ControlBlock, PrmBeginRes, ReleaseRes
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc import dcerpc, epm, records
from pdgw.profinet.rpc.dcerpc import RpcHeader
from pdgw.profinet.rpc.records import Operation
from pdgw.tools.decoder.frames.fields import BoundedDict, Document, name_in, parameter_text
from pdgw.tools.decoder.frames.profinet.blocks import IM_INDEXES, documents, named, place_text, read_blocks, status_text
from pdgw.tools.decoder.frames.profinet.connect import Change, Connection, RelationRecord, StationNames, read_request
from pdgw.tools.decoder.frames.profinet.cyclic import CyclicDecoder
from pdgw.tools.decoder.frames.records import (
    AcyclicRecord,
    Base,
    OtherRecord,
    ParameterRequestRecord,
    ParameterResponseRecord,
    Record,
)

OPERATIONS: Final = frozenset({Operation.CONNECT, Operation.RELEASE, Operation.CONTROL})
_CHANGES: Final[dict[type[ControlBlock], Change]] = {
    ApplicationReadyRes: Change.READY,
    PrmBeginRes: Change.PAUSED,
    ReleaseRes: Change.ENDED,
}
"""Answers that change a relationship."""


class RelationCalls:
    """All relationships of a capture. ``cyclic`` decodes their frames."""

    def __init__(self, cyclic: CyclicDecoder, names: StationNames) -> None:
        self._cyclic = cyclic
        self._names = names
        self._asked: BoundedDict[tuple[UUID, int], Connection] = BoundedDict()
        self._granted: BoundedDict[UUID, Connection] = BoundedDict()

    def between(self, addresses: bytes) -> Connection | None:
        """The relationship of frames with this destination and source."""
        return next((item for item in self._granted.newest() if item.is_between(addresses)), None)

    def record(
        self,
        base: Base,
        header: RpcHeader,
        head: str,
        arguments: bytes,
        fields: Document,
        latency: int | None,
        *,
        is_request: bool,
    ) -> AcyclicRecord:
        """The record of one call with arguments; ProfidriveError when its blocks are damaged."""
        fields["blocks"] = blocks = documents(arguments)
        if header.operation == Operation.CONNECT:
            key = (header.activity, header.sequence)
            if is_request:
                connection = read_request(arguments)
                self._asked.put(key, connection)
                text = f"{head}: {_asked_text(connection, fields)}"
                if not self._cyclic.request(connection):
                    return AcyclicRecord(*base, text, fields, latency)
                return RelationRecord(*base, text, fields, latency, change=Change.REQUESTED, connection=connection)
            return self._answered(base, head, self._asked.pop(key), arguments, fields, latency)
        text = f"{head}: {named(blocks)}"
        if not is_request:
            for cls, change in _CHANGES.items():
                for block in read_blocks(arguments, cls):
                    uuid = block.ar_uuid
                    known = self._granted.pop(uuid) if change is Change.ENDED else self._granted.get(uuid)
                    if known is not None:
                        return RelationRecord(*base, text, fields, latency, change=change, connection=known)
        return AcyclicRecord(*base, text, fields, latency)

    def refuse(self, header: RpcHeader) -> None:
        """The device has rejected a call."""
        connection = self._asked.pop((header.activity, header.sequence))
        if connection is not None:
            self._cyclic.end_request(connection)

    def _answered(
        self,
        base: Base,
        head: str,
        asked: Connection | None,
        arguments: bytes,
        fields: Document,
        latency: int | None,
    ) -> AcyclicRecord:
        if asked is None:
            return AcyclicRecord(*base, f"{head}: request missing", fields, latency)
        connection = asked.answered(arguments)
        if connection.device_mac is not None:
            if connection.station:
                self._names.learn(connection.device_mac, connection.station)
            connection = replace(connection, station=self._names.of(connection.device_mac))
        if connection.ar is not None:
            self._names.learn(connection.ar.initiator_mac, connection.controller)
        text = f"{head}: {_asked_text(connection, fields)}"
        if not self._cyclic.connect(connection) or connection.ar is None:
            return AcyclicRecord(*base, text, fields, latency)
        self._granted.put(connection.ar.ar_uuid, connection)
        return RelationRecord(*base, text, fields, latency, change=Change.GRANTED, connection=connection)


def _asked_text(connection: Connection, fields: Document) -> str:
    """The request or response in one line; ``fields`` gets the relationships."""
    fields["relations"] = [
        {"direction": direction.value, "frame_id": plan.frame_id, "submodules": len(plan.data)}
        for direction, plan in connection.relations
    ]
    parts = [f"{direction.value}s FrameID {plan.frame_id:04X}h" for direction, plan in connection.relations]
    if not parts:
        parts.append("no cyclic relationship")
    else:
        block = connection.relations[0][1].block
        parts.append(f"cycle {block.cycle_ns / MS:g} ms, data hold {block.hold_ns / MS:g} ms")
    if connection.controller:
        parts.append(f"controller {connection.controller}")
    if connection.station:
        parts.append(f"device {connection.station}")
    return ", ".join(parts)


_MAX_BODY = 1 << 16
_PARAMETER_RECORDS = {records.RECORD_LOCAL: "parameters, local", records.RECORD_GLOBAL: "parameters, global"}
_FIRST_SYSTEM_INDEX: Final = 0x8000
"""Records below are the manufacturer's own."""
_INTERFACES: Final = frozenset({dcerpc.DEVICE_INTERFACE, dcerpc.CONTROLLER_INTERFACE})
_INDEXES: Final = frozenset(Index)
_INTERFACE_BYTES: Final = frozenset(
    octets for uuid in (*_INTERFACES, epm.INTERFACE[0]) for octets in (uuid.bytes, uuid.bytes_le)
)


def is_profinet_call(data: bytes) -> bool:
    """Whether the datagram of any port is an RPC packet of PROFINET.

    Only the first request needs port 34964: many devices answer from another port, and the controller continues there.
    """
    return (
        len(data) >= dcerpc.HEADER_SIZE and data[0] == dcerpc.VERSION and data[dcerpc.INTERFACE_AT] in _INTERFACE_BYTES
    )


_CANCELS: Final = {dcerpc.PacketType.CANCEL: "cancelled", dcerpc.PacketType.CANCEL_ACK: "cancel acknowledged"}


class AcyclicDecoder:
    """All RPC packets of a capture. ``cyclic`` gets each telegram in P922 and each Connect."""

    def __init__(self, cyclic: CyclicDecoder, names: StationNames) -> None:
        self._cyclic = cyclic
        self.relations = RelationCalls(cyclic, names)
        self._calls: BoundedDict[tuple[UUID, int], tuple[int, str]] = BoundedDict()
        """Time and text of each request."""
        self._bodies: BoundedDict[tuple[UUID, int, bool], dcerpc.Reassembly] = BoundedDict()
        self._requests: BoundedDict[tuple[Hashable, int, int], tuple[int, Request]] = BoundedDict()

    def decode(self, number: int, time_ns: int, channel: str, data: bytes, peers: frozenset[bytes]) -> Record:
        """The record of one UDP payload; ``peers`` are the two addresses."""
        try:
            header, body = dcerpc.decode_packet(data)
        except ProfidriveError as error:
            return OtherRecord(number, time_ns, channel, data, text=f"not an RPC packet: {error}")
        base = (number, time_ns, channel, data)
        fields: Document = {
            "packet": header.packet_type.name.lower(),
            "operation": _operation_name(header.operation),
            "activity": str(header.activity),
            "sequence": header.sequence,
        }
        call = (header.activity, header.sequence)
        if header.packet_type is dcerpc.PacketType.REQUEST:
            record = self._record(base, header, body, fields, None, peers)
            self._calls.put(call, (time_ns, record.text))
            return record
        asked_ns, asked = self._calls.get(call) or (time_ns, "")
        latency = max(0, time_ns - asked_ns) if asked else None
        record = self._record(base, header, body, fields, latency, peers)
        if asked and (header.packet_type in _CANCELS or fields.get("reject_status") == dcerpc.RejectStatus.CANCELLED):
            record.text += f": {asked}"
        return record

    def _record(
        self,
        base: Base,
        header: dcerpc.RpcHeader,
        body: bytes,
        fields: Document,
        latency: int | None,
        peers: frozenset[bytes],
    ) -> AcyclicRecord:
        head = f"{fields['operation']} {_CANCELS.get(header.packet_type, fields['packet'])}"
        if header.packet_type in {dcerpc.PacketType.REJECT, dcerpc.PacketType.FAULT}:
            fields["reject_status"], text = _reject(header, body)
            return AcyclicRecord(*base, f"{head}: {text}", fields, latency)
        if header.packet_type not in {dcerpc.PacketType.REQUEST, dcerpc.PacketType.RESPONSE}:
            return AcyclicRecord(*base, head, fields, latency)
        if header.interface == epm.INTERFACE[0]:
            fields["operation"] = "endpoint-mapper-lookup"
            return AcyclicRecord(*base, f"{fields['operation']} {fields['packet']}", fields, latency)
        if header.interface not in _INTERFACES:
            return AcyclicRecord(*base, f"{head} of interface {header.interface}", fields, latency)
        try:
            whole = self._whole(header, body)
            if whole is None:
                return AcyclicRecord(*base, f"{head}, fragment {header.fragment}", fields, latency)
            return self._call(base, header, whole, fields, latency, peers)
        except ProfidriveError as error:
            fields["error"] = str(error)
            return AcyclicRecord(*base, f"{head}: {error}", fields, latency)

    def _whole(self, header: dcerpc.RpcHeader, body: bytes) -> bytes | None:
        if dcerpc.Flags.FRAGMENT not in header.flags:
            return body
        key = (header.activity, header.sequence, header.packet_type is dcerpc.PacketType.REQUEST)
        reassembly = self._bodies.get(key) or dcerpc.Reassembly(_MAX_BODY)
        self._bodies.put(key, reassembly)
        whole = reassembly.add(header, body)
        if whole is not None:
            self._bodies.pop(key)
        return whole

    def _call(
        self,
        base: Base,
        header: dcerpc.RpcHeader,
        body: bytes,
        fields: Document,
        latency: int | None,
        peers: frozenset[bytes],
    ) -> AcyclicRecord:
        is_request = header.packet_type is dcerpc.PacketType.REQUEST
        head = f"{fields['operation']} {fields['packet']}"
        first, arguments = records.decode_arguments(body, little=header.little_endian)
        status = records.PnioStatus() if is_request else records.PnioStatus.of(first)
        if not is_request:
            fields["status"] = {"raw": status.value, "text": status_text(status)}
        outcome = "" if is_request or not status.value else f": {status_text(status)}"
        if status.value:
            self.relations.refuse(header)
        if header.operation in OPERATIONS and arguments and not status.value:
            return self.relations.record(base, header, head, arguments, fields, latency, is_request=is_request)
        if (
            header.operation not in {records.Operation.READ, records.Operation.WRITE, records.Operation.READ_IMPLICIT}
            or not arguments
        ):
            return AcyclicRecord(*base, f"{head}, {len(arguments)} bytes{outcome}", fields, latency)
        block, record = records.decode_block(arguments)
        fields["record"] = {
            "index": block.index,
            "api": block.api,
            "slot": block.slot,
            "subslot": block.subslot,
            "length": block.length,
            "data": record.hex(),
        }
        head += f" of {_record_name(block.index)}, {place_text(block.slot, block.subslot)}"
        if block.index in _PARAMETER_RECORDS and record:
            if block.type is records.BlockType.WRITE_REQUEST:
                return self._request(base, head, record, fields, peers)
            if block.type is records.BlockType.READ_RESPONSE:
                return self._response(base, head, record, fields, peers)
        return AcyclicRecord(*base, f"{head}{self._contents(block, record, fields)}{outcome}", fields, latency)

    def _contents(self, block: records.RecordBlock, record: bytes, fields: Document) -> str:
        """Content of a record other than a parameter request or response."""
        if block.index == records.RECORD_MULTIPLE and block.type is records.BlockType.WRITE_REQUEST:
            writes = records.split_multiple(record)
            fields["record"]["writes"] = [_write_document(item) | {"data": data.hex()} for item, data in writes]
            return f": {'; '.join(_written(item) for item, _ in writes)}"
        if block.index == records.RECORD_MULTIPLE and record:
            answers = records.split_answers(record)
            fields["record"]["writes"] = [
                _write_document(item) | {"status": {"raw": item.status.value, "text": item.status.text}}
                for item in answers
            ]
            return f": {'; '.join(_written(item) for item in answers)}"
        if not record or block.index < _FIRST_SYSTEM_INDEX:
            return _length(block, record)
        fields["record"]["blocks"] = blocks = documents(record)
        return f"{_length(block, record)}: {named(blocks)}" if blocks else _length(block, record)

    def _request(
        self, base: Base, head: str, record: bytes, fields: Document, peers: frozenset[bytes]
    ) -> AcyclicRecord:
        request = decode_request(record)
        self._requests.put((peers, request.do_id, request.reference), (base[1], request))
        fields["parameter"] = document = _request_document(request)
        return ParameterRequestRecord(*base, f"{head}: {_parameters(document)}", fields, request=request)

    def _response(
        self, base: Base, head: str, record: bytes, fields: Document, peers: frozenset[bytes]
    ) -> AcyclicRecord:
        response = decode_response(record)
        asked, request = self._requests.pop((peers, response.do_id, response.reference)) or (None, None)
        latency = None if asked is None else max(0, base[1] - asked)
        fields["parameter"] = document = _answer_document(request, response)
        if request is not None:
            self._detect_telegram(request, response)
        text = f"{head}: {_parameters(document)}"
        return ParameterResponseRecord(*base, text, fields, latency, response=response, request=request)

    def _detect_telegram(self, request: Request, response: Response) -> None:
        change = request.request_id is RequestId.CHANGE
        for position, address in enumerate(request.addresses):
            if address.pnu != Pnu.TELEGRAM or address.attribute != Attribute.VALUE:
                continue
            answer = response.values[position] if position < len(response.values) else None
            if answer is not None and answer.failed:
                continue
            value = request.values[position] if change else answer
            number = _first(value)
            if number is not None:
                self._cyclic.observe(request.do_id, number)


def _first(value: Values | None) -> int | None:
    if value is None or isinstance(value.values, bytes) or not value.values:
        return None
    return int(value.values[0])


def _values_document(item: Values) -> Document:
    values = item.values.hex() if isinstance(item.values, bytes) else list(item.values)
    return {"format": item.format.name, "values": values, "text": item.text, "failed": item.failed}


def _request_document(request: Request) -> Document:
    parameters = []
    for position, address in enumerate(request.addresses):
        entry: Document = {
            "pnu": address.pnu,
            "subindex": address.subindex,
            "elements": address.elements,
            "attribute": name_in(Attribute, address.attribute, f"{address.attribute:02X}h"),
        }
        if request.values:
            entry |= _values_document(request.values[position])
        parameters.append(entry)
    return {
        "reference": request.reference,
        "service": _service_name(request.request_id),
        "do_id": request.do_id,
        "parameters": parameters,
    }


def _service_name(request_id: RequestId) -> str:
    return "request parameter" if request_id is RequestId.REQUEST else "change parameter"


def _answer_document(request: Request | None, response: Response) -> Document:
    """The response, with the addresses of the request it answers."""
    document: Document = {
        "reference": response.reference,
        "service": _service_name(response.request_id),
        "do_id": response.do_id,
        "negative": response.negative,
        "parameters": [_values_document(item) for item in response.values],
    }
    if request is None or len(response.values) not in {0, len(request.addresses)}:
        return document
    asked = _request_document(request)["parameters"]
    address_keys = ("pnu", "subindex", "elements", "attribute")
    addresses = [{key: item[key] for key in address_keys} for item in asked]
    answers = document["parameters"] or [{"text": "written"} for _ in addresses]
    document["parameters"] = [address | answer for address, answer in zip(addresses, answers, strict=True)]
    return document


def _parameters(document: Document) -> str:
    head = f"{document['service']} ref {document['reference']} DO {document['do_id']}"
    return " | ".join([head, *(parameter_text(item) for item in document["parameters"])])


def _operation_name(operation: int) -> str:
    return name_in(Operation, operation, f"operation {operation}").replace(" ", "-")


def _record_name(index: int) -> str:
    if index in _PARAMETER_RECORDS:
        return f"{index:04X}h ({_PARAMETER_RECORDS[index]})"
    if index in IM_INDEXES:
        return f"{index:04X}h (I&M{index - IM_INDEXES.start})"
    return f"{index:04X}h ({name_in(Index, index)})" if index in _INDEXES else f"{index:04X}h"


def _write_document(block: records.RecordBlock) -> Document:
    return {"index": block.index, "api": block.api, "slot": block.slot, "subslot": block.subslot}


def _written(block: records.RecordBlock) -> str:
    text = f"{_record_name(block.index)}, {place_text(block.slot, block.subslot)}"
    return (
        text
        if block.type is records.BlockType.WRITE_REQUEST or not block.status.value
        else f"{text}: {block.status.text}"
    )


def _length(block: records.RecordBlock, record: bytes) -> str:
    if record:
        return f", {len(record)} bytes"
    return f", up to {block.length} bytes" if block.type is records.BlockType.READ_REQUEST else ""


def _reject(header: dcerpc.RpcHeader, body: bytes) -> tuple[int | None, str]:
    try:
        status = dcerpc.decode_status(body, little=header.little_endian)
    except ProfidriveError as error:
        return None, str(error)
    return status, f"{name_in(dcerpc.RejectStatus, status, 'unknown status')} ({status:08X}h)"
