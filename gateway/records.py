"""The records of the gateway: parameter access points B02Eh/B02Fh and I&M0 to I&M4, for every slot.

Slot 0 is the device, slot n the n-th axis; subslot 1 is the parameter access point. Source: docs/transport.md section 3.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from uuid import UUID

from pdgw.gateway import identity
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.parameters.manager import ParameterManager
from pdgw.gateway.parameters.profile import MAX_BLOCK
from pdgw.gateway.store import ParameterStore
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.records import (
    RECORD_GLOBAL,
    RECORD_LOCAL,
    AccessError,
    RecordBlock,
    RecordRefused,
    UnknownArUuid,
)

log = logging.getLogger("gateway")

ACCESS_POINT = 1
"""Subslot of the parameter access point."""
_APIS = (0, identification.PROFILE_ID)
_HEADER_SIZE = 4
_IDENTIFICATION = range(identification.INDEX, identification.INDEX + 5)
_STORED: dict[int, tuple[str, ...]] = {
    1: ("im1_function", "im1_location"),
    2: ("im2_date",),
    3: ("im3_descriptor",),
    4: ("im4_signature",),
}
"""Where the parameter store keeps the writable identification."""


class Records:
    """Serves record access for the acyclic server, in its task.

    One parameter request is outstanding per access point and record: while it is in work, a further write and a read are a
    state conflict. A write after an answer nobody fetched replaces it. ``ar_uuid`` None: who calls has checked the relationship.
    """

    def __init__(
        self,
        manager: ParameterManager,
        store: ParameterStore,
        update_store: Callable[[Callable[[], None]], None],
        ar_uuid: UUID | None,
        station_serial: str,
    ) -> None:
        self._manager = manager
        self._store = store
        self._update_store = update_store
        self._ar_uuid = ar_uuid
        self._serial = station_serial
        self._requests: dict[tuple[int, int], Future[bytes | None]] = {}

    def write(self, block: RecordBlock, data: bytes) -> None:
        """RecordHandler."""
        self._check_place(block, implicit=False)
        if block.index in {RECORD_LOCAL, RECORD_GLOBAL}:
            self._request(block, data)
        elif block.index in _IDENTIFICATION:
            self._write_identification(block.index - identification.INDEX, data)
        else:
            raise RecordRefused(AccessError.INVALID_INDEX)

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        """RecordHandler."""
        self._check_place(block, implicit=implicit)
        if block.index in {RECORD_LOCAL, RECORD_GLOBAL}:
            return self._response(block)
        if block.index in _IDENTIFICATION:
            return self._identification(block.index - identification.INDEX)
        raise RecordRefused(AccessError.INVALID_INDEX)

    def _check_place(self, block: RecordBlock, *, implicit: bool) -> None:
        if not implicit and self._ar_uuid is not None and block.ar_uuid != self._ar_uuid:
            raise UnknownArUuid
        if block.api not in _APIS:
            raise RecordRefused(AccessError.INVALID_AREA)
        if block.slot >= len(self._manager.slots) or block.subslot != ACCESS_POINT:
            raise RecordRefused(AccessError.INVALID_SLOT)

    def _request(self, block: RecordBlock, data: bytes) -> None:
        if len(data) > MAX_BLOCK:
            raise RecordRefused(AccessError.WRITE_LENGTH)
        if len(data) < _HEADER_SIZE:
            raise RecordRefused(AccessError.INVALID_PARAMETER)
        place = (block.slot, block.index)
        present = self._requests.get(place)
        if present is not None and not present.done():
            raise RecordRefused(AccessError.STATE_CONFLICT)
        local = self._manager.slots[block.slot] if block.index == RECORD_LOCAL else None
        self._requests[place] = self._manager.submit(data, local)

    def _response(self, block: RecordBlock) -> bytes:
        place = (block.slot, block.index)
        request = self._requests.get(place)
        if request is None or not request.done():
            raise RecordRefused(AccessError.STATE_CONFLICT)
        error = request.exception()
        if error is not None:
            log.error("parameter request failed: %r", error)
        response = None if error is not None else request.result()
        if response is None:
            del self._requests[place]
            raise RecordRefused(AccessError.READ_ERROR)
        if len(response) > block.length:
            raise RecordRefused(AccessError.INVALID_PARAMETER)  # it may be read again with more room
        del self._requests[place]
        return response

    def _identification(self, number: int) -> bytes:
        if number == 0:
            return identification.encode_im0(
                identification.Im0(
                    identity.VENDOR_ID,
                    identity.ORDER_ID,
                    self._serial,
                    identity.HARDWARE_REVISION,
                    ("V", *identity.RELEASE),
                )
            )
        values = [getattr(self._store.parameters, name) for name in _STORED[number]]
        octets: Callable[[str], bytes] = bytes.fromhex if number == identification.SIGNATURE else str.encode
        return identification.encode_im(number, tuple(octets(value) for value in values))

    def _write_identification(self, number: int, data: bytes) -> None:
        if number == 0:
            raise RecordRefused(AccessError.ACCESS_DENIED)
        try:
            values = identification.decode_im(number, data)
        except ProfidriveError as error:
            log.warning("I&M%d not written: %s", number, error)
            raise RecordRefused(AccessError.INVALID_PARAMETER) from error

        def change() -> None:
            for name, value in zip(_STORED[number], values, strict=True):
                text = value.hex() if number == identification.SIGNATURE else value.decode("ascii").rstrip()
                setattr(self._store.parameters, name, text)

        try:
            self._update_store(change)
        except GatewayError as error:
            log.error("%s", error)
            raise RecordRefused(AccessError.WRITE_ERROR) from error
