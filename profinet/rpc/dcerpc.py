"""Connectionless DCE/RPC packets: the 80-byte header, packet types, fragments.

Source: C706 chapter 12 (connectionless PDUs) as PROFINET uses it (IEC 61158-6-10), docs/plc.md "Acyclic channel". Left out:
authentication, which PROFINET does not use, and the bodies of cancels.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass, replace
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError

ACYCLIC_PORT = 0x8894
VERSION = 4
MAX_BODY = 1384
"""Largest body of one packet: with its header it fits an Ethernet frame. A multiple of 8, as fragments have to be."""
DEVICE_INTERFACE = UUID("dea00001-6c97-11d1-8271-00a02442df7d")
"""PNIO device interface, version 1."""
INTERFACE_VERSION = 1
CONTROLLER_INTERFACE = UUID("dea00002-6c97-11d1-8271-00a02442df7d")
"""PNIO controller interface: where ApplicationReady goes."""
OBJECT_PREFIX = UUID("dea00000-6c97-11d1-8271-000000000000").bytes[:10]


def object_uuid(instance: int, device_id: int, vendor_id: int) -> UUID:
    """The object UUID of a PROFINET device instance."""
    return UUID(bytes=OBJECT_PREFIX + struct.pack(">HHH", instance, device_id, vendor_id))


class PacketType(enum.IntEnum):
    """ptype."""

    REQUEST = 0
    PING = 1
    RESPONSE = 2
    FAULT = 3
    WORKING = 4
    NOCALL = 5
    REJECT = 6
    ACK = 7
    CANCEL = 8
    FACK = 9
    CANCEL_ACK = 10


class Flags(enum.IntFlag):
    """flags1."""

    LAST_FRAGMENT = 0x02
    FRAGMENT = 0x04
    NO_FACK = 0x08
    MAYBE = 0x10
    IDEMPOTENT = 0x20
    BROADCAST = 0x40


NO_FLAGS = Flags(0)


class RejectStatus(enum.IntEnum):
    """Body of a REJECT or FAULT packet."""

    FAILED = 0x1C000012
    """nca_s_fault_unspec: the call was begun, and ended by a mistake of the server."""
    CANCELLED = 0x1C00000D
    """nca_s_fault_cancel: the caller cancelled the call."""
    OPERATION_OUT_OF_RANGE = 0x1C010002
    UNKNOWN_INTERFACE = 0x1C010003
    PROTOCOL_ERROR = 0x1C01000B


@dataclass(frozen=True, slots=True)
class RpcHeader:
    """One packet's header. ``little_endian`` is the data representation of header and NDR data, not of the blocks."""

    packet_type: PacketType
    object: UUID
    activity: UUID
    sequence: int
    operation: int
    interface: UUID = DEVICE_INTERFACE
    interface_version: int = INTERFACE_VERSION
    flags: Flags = NO_FLAGS
    server_boot: int = 0
    fragment: int = 0
    serial: int = 0
    little_endian: bool = True

    def answer(self, packet_type: PacketType, *, server_boot: int = 0, fragment: int = 0) -> RpcHeader:
        """The header of an answer: mirrored, with another type."""
        # Real devices set these flags on a response, complete or not.
        flags = Flags.LAST_FRAGMENT | Flags.NO_FACK if packet_type is PacketType.RESPONSE else NO_FLAGS
        return replace(self, packet_type=packet_type, flags=flags, server_boot=server_boot, fragment=fragment, serial=0)


_ENDS = {True: "<", False: ">"}
_HEAD = struct.Struct("4B3sB")
_TAILS = {little: struct.Struct(f"{end}16s16s16sIIIHHHHHBB") for little, end in _ENDS.items()}
HEADER_SIZE = _HEAD.size + _TAILS[True].size
INTERFACE_AT = slice(_HEAD.size + 16, _HEAD.size + 32)
"""Place of the interface's UUID, in the byte order of the packet."""
_U32 = {little: struct.Struct(f"{end}I") for little, end in _ENDS.items()}
_NO_HINT = 0xFFFF


def _uuid_bytes(value: UUID, *, little: bool) -> bytes:
    return value.bytes_le if little else value.bytes


def encode_packet(header: RpcHeader, body: bytes = b"") -> bytes:
    """One datagram."""
    little = header.little_endian
    head = _HEAD.pack(
        VERSION, header.packet_type, header.flags, 0, bytes((0x10 if little else 0, 0, 0)), header.serial >> 8
    )
    tail = _TAILS[little].pack(
        _uuid_bytes(header.object, little=little),
        _uuid_bytes(header.interface, little=little),
        _uuid_bytes(header.activity, little=little),
        header.server_boot,
        header.interface_version,
        header.sequence,
        header.operation,
        _NO_HINT,
        _NO_HINT,
        len(body),
        header.fragment,
        0,
        header.serial & 0xFF,
    )
    return head + tail + body


def decode_packet(data: bytes) -> tuple[RpcHeader, bytes]:
    """Header and body of a datagram; ProfidriveError names the field that is wrong."""
    if len(data) < HEADER_SIZE:
        raise ProfidriveError("RPC packet", f"{len(data)} bytes", f"a header of {HEADER_SIZE} bytes")
    version, packet_type, flags, _, representation, serial_high = _HEAD.unpack_from(data)
    if version != VERSION:
        raise ProfidriveError("RPC version", version, f"{VERSION} (connectionless)")
    if packet_type not in set(PacketType):
        raise ProfidriveError("RPC packet type", packet_type, "0..10")
    if representation[0] not in {0x00, 0x10}:
        raise ProfidriveError("RPC data representation", f"{representation[0]:02X}h", "00h or 10h (ASCII, IEEE floats)")
    little = representation[0] == 0x10
    (
        object_bytes,
        interface,
        activity,
        server_boot,
        interface_version,
        sequence,
        operation,
        _,
        _,
        length,
        fragment,
        authentication,
        serial_low,
    ) = _TAILS[little].unpack_from(data, _HEAD.size)
    if authentication:
        raise ProfidriveError("RPC authentication", authentication, "0 (none)")
    if length > len(data) - HEADER_SIZE:
        raise ProfidriveError("RPC body length", length, f"at most the {len(data) - HEADER_SIZE} received bytes")

    def uuid(value: bytes) -> UUID:
        return UUID(bytes_le=value) if little else UUID(bytes=value)

    header = RpcHeader(
        PacketType(packet_type),
        uuid(object_bytes),
        uuid(activity),
        sequence,
        operation,
        uuid(interface),
        interface_version,
        Flags(flags & 0x7E),
        server_boot,
        fragment,
        (serial_high << 8) | serial_low,
        little,
    )
    return header, data[HEADER_SIZE : HEADER_SIZE + length]


def encode_status(status: int, *, little: bool) -> bytes:
    """The body of a REJECT or FAULT packet."""
    return _U32[little].pack(status)


def decode_status(body: bytes, *, little: bool) -> int:
    """The status of a REJECT or FAULT packet."""
    if len(body) < 4:
        raise ProfidriveError("RPC status", f"{len(body)} bytes", "4 bytes")
    return int(_U32[little].unpack_from(body)[0])


def encode_fragments(header: RpcHeader, body: bytes) -> list[bytes]:
    """A body as one packet, or as numbered fragments.

    Fragments ask for no acknowledgement: a lost one is made good by the repetition of the call.
    """
    if len(body) <= MAX_BODY:
        return [encode_packet(header, body)]
    packets = []
    for number, offset in enumerate(range(0, len(body), MAX_BODY)):
        last = offset + MAX_BODY >= len(body)
        flags = (
            header.flags & ~Flags.LAST_FRAGMENT
            | Flags.FRAGMENT
            | Flags.NO_FACK
            | (Flags.LAST_FRAGMENT if last else NO_FLAGS)
        )
        part = replace(header, flags=flags, fragment=number, serial=number)
        packets.append(encode_packet(part, body[offset : offset + MAX_BODY]))
    return packets


_FACK = {little: struct.Struct(f"{end}BxHIIHH") for little, end in _ENDS.items()}


def encode_fack(header: RpcHeader, window: int) -> bytes:
    """The acknowledgement of a fragment: ``window`` more packets of MAX_BODY may follow."""
    body = _FACK[header.little_endian].pack(0, window, MAX_BODY, MAX_BODY, header.serial, 0)
    return encode_packet(header.answer(PacketType.FACK, fragment=header.fragment), body)


class Reassembly:
    """Collects the fragments of one call; ``limit`` bounds what a peer can make it keep."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._parts: dict[int, bytes] = {}
        self._size = self._highest = 0
        self._last: int | None = None

    def add(self, header: RpcHeader, body: bytes) -> bytes | None:
        """The whole body once it is complete. A repeated fragment changes nothing; ProfidriveError beyond the limit."""
        if Flags.FRAGMENT not in header.flags:
            if len(body) > self.limit:
                raise ProfidriveError("RPC body", f"{len(body)} bytes", f"at most {self.limit}")
            return body
        if header.fragment not in self._parts:
            self._parts[header.fragment] = body
            self._size += len(body)
            self._highest = max(self._highest, header.fragment)
        if Flags.LAST_FRAGMENT in header.flags:
            self._last = header.fragment
        if self._size > self.limit or len(self._parts) > self.limit:
            raise ProfidriveError("RPC fragments", "together", f"at most {self.limit} bytes")
        last = self._last
        if last is None:
            return None
        if self._highest > last:
            raise ProfidriveError("RPC fragment", self._highest, f"at most the last one, {last}")
        # All are different and none has a higher number than the last, so their count shows whether one is missing.
        return b"".join(self._parts[number] for number in range(last + 1)) if len(self._parts) > last else None
