"""The PLC's side of record access: builds calls, recognises their answers; sans-I/O."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class RecordResult:
    """The answer of a call; ``data`` is empty unless a read succeeded."""

    status: PnioStatus
    data: bytes


class RpcCall:
    """One call: ``packets`` are sent (again, while no answer comes), ``receive`` is given what comes back."""

    def __init__(self, header: RpcHeader, body: bytes, max_answer: int) -> None:
        self._header = header
        self.packets = dcerpc.encode_fragments(header, body)
        self._reassembly = Reassembly(max_answer)

    def receive(self, data: bytes) -> tuple[RpcHeader, bytes] | list[bytes] | None:
        """Header and body of the answer, or datagrams to send back (acknowledged fragments), or None for what is of another call.

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
        return header, whole


@dataclass(frozen=True, slots=True)
class ServiceResult:
    """The answer of a service of the device: its status and its blocks."""

    status: PnioStatus
    arguments: bytes


class ServiceCall:
    """A call of the device interface whose arguments are blocks (Connect, Release ...)."""

    def __init__(self, header: RpcHeader, arguments: bytes, maximum: int) -> None:
        ndr = encode_arguments(maximum, arguments, max(maximum, len(arguments)), little=header.little_endian)
        self._call = RpcCall(header, ndr, maximum + 64)
        self.packets = self._call.packets

    def receive(self, data: bytes) -> ServiceResult | list[bytes] | None:
        """As ``RpcCall.receive``, with the answer read."""
        answer = self._call.receive(data)
        if not isinstance(answer, tuple):
            return answer
        header, body = answer
        status, arguments = decode_arguments(body, little=header.little_endian)
        return ServiceResult(PnioStatus.of(status), arguments)


class RecordCall:
    """A read or write of a record."""

    def __init__(self, header: RpcHeader, arguments: bytes, max_record: int) -> None:
        write = header.operation == Operation.WRITE
        self._expected = BlockType.WRITE_RESPONSE if write else BlockType.READ_RESPONSE
        self._call = ServiceCall(header, arguments, max_record + BLOCK_SIZE)
        self.packets = self._call.packets

    def receive(self, data: bytes) -> RecordResult | list[bytes] | None:
        """As ``RpcCall.receive``, with the record of the answer."""
        answer = self._call.receive(data)
        if not isinstance(answer, ServiceResult):
            return answer
        if answer.status.value:
            return RecordResult(answer.status, b"")
        block, record = decode_block(answer.arguments)
        if block.type is not self._expected:
            raise ProfidriveError("BlockType of the answer", f"{block.type:04X}h", f"{self._expected:04X}h")
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

    def service(self, operation: Operation, arguments: bytes) -> ServiceCall:
        """Connect, Control or Release with their blocks."""
        return ServiceCall(self.header(operation), arguments, self.max_record)

    def _call(self, operation: Operation, block: RecordBlock, data: bytes = b"") -> RecordCall:
        return RecordCall(self.header(operation), encode_block(block) + data, self.max_record)

    def write(self, api: int, slot: int, subslot: int, index: int, data: bytes) -> RecordCall:
        """IODWrite of a record."""
        block = RecordBlock(
            BlockType.WRITE_REQUEST, self._sequence & 0xFFFF, self.ar_uuid, api, slot, subslot, index, len(data)
        )
        return self._call(Operation.WRITE, block, data)

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
        return self._call(Operation.READ_IMPLICIT if implicit else Operation.READ, block)
