"""Parameter access over UDP: write the request, read until the response is there.

A PROFINET station gives access within an application relationship: that of its controller, or a device access relationship
(IEC 61158-6-10, ARType 6; the endpoint mapper has the device's object UUID). Such a relationship may read; what it may write the
station decides ([parameters] write_from of a gateway).
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import time
import uuid
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Final, Protocol, Self, TypeVar

from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.codec import (
    ZERO,
    ParameterAddress,
    Request,
    RequestId,
    Response,
    Values,
    check_answers,
    decode_response,
    encode_request,
)
from pdgw.profinet.blocks.connect_blocks import ACTIVE_BY_INITIATOR, DEVICE_ACCESS, LT_RT, ArBlockReq, ArType
from pdgw.profinet.blocks.control import ControlCommand, ReleaseReq
from pdgw.profinet.rpc import epm
from pdgw.profinet.rpc.client import RecordCaller, RecordResult, RpcCall, ServiceResult
from pdgw.profinet.rpc.dcerpc import OBJECT_PREFIX, RpcHeader, object_uuid
from pdgw.profinet.rpc.identification import INDEX, PROFILE_ID, SIGNATURE, TEXT_FIELDS, Im0, decode_im, decode_im0
from pdgw.profinet.rpc.records import NIL, RECORD_GLOBAL, RECORD_LOCAL, AccessError, Operation

_ATTEMPTS = 5
_REPEAT_S = 0.4
_POLL_S = 0.002
_LONGEST_POLL_S = 0.008
_DATAGRAM = 2048
_NAME: Final = "pdgw-param"
_SESSION: Final = 1
_ACTIVITY_TIMEOUT: Final = 1000
"""In 100 ms: the person may think about what to write next."""
_ENTRIES_MAX: Final = 16
_GROUP_BIT: Final = 1 << 40

R = TypeVar("R")
Answer = TypeVar("Answer", RecordResult, ServiceResult)


class Channel(Protocol):
    """Datagrams to one device and back, and the clock they are waited for with."""

    @property
    def local_address(self) -> tuple[str, int]:
        """The address that it sends from."""

    def send(self, data: bytes) -> None:
        """Send a datagram; OSError if no program receives there at present."""

    def receive(self, timeout_s: float) -> bytes | None:
        """The next datagram, None when none comes in time; OSError as ``send``."""

    def now(self) -> float:
        """Monotonic seconds."""

    def sleep(self, seconds: float) -> None:
        """Let time pass."""

    def close(self) -> None:
        """Release the port."""


class UdpChannel:
    """A UDP socket and the machine's clock."""

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect(address)
        except OSError as error:
            self._socket.close()
            raise GatewayError(f"{address[0]}:{address[1]}: cannot be reached ({error.strerror or error})") from error
        self.now = time.monotonic
        self.sleep = time.sleep
        self.close = self._socket.close

    @property
    def local_address(self) -> tuple[str, int]:
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def send(self, data: bytes) -> None:
        self._socket.send(data)

    def receive(self, timeout_s: float) -> bytes | None:
        self._socket.settimeout(timeout_s)
        try:
            return self._socket.recv(_DATAGRAM)
        except TimeoutError:
            return None


def _looked_up(header: RpcHeader, body: bytes) -> tuple[bytes, uuid.UUID | None]:
    return epm.lookup_answer(body, little=header.little_endian)


class ParameterClient:
    """One access point of a device. Raises GatewayError when it does not answer or refuses the record.

    ``channel``: what reaches the device, a UDP socket without one. ``caller``: of a relationship that the station has.
    """

    def __init__(
        self,
        address: tuple[str, int],
        do_id: int,
        *,
        slot: int = 1,
        subslot: int = 1,
        local: bool = False,
        timeout_s: float = 30,
        channel: Channel | None = None,
        caller: RecordCaller | None = None,
    ) -> None:
        self.do_id = do_id
        self.address = address
        self._place = (PROFILE_ID if slot else 0, slot, subslot)  # slot 0 has no profile
        self._index = RECORD_LOCAL if local else RECORD_GLOBAL
        self._timeout_s = timeout_s
        self._caller = caller or RecordCaller(uuid.uuid4(), object_uuid(1, 0, 0))
        self._connected = False
        self._references = itertools.cycle(range(1, 256))
        self._channel: Channel = UdpChannel(address) if channel is None else channel
        self.tap: Callable[[bool, bytes], None] = lambda sent, data: None
        """Called with every datagram (sent by us, data)."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        if self._connected:
            block = ReleaseReq(ar_uuid=self._caller.ar_uuid, session_key=_SESSION, command=ControlCommand.RELEASE)
            with contextlib.suppress(GatewayError):  # a station that does not answer ends the relationship by itself
                self.call(self._caller.service(Operation.RELEASE, block.encode()))
        self._channel.close()

    def connect(self) -> None:
        """Be a device access relationship of a PROFINET station from now on; GatewayError when it refuses."""
        caller = RecordCaller(uuid.uuid4(), NIL, uuid.uuid4())
        caller.device = self._station(caller)
        block = ArBlockReq(
            ar_type=ArType.DEVICE_ACCESS,
            ar_uuid=caller.ar_uuid,
            session_key=_SESSION,
            initiator_mac=(uuid.getnode() & ~_GROUP_BIT).to_bytes(6, "big"),
            initiator_object=object_uuid(1, 1, 1),
            properties=ACTIVE_BY_INITIATOR | DEVICE_ACCESS,
            activity_timeout=_ACTIVITY_TIMEOUT,
            rt_port=LT_RT,
            station_name=_NAME,
        )
        self._succeeded(self.call(caller.service(Operation.CONNECT, block.encode())), "device access")
        self._caller, self._connected = caller, True

    def _station(self, caller: RecordCaller) -> uuid.UUID:
        """The object UUID of the device, from the endpoint mapper."""
        request = epm.lookup_request()
        interface, version = epm.INTERFACE
        for _ in range(_ENTRIES_MAX):
            asked = replace(caller.header(epm.LOOKUP), interface=interface, interface_version=version)
            handle, found = self.call(RpcCall(asked, request, caller.max_record, _looked_up))
            if found is None:
                break
            if found.bytes[: len(OBJECT_PREFIX)] == OBJECT_PREFIX:
                return found
            request = epm.lookup_request(handle)
        raise GatewayError(f"{self._name}: the endpoint mapper lists no PROFINET device")

    @property
    def local_address(self) -> tuple[str, int]:
        """The address that it sends from."""
        return self._channel.local_address

    def _send(self, packet: bytes) -> None:
        self._channel.send(packet)
        self.tap(True, packet)

    # -- records ------------------------------------------------------------------------------------------------------

    def call(self, call: RpcCall[R]) -> R:
        """Send a call, again while no answer comes."""
        for _ in range(_ATTEMPTS):
            try:
                for packet in call.packets:
                    self._send(packet)
                result = self._answer(call)
            except OSError as error:
                self._channel.sleep(_REPEAT_S / _ATTEMPTS)  # no receiver at the moment: the device may be starting
                reason = error.strerror or str(error)
                continue
            except ProfidriveError as error:
                raise GatewayError(f"{self._name}: the answer is not valid: {error}") from error
            if result is not None:
                return result
            reason = "no answer"
        raise GatewayError(
            f"{self._name}: no answer on the record channel ({reason}); check that pdgw run or the device uses "
            "this address and port"
        )

    def _answer(self, call: RpcCall[R]) -> R | None:
        channel = self._channel
        deadline = channel.now() + _REPEAT_S
        while (left := deadline - channel.now()) > 0:
            data = channel.receive(left)
            if data is None:
                return None
            self.tap(False, data)
            received = call.receive(data)
            if isinstance(received, list):
                for packet in received:
                    self._send(packet)
            elif received is not None:
                return received
        return None

    @property
    def _name(self) -> str:
        return f"{self.address[0]}:{self.address[1]}"

    def read_record(self, index: int) -> bytes:
        """Any record of the access point's subslot; GatewayError with the PNIO status when it is refused."""
        result = self.call(self._caller.read(*self._place, index))
        return self._succeeded(result, f"reading record {index:04X}h").data

    def write_record(self, index: int, data: bytes) -> None:
        """As ``read_record``."""
        self._succeeded(self.call(self._caller.write(*self._place, index, data)), f"writing record {index:04X}h")

    def _succeeded(self, result: Answer, what: str) -> Answer:
        """The result; GatewayError with the PNIO status of a rejection."""
        if result.status.value:
            raise GatewayError(f"{self._name}: {what} failed: {result.status.text}")
        return result

    # -- parameters ---------------------------------------------------------------------------------------------------

    def exchange(self, request: bytes) -> bytes:
        """The response to a request, both as bytes."""
        self.write_record(self._index, request)
        deadline = self._channel.now() + self._timeout_s
        pause = _POLL_S
        while True:
            result = self.call(self._caller.read(*self._place, self._index))
            if result.status.code1 != AccessError.STATE_CONFLICT:
                return self._succeeded(result, "reading the response").data
            if self._channel.now() > deadline:
                raise GatewayError(f"{self._name}: no response within {self._timeout_s:g} s")
            self._channel.sleep(pause)
            pause = min(2 * pause, _LONGEST_POLL_S)

    def request(self, addresses: list[ParameterAddress], values: list[Values] | None = None) -> list[Values]:
        """Read (or with ``values`` change) up to 39 parameters; one value area for each.

        In a positive change the areas are those of Zero. GatewayError for an answer that does not belong to the request.
        """
        request = Request(
            next(self._references),
            RequestId.CHANGE if values is not None else RequestId.REQUEST,
            self.do_id,
            tuple(addresses),
            tuple(values or ()),
        )
        try:
            response: Response = decode_response(self.exchange(encode_request(request)))
            answers = list(check_answers(request, response))
        except ProfidriveError as error:
            raise GatewayError(f"{self._name}: {error}") from error
        if not answers:
            return [ZERO] * len(addresses)
        # A request rejected as a whole has one error for all.
        return answers if len(answers) == len(addresses) else answers * len(addresses)


def read_identification(client: ParameterClient) -> dict[str, str]:
    """The fields of I&M0 and of each record that it says there is; GatewayError when one is refused or is none."""
    number = 0
    try:
        im0 = decode_im0(client.read_record(INDEX))
        found = _device(im0)
        for number in (item for item in TEXT_FIELDS if im0.supported >> item & 1):
            values = decode_im(number, client.read_record(INDEX + number))
            for (name, _), value in zip(TEXT_FIELDS[number], values, strict=True):
                found[name] = value.rstrip(b"\0").hex(" ") if number == SIGNATURE else value.decode("ascii").rstrip()
    except ProfidriveError as error:
        raise GatewayError(f"record {INDEX + number:04X}h: {error}") from error
    return found


def _device(im0: Im0) -> dict[str, str]:
    prefix, *numbers = im0.software
    return {
        "Vendor ID": f"{im0.vendor_id:04X}h",
        "Order ID": im0.order_id,
        "IM_Serial_Number": im0.serial_number,
        "IM_Hardware_Revision": str(im0.hardware_revision),
        "IM_Software_Revision": f"{prefix}{'.'.join(map(str, numbers))}",
        "IM_Revision_Counter": str(im0.revision_counter),
        "IM_Profile_ID": f"{im0.profile_id:04X}h",
        "IM_Profile_Specific_Type": f"{im0.profile_type:04X}h",
    }
