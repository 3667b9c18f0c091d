"""The records of the gateway: parameter access points B02Eh, B02Fh and 2Fh, and I&M0 to I&M4, for every slot.

Slot 0 is the device, slot n the n-th axis; subslot 1 is the parameter access point, and the telegram's submodule serves the same
requests: function blocks address either. Source: docs/plc.md "Acyclic channel".
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from uuid import UUID

from pdgw.gateway.base import identity
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.store import DeviceParameters, IdentificationTexts
from pdgw.gateway.base.udp import Address
from pdgw.gateway.parameters.manager import ParameterManager
from pdgw.gateway.parameters.profile import MAX_BLOCK
from pdgw.gateway.service.running import RunningGateway
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import HEADER_SIZE, RequestId
from pdgw.profinet.model import DAP_SLOT, INTERFACE_SUBSLOT, PORT_SUBSLOT, TELEGRAM_SUBSLOT
from pdgw.profinet.rpc import identification
from pdgw.profinet.rpc.records import (
    PARAMETER_RECORDS,
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
_FURTHER = {
    True: ({INTERFACE_SUBSLOT, PORT_SUBSLOT}, {identification.INDEX}),
    False: ({TELEGRAM_SUBSLOT}, {identification.INDEX, *PARAMETER_RECORDS}),
}
"""Further subslots of slot 0 (True) and of a drive object, and their records: I&M0 is the device's."""
_REQUEST_ID_OFFSET = 1
_OUTSTANDING = 32
"""Requests of all callers that are in work or whose answers were not fetched yet."""
_SERIAL_MAX = 16
"""Characters of the station's name that are IM_Serial_Number."""
_LOGGED_MAX = 64
"""Maximum number of different refusals in the log."""
_STORED: dict[int, tuple[str, ...]] = {
    1: ("im1_function", "im1_location"),
    2: ("im2_date",),
    3: ("im3_descriptor",),
    4: ("im4_signature",),
}
"""Storage of the writable identification (I&M)."""


@dataclass(frozen=True, slots=True)
class Caller:
    """A client: its address, and the activity of its remote procedure calls."""

    address: Address
    activity: UUID


_Owner = tuple[UUID, Caller, int, int]
"""AR, caller, slot and record index of an outstanding request."""


class Records:
    """Serves record access for the acyclic server, in its task; ``of`` has the view of one caller.

    One parameter request is outstanding per access point and record: while it is in work, a further write and a read are a state
    conflict. Its answer is for its caller alone, and waits for him beside those for others; his next request replaces it.
    ``writers``: the networks parameters and I&M may be written from, None for everywhere; it may be another one for each call.
    ``ar_uuid`` None: who calls has checked the relationship.
    """

    def __init__(
        self,
        daemon: RunningGateway,
        manager: ParameterManager,
        ar_uuid: UUID | None,
        writers: Sequence[IPv4Network] | None = None,
    ) -> None:
        self._daemon = daemon
        self._manager = manager
        self._ar_uuid = ar_uuid
        self.writers = writers
        self._logged: set[str] = set()
        self._in_work: dict[tuple[int, int], Future[bytes | None]] = {}
        self._requests: OrderedDict[_Owner, Future[bytes | None]] = OrderedDict()

    def of(self, address: Address, activity: UUID) -> CallerRecords:
        """The access of a client, as a RecordHandler."""
        return CallerRecords(self, Caller(address, activity))

    def write(self, caller: Caller, block: RecordBlock, data: bytes) -> None:
        """As ``RecordHandler.write``."""
        self._check_place(block, implicit=False)
        if block.index in PARAMETER_RECORDS:
            self._request(caller, block, data)
        elif block.index in identification.INDEXES:
            self._check_writer(caller)
            self._write_identification(block.slot, block.index - identification.INDEX, data)
        else:
            raise RecordRefused(AccessError.INVALID_INDEX)

    def read(self, caller: Caller, block: RecordBlock, *, implicit: bool) -> bytes:
        """As ``RecordHandler.read``."""
        self._check_place(block, implicit=implicit)
        if block.index in PARAMETER_RECORDS:
            return self._response(caller, block)
        if block.index in identification.INDEXES:
            return self._identification(block.slot, block.subslot, block.index - identification.INDEX)
        raise RecordRefused(AccessError.INVALID_INDEX)

    def _check_place(self, block: RecordBlock, *, implicit: bool) -> None:
        if not implicit and self._ar_uuid is not None and block.ar_uuid != self._ar_uuid:
            raise UnknownArUuid
        if block.api not in _APIS:
            raise RecordRefused(AccessError.INVALID_AREA)
        if block.slot >= len(self._manager.slots):
            raise RecordRefused(AccessError.INVALID_SLOT)
        if block.subslot == ACCESS_POINT:
            return
        subslots, indexes = _FURTHER[block.slot == DAP_SLOT]
        if block.subslot not in subslots:
            raise RecordRefused(AccessError.INVALID_SLOT)
        if block.index not in indexes:
            raise RecordRefused(AccessError.INVALID_INDEX)

    def _check_writer(self, caller: Caller) -> None:
        host = caller.address[0]
        if self.writers is not None and not any(IPv4Address(host) in network for network in self.writers):
            raise RecordRefused(AccessError.ACCESS_DENIED)

    def log_refusal(self, caller: Caller, block: RecordBlock, refusal: RecordRefused) -> None:
        """Each one once. A state conflict is none: the caller asks again while the answer is not there."""
        if refusal.code1 == AccessError.STATE_CONFLICT:
            return
        why = refusal.allowed
        if refusal.code1 == AccessError.ACCESS_DENIED:
            why += "; only [parameters] write_from may write; I&M0 is fixed"
        place = f"slot {block.slot}, subslot {block.subslot}"
        line = f"record {block.index:04X}h of {place} for {caller.address[0]} refused: {why}"
        if line not in self._logged and len(self._logged) < _LOGGED_MAX:
            self._logged.add(line)
            log.warning("%s", line)

    def _request(self, caller: Caller, block: RecordBlock, data: bytes) -> None:
        if len(data) > MAX_BLOCK:
            raise RecordRefused(AccessError.WRITE_LENGTH)
        if len(data) < HEADER_SIZE:
            raise RecordRefused(AccessError.INVALID_PARAMETER)
        if data[_REQUEST_ID_OFFSET] != RequestId.REQUEST:
            self._check_writer(caller)
        place = (block.slot, block.index)
        present = self._in_work.get(place)
        if present is not None and not present.done():
            raise RecordRefused(AccessError.STATE_CONFLICT)
        local = self._manager.slots[block.slot] if block.index == RECORD_LOCAL else None
        request = self._manager.submit(data, local, caller.address[0])
        owner = self._owner(caller, block)
        self._in_work[place] = self._requests[owner] = request
        self._requests.move_to_end(owner)
        self._discard_old()

    def _discard_old(self) -> None:
        """Limit the memory for unread answers: the oldest are discarded."""
        done = [owner for owner, request in self._requests.items() if request.done()]
        for owner in done[: max(0, len(self._requests) - _OUTSTANDING)]:
            del self._requests[owner]

    @staticmethod
    def _owner(caller: Caller, block: RecordBlock) -> _Owner:
        return (block.ar_uuid, caller, block.slot, block.index)

    def _response(self, caller: Caller, block: RecordBlock) -> bytes:
        owner = self._owner(caller, block)
        request = self._requests.get(owner)
        if request is None or not request.done():
            raise RecordRefused(AccessError.STATE_CONFLICT)
        response = None if request.exception() is not None else request.result()
        if response is None:
            del self._requests[owner]
            raise RecordRefused(AccessError.READ_ERROR)
        if len(response) > block.length:
            raise RecordRefused(AccessError.INVALID_PARAMETER)  # the client may read it again with a larger buffer
        del self._requests[owner]
        return response

    def _texts(self, parameters: DeviceParameters, slot: int) -> IdentificationTexts:
        """The device and each drive object have their own."""
        return parameters if slot == DAP_SLOT else parameters.drive_object(self._manager.slots[slot])

    def _identification(self, slot: int, subslot: int, number: int) -> bytes:
        if number == 0:
            transport = self._daemon.config.transport
            serial, software = transport.station_name[:_SERIAL_MAX], ("V", *identity.RELEASE)
            return identification.encode_im0(
                identification.Im0(
                    transport.vendor_id,
                    identity.ORDER_ID,
                    serial,
                    identity.HARDWARE_REVISION,
                    software,
                    supported=identification.SUPPORTED if subslot == ACCESS_POINT else 0,
                )
            )
        texts = self._texts(self._daemon.store.parameters, slot)
        values = [getattr(texts, name) for name in _STORED[number]]
        octets: Callable[[str], bytes] = bytes.fromhex if number == identification.SIGNATURE else str.encode
        return identification.encode_im(number, tuple(octets(value) for value in values))

    def _write_identification(self, slot: int, number: int, data: bytes) -> None:
        if number == 0:
            raise RecordRefused(AccessError.ACCESS_DENIED)
        if len(data) != identification.size_of(number):
            log.warning("I&M%d not written: %d bytes, allowed: %d", number, len(data), identification.size_of(number))
            raise RecordRefused(AccessError.WRITE_LENGTH)
        try:
            values = identification.decode_im(number, data)
        except ProfidriveError as error:
            log.warning("I&M%d not written: %s", number, error)
            raise RecordRefused(AccessError.INVALID_PARAMETER) from error

        def change(parameters: DeviceParameters) -> None:
            for name, value in zip(_STORED[number], values, strict=True):
                text = value.hex() if number == identification.SIGNATURE else value.decode("ascii").rstrip()
                setattr(self._texts(parameters, slot), name, text)

        try:
            self._daemon.update_store(change)
        except GatewayError as error:
            log.error("%s", error)
            raise RecordRefused(AccessError.WRITE_ERROR) from error


class CallerRecords:
    """The records as one caller sees them: a RecordHandler."""

    def __init__(self, records: Records, caller: Caller) -> None:
        self._records = records
        self._caller = caller

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        """RecordHandler."""
        try:
            return self._records.read(self._caller, block, implicit=implicit)
        except RecordRefused as refusal:
            self._records.log_refusal(self._caller, block, refusal)
            raise

    def write(self, block: RecordBlock, data: bytes) -> None:
        """RecordHandler."""
        try:
            self._records.write(self._caller, block, data)
        except RecordRefused as refusal:
            self._records.log_refusal(self._caller, block, refusal)
            raise
