"""Values that objects of a device must have, from a DCF or a configuration: encoded, compared and shown.

Source: CiA 301 (data types), CiA 306 (ParameterValue).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Final

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import CanType, ObjectAddress

_SIGNED: Final = {0x02: 8, 0x03: 16, 0x04: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
_UNSIGNED: Final = {
    0x05: 8,
    0x06: 16,
    0x07: 32,
    0x16: 24,
    0x18: 40,
    0x19: 48,
    0x1A: 56,
    0x1B: 64,
    0x01: 8,
    0x0C: 48,
    0x0D: 48,
}
INTEGERS: Final = {code: (bits, code in _SIGNED) for code, bits in (_SIGNED | _UNSIGNED).items()}
"""Data types with whole numbers: bits and whether signed. BOOLEAN has 8 bits, TIME_OF_DAY and TIME_DIFFERENCE 48."""
UNICODE_STRING: Final = 0x0B
_REALS: Final = {0x08: "<f", 0x11: "<d"}
TEXTS: Final = {CanType.VISIBLE_STRING.code: "latin-1", UNICODE_STRING: "utf-16-le"}
_UNKNOWN: Final = 0


def object_name(index: int, subindex: int = 0) -> str:
    """``2210h.3``, ``6085h``: an object in configuration, messages and tables."""
    return f"{index:04X}h.{subindex}" if subindex else f"{index:04X}h"


@dataclass(frozen=True, slots=True)
class DeviceValue:
    """The value of one object. ``source``: where it is from, for messages.

    ``data_type``: of CiA 301; 0: no data sheet at hand has the object, so that a number has the length of what the device holds.
    """

    index: int
    subindex: int
    value: int | float | str | bytes
    source: str
    data_type: int = _UNKNOWN

    @property
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def name(self) -> str:
        """See ``object_name``."""
        return object_name(self.index, self.subindex)

    def encoded(self, size: int = 0) -> bytes:
        """The bytes to write. ``size``: those that the device holds. CanopenError for a value that is none of its type."""
        value, type_ = self.value, self.data_type
        if isinstance(value, bytes):
            return value
        try:
            if isinstance(value, str):
                if type_ in INTEGERS or type_ in _REALS:
                    raise ValueError("a number")
                return value.encode(TEXTS.get(type_, "latin-1"))
            if type_ in TEXTS or type_ == CanType.OCTET_STRING.code:
                raise ValueError("a text in quotation marks")
            if type_ in INTEGERS and isinstance(value, float):
                raise ValueError("a number without a point")
            if type_ in _REALS or isinstance(value, float):
                return struct.pack(_REALS.get(type_, "<f" if size <= 4 else "<d"), value)
            bits, signed = INTEGERS.get(type_, (8 * size, value < 0))
            size = bits // 8
            return value.to_bytes(size, "little", signed=signed)
        except UnicodeEncodeError:
            allowed = "letters of Latin-1"
        except ValueError as error:
            allowed = str(error)
        except (OverflowError, struct.error):
            allowed = f"a number of {size} bytes"
        raise CanopenError(f"{self.name} of {self.source}", value, allowed)

    def is_held_by(self, data: bytes) -> bool:
        """Whether the device, which holds ``data``, has the value. A text may be filled up."""
        own = self.encoded(len(data))
        return own == data if not isinstance(self.value, str) else own.rstrip(b"\0 ") == data.rstrip(b"\0 ")

    def text(self, data: bytes | None = None) -> str:
        """The value for people, or that of the data of the device."""
        if data is None:
            return self.value.hex() if isinstance(self.value, bytes) else str(self.value)
        if isinstance(self.value, str):
            return data.decode(TEXTS.get(self.data_type, "latin-1"), "replace").rstrip("\0")
        if self.data_type in _REALS and len(data) == struct.calcsize(_REALS[self.data_type]):
            return str(struct.unpack(_REALS[self.data_type], data)[0])
        if not isinstance(self.value, int):
            return data.hex()
        _, signed = INTEGERS.get(self.data_type, (0, self.value < 0))
        return str(int.from_bytes(data, "little", signed=signed))


@dataclass(frozen=True, slots=True)
class DeviceValues:
    """All values of one device, in the order of their sources."""

    items: tuple[DeviceValue, ...] = ()
    source: str = ""
    """For messages: the names of the sources."""
    skipped: int = 0
    """Number of further values of the file, which are owned by the gateway."""
    date: tuple[int, int] = (0, 0)
    """1020h of a file that has all values; 0: compare them each time."""
    identity: tuple[int, int] = (0, 0)
    """Vendor-ID and product code of the device that the file is for; 0: unknown."""

    def __bool__(self) -> bool:
        return bool(self.items)

    @property
    def numbers(self) -> dict[ObjectAddress, int]:
        """The whole numbers among them."""
        return {item.address: item.value for item in self.items if isinstance(item.value, int)}

    @property
    def checksum(self) -> int:
        """Of all values; not 0."""
        return zlib.crc32(repr([(item.address, item.value) for item in self.items]).encode()) or 1


@dataclass(frozen=True, slots=True)
class KnownDevice:
    """The device that a node was when it was brought up last (1018h); all 0: unknown."""

    vendor_id: int = 0
    product_code: int = 0
    revision: int = 0
    serial_number: int = 0
    verified: int = 0
    """Checksum of the values that the device was found to have beside their 1020h; 0: none."""

    def replaced_by(self, other: KnownDevice) -> str:
        """What is different of another device; empty if it is the same or one of them has no serial number."""
        if not (self.serial_number and other.serial_number) or self.serial_number == other.serial_number:
            return ""
        changed = f"serial {self.serial_number} -> {other.serial_number}"
        if self.revision != other.revision:
            changed += f", revision {self.revision:X}h -> {other.revision:X}h"
        return f"replaced: {changed}"
