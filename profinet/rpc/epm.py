"""The endpoint mapper: which object answers on which port.

Source: C706 (ept_lookup), as real controllers ask it and tshark reads it. Two entries: the mapper itself and the device.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from ipaddress import IPv4Address
from typing import Final
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT, DEVICE_INTERFACE, INTERFACE_VERSION, RejectStatus

INTERFACE: Final = (UUID("e1af8308-5d1f-11c9-91a4-08002b14a0fa"), 3)
LOOKUP: Final = 2
_NDR_SYNTAX = (UUID("8a885d04-1ceb-11c9-9fe8-08002b104860"), 2)
NOT_REGISTERED: Final = 0x16C9A0D6
"""No further entry."""
_HANDLES = 16
"""Look-ups under way; the oldest is forgotten first."""
_NIL_HANDLE = bytes(20)
_REQUEST_MAX = 76
_REQUEST_MIN = 40
"""Null references carry no UUID."""
_TAIL = struct.calcsize("=20sI")
"""Handle and maximum number of entries, at the end of a request."""
_COUNTS = 16
"""Entries, maximum, offset and actual count, after the handle of an answer."""
_ANNOTATION_SIZE = 64
_FLOOR_UUID, _FLOOR_RPC, _FLOOR_UDP, _FLOOR_IP = 0x0D, 0x0A, 0x08, 0x09


def lookup_request(handle: bytes = _NIL_HANDLE, *, little: bool = True) -> bytes:
    """The NDR body that asks for the next entry of all (``handle`` of the answer before)."""
    end = "<" if little else ">"
    return struct.pack(f"{end}4I", 0, 0, 0, 0) + handle + struct.pack(f"{end}I", 1)


def lookup_answer(body: bytes, *, little: bool) -> tuple[bytes, UUID | None]:
    """Handle and object of the entry; None when there is no further one. ProfidriveError for what is too short."""
    least = len(_NIL_HANDLE) + _COUNTS + 16
    if len(body) < len(_NIL_HANDLE) + _COUNTS:
        raise ProfidriveError("answer of the endpoint mapper", f"{len(body)} bytes", f"at least {least}")
    handle, content = body[: len(_NIL_HANDLE)], body[len(_NIL_HANDLE) + _COUNTS :]
    (count,) = struct.unpack_from("<I" if little else ">I", body, len(_NIL_HANDLE))
    if not count or len(content) < 16:
        return handle, None
    return handle, UUID(bytes_le=content[:16]) if little else UUID(bytes=content[:16])


def _floor(left: bytes, right: bytes) -> bytes:
    return struct.pack("<H", len(left)) + left + struct.pack("<H", len(right)) + right


def _syntax(interface: tuple[UUID, int]) -> bytes:
    uuid, version = interface
    return _floor(bytes((_FLOOR_UUID,)) + uuid.bytes_le + struct.pack("<H", version), bytes(2))


def tower(interface: tuple[UUID, int], port: int, address: IPv4Address) -> bytes:
    """The five floors of an entry; always little-endian but for port and address."""
    floors = (
        _syntax(interface),
        _syntax(_NDR_SYNTAX),
        _floor(bytes((_FLOOR_RPC,)), bytes(2)),
        _floor(bytes((_FLOOR_UDP,)), port.to_bytes(2, "big")),
        _floor(bytes((_FLOOR_IP,)), address.packed),
    )
    return struct.pack("<H", len(floors)) + b"".join(floors)


class EndpointMapper:
    """Look-ups, continued by the handle that each answer carries."""

    def __init__(self, device: UUID, annotation: str) -> None:
        self._device = device
        self._annotation = annotation.encode("latin-1")[: _ANNOTATION_SIZE - 1] + b"\0"
        self._handles: OrderedDict[bytes, int] = OrderedDict()
        self._last = 0

    def execute(self, operation: int, body: bytes, address: IPv4Address, *, little: bool) -> bytes | RejectStatus:
        """The NDR body of the answer."""
        if operation != LOOKUP:
            return RejectStatus.OPERATION_OUT_OF_RANGE
        body = body[:_REQUEST_MAX]
        if len(body) < _REQUEST_MIN:
            return RejectStatus.PROTOCOL_ERROR
        handle = body[-_TAIL : -_TAIL + len(_NIL_HANDLE)]
        end = "<" if little else ">"
        if handle == _NIL_HANDLE:
            self._last = (self._last + 1) & 0xFFFFFFFF
            handle = struct.pack(f"{end}I", 0) + UUID(int=self._last).bytes
            self._handles[handle] = 0
            while len(self._handles) > _HANDLES:
                self._handles.popitem(last=False)
        entry = self._handles.get(handle)
        if entry is None or not any(body[-_TAIL + len(_NIL_HANDLE) :]):
            return self._answer(end, _NIL_HANDLE, None, address)
        if entry > 1:
            del self._handles[handle]
            return self._answer(end, _NIL_HANDLE, None, address)
        self._handles[handle] = entry + 1
        return self._answer(end, handle, entry, address)

    def _answer(self, end: str, handle: bytes, entry: int | None, address: IPv4Address) -> bytes:
        if entry is None:
            return handle + struct.pack(f"{end}4I", 0, 1, 0, 0) + struct.pack(f"{end}I", NOT_REGISTERED)
        object_uuid = (UUID(int=0), self._device)[entry]
        floors = tower((INTERFACE, (DEVICE_INTERFACE, INTERFACE_VERSION))[entry], ACYCLIC_PORT, address)
        annotation = self._annotation
        return b"".join(
            (
                handle,
                struct.pack(f"{end}4I", 1, 1, 0, 1),
                object_uuid.bytes_le if end == "<" else object_uuid.bytes,
                struct.pack(f"{end}3I", entry + 3, 0, len(annotation)),
                annotation + bytes(-len(annotation) % 4),
                struct.pack(f"{end}2I", len(floors), len(floors)),
                floors + bytes(-len(floors) % 4),
                struct.pack(f"{end}I", 0),
            )
        )
