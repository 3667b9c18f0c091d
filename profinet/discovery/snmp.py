"""An SNMP agent, v1 and v2c: GET, GETNEXT and GETBULK on a table of objects, SET of texts where allowed, sans-I/O.

Source: RFC 1157, RFC 3416 (protocol), X.690 (BER). A SET changes all its variables or none. Everything is bounded: a datagram,
its variables, the answer. With a library (pysnmp) one request would hold up the loop that serves the drives for two cycles of
1 ms, so the few types needed are encoded here.
"""

from __future__ import annotations

import enum
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.profidrive.errors import ProfidriveError

Oid = tuple[int, ...]
REQUEST_MAX: Final = 1472
"""Bytes of a datagram that fits into one Ethernet frame."""
_VARIABLES_MAX = 64
_REPETITIONS_MAX = 32
_OID_MAX = 128
_SEQUENCE, _NULL, _OID = 0x30, 0x05, 0x06
_LONG_LENGTH, _LENGTH_BYTES_MAX = 0x80, 2
_V1, _V2C = 0, 1
_PRINTABLE = (0x20, 0x7E)


class Kind(enum.IntEnum):
    """Types of values with their BER tags."""

    INTEGER = 0x02
    OCTETS = 0x04
    OID = 0x06
    IP_ADDRESS = 0x40
    COUNTER = 0x41
    GAUGE = 0x42
    TIME_TICKS = 0x43


class Pdu(enum.IntEnum):
    """PDU types with their BER tags."""

    GET = 0xA0
    GET_NEXT = 0xA1
    RESPONSE = 0xA2
    SET = 0xA3
    GET_BULK = 0xA5


class ErrorStatus(enum.IntEnum):
    """error-status of an answer."""

    OK = 0
    TOO_BIG = 1
    NO_SUCH_NAME = 2
    BAD_VALUE = 3
    WRONG_TYPE = 7
    WRONG_VALUE = 10
    NOT_WRITABLE = 17


_NO_SUCH_OBJECT, _END_OF_MIB = 0x80, 0x82
"""Exceptions of v2c in place of a value."""


@dataclass(frozen=True, slots=True, order=True)
class Variable:
    """An object instance; ``value`` is an integer, bytes or an object identifier by its kind."""

    oid: Oid
    kind: Kind
    value: int | bytes | Oid


# -- BER --------------------------------------------------------------------------------------------------------------


def _tlv(tag: int, content: bytes) -> bytes:
    length = len(content)
    if length < _LONG_LENGTH:
        return bytes((tag, length)) + content
    size = (length.bit_length() + 7) // 8
    return bytes((tag, _LONG_LENGTH | size)) + length.to_bytes(size, "big") + content


def _integer(value: int) -> bytes:
    return value.to_bytes(value.bit_length() // 8 + 1, "big", signed=True)


def _oid(oid: Oid) -> bytes:
    first, second, *rest = oid
    out = bytearray()
    for number in (first * 40 + second, *rest):
        part = [number & 0x7F]
        while number := number >> 7:
            part.append(number & 0x7F | 0x80)
        out += bytes(reversed(part))
    return bytes(out)


def encode_value(kind: Kind, value: int | bytes | Oid) -> bytes:
    """A value with tag and length."""
    if isinstance(value, tuple):
        return _tlv(kind, _oid(value))
    return _tlv(kind, _integer(value) if isinstance(value, int) else value)


class _Reader:
    """Tags and lengths of one level; ProfidriveError where the bytes are none."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def left(self) -> bool:
        return self._at < len(self._data)

    def next(self) -> tuple[int, bytes]:
        data, at = self._data, self._at
        if len(data) - at < 2:
            raise ProfidriveError("SNMP", f"{len(data) - at} bytes left", "tag and length")
        tag, length = data[at], data[at + 1]
        at += 2
        if length & _LONG_LENGTH:
            size = length & ~_LONG_LENGTH
            if not 1 <= size <= _LENGTH_BYTES_MAX or len(data) - at < size:
                raise ProfidriveError("SNMP length", f"{size} bytes", f"1..{_LENGTH_BYTES_MAX}")
            length = int.from_bytes(data[at : at + size], "big")
            at += size
        if length > len(data) - at:
            raise ProfidriveError("SNMP length", length, f"at most {len(data) - at}")
        self._at = at + length
        return tag, data[at : self._at]

    def take(self, tag: int) -> bytes:
        found, content = self.next()
        if found != tag:
            raise ProfidriveError("SNMP tag", f"{found:02X}h", f"{tag:02X}h")
        return content

    def integer(self) -> int:
        content = self.take(Kind.INTEGER)
        if not 1 <= len(content) <= 4:
            raise ProfidriveError("SNMP INTEGER", f"{len(content)} bytes", "1..4")
        return int.from_bytes(content, "big", signed=True)


def _read_oid(content: bytes) -> Oid:
    if not content or len(content) > _OID_MAX or content[-1] & 0x80:
        raise ProfidriveError("SNMP OID", content.hex(), f"1..{_OID_MAX} bytes, the last below 80h")
    numbers = [0]
    for byte in content:
        numbers[-1] = numbers[-1] << 7 | byte & 0x7F
        if not byte & 0x80:
            numbers.append(0)
    first = min(numbers[0] // 40, 2)
    return (first, numbers[0] - 40 * first, *numbers[1:-1])


# -- the agent --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Request:
    version: int
    pdu: Pdu
    number: bytes
    """RequestID as it came."""
    repeaters: tuple[int, int]
    """Of GETBULK: non-repeaters and max-repetitions."""
    oids: tuple[Oid, ...]
    values: tuple[tuple[int, bytes], ...]
    """Tag and content of each."""
    variables: bytes
    """As they came, for an answer with an error."""
    community: bytes


@dataclass(frozen=True, slots=True)
class Writing:
    """What may be written with another community: texts by OID, each with its longest length; ``write`` gets all of a request."""

    community: bytes
    lengths: Mapping[Oid, int]
    write: Callable[[Mapping[Oid, str]], None]


class Agent:
    """Answers requests with ``community`` from what ``objects`` gives, sorted by OID. Without ``writing`` a SET is refused."""

    def __init__(
        self, community: bytes, objects: Callable[[], Sequence[Variable]], writing: Writing | None = None
    ) -> None:
        self._writing = writing
        self._communities = {community} if writing is None else {community, writing.community}
        self._objects = objects
        self.ignored = 0
        """Datagrams without an answer: damaged, another version or community."""

    def answer(self, data: bytes) -> bytes | None:
        """The answer to a datagram; None where it gets none."""
        try:
            request = self._decode(data)
        except ProfidriveError:
            self.ignored += 1
            return None
        if request.pdu is Pdu.SET:
            return self._encode(request, *self._write(request), request.variables)
        return self._read(request)

    def _write(self, request: _Request) -> tuple[ErrorStatus, int]:
        """Write every variable or none: error-status and error-index."""
        writing, old = self._writing, request.version == _V1
        texts: dict[Oid, str] = {}
        for index, (oid, (tag, content)) in enumerate(zip(request.oids, request.values, strict=True), 1):
            if writing is None or request.community != writing.community or oid not in writing.lengths:
                return ErrorStatus.NO_SUCH_NAME if old else ErrorStatus.NOT_WRITABLE, index
            if tag != Kind.OCTETS:
                return ErrorStatus.BAD_VALUE if old else ErrorStatus.WRONG_TYPE, index
            if len(content) > writing.lengths[oid] or any(
                not _PRINTABLE[0] <= byte <= _PRINTABLE[1] for byte in content
            ):
                return ErrorStatus.BAD_VALUE if old else ErrorStatus.WRONG_VALUE, index
            texts[oid] = content.decode("ascii")
        if writing is not None:
            writing.write(texts)
        return ErrorStatus.OK, 0

    def _decode(self, data: bytes) -> _Request:
        if len(data) > REQUEST_MAX:
            raise ProfidriveError("SNMP", f"{len(data)} bytes", f"at most {REQUEST_MAX}")
        message = _Reader(_Reader(data).take(_SEQUENCE))
        version = message.integer()
        community = message.take(Kind.OCTETS)
        if version not in {_V1, _V2C} or community not in self._communities:
            raise ProfidriveError("SNMP", version, "version 1 or 2c and the community of this agent")
        tag, content = message.next()
        allowed = {Pdu.GET, Pdu.GET_NEXT, Pdu.SET} | ({Pdu.GET_BULK} if version == _V2C else set())
        if tag not in allowed:
            raise ProfidriveError("SNMP PDU", f"{tag:02X}h", "GET, GETNEXT, GETBULK of v2c or SET")
        pdu = _Reader(content)
        number = pdu.take(Kind.INTEGER)
        repeaters = (pdu.integer(), pdu.integer())
        variables = pdu.take(_SEQUENCE)
        oids: list[Oid] = []
        values: list[tuple[int, bytes]] = []
        reader = _Reader(variables)
        while reader.left:
            bound = _Reader(reader.take(_SEQUENCE))
            oids.append(_read_oid(bound.take(_OID)))
            values.append(bound.next() if tag == Pdu.SET else (_NULL, b""))
            if len(oids) > _VARIABLES_MAX:
                raise ProfidriveError("SNMP variables", len(oids), f"at most {_VARIABLES_MAX}")
        return _Request(version, Pdu(tag), number, repeaters, tuple(oids), tuple(values), variables, community)

    def _read(self, request: _Request) -> bytes:
        objects = self._objects()
        oids = [item.oid for item in objects]
        found: list[bytes] = []
        for index, (oid, following) in enumerate(_asked(request, objects, oids), 1):
            at = bisect_right(oids, oid) if following else bisect_left(oids, oid)
            if at < len(oids) and (following or oids[at] == oid):
                item = objects[at]
                found.append(_bind(item.oid, encode_value(item.kind, item.value)))
            elif request.version == _V1:
                return self._encode(request, ErrorStatus.NO_SUCH_NAME, index, request.variables)
            else:
                found.append(_bind(oid, _tlv(_END_OF_MIB if following else _NO_SUCH_OBJECT, b"")))
        answer = self._encode(request, ErrorStatus.OK, 0, b"".join(found))
        while len(answer) > REQUEST_MAX and request.pdu is Pdu.GET_BULK and len(found) > 1:
            found = found[: len(found) * 3 // 4]
            answer = self._encode(request, ErrorStatus.OK, 0, b"".join(found))
        if len(answer) > REQUEST_MAX:
            return self._encode(request, ErrorStatus.TOO_BIG, 0, b"")
        return answer

    def _encode(self, request: _Request, status: ErrorStatus, index: int, variables: bytes) -> bytes:
        pdu = _tlv(Kind.INTEGER, request.number) + _tlv(Kind.INTEGER, _integer(status))
        pdu += _tlv(Kind.INTEGER, _integer(index)) + _tlv(_SEQUENCE, variables)
        head = _tlv(Kind.INTEGER, _integer(request.version)) + _tlv(Kind.OCTETS, request.community)
        return _tlv(_SEQUENCE, head + _tlv(Pdu.RESPONSE, pdu))


def _bind(oid: Oid, value: bytes) -> bytes:
    return _tlv(_SEQUENCE, _tlv(_OID, _oid(oid)) + value)


def _asked(request: _Request, objects: Sequence[Variable], oids: Sequence[Oid]) -> list[tuple[Oid, bool]]:
    """Each OID with whether the next one is asked for; of GETBULK the repetitions too."""
    if request.pdu is not Pdu.GET_BULK:
        return [(oid, request.pdu is Pdu.GET_NEXT) for oid in request.oids]
    first = max(0, min(request.repeaters[0], len(request.oids)))
    asked = [(oid, True) for oid in request.oids[:first]]
    columns = list(request.oids[first:])
    for _ in range(max(0, min(request.repeaters[1], _REPETITIONS_MAX))):
        asked += [(oid, True) for oid in columns]
        places = [bisect_right(oids, oid) for oid in columns]
        columns = [oids[at] if at < len(oids) else oid for oid, at in zip(columns, places, strict=True)]
    return asked
