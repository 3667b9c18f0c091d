"""The PLC's side of record access: builds calls, recognises their answers; sans-I/O."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, Reassembly, RpcHeader
from pdgw.profinet.rpc.records import (
    BLOCK_SIZE,
    NIL,
    BlockType,
    Operation,
    PnioStatus,
    RecordBlock,
    decode_arguments,
    decode_block,
    encode_arguments,
    encode_block,
)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RecordResult:
    """The answer of a call; ``data`` is empty unless a read succeeded."""

    status: PnioStatus
    data: bytes


@dataclass(frozen=True, slots=True)
class ServiceResult:
    """The answer of a service of the device: its status and its blocks."""

    status: PnioStatus
    arguments: bytes


class RpcCall(Generic[T]):
    """One call: ``packets`` are sent (again, while no answer comes), ``receive`` is given what comes back.

    ``decode`` makes the result of the header and body of the answer.
    """

    def __init__(
        self, header: RpcHeader, body: bytes, max_answer: int, decode: Callable[[RpcHeader, bytes], T]
    ) -> None:
        self._header = header
        self._decode = decode
        self.packets = dcerpc.encode_fragments(header, body)
        self._reassembly = Reassembly(max_answer)

    def receive(self, data: bytes) -> T | list[bytes] | None:
        """The result, or datagrams to send back (acknowledged fragments), or None for what is of another call.

        ProfidriveError when the device rejects the call or its answer makes no sense.
        """
        header, body = dcerpc.decode_packet(data)
        own = self._header
        if header.activity != own.activity or header.sequence != own.sequence:
            return None
        if header.packet_type in {PacketType.REJECT, PacketType.FAULT}:
            refusal = dcerpc.decode_status(body, little=header.little_endian)
            raise ProfidriveError("RPC call", f"refused with status {refusal:08X}h", "an operation the device has")
        if header.packet_type is not PacketType.RESPONSE:
            return None
        whole = self._reassembly.add(header, body)
        if whole is None:
            return [] if Flags.NO_FACK in header.flags else [dcerpc.encode_fack(header, 8)]
        return self._decode(header, whole)


ServiceCall = RpcCall[ServiceResult]
"""A call of the device interface whose arguments are blocks (Connect, Release ...)."""
RecordCall = RpcCall[RecordResult]
"""A read or write of a record."""


def _service_result(header: RpcHeader, body: bytes) -> ServiceResult:
    status, arguments = decode_arguments(body, little=header.little_endian)
    return ServiceResult(PnioStatus.of(status), arguments)


def _record_result(expected: BlockType, header: RpcHeader, body: bytes) -> RecordResult:
    answer = _service_result(header, body)
    if answer.status.value:
        return RecordResult(answer.status, b"")
    block, record = decode_block(answer.arguments)
    if block.type is not expected:
        raise ProfidriveError("BlockType of the answer", f"{block.type:04X}h", f"{expected:04X}h")
    return RecordResult(block.status, record)


class RecordCaller:
    """Makes the calls of one application relationship; ``activity`` must be unique to this caller."""

    def __init__(self, activity: UUID, device: UUID, ar_uuid: UUID = NIL, max_record: int = 4096) -> None:
        self.activity = activity
        self.device = device
        self.ar_uuid = ar_uuid
        self.max_record = max_record
        self._sequence = 0

    def header(self, operation: int) -> RpcHeader:
        """The header of the next call."""
        # PROFINET devices expect the idempotent flag; the server executes a call only once nevertheless.
        sequence = self._sequence
        self._sequence += 1
        return RpcHeader(PacketType.REQUEST, self.device, self.activity, sequence, operation, flags=Flags.IDEMPOTENT)

    def _call(
        self, operation: Operation, arguments: bytes, maximum: int, decode: Callable[[RpcHeader, bytes], T]
    ) -> RpcCall[T]:
        header = self.header(operation)
        ndr = encode_arguments(maximum, arguments, max(maximum, len(arguments)), little=header.little_endian)
        return RpcCall(header, ndr, maximum + 64, decode)

    def service(self, operation: Operation, arguments: bytes) -> ServiceCall:
        """Connect, Control or Release with their blocks."""
        return self._call(operation, arguments, self.max_record, _service_result)

    def _record(self, operation: Operation, block: RecordBlock, answer: BlockType, data: bytes = b"") -> RecordCall:
        maximum = self.max_record + BLOCK_SIZE
        return self._call(operation, encode_block(block) + data, maximum, partial(_record_result, answer))

    def write(self, api: int, slot: int, subslot: int, index: int, data: bytes) -> RecordCall:
        """IODWrite of a record."""
        block = RecordBlock(
            BlockType.WRITE_REQUEST, self._sequence & 0xFFFF, self.ar_uuid, api, slot, subslot, index, len(data)
        )
        return self._record(Operation.WRITE, block, BlockType.WRITE_RESPONSE, data)

    def read(self, api: int, slot: int, subslot: int, index: int, *, implicit: bool = False) -> RecordCall:
        """IODRead, or Read Implicit, which needs no application relationship."""
        block = RecordBlock(
            BlockType.READ_REQUEST,
            self._sequence & 0xFFFF,
            NIL if implicit else self.ar_uuid,
            api,
            slot,
            subslot,
            index,
            self.max_record,
        )
        operation = Operation.READ_IMPLICIT if implicit else Operation.READ
        return self._record(operation, block, BlockType.READ_RESPONSE)
