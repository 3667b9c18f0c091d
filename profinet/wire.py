"""Declared wire formats: a structure is a dataclass whose fields are its layout; codec, checks and error codes derive from it.

A refusal of a PROFINET block names the block (ErrorCode1) and the number of the field in it (ErrorCode2), counted through
nested lists: 0 type, 1 length, 2 and 3 version, then the fields. Here that number is the place of the field in the
declaration. Everything is big-endian; only RPC and NDR headers follow the sender (``rpc.dcerpc``).
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Self
from uuid import UUID

from pdgw.profidrive.errors import ProfidriveError

LENGTH_FIELD = 1
"""Number of BlockLength: every field beyond the end of the block is an error of its length."""
FIRST_FIELD = 4
"""Number of the first field after type, length and version."""


class WireError(ProfidriveError):
    """A field does not hold what is allowed. ``number`` is its place in the block (ErrorCode2)."""

    def __init__(self, field: str, value: object, allowed: str, number: int) -> None:
        self.number = number
        super().__init__(field, value, allowed)


@dataclasses.dataclass(frozen=True, slots=True)
class Check:
    """Allowed values of a field, for the machine and as text."""

    accepts: Callable[[Any], bool]
    allowed: str


def one_of(*values: int) -> Check:
    return Check(frozenset(values).__contains__, " or ".join(f"{value:04X}h" for value in values))


def between(low: int, high: int) -> Check:
    return Check(lambda value: low <= value <= high, f"{low}..{high}")


class Cursor:
    """Read position in a structure. ``checked``: False accepts any values of other senders."""

    __slots__ = ("at", "checked", "data", "start")

    def __init__(self, data: bytes, at: int = 0, start: int = 0, *, checked: bool = True) -> None:
        self.data = data
        self.at = at
        self.start = start
        """Origin of the alignment."""
        self.checked = checked

    @property
    def left(self) -> int:
        return len(self.data) - self.at

    def take(self, count: int, name: str) -> bytes:
        """The next bytes; the error is one of the block's length."""
        if count > self.left:
            raise WireError(name, f"{self.left} bytes left", f"{count} bytes", LENGTH_FIELD)
        self.at += count
        return self.data[self.at - count : self.at]


class _Kind:
    """Encoding of a field. ``width``: its share in the count of fields."""

    width = 1

    def numbered(self, name: str, number: int) -> Iterator[tuple[int, str]]:
        """What each of these numbers counts, as an error names it."""
        yield number, name

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> Any:
        raise NotImplementedError

    def write(self, out: bytearray, value: Any, start: int) -> None:
        raise NotImplementedError


class _Scalar(_Kind):
    def __init__(self, char: str, check: Check | None, shift: int = 0) -> None:
        self._struct = struct.Struct(">" + char)
        self._check = check
        self._shift = shift

    def numbered(self, name: str, number: int) -> Iterator[tuple[int, str]]:
        yield number + self._shift, name

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> Any:
        value = self._struct.unpack(cursor.take(self._struct.size, name))[0]
        if self._check is not None and cursor.checked and not self._check.accepts(value):
            raise WireError(name, f"{value:X}h", self._check.allowed, number + self._shift)
        return value

    def write(self, out: bytearray, value: Any, start: int) -> None:
        out += self._struct.pack(value)


class _Uuid(_Kind):
    def __init__(self, check: Check | None) -> None:
        self._check = check

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> UUID:
        value = UUID(bytes=cursor.take(16, name))
        if self._check is not None and cursor.checked and not self._check.accepts(value):
            raise WireError(name, str(value), self._check.allowed, number)
        return value

    def write(self, out: bytearray, value: UUID, start: int) -> None:
        out += value.bytes


class _Octets(_Kind):
    def __init__(self, size: int, check: Check | None) -> None:
        self._size = size
        self._check = check

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> bytes:
        value = cursor.take(self._size, name)
        if self._check is not None and cursor.checked and not self._check.accepts(value):
            raise WireError(name, value.hex(":"), self._check.allowed, number)
        return value

    def write(self, out: bytearray, value: bytes, start: int) -> None:
        out += value


class _Text(_Kind):
    """Length and characters: two numbers."""

    width = 2

    def __init__(self, size: struct.Struct, length: Check, characters: Check) -> None:
        self._size = size
        self._length = length
        self._characters = characters

    def numbered(self, name: str, number: int) -> Iterator[tuple[int, str]]:
        yield number, f"length of {name}"
        yield number + 1, name

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> str:
        (length,) = self._size.unpack(cursor.take(self._size.size, name))
        if cursor.checked and not self._length.accepts(length):
            raise WireError(f"length of {name}", length, self._length.allowed, number)
        text = cursor.take(length, name).decode("latin-1")
        if cursor.checked and not self._characters.accepts(text):
            raise WireError(name, text, self._characters.allowed, number + 1)
        return text

    def write(self, out: bytearray, value: str, start: int) -> None:
        out += self._size.pack(len(value)) + value.encode("latin-1")


_NUMBER_OF = "number of "


class _Array(_Kind):
    """Successive structures, after their number or as many as earlier fields say."""

    def __init__(self, item: type[Structure], minimum: int, count: Callable[[dict[str, Any]], int] | None) -> None:
        self.item = item
        self._minimum = minimum
        self._count = count
        self.first = 0 if count else 1
        self.width = self.first + width(item)

    def numbered(self, name: str, number: int) -> Iterator[tuple[int, str]]:
        if self.first:
            yield number, _NUMBER_OF + name
        yield from _numbered(self.item, f"{name}.", number + self.first)

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> tuple[Any, ...]:
        if self._count is not None:
            count = self._count(before)
        else:
            count = int.from_bytes(cursor.take(2, _NUMBER_OF + name), "big")
            if cursor.checked and count < self._minimum:
                raise WireError(_NUMBER_OF + name, count, f"at least {self._minimum}", number)
        return tuple(self.item.read(cursor, number + self.first) for _ in range(count))

    def write(self, out: bytearray, value: tuple[Structure, ...], start: int) -> None:
        if self._count is None:
            out += len(value).to_bytes(2, "big")
        for item in value:
            item.write(out, start)


class _Padding(_Kind):
    """Zeros: a fixed number of bytes, or up to a multiple of 4 from the block's start. What comes in is not looked at."""

    width = 0

    def __init__(self, size: int | None) -> None:
        self._size = size

    def numbered(self, name: str, number: int) -> Iterator[tuple[int, str]]:
        yield from ()

    def _missing(self, length: int) -> int:
        return -length % 4 if self._size is None else self._size

    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> None:
        cursor.take(min(cursor.left, self._missing(cursor.at - cursor.start)), name)

    def write(self, out: bytearray, value: None, start: int) -> None:
        out += bytes(self._missing(len(out) - start))


class _Rest(_Kind):
    def read(self, cursor: Cursor, name: str, number: int, before: dict[str, Any]) -> bytes:
        return cursor.take(cursor.left, name)

    def write(self, out: bytearray, value: bytes, start: int) -> None:
        out += value


_KIND = "wire"


def _field(kind: _Kind, default: Any = dataclasses.MISSING) -> Any:
    return dataclasses.field(metadata={_KIND: kind}, default=default)


def u8(check: Check | None = None, *, shift: int = 0, default: Any = dataclasses.MISSING) -> Any:
    """An UNSIGNED8. ``shift``: difference between the standard's number of this field and its place."""
    return _field(_Scalar("B", check, shift), default)


def u16(check: Check | None = None, *, default: Any = dataclasses.MISSING) -> Any:
    """An UNSIGNED16."""
    return _field(_Scalar("H", check), default)


def u32(check: Check | None = None, *, default: Any = dataclasses.MISSING) -> Any:
    """An UNSIGNED32."""
    return _field(_Scalar("I", check), default)


def uuid(check: Check | None = None, *, default: Any = dataclasses.MISSING) -> Any:
    """A UUID in network order."""
    return _field(_Uuid(check), default)


def octets(size: int, check: Check | None = None, *, default: Any = dataclasses.MISSING) -> Any:
    """Bytes of a fixed number, for example a MAC address."""
    return _field(_Octets(size, check), default)


_ANY_TEXT = Check(lambda text: True, "any")


def text(length: Check | None = None, characters: Check = _ANY_TEXT, *, size: str = "H") -> Any:
    """Characters after their number."""
    layout = struct.Struct(">" + size)
    return _field(_Text(layout, length or between(0, 0xFFFF), characters))


def array(item: type[Structure], *, minimum: int = 0, count: Callable[[dict[str, Any]], int] | None = None) -> Any:
    """Structures after their number (UNSIGNED16), or ``count(earlier fields)`` of them without a number."""
    return _field(_Array(item, minimum, count))


def padding(size: int) -> Any:
    """Reserved bytes."""
    return _field(_Padding(size), None)


def align() -> Any:
    """Zeros up to a multiple of 4 bytes from the start of the block."""
    return _field(_Padding(None), None)


def rest() -> Any:
    """The rest of the block."""
    return _field(_Rest(), b"")


class Structure:
    """Base of the declared structures; subclasses are keyword-only dataclasses."""

    @classmethod
    def read(cls, cursor: Cursor, number: int = FIRST_FIELD) -> Self:
        """Read and check the fields; WireError names the first that is wrong. ``number``: of the first field."""
        values: dict[str, Any] = {}
        for name, kind in _kinds(cls):
            values[name] = kind.read(cursor, f"{cls.__name__}.{name}", number, values)
            number += kind.width
        return cls(**values)

    def write(self, out: bytearray, start: int = 0) -> None:
        """Append the fields; ``start`` is where the block begins in ``out``."""
        for name, kind in _kinds(type(self)):
            kind.write(out, getattr(self, name), start)


_KINDS: dict[type[Structure], tuple[tuple[str, _Kind], ...]] = {}


def _kinds(cls: type[Structure]) -> tuple[tuple[str, _Kind], ...]:
    if cls not in _KINDS:
        fields: dict[str, dataclasses.Field[Any]] = vars(cls).get("__dataclass_fields__", {})
        _KINDS[cls] = tuple((name, item.metadata[_KIND]) for name, item in fields.items() if _KIND in item.metadata)
    return _KINDS[cls]


def width(cls: type[Structure]) -> int:
    """Share of a structure in the count of fields."""
    return sum(kind.width for _, kind in _kinds(cls))


def _numbered(cls: type[Structure], prefix: str, number: int) -> Iterator[tuple[int, str]]:
    for name, kind in _kinds(cls):
        yield from kind.numbered(prefix + name, number)
        number += kind.width


def number_of(cls: type[Structure], path: str) -> int:
    """The number of a field in its block (ErrorCode2); ``path`` goes through nested lists: ``apis.data.slot``."""
    for number, name in _numbered(cls, "", FIRST_FIELD):
        if name.removeprefix(_NUMBER_OF) == path:
            return number
    raise KeyError(path)


HEADER = struct.Struct(">HHBB")
"""BlockType, BlockLength (from the version on), BlockVersionHigh, BlockVersionLow."""
VERSION_SIZE = 2
_HEADER_FIELDS = ("type", "length", "version", "version")


class Block(Structure):
    """A structure after a block header."""

    TYPE: ClassVar[int]
    ERROR_CODE1: ClassVar[int] = 0
    """Code of this block in a rejection."""
    VERSION: ClassVar[tuple[int, int]] = (1, 0)

    def encode(self) -> bytes:
        """Header and fields."""
        out = bytearray(HEADER.size)
        self.write(out)
        HEADER.pack_into(out, 0, self.TYPE, len(out) - HEADER.size + VERSION_SIZE, *self.VERSION)
        return bytes(out)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """One whole block; WireError when header or a field is wrong, or bytes are left."""
        if len(data) < HEADER.size:
            raise WireError(cls.__name__, f"{len(data)} bytes", f"a header of {HEADER.size} bytes", LENGTH_FIELD)
        kind, length, major, minor = HEADER.unpack_from(data)
        if kind != cls.TYPE:
            raise WireError(f"type of {cls.__name__}", f"{kind:04X}h", f"{cls.TYPE:04X}h", 0)
        if length != len(data) - HEADER.size + VERSION_SIZE:
            raise WireError(
                f"length of {cls.__name__}", length, f"{len(data) - HEADER.size + VERSION_SIZE}", LENGTH_FIELD
            )
        if major != cls.VERSION[0]:
            raise WireError(f"version of {cls.__name__}", f"{major}.{minor}", f"{cls.VERSION[0]}.x", 2)
        if minor != cls.VERSION[1]:
            raise WireError(f"version of {cls.__name__}", f"{major}.{minor}", f"x.{cls.VERSION[1]}", 3)
        cursor = Cursor(data, HEADER.size)
        block = cls.read(cursor)
        if cursor.left:
            raise WireError(cls.__name__, f"{cursor.left} bytes after the last field", "none", LENGTH_FIELD)
        return block

    @classmethod
    def field_at(cls, number: int) -> str:
        """What ErrorCode2 of a refusal of this block counts, for the reader; the number where the block has no such field."""
        if number < FIRST_FIELD:
            return f"{_HEADER_FIELDS[number]} of {cls.__name__}"
        known = dict(_numbered(cls, f"{cls.__name__}.", FIRST_FIELD))
        return known.get(number, f"{cls.__name__}, field {number}")

    @classmethod
    def understand(cls, data: bytes) -> Self:
        """The fields of a block that others exchanged, whatever their values; WireError only where it is too short."""
        return cls.read(Cursor(data, HEADER.size, checked=False))


def split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield type and whole bytes of each block of a request; WireError where a length does not fit.

    A length beyond the data is an error of the length field of that block, whatever it is.
    """
    at = 0
    while at < len(data):
        if len(data) - at < HEADER.size:
            raise WireError("block header", f"{len(data) - at} bytes left", f"{HEADER.size} bytes", LENGTH_FIELD)
        kind, length = struct.unpack_from(">HH", data, at)
        end = at + HEADER.size - VERSION_SIZE + length
        if length < VERSION_SIZE or end > len(data):
            raise BlockLengthError(kind, length, len(data) - at - HEADER.size + VERSION_SIZE)
        yield kind, data[at:end]
        at = end


class BlockLengthError(WireError):
    """BlockLength exceeds the data; ``kind`` is the BlockType."""

    def __init__(self, kind: int, length: int, most: int) -> None:
        self.kind = kind
        super().__init__(f"length of block {kind:04X}h", length, f"{VERSION_SIZE}..{most}", LENGTH_FIELD)
