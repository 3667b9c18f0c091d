"""Parameters of a PROFINET station without being its controller: a device access relationship around the records.

Source: IEC 61158-6-10 (ARType 6), the endpoint mapper for the device's object UUID. Such a relationship may read; what it may
write the station decides ([parameters] write_from of a gateway).
"""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from pdgw.gateway.errors import GatewayError
from pdgw.profinet.blocks.connect import ACTIVE_BY_INITIATOR, DEVICE_ACCESS, LT_RT, ArBlockReq, ArType
from pdgw.profinet.blocks.control import ControlCommand, ReleaseReq
from pdgw.profinet.rpc import epm
from pdgw.profinet.rpc.client import RpcCall, ServiceCall, ServiceResult
from pdgw.profinet.rpc.dcerpc import OBJECT_PREFIX, Flags, PacketType, RpcHeader, object_uuid
from pdgw.profinet.rpc.records import NIL, Operation

Call = Callable[[Any], Any]
"""Execute an ``RpcCall`` or ``ServiceCall``; GatewayError without an answer."""
_NAME: Final = "pdgw-param"
_SESSION: Final = 1
_ACTIVITY_TIMEOUT: Final = 1000
"""In 100 ms: the person may think about what to write next."""
_ENTRIES_MAX: Final = 16
_ANSWER_MAX: Final = 4096
_GROUP_BIT: Final = 1 << 40


class StationAccess:
    """The relationship, from ``open`` to ``close``. ``device`` and ``ar_uuid`` address its record calls."""

    def __init__(self, call: Call, name: str) -> None:
        self._call = call
        self._name = name
        self._activity = uuid.uuid4()
        self._sequence = 0
        self.device = NIL
        self.ar_uuid = uuid.uuid4()

    def _header(self, operation: int, target: uuid.UUID) -> RpcHeader:
        header = RpcHeader(
            PacketType.REQUEST, target, self._activity, self._sequence, operation, flags=Flags.IDEMPOTENT
        )
        self._sequence += 1
        return header

    def open(self) -> None:
        """Find the device's object and connect; GatewayError with the reason when it refuses."""
        self.device = self._find()
        mac = (uuid.getnode() & ~_GROUP_BIT).to_bytes(6, "big")
        block = ArBlockReq(
            ar_type=ArType.DEVICE_ACCESS,
            ar_uuid=self.ar_uuid,
            session_key=_SESSION,
            initiator_mac=mac,
            initiator_object=object_uuid(1, 1, 1),
            properties=ACTIVE_BY_INITIATOR | DEVICE_ACCESS,
            activity_timeout=_ACTIVITY_TIMEOUT,
            rt_port=LT_RT,
            station_name=_NAME,
        )
        result = self._service(Operation.CONNECT, block.encode())
        if result.status.value:
            raise GatewayError(f"{self._name}: the device rejects device access: {result.status.text}")

    def close(self) -> None:
        """End the relationship; GatewayError without an answer."""
        block = ReleaseReq(ar_uuid=self.ar_uuid, session_key=_SESSION, command=ControlCommand.RELEASE)
        self._service(Operation.RELEASE, block.encode())

    def _service(self, operation: Operation, arguments: bytes) -> ServiceResult:
        result = self._call(ServiceCall(self._header(operation, self.device), arguments, _ANSWER_MAX))
        assert isinstance(result, ServiceResult)
        return result

    def _find(self) -> uuid.UUID:
        """The object UUID of the device, from the endpoint mapper."""
        request = epm.lookup_request()
        interface, version = epm.INTERFACE
        for _ in range(_ENTRIES_MAX):
            asked = replace(self._header(epm.LOOKUP, NIL), interface=interface, interface_version=version)
            header, body = self._call(RpcCall(asked, request, _ANSWER_MAX))
            handle, found = epm.lookup_answer(body, little=header.little_endian)
            if found is None:
                break
            if found.bytes[: len(OBJECT_PREFIX)] == OBJECT_PREFIX:
                return found
            request = epm.lookup_request(handle)
        raise GatewayError(f"{self._name}: the endpoint mapper lists no PROFINET device")
