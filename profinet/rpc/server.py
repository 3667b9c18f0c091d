"""The record server of a device: datagrams in, datagrams out.

Each call (activity and sequence number) is executed once: a repetition is answered with the kept answer. Calls are answered
at once; a record whose data is not ready is a "state conflict", and the PLC repeats its read.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, Reassembly, RejectStatus, RpcHeader
from pdgw.profinet.rpc.records import (
    BLOCK_SIZE,
    AccessError,
    BlockType,
    Operation,
    PnioStatus,
    RecordBlock,
    RecordRefused,
    decode_arguments,
    decode_block,
    encode_arguments,
    encode_block,
)

_ACTIVITIES = 64
"""Callers remembered; the longest silent one is forgotten first."""
_WINDOW = 8
_SEQUENCES = 1 << 32


class RecordHandler(Protocol):
    """What serves the records; both raise RecordRefused."""

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        """The data of a record."""

    def write(self, block: RecordBlock, data: bytes) -> None:
        """Take the data of a record."""


@dataclass(slots=True)
class _Call:
    """The newest call of an activity."""

    sequence: int
    reassembly: Reassembly
    answer: list[bytes] | None = None


class RecordServer:
    """Sans-I/O: ``receive`` gets each datagram and returns those to send back. Not thread-safe."""

    def __init__(self, handler: RecordHandler, max_record: int, boot_time: int = 1) -> None:
        self._handler = handler
        self._limit = max_record + BLOCK_SIZE + 64
        self._boot_time = boot_time
        self._calls: OrderedDict[tuple[Hashable, UUID], _Call] = OrderedDict()
        self.malformed = 0
        """Datagrams that were no RPC packets."""
        self.repeated = 0
        """Calls answered again."""

    def receive(self, data: bytes, source: Hashable) -> list[bytes]:
        """The answers to one datagram of ``source``."""
        try:
            header, body = dcerpc.decode_packet(data)
        except ProfidriveError:
            self.malformed += 1
            return []
        key = (source, header.activity)
        if header.packet_type is PacketType.REQUEST:
            return self._request(key, header, body)
        call = self._calls.get(key)
        known = call is not None and call.sequence == header.sequence
        if header.packet_type is PacketType.PING:
            if call is not None and known:
                return call.answer or [dcerpc.encode_packet(header.answer(PacketType.WORKING))]
            return [dcerpc.encode_packet(header.answer(PacketType.NOCALL))]
        return []

    def _request(self, key: tuple[Hashable, UUID], header: RpcHeader, body: bytes) -> list[bytes]:
        call = self._calls.get(key)
        if call is None or call.sequence != header.sequence:
            if call is not None and (header.sequence - call.sequence) % _SEQUENCES >= _SEQUENCES // 2:
                return []  # older than what was answered: a straggler
            call = _Call(header.sequence, Reassembly(self._limit))
            self._calls[key] = call
            while len(self._calls) > _ACTIVITIES:
                self._calls.popitem(last=False)
        self._calls.move_to_end(key)
        if call.answer is not None:
            self.repeated += 1
            return call.answer
        try:
            whole = call.reassembly.add(header, body)
        except ProfidriveError:
            call.answer = [self._reject(header, RejectStatus.PROTOCOL_ERROR)]
            return call.answer
        if whole is None:
            wants_fack = Flags.NO_FACK not in header.flags
            return [dcerpc.encode_fack(header, _WINDOW)] if wants_fack else []
        call.answer = self._execute(header, whole)
        return [] if Flags.MAYBE in header.flags else call.answer

    def _execute(self, header: RpcHeader, body: bytes) -> list[bytes]:
        if header.interface != dcerpc.DEVICE_INTERFACE or header.interface_version != dcerpc.INTERFACE_VERSION:
            return [self._reject(header, RejectStatus.UNKNOWN_INTERFACE)]
        if header.operation not in {Operation.READ, Operation.WRITE, Operation.READ_IMPLICIT}:
            return [self._reject(header, RejectStatus.OPERATION_OUT_OF_RANGE)]
        operation = Operation(header.operation)
        expected = BlockType.WRITE_REQUEST if operation is Operation.WRITE else BlockType.READ_REQUEST
        try:
            maximum, arguments = decode_arguments(body, little=header.little_endian)
            block, data = decode_block(arguments)
            if block.type is not expected:
                raise ProfidriveError("BlockType", f"{block.type:04X}h", f"{expected:04X}h")
        except ProfidriveError:
            return [self._reject(header, RejectStatus.PROTOCOL_ERROR)]
        status = PnioStatus()
        answer = b""
        try:
            if operation is Operation.WRITE:
                self._handler.write(block, data)
            else:
                answer = self._handler.read(block, implicit=operation is Operation.READ_IMPLICIT)
                if len(answer) > block.length or len(answer) + BLOCK_SIZE > maximum:
                    raise RecordRefused(AccessError.INVALID_PARAMETER)
        except RecordRefused as error:
            status = error.status(operation)
            answer = b""
        length = block.length if operation is Operation.WRITE and not status.value else len(answer)
        arguments = encode_block(block.answer(length, status)) + answer
        ndr = encode_arguments(status.value, arguments, max(maximum, len(arguments)), little=header.little_endian)
        response = header.answer(PacketType.RESPONSE, server_boot=self._boot_time)
        return dcerpc.encode_fragments(response, ndr)

    def _reject(self, header: RpcHeader, status: RejectStatus) -> bytes:
        body = dcerpc.encode_status(status, little=header.little_endian)
        return dcerpc.encode_packet(header.answer(PacketType.REJECT, server_boot=self._boot_time), body)
