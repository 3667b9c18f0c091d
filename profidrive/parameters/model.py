"""The parameter model of a device: a request's bytes in, the response's bytes out.

Source: PROFIdrive profile 4.1 chapter 6.2.3 (docs/parameter-channel.md). Parameters are processed in order, a failed one does
not stop the others. Left out: where values come from; a device binds them.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters import codec
from pdgw.profidrive.parameters.catalogue import NAME_SIZE, ParameterSpec
from pdgw.profidrive.parameters.description import UNITS, Description
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused

_GENERIC = {1: DataType.BYTE, 2: DataType.WORD, 4: DataType.DOUBLE_WORD}
_HIGHEST_SUBINDEX = 0xFFFE
_ERROR_SIZE = 6


class Parameter(Protocol):
    """One parameter of a drive object. All methods raise ParameterRefused."""

    @property
    def texts(self) -> Sequence[str]:
        """The text array, empty where there is none."""

    def read(self, subindex: int, elements: int) -> codec.Values:
        """``elements`` values from ``subindex``; 0 means the one of a non-array."""

    def write(self, subindex: int, elements: int, values: codec.Values) -> None:
        """The other way round."""

    def description(self) -> Description:
        """Description of the parameter."""


class DriveObjectParameters(Protocol):
    """The parameters of a drive object (DO)."""

    def parameter(self, pnu: int) -> Parameter:
        """ParameterRefused (impermissible PNU) where there is none."""

    def check_writable(self, pnu: int) -> None:
        """ParameterRefused while nothing may be written (operation priority, P927)."""


def generic(data_type: DataType) -> DataType | None:
    """Byte, Word or Double word for a type of that size."""
    return _GENERIC.get(data_type.size) if data_type.char else None


def converted(values: codec.Values, data_type: DataType) -> codec.Values:
    """Written values as their parameter's type: the type itself, or Byte, Word, Double word of the same size.

    ParameterRefused with incorrect data type otherwise.
    """
    if values.format is data_type:
        return values
    if values.format is not generic(data_type) or isinstance(values.values, bytes):
        raise ParameterRefused(Number.INCORRECT_DATA_TYPE)
    count = len(values.values)
    raw = struct.pack(f">{count}{values.format.char}", *values.values)
    return codec.Values(data_type, struct.unpack(f">{count}{data_type.char}", raw))


@dataclass(frozen=True)
class BoundParameter:
    """A declared parameter with its functions.

    ``get`` returns the present value: a number, the elements of an array, or the bytes of a string. ``set`` takes one number
    (no array of the profile is writable). Both may raise ParameterRefused.
    """

    spec: ParameterSpec
    get: Callable[[], int | float | bytes | Sequence[int]]
    set: Callable[[int], None] | None = None
    format: DataType | None = None
    """Format of the answer, if it differs from the declared one."""
    own_texts: Callable[[], Sequence[str]] | None = None
    """A text array that only the device can know."""

    @property
    def texts(self) -> Sequence[str]:
        return self.spec.texts if self.own_texts is None else self.own_texts()

    def read(self, subindex: int, elements: int) -> codec.Values:
        data_type = self.format or self.spec.type
        value = self.get()
        if not self.spec.array:
            if subindex or elements > (len(value) if isinstance(value, bytes) else 1):
                raise ParameterRefused(Number.NO_ARRAY)
            return codec.Values(data_type, value if isinstance(value, bytes) else (value,))  # type: ignore[arg-type]
        if elements == 0:
            raise ParameterRefused(Number.ADDRESS_IMPERMISSIBLE)
        items: Sequence[int] = value  # type: ignore[assignment]
        if subindex + elements > len(items):
            raise ParameterRefused(Number.FAULTY_SUBINDEX, max(subindex, len(items)) if elements > 1 else None)
        return codec.Values(data_type, tuple(items[subindex : subindex + elements]))

    def write(self, subindex: int, elements: int, values: codec.Values) -> None:
        if self.set is None:
            raise ParameterRefused(Number.VALUE_CANNOT_BE_CHANGED)
        if subindex or elements > 1:
            raise ParameterRefused(Number.NO_ARRAY)
        (value,) = converted(values, self.spec.type).values
        number = int(value)
        low, high = self.spec.low, self.spec.high
        if (low is not None and number < low) or (high is not None and number > high):
            raise ParameterRefused(Number.LIMIT_EXCEEDED)
        self.set(number)

    def description(self) -> Description:
        spec = self.spec
        value = self.get() if spec.array or not spec.type.char else 0
        count = len(value) if isinstance(value, Sequence) else 0
        low, high = spec.low or 0, spec.high or 0
        writable = self.set is not None
        return Description(
            self.format or spec.type,
            spec.name,
            spec.array,
            count,
            writable,
            bool(self.texts),
            low,
            high,
            spec.reset_only,
            UNITS.get(spec.unit),
        )


def answer(data: bytes, find: Callable[[int], DriveObjectParameters | None], max_block: int) -> bytes | None:
    """The response to a request; None without a complete header. ``find`` returns the DO, or None."""
    try:
        request = codec.decode_request(data)
    except codec.RequestError as error:
        return error.response()
    return codec.encode_response(respond(request, find(request.do_id), max_block))


def respond(request: codec.Request, drive_object: DriveObjectParameters | None, max_block: int) -> codec.Response:
    """As ``answer``, for a decoded request."""
    values = []
    room = max_block - codec.HEADER_SIZE
    for place, address in enumerate(request.addresses):
        # Each of the following may need room for an error.
        reserved = _ERROR_SIZE * (len(request.addresses) - place - 1)
        item = _one(request, place, address, drive_object, room - reserved)
        room -= _size(item)
        values.append(item)
    if request.request_id is codec.RequestId.CHANGE and not any(item.failed for item in values):
        values = []
    return codec.Response(request.reference, request.request_id, request.do_id, len(request.addresses), tuple(values))


def _one(
    request: codec.Request,
    place: int,
    address: codec.ParameterAddress,
    drive_object: DriveObjectParameters | None,
    room: int,
) -> codec.Values:
    try:
        if drive_object is None:
            raise ParameterRefused(Number.DO_DOES_NOT_EXIST)
        _check(address)
        parameter = drive_object.parameter(address.pnu)
        if request.request_id is codec.RequestId.REQUEST:
            item = _read(parameter, address)
        else:
            item = _write(drive_object, parameter, address, request.values[place])
        if _size(item) > room:
            raise ParameterRefused(Number.RESPONSE_TOO_LONG)
    except ParameterRefused as refused:
        return codec.Values.error(refused.number, refused.subindex)
    return item


def _check(address: codec.ParameterAddress) -> None:
    if (
        address.pnu == 0
        or address.attribute not in set(codec.Attribute)
        or address.elements > codec.MAX_ELEMENTS
        or address.subindex > _HIGHEST_SUBINDEX
        or (address.elements == 0 and address.subindex and address.attribute != codec.Attribute.DESCRIPTION)
    ):
        raise ParameterRefused(Number.ADDRESS_IMPERMISSIBLE)


def _read(parameter: Parameter, address: codec.ParameterAddress) -> codec.Values:
    if address.attribute == codec.Attribute.VALUE:
        return parameter.read(address.subindex, address.elements)
    if address.attribute == codec.Attribute.DESCRIPTION:
        if address.elements > 1:
            raise ParameterRefused(Number.ADDRESS_IMPERMISSIBLE)
        return parameter.description().values(address.subindex)
    texts = parameter.texts
    if not texts:
        raise ParameterRefused(Number.NO_TEXT_ARRAY)
    count = max(1, address.elements)
    if address.subindex + count > len(texts):
        raise ParameterRefused(Number.FAULTY_SUBINDEX)
    if count * NAME_SIZE > codec.MAX_ELEMENTS:
        raise ParameterRefused(Number.RESPONSE_TOO_LONG)
    chosen = texts[address.subindex : address.subindex + count]
    return codec.Values(DataType.VISIBLE_STRING, b"".join(text.encode("ascii").ljust(NAME_SIZE) for text in chosen))


def _write(
    drive_object: DriveObjectParameters, parameter: Parameter, address: codec.ParameterAddress, values: codec.Values
) -> codec.Values:
    if address.attribute == codec.Attribute.DESCRIPTION:
        raise ParameterRefused(Number.DESCRIPTION_CANNOT_BE_CHANGED)
    if address.attribute == codec.Attribute.TEXT:
        raise ParameterRefused(Number.TEXT_CANNOT_BE_CHANGED)
    if values.format in {DataType.ZERO, DataType.ERROR}:
        raise ParameterRefused(Number.ILLEGAL_FORMAT)
    if values.format.char and len(values.values) != max(1, address.elements):
        raise ParameterRefused(Number.NUMBER_OF_VALUES_INCONSISTENT)
    drive_object.check_writable(address.pnu)
    parameter.write(address.subindex, address.elements, values)
    return codec.ZERO


def _size(item: codec.Values) -> int:
    """Bytes of a value area in a response."""
    content = len(item.values) * (1 if isinstance(item.values, bytes) else item.format.size)
    return 2 + content + (content & 1)
