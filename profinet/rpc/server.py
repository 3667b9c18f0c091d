"""The server's side of connectionless RPC, and the record service on it: datagrams in, datagrams out.

Each call (interface, activity and sequence number) is executed once: a repetition is answered with the kept answer. Calls are
answered at once; a record whose data is not ready is a "state conflict", and the PLC repeats its read. What a caller can make
this side keep is bounded: callers, unfinished calls, their size and their age.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar
from uuid import UUID

from pdgw.base.durations import SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc, records
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, Reassembly, RejectStatus, RpcHeader

_ACTIVITIES = 64
"""Callers remembered; the longest silent one is forgotten first. The log names this number of them."""
_UNFINISHED = 8
"""Calls of which fragments are missing; the oldest is forgotten first."""
FRAGMENT_TIMEOUT_NS = 2 * SECOND
"""After this time a call whose fragments did not come is forgotten."""
STRAGGLER_NS = 10 * SECOND
"""After this time a smaller sequence number is that of a caller that started again."""
_WINDOW = 8
_SEQUENCES = 1 << 32

Source = TypeVar("Source", bound=Hashable)

Interface = tuple[UUID, int]
"""Interface UUID and version."""
_Key = tuple[Source, UUID, UUID]
"""Caller, interface and activity. The sequence numbers of an activity rise for each interface of its own (C706)."""


@dataclass(slots=True)
class _Call:
    """The newest call of an activity to an interface."""

    sequence: int
    reassembly: Reassembly
    since: int
    answer: list[bytes] | None = None


def _raise(error: Exception) -> None:
    raise error


class RpcServer(Generic[Source]):
    """Sans-I/O: ``receive`` gets each datagram and returns those to send back. Not thread-safe.

    ``interfaces``: what executes the calls of each interface: the NDR body of the response comes back, or why it is rejected.
    """

    def __init__(
        self,
        interfaces: Mapping[Interface, Callable[[RpcHeader, bytes, Source, int], bytes | RejectStatus]],
        limit: int,
        boot_time: int = 1,
    ) -> None:
        self._interfaces = interfaces
        self._limit = limit
        self._boot_time = boot_time
        self._calls: OrderedDict[_Key[Source], _Call] = OrderedDict()
        self._named: set[Source] = set()
        self.on_error: Callable[[Exception], None] = _raise
        """Called with an unexpected error in a call. If it returns, the caller gets a FAULT, and the next call is served."""
        self.malformed = 0
        """Datagrams that were no RPC packets."""
        self.repeated = 0
        """Calls answered again."""
        self.dropped = 0
        """Calls without an answer: older than the last one of their activity, or too many with fragments missing."""
        self.on_dropped: Callable[[Source, str], object] = lambda source, why: None
        """Called with the first of them for each caller, and why."""

    def receive(self, data: bytes, source: Source, now: int = 0) -> list[bytes]:
        """The answers to one datagram of ``source``. Without a clock (0) unfinished calls are bounded by their number alone."""
        try:
            header, body = dcerpc.decode_packet(data)
        except ProfidriveError:
            self.malformed += 1
            return []
        return self.serve(header, body, source, now)

    def serve(self, header: RpcHeader, body: bytes, source: Source, now: int) -> list[bytes]:
        """As ``receive``, of a packet that is taken apart already."""
        key = (source, header.interface, header.activity)
        if header.packet_type is PacketType.REQUEST:
            return self._request(key, header, body, now)
        if header.packet_type is PacketType.PING:
            call = self._calls.get(key)
            if call is not None and call.sequence == header.sequence:
                return call.answer or [dcerpc.encode_packet(header.answer(PacketType.WORKING))]
            return [dcerpc.encode_packet(header.answer(PacketType.NOCALL))]
        return []

    def _request(self, key: _Key[Source], header: RpcHeader, body: bytes, now: int) -> list[bytes]:
        call = self._calls.get(key)
        stale = call is not None and call.answer is None and now - call.since > FRAGMENT_TIMEOUT_NS
        if call is None or call.sequence != header.sequence or stale:
            older = call is not None and (header.sequence - call.sequence) % _SEQUENCES >= _SEQUENCES // 2
            if call is not None and older and now - call.since <= STRAGGLER_NS:
                # Delayed on the network: older than the last call.
                self._drop(key, f"sequence number {header.sequence} is below {call.sequence} of its last call")
                return []
            call = self._calls[key] = _Call(header.sequence, Reassembly(self._limit), now)
            while len(self._calls) > _ACTIVITIES:
                self._calls.popitem(last=False)
        self._calls.move_to_end(key)
        if call.answer is not None:
            self.repeated += 1
            return call.answer
        try:
            whole = call.reassembly.add(header, body)
        except ProfidriveError:
            call.answer = [self._status(PacketType.REJECT, header, RejectStatus.PROTOCOL_ERROR)]
            return call.answer
        if whole is None:
            self._discard_unfinished()
            return [] if Flags.NO_FACK in header.flags else [dcerpc.encode_fack(header, _WINDOW)]
        call.answer = self._execute(header, whole, key[0], now)
        call.reassembly = Reassembly(0)
        return [] if Flags.MAYBE in header.flags else call.answer

    def _discard_unfinished(self) -> None:
        unfinished = [key for key, call in self._calls.items() if call.answer is None]
        for key in unfinished[:-_UNFINISHED]:
            del self._calls[key]
            self._drop(key, f"more than {_UNFINISHED} calls have fragments missing")

    def _drop(self, key: _Key[Source], why: str) -> None:
        self.dropped += 1
        source, interface, activity = key
        if source not in self._named and len(self._named) < _ACTIVITIES:
            self._named.add(source)
            self.on_dropped(source, f"{why} (interface {interface}, activity {activity})")

    def _execute(self, header: RpcHeader, body: bytes, source: Source, now: int) -> list[bytes]:
        execute = self._interfaces.get((header.interface, header.interface_version))
        if execute is None:
            return [self._status(PacketType.REJECT, header, RejectStatus.UNKNOWN_INTERFACE)]
        try:
            result = execute(header, body, source, now)
        except Exception as error:  # an error of one caller: serve all others
            self.on_error(error)
            return [self._status(PacketType.FAULT, header, RejectStatus.FAILED)]
        if isinstance(result, RejectStatus):
            return [self._status(PacketType.REJECT, header, result)]
        return dcerpc.encode_fragments(header.answer(PacketType.RESPONSE, server_boot=self._boot_time), result)

    def _status(self, packet_type: PacketType, header: RpcHeader, status: RejectStatus) -> bytes:
        body = dcerpc.encode_status(status, little=header.little_endian)
        return dcerpc.encode_packet(header.answer(packet_type, server_boot=self._boot_time), body)


# -- records ----------------------------------------------------------------------------------------------------------


class RecordHandler(Protocol):
    """Serves the records; both methods raise RecordRefused."""

    def read(self, block: records.RecordBlock, *, implicit: bool) -> bytes:
        """The data of a record."""

    def write(self, block: records.RecordBlock, data: bytes) -> None:
        """Take the data of a record."""


class NoRecords:
    """Serves nothing yet."""

    def read(self, block: records.RecordBlock, *, implicit: bool) -> bytes:
        """RecordHandler."""
        raise records.RecordRefused(records.AccessError.STATE_CONFLICT)

    def write(self, block: records.RecordBlock, data: bytes) -> None:
        """RecordHandler."""
        raise records.RecordRefused(records.AccessError.STATE_CONFLICT)


RECORD_OPERATIONS = frozenset({records.Operation.READ, records.Operation.WRITE, records.Operation.READ_IMPLICIT})


def serve_record(handler: RecordHandler, header: RpcHeader, body: bytes) -> bytes | RejectStatus:
    """Execute a read or write of records; the NDR body of the response."""
    operation = records.Operation(header.operation)
    expected = (
        records.BlockType.WRITE_REQUEST if operation is records.Operation.WRITE else records.BlockType.READ_REQUEST
    )
    try:
        maximum, arguments = records.decode_arguments(body, little=header.little_endian)
        block, data = records.decode_block(arguments)
        if block.type is not expected:
            raise ProfidriveError("BlockType", f"{block.type:04X}h", f"{expected:04X}h")
    except ProfidriveError:
        return RejectStatus.PROTOCOL_ERROR
    status = records.PnioStatus()
    answer = b""
    try:
        if operation is not records.Operation.WRITE:
            answer = handler.read(block, implicit=operation is records.Operation.READ_IMPLICIT)
            if len(answer) > block.length:
                raise records.RecordRefused(records.AccessError.INVALID_PARAMETER)
        elif block.index == records.RECORD_MULTIPLE:
            answer = _write_multiple(handler, data)
        else:
            handler.write(block, data)
        if len(answer) + records.BLOCK_SIZE > maximum:
            raise records.RecordRefused(records.AccessError.INVALID_PARAMETER)
    except records.RecordRefused as error:
        status = error.status(operation)
        answer = b""
    length = block.length if operation is records.Operation.WRITE and not status.value and not answer else len(answer)
    arguments = records.encode_block(block.answer(length, status)) + answer
    return records.encode_arguments(status.value, arguments, max(maximum, len(arguments)), little=header.little_endian)


def _write_multiple(handler: RecordHandler, data: bytes) -> bytes:
    """Each write inside has its own status; one that is refused stops no other."""
    try:
        writes = records.split_multiple(data)
    except ProfidriveError as error:
        raise records.RecordRefused(records.AccessError.INVALID_PARAMETER) from error
    answers = []
    for block, content in writes:
        status = records.PnioStatus()
        try:
            handler.write(block, content)
        except records.UnknownArUuid:
            raise
        except records.RecordRefused as error:
            status = error.status(records.Operation.WRITE)
        answers.append(records.encode_block(block.answer(0 if status.value else block.length, status)))
    return b"".join(answers)


class RecordServer(RpcServer[Source]):
    """Records alone, of a relationship that needs no Connect.

    ``handler``: what serves the records, or what has a handler for each caller (its address and the activity of its calls).
    """

    def __init__(
        self,
        handler: RecordHandler | Callable[[Source, UUID], RecordHandler],
        max_record: int,
        boot_time: int = 1,
    ) -> None:
        def execute(header: RpcHeader, body: bytes, source: Source, now: int) -> bytes | RejectStatus:
            if header.operation not in RECORD_OPERATIONS:
                return RejectStatus.OPERATION_OUT_OF_RANGE
            return serve_record(handler(source, header.activity) if callable(handler) else handler, header, body)

        interface = (dcerpc.DEVICE_INTERFACE, dcerpc.INTERFACE_VERSION)
        super().__init__({interface: execute}, max_record + records.BLOCK_SIZE + 64, boot_time)
