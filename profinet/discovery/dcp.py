"""Discovery and basic configuration protocol: Identify, Get and Set, sans-I/O.

Source: IEC 61158-6-10 (DCP), as scapy's ``pnio_dcp`` and tshark read it. Left out: Hello, DHCP.

Secure default: while an application relationship is up, another name, another IP suite and reset are refused as "in operation".
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet import ethernet
from pdgw.profinet.station import NO_IP, IpSuite, Station, check_name

FRAME_ID_GET_SET: Final = 0xFEFD
FRAME_ID_IDENTIFY: Final = 0xFEFE
FRAME_ID_IDENTIFY_RESPONSE: Final = 0xFEFF
HEADER: Final = struct.Struct(">HBBIHH")
"""FrameID, ServiceID, ServiceType, Xid, ResponseDelayFactor, DCPDataLength."""
_BLOCK = struct.Struct(">BBH")
_U16 = struct.Struct(">H")
DELAY_UNIT_NS: Final = 10 * MS
DELAY_FACTOR_MAX: Final = 6400
_PENDING_MAX = 16


class Service(enum.IntEnum):
    """ServiceID."""

    GET = 3
    SET = 4
    IDENTIFY = 5


class ServiceType(enum.IntEnum):
    """ServiceType."""

    REQUEST = 0
    SUCCESS = 1
    NOT_SUPPORTED = 5


class Option(enum.Enum):
    """Option and suboption."""

    MAC = (1, 1)
    IP = (1, 2)
    VENDOR = (2, 1)
    NAME = (2, 2)
    DEVICE_ID = (2, 3)
    ROLE = (2, 4)
    OPTIONS = (2, 5)
    ALIAS = (2, 6)
    INSTANCE = (2, 7)
    START = (5, 1)
    STOP = (5, 2)
    SIGNAL = (5, 3)
    RESPONSE = (5, 4)
    FACTORY_RESET = (5, 5)
    RESET = (5, 6)
    ALL = (0xFF, 0xFF)


_BY_CODE = {option.value: option for option in Option}
_OPTIONS = {option.value[0] for option in Option}
SUPPORTED: Final = tuple(option for option in Option if option is not Option.ALIAS)
"""As block 2/5 lists them."""
_ROLE_IO_DEVICE = b"\x01\x00"
_SIGNAL_FLASH = b"\x01\x00"
_RESET_MODE_2 = 2 << 1
"""Mode 2 (communication parameters) in the qualifier."""
_PERMANENT = 0x0001


class SetError(enum.IntEnum):
    """BlockError of an answer to Set."""

    OK = 0
    OPTION = 1
    SUBOPTION = 2
    VALUE = 3
    RESOURCE = 4
    LOCAL = 5
    IN_OPERATION = 6


@dataclass(frozen=True, slots=True)
class NameSet:
    """DCP gave a name ("" takes it away); a temporary one is forgotten at power off, and so is the stored one."""

    name: str
    permanent: bool


@dataclass(frozen=True, slots=True)
class IpSet:
    """DCP gave an IP suite (all zero takes it away)."""

    ip: IpSuite
    permanent: bool


@dataclass(frozen=True, slots=True)
class Flash:
    """Show which device this is: 3 s at 1 Hz."""


@dataclass(frozen=True, slots=True)
class ResetToFactory:
    """Name, IP suite and I&M1 to 4 are to be cleared."""


DcpEvent = NameSet | IpSet | Flash | ResetToFactory


def encode(frame_id: int, service: Service, kind: ServiceType, xid: int, blocks: bytes, delay: int = 0) -> bytes:
    """A DCP payload from its FrameID on."""
    return HEADER.pack(frame_id, service, kind, xid, delay, len(blocks)) + blocks


def encode_block(option: Option, content: bytes) -> bytes:
    """A block, padded to an even length."""
    block = _BLOCK.pack(*option.value, len(content)) + content
    return block + bytes(len(block) & 1)


def split(blocks: bytes) -> list[tuple[tuple[int, int], bytes]]:
    """Option and content of each block; ProfidriveError where a length does not fit."""
    found = []
    at = 0
    while at < len(blocks):
        if len(blocks) - at < _BLOCK.size:
            raise ProfidriveError("DCP block", f"{len(blocks) - at} bytes", f"a header of {_BLOCK.size} bytes")
        option, suboption, length = _BLOCK.unpack_from(blocks, at)
        at += _BLOCK.size
        if length > len(blocks) - at:
            raise ProfidriveError("DCPBlockLength", length, f"at most {len(blocks) - at}")
        found.append(((option, suboption), blocks[at : at + length]))
        at += length + (length & 1)
    return found


class DcpResponder:
    """Answers DCP frames for a station. Identify answers are due later; ``poll`` hands them out.

    ``in_operation``: whether an application relationship is up. ``give_ip`` gives the interface its address; False when it keeps
    the one it has. Events of accepted Sets collect in ``events``.
    """

    def __init__(
        self,
        station: Station,
        in_operation: Callable[[], bool],
        give_ip: Callable[[IpSuite], bool] = lambda suite: True,
    ) -> None:
        self._station = station
        self._in_operation = in_operation
        self._give_ip = give_ip
        self._pending: dict[bytes, tuple[int, bytes]] = {}
        self.events: list[DcpEvent] = []
        self.ignored = 0
        """Frames without an answer: damaged, or not meant for this station."""
        self.refused = 0
        """Blocks of Set answered with an error."""

    @property
    def deadline(self) -> int | None:
        """When ``poll`` has something to hand out."""
        return min(due for due, _ in self._pending.values()) if self._pending else None

    def poll(self, now: int) -> list[bytes]:
        """The Identify answers that are due."""
        due = [source for source, (when, _) in self._pending.items() if when <= now]
        return [self._pending.pop(source)[1] for source in due]

    def receive(self, data: bytes, start: int, now: int) -> bytes | None:
        """A frame whose payload starts at ``start`` with a DCP FrameID; its immediate answer, if it has one."""
        destination, source = data[:6], data[6:12]
        answer = None
        if len(data) - start >= HEADER.size and not source[0] & 1:
            frame_id, service, kind, xid, delay, length = HEADER.unpack_from(data, start)
            blocks = data[start + HEADER.size :]
            if kind == ServiceType.REQUEST and length <= len(blocks):
                answer = self._dispatch(destination, source, (frame_id, service), (xid, delay), blocks[:length], now)
        if answer is None:
            self.ignored += 1
        return answer or None

    def _dispatch(
        self,
        destination: bytes,
        source: bytes,
        kind: tuple[int, int],
        request: tuple[int, int],
        blocks: bytes,
        now: int,
    ) -> bytes | None:
        xid, delay = request
        own = destination == self._station.identity.mac
        if kind == (FRAME_ID_IDENTIFY, Service.IDENTIFY):
            if destination != ethernet.DCP_MULTICAST and not own:
                return None
            return self._identify(source, xid, delay, blocks, now)
        if not own or kind[0] != FRAME_ID_GET_SET:
            return None
        try:
            if kind[1] == Service.GET:
                return self._answer(source, Service.GET, xid, self._get(blocks))
            if kind[1] == Service.SET:
                return self._answer(source, Service.SET, xid, self._set(blocks))
        except ProfidriveError:
            return None
        payload = HEADER.pack(FRAME_ID_GET_SET, kind[1], ServiceType.NOT_SUPPORTED, xid, 0, 0)
        return ethernet.frame(source, self._station.identity.mac, payload)

    def _answer(self, source: bytes, service: Service, xid: int, blocks: bytes) -> bytes:
        payload = encode(FRAME_ID_GET_SET, service, ServiceType.SUCCESS, xid, blocks)
        return ethernet.frame(source, self._station.identity.mac, payload)

    # -- Identify -----------------------------------------------------------------------------------------------------

    def _identify(self, source: bytes, xid: int, delay: int, blocks: bytes, now: int) -> bytes | None:
        try:
            filters = split(blocks)
        except ProfidriveError:
            return None
        if not filters or not all(self._matches(code, content) for code, content in filters):
            return None
        if delay > DELAY_FACTOR_MAX or (source not in self._pending and len(self._pending) >= _PENDING_MAX):
            return None
        mac = self._station.identity.mac
        # 0 is reserved. A tester sends it and expects the same answer as for 1.
        due = now + (mac[4] * 256 + mac[5]) % max(1, delay) * DELAY_UNIT_NS
        content = b"".join(
            self._block(option)
            for option in (
                Option.IP,
                Option.VENDOR,
                Option.NAME,
                Option.DEVICE_ID,
                Option.ROLE,
                Option.OPTIONS,
                Option.INSTANCE,
            )
        )
        payload = encode(FRAME_ID_IDENTIFY_RESPONSE, Service.IDENTIFY, ServiceType.SUCCESS, xid, content)
        self._pending[source] = (due, ethernet.frame(source, mac, payload))
        return b""

    def _matches(self, code: tuple[int, int], content: bytes) -> bool:
        option = _BY_CODE.get(code)
        if option is Option.ALL:
            return not content
        if option is Option.ALIAS:
            neighbour = self._station.neighbour
            return neighbour is not None and content == neighbour.alias.encode("latin-1")
        if option is None or option.value[0] == Option.START.value[0] or option is Option.INSTANCE:
            return False
        value = self._value(option)
        return bool(value) and content == value

    # -- Get ----------------------------------------------------------------------------------------------------------

    def _value(self, option: Option) -> bytes:
        """Content of a block of ours after BlockInfo."""
        station = self._station
        identity = station.identity
        match option:
            case Option.MAC:
                return identity.mac
            case Option.IP:
                return station.ip.encode()
            case Option.VENDOR:
                return identity.product_text.encode("latin-1")
            case Option.NAME:
                return station.name.encode("latin-1")
            case Option.DEVICE_ID:
                return _U16.pack(identity.vendor_id) + _U16.pack(identity.device_id)
            case Option.ROLE:
                return _ROLE_IO_DEVICE
            case Option.OPTIONS:
                return bytes(code for item in SUPPORTED for code in item.value)
            case Option.INSTANCE:
                return _U16.pack(identity.instance)
        raise KeyError(option)

    def _block(self, option: Option) -> bytes:
        info = 1 if option is Option.IP and self._station.ip.is_set else 0
        return encode_block(option, _U16.pack(info) + self._value(option))

    def _get(self, blocks: bytes) -> bytes:
        if not blocks or len(blocks) % 2:
            raise ProfidriveError("DCP Get", f"{len(blocks)} bytes", "pairs of option and suboption")
        parts = []
        for at in range(0, len(blocks), 2):
            code = (blocks[at], blocks[at + 1])
            option = _BY_CODE.get(code)
            readable = option in SUPPORTED and option is not Option.ALL and code[0] != Option.START.value[0]
            if option is not None and readable:
                parts.append(self._block(option))
            else:
                parts.append(_result(code, SetError.SUBOPTION if code[0] in _OPTIONS else SetError.OPTION))
        return b"".join(parts)

    # -- Set ----------------------------------------------------------------------------------------------------------

    def _set(self, blocks: bytes) -> bytes:
        requests = split(blocks)
        if not requests or any(len(content) < _U16.size for _, content in requests):
            raise ProfidriveError("DCP Set", blocks.hex(), "blocks with a BlockQualifier")
        parts = []
        for code, content in requests:
            error = self._set_one(code, _U16.unpack_from(content)[0], content[_U16.size :])
            self.refused += error is not SetError.OK
            parts.append(_result(code, error))
        return b"".join(parts)

    def _set_one(self, code: tuple[int, int], qualifier: int, value: bytes) -> SetError:
        option = _BY_CODE.get(code)
        permanent = bool(qualifier & _PERMANENT)
        match option:
            case Option.START | Option.STOP:
                return SetError.OK
            case Option.SIGNAL:
                if value != _SIGNAL_FLASH:
                    return SetError.VALUE
                self.events.append(Flash())
                return SetError.OK
            case Option.NAME | Option.IP | Option.FACTORY_RESET | Option.RESET if (
                self._in_operation() and value != self._unchanged(option)
            ):
                return SetError.IN_OPERATION
            case Option.NAME:
                return self._set_name(value, permanent)
            case Option.IP:
                return self._set_ip(value, permanent)
            case Option.FACTORY_RESET | Option.RESET:
                if value or (option is Option.RESET and qualifier != _RESET_MODE_2):
                    return SetError.VALUE
                self._station.name = ""
                if self._give_ip(NO_IP):
                    self._station.ip = NO_IP
                self.events.append(ResetToFactory())
                return SetError.OK
        return SetError.SUBOPTION if code[0] in _OPTIONS else SetError.OPTION

    def _unchanged(self, option: Option) -> bytes | None:
        """The value of a Set that changes nothing; None: there is none, as for a reset."""
        return self._value(option) if option in {Option.NAME, Option.IP} else None

    def _set_name(self, value: bytes, permanent: bool) -> SetError:
        name = value.decode("latin-1")
        try:
            if value:
                check_name(name)
        except ProfidriveError:
            return SetError.VALUE
        self._station.name = name
        self.events.append(NameSet(name, permanent))
        return SetError.OK

    def _set_ip(self, value: bytes, permanent: bool) -> SetError:
        if len(value) != len(NO_IP.encode()):
            return SetError.VALUE
        suite = IpSuite.decode(value)
        try:
            suite.check()
        except ProfidriveError:
            return SetError.VALUE
        if not self._give_ip(suite):
            return SetError.LOCAL
        self._station.ip = suite
        self.events.append(IpSet(suite, permanent))
        return SetError.OK


def _result(code: tuple[int, int], error: SetError) -> bytes:
    return encode_block(Option.RESPONSE, bytes((*code, error)))
