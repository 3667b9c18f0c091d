"""Requests and responses of the parameter channel, both directions, as typed objects."""

from __future__ import annotations

import enum
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber, error_text

MAX_PARAMETERS = 39
MAX_ELEMENTS = 234
_HEADER = struct.Struct(">BBBB")
HEADER_SIZE = _HEADER.size
"""Size of a header of request or response."""
_ADDRESS = struct.Struct(">BBHH")
_NEGATIVE = 0x80


class RequestId(enum.IntEnum):
    """Services."""

    REQUEST = 0x01
    CHANGE = 0x02


class Attribute(enum.IntEnum):
    """The addressed part of a parameter."""

    VALUE = 0x10
    DESCRIPTION = 0x20
    TEXT = 0x30


@dataclass(frozen=True, slots=True)
class ParameterAddress:
    """One parameter address. ``elements`` 0 with subindex 0 means the one element of a non-array."""

    pnu: int
    subindex: int = 0
    elements: int = 0
    attribute: int = Attribute.VALUE


@dataclass(frozen=True, slots=True)
class Values:
    """A value area: format and values. Integers and floats as such, strings and octets as bytes."""

    format: DataType
    values: tuple[int | float, ...] | bytes

    @classmethod
    def error(cls, number: int, subindex: int | None = None) -> Values:
        """The error value of a failed parameter."""
        return cls(DataType.ERROR, (number,) if subindex is None else (number, subindex))

    @property
    def failed(self) -> bool:
        return self.format is DataType.ERROR

    @property
    def text(self) -> str:
        """For the reader: the values, or the error in words."""
        if isinstance(self.values, bytes):
            return self.values.decode("latin-1") if self.format is DataType.VISIBLE_STRING else self.values.hex(" ")
        if self.format is DataType.ZERO:
            return "written"
        if self.failed:
            where = f", subindex {self.values[1]}" if len(self.values) > 1 else ""
            return f"error {int(self.values[0]):02X}h: {error_text(int(self.values[0]))}{where}"
        return ", ".join(str(value) for value in self.values)


ZERO = Values(DataType.ZERO, ())
"""The place of a parameter that was written in a partly failed change."""


@dataclass(frozen=True, slots=True)
class Request:
    """A parameter request; ``values`` (one area per address) only in a change."""

    reference: int
    request_id: RequestId
    do_id: int
    addresses: tuple[ParameterAddress, ...]
    values: tuple[Values, ...] = ()


@dataclass(frozen=True, slots=True)
class Response:
    """A parameter response; ``values`` is empty in a positive change response."""

    reference: int
    request_id: RequestId
    do_id: int
    count: int
    values: tuple[Values, ...] = ()

    @property
    def negative(self) -> bool:
        """At least one parameter failed."""
        return any(item.failed for item in self.values)


class RequestError(ProfidriveError):
    """A request that cannot be understood. ``reference`` and ``do_id`` are known when its header could be read."""

    def __init__(self, field: str, value: object, allowed: str, number: ParameterErrorNumber, header: bytes) -> None:
        super().__init__(field, value, allowed)
        self.number = number
        self.header = header[:4] if len(header) >= 4 else None

    def response(self) -> bytes | None:
        """The negative response, None where not even a header came: then the record is refused."""
        if self.header is None:
            return None
        reference, request_id, do_id, _ = self.header
        known = request_id in set(RequestId)
        answer = request_id | _NEGATIVE if known else _NEGATIVE
        return _HEADER.pack(reference, answer, do_id, 1) + _pack_values(Values.error(self.number))


# -- values -----------------------------------------------------------------------------------------------------------


def _count(item: Values) -> int:
    """No. of Values: elements of the format's size; 16-bit characters count once."""
    if isinstance(item.values, bytes):
        return len(item.values) // item.format.size if item.format.size else 0
    return len(item.values)


def _pack_numbers(item: Values) -> bytes:
    if not item.format.char and item.values:
        raise ProfidriveError(f"values of format {item.format.name}", item.values, "bytes")
    return struct.pack(f">{len(item.values)}{item.format.char}", *item.values) if item.format.char else b""


def _pack_values(item: Values) -> bytes:
    count = _count(item)
    if not 0 <= count <= MAX_ELEMENTS:
        raise ProfidriveError("No. of Values", count, f"0..{MAX_ELEMENTS}")
    if isinstance(item.values, bytes) and len(item.values) != count * item.format.size:
        raise ProfidriveError(
            f"values of format {item.format.name}", item.values, f"a multiple of {item.format.size} bytes"
        )
    try:
        data = item.values if isinstance(item.values, bytes) else _pack_numbers(item)
    except (struct.error, OverflowError) as error:  # OverflowError: a float beyond 32 bits
        raise ProfidriveError(
            f"values of format {item.format.name}", item.values, f"values that fit ({error})"
        ) from error
    return bytes((item.format.code, count)) + data + b"\0" * (len(data) & 1)


class _Reader:
    """Read a block from left to right; errors contain the offset."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.offset = 0

    def take(self, size: int, what: str, number: ParameterErrorNumber) -> bytes:
        end = self.offset + size
        if end > len(self.data):
            missing = end - len(self.data)
            raise RequestError(
                what, f"end of data at offset {len(self.data)}", f"{missing} more bytes", number, self.data
            )
        part = self.data[self.offset : end]
        self.offset = end
        return part

    def values(self) -> Values:
        code, count = self.take(2, "value format", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT)
        try:
            data_type = DataType.from_code(code)
        except ProfidriveError as error:
            raise RequestError(
                f"format at offset {self.offset - 2}",
                f"{code:02X}h",
                error.allowed,
                ParameterErrorNumber.ILLEGAL_FORMAT,
                self.data,
            ) from None
        if count > MAX_ELEMENTS:
            raise RequestError(
                f"No. of Values at offset {self.offset - 1}",
                count,
                f"0..{MAX_ELEMENTS}",
                ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT,
                self.data,
            )
        if data_type is DataType.ERROR and count not in {1, 2}:
            raise RequestError(
                f"No. of Values at offset {self.offset - 1}",
                count,
                "1 (error number) or 2 (with subindex) after format 44h",
                ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT,
                self.data,
            )
        size = data_type.size * count
        data = self.take(size, f"values at offset {self.offset}", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT)
        if size & 1:
            self.take(1, "padding", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT)
        if not data_type.char:
            return Values(data_type, data) if data_type is not DataType.ZERO else ZERO
        return Values(data_type, struct.unpack(f">{count}{data_type.char}", data))

    def end(self) -> None:
        if self.offset != len(self.data):
            raise RequestError(
                f"data after the last value at offset {self.offset}",
                f"{len(self.data) - self.offset} bytes",
                "none",
                ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT,
                self.data,
            )


# -- requests ---------------------------------------------------------------------------------------------------------


def encode_request(request: Request) -> bytes:
    """The bytes of a request (PLC side); ProfidriveError names the field that is not allowed."""
    if not 1 <= request.reference <= 255:
        raise ProfidriveError("Request Reference", request.reference, "1..255")
    if not 0 <= request.do_id <= 254:
        raise ProfidriveError("DO-ID", request.do_id, "0..254")
    count = len(request.addresses)
    if not 1 <= count <= MAX_PARAMETERS:
        raise ProfidriveError("No. of Parameters", count, f"1..{MAX_PARAMETERS}")
    change = request.request_id is RequestId.CHANGE
    if len(request.values) != (count if change else 0):
        raise ProfidriveError("value areas", len(request.values), f"{count if change else 0}")
    parts = [_HEADER.pack(request.reference, request.request_id, request.do_id, count)]
    for address in request.addresses:
        if not 1 <= address.pnu <= 0xFFFF:
            raise ProfidriveError("PNU", address.pnu, "1..65535")
        if not 0 <= address.subindex <= 0xFFFE:
            raise ProfidriveError("Subindex", address.subindex, "0..65534")
        if not 0 <= address.elements <= MAX_ELEMENTS:
            raise ProfidriveError("No. of Elements", address.elements, f"0..{MAX_ELEMENTS}")
        parts.append(_ADDRESS.pack(address.attribute, address.elements, address.pnu, address.subindex))
    parts += [_pack_values(item) for item in request.values]
    return b"".join(parts)


def decode_request(data: bytes) -> Request:
    """A request's bytes as an object; RequestError carries the error number the PLC is answered with."""
    reader = _Reader(data)
    inconsistent = ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT
    reference, request_id, do_id, count = reader.take(4, "request header", inconsistent)
    if request_id not in {RequestId.REQUEST, RequestId.CHANGE}:
        raise RequestError(
            "Request ID", f"{request_id:02X}h", "01h or 02h", ParameterErrorNumber.SERVICE_NOT_SUPPORTED, data
        )
    if reference == 0:
        raise RequestError("Request Reference", 0, "1..255", ParameterErrorNumber.ADDRESS_IMPERMISSIBLE, data)
    if not 1 <= count <= MAX_PARAMETERS:
        raise RequestError("No. of Parameters", count, f"1..{MAX_PARAMETERS}", inconsistent, data)
    addresses = []
    for _ in range(count):
        where = reader.offset
        raw = reader.take(_ADDRESS.size, f"parameter address at offset {where}", inconsistent)
        attribute, elements, pnu, subindex = _ADDRESS.unpack(raw)
        addresses.append(ParameterAddress(pnu, subindex, elements, attribute))
    values: tuple[Values, ...] = ()
    if request_id == RequestId.CHANGE:
        values = tuple(reader.values() for _ in range(count))
    reader.end()
    return Request(reference, RequestId(request_id), do_id, tuple(addresses), values)


# -- responses --------------------------------------------------------------------------------------------------------


def encode_response(response: Response) -> bytes:
    """The bytes of a response (device side)."""
    response_id = response.request_id | (_NEGATIVE if response.negative else 0)
    parts = [_HEADER.pack(response.reference, response_id, response.do_id, response.count)]
    parts += [_pack_values(item) for item in response.values]
    return b"".join(parts)


def is_negative(response: bytes) -> bool:
    """Whether a response says that something of the request was refused."""
    return len(response) < _HEADER.size or bool(response[1] & _NEGATIVE)


def decode_response(data: bytes) -> Response:
    """Decode a response; ProfidriveError has the offset of the error."""
    reader = _Reader(data)
    inconsistent = ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT
    reference, response_id, do_id, count = reader.take(4, "response header", inconsistent)
    request_id = response_id & ~_NEGATIVE
    if request_id not in {RequestId.REQUEST, RequestId.CHANGE}:
        raise ProfidriveError("Response ID", f"{response_id:02X}h", "01h, 02h, 81h or 82h")
    values: tuple[Values, ...] = ()
    if response_id != RequestId.CHANGE:
        # A rejected request is answered with one error value, whatever its count.
        values = tuple(reader.values() for _ in range(count))
    reader.end()
    response = Response(reference, RequestId(request_id), do_id, count, values)
    if response.negative != bool(response_id & _NEGATIVE):
        raise ProfidriveError("Response ID", f"{response_id:02X}h", "81h or 82h exactly when a parameter failed")
    return response


def check_answers(request: Request, response: Response) -> Sequence[Values]:
    """The value areas of a response, checked against its request; ProfidriveError when they do not belong together."""
    for field, sent, received in (
        ("Request Reference", request.reference, response.reference),
        ("Request ID", request.request_id, response.request_id),
        ("DO-ID", request.do_id, response.do_id),
    ):
        if sent != received:
            raise ProfidriveError(f"{field} of the response", received, f"{sent}, as in the request")
    if len(response.values) == 1 and response.values[0].failed:
        return response.values
    if response.count != len(request.addresses):
        raise ProfidriveError("No. of Parameters of the response", response.count, f"{len(request.addresses)}")
    return response.values


# -- the word-swapped form --------------------------------------------------------------------------------------------


def unswap(data: bytes) -> bytes | None:
    """The standard form of a request printed with swapped bytes in each word, as the manufacturer's guide does.

    The guide swaps all words but the subindex. None when the data does not look like that form.
    """
    if len(data) < 10 or (len(data) - 4) % 6:
        return None
    swapped = bytearray()
    for offset in range(0, len(data), 2):
        word = data[offset : offset + 2]
        is_subindex = offset >= 4 and (offset - 4) % 6 == 4
        swapped += word if is_subindex else word[::-1]
    candidate = bytes(swapped)
    try:
        decoded = decode_request(candidate)
    except ProfidriveError:
        return None
    known = all(address.attribute in set(Attribute) for address in decoded.addresses)
    return candidate if known and decoded.request_id is RequestId.REQUEST else None
