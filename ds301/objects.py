"""Object declarations: index, sub-index, type, access, mappability, default and limits, once.

Source: CiA DS 301 (data types, object codes), CiA 306 (EDS access names). Everything that needs to know an object -
PDO codec, EDS, simulator, parameter channel, decoder - derives from such declarations.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from pdgw.ds301.aborts import CanopenError


class CanType(enum.Enum):
    """CiA 301 data types: code, struct character (little-endian), bits."""

    BOOLEAN = (0x01, "?", 8)
    I8 = (0x02, "b", 8)
    I16 = (0x03, "h", 16)
    I32 = (0x04, "i", 32)
    U8 = (0x05, "B", 8)
    U16 = (0x06, "H", 16)
    U32 = (0x07, "I", 32)
    REAL32 = (0x08, "f", 32)
    VISIBLE_STRING = (0x09, "", 0)
    OCTET_STRING = (0x0A, "", 0)
    DOMAIN = (0x0F, "", 0)
    I64 = (0x15, "q", 64)
    U64 = (0x1B, "Q", 64)

    def __init__(self, code: int, char: str, bits: int) -> None:
        self.code = code
        self.char = char
        self.bits = bits

    @property
    def integer_range(self) -> tuple[int, int]:
        """Smallest and largest value of an integer type; CanopenError for the others."""
        if not self.char or self in (CanType.REAL32, CanType.BOOLEAN):
            raise CanopenError("data type", self.name, "an integer type")
        if self.char.islower():
            return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        return 0, (1 << self.bits) - 1


COMMUNICATION_AREA: Final = range(0x1000, 0x2000)
MANUFACTURER_AREA: Final = range(0x2000, 0x6000)
"""Indices of CiA 301 itself and of manufacturers; those of a device profile follow."""


ObjectAddress = tuple[int, int]
"""Index and sub-index."""


class Access(enum.Enum):
    """CiA 306 access types."""

    RO = "ro"
    WO = "wo"
    RW = "rw"
    CONST = "const"


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of an object dictionary (a VAR, or one sub-index of an ARRAY/RECORD).

    ``attribute`` is the name the value has in cyclic images (``DriveFeedback.velocity_actual``), empty for objects
    that are never cyclic. ``low``/``high`` are None where the type's own range applies.
    """

    index: int
    subindex: int
    name: str
    type: CanType
    access: Access = Access.RW
    pdo: bool = False
    default: int | float | bytes | str | None = None
    low: int | None = None
    high: int | None = None
    unit: str = ""
    attribute: str = ""

    @property
    def address(self) -> ObjectAddress:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def limits(self) -> tuple[int, int]:
        """The value range of an integer entry."""
        low, high = self.type.integer_range
        return (low if self.low is None else self.low, high if self.high is None else self.high)

    @property
    def mapping(self) -> int:
        """The PDO mapping parameter: index, sub-index, bit length."""
        return (self.index << 16) | (self.subindex << 8) | self.type.bits

    def __str__(self) -> str:
        sub = f"/{self.subindex}" if self.subindex else ""
        return f"{self.name} {self.index:04X}h{sub}"


class ObjectKind(enum.Enum):
    """CiA 301 object codes."""

    VAR = 0x07
    ARRAY = 0x08
    RECORD = 0x09


@dataclass(frozen=True)
class ObjectSpec:
    """An object of a device: its kind and its entries in sub-index order (sub-index 0 included)."""

    index: int
    name: str
    kind: ObjectKind
    entries: tuple[Entry, ...]


def var(index: int, name: str, type_: CanType, access: Access = Access.RW, **kw: object) -> ObjectSpec:
    """A VAR object; keywords as for ``Entry``."""
    return ObjectSpec(index, name, ObjectKind.VAR, (Entry(index, 0, name, type_, access, **kw),))  # type: ignore[arg-type]


def array(index: int, name: str, *entries: Entry, kind: ObjectKind = ObjectKind.ARRAY) -> ObjectSpec:
    """An ARRAY (or RECORD) of the given entries; sub-index 0 is added."""
    highest = max(entry.subindex for entry in entries)
    count = Entry(index, 0, "Highest sub-index supported", CanType.U8, Access.RO, default=highest)
    return ObjectSpec(index, name, kind, (count, *entries))


@dataclass(frozen=True)
class Catalogue:
    """All objects of a device profile, addressable by (index, sub-index) and by attribute."""

    objects: tuple[ObjectSpec, ...]
    _by_address: dict[tuple[int, int], Entry] = field(init=False, repr=False)
    _by_attribute: dict[str, Entry] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        entries = [entry for spec in self.objects for entry in spec.entries]
        by_address = {entry.address: entry for entry in entries}
        if len(by_address) != len(entries):
            raise CanopenError("object catalogue", "duplicate address", "each object declared once")
        object.__setattr__(self, "_by_address", by_address)
        object.__setattr__(self, "_by_attribute", {e.attribute: e for e in entries if e.attribute})

    def entry(self, index: int, subindex: int = 0) -> Entry:
        """The entry at an address; CanopenError where the catalogue lacks it."""
        try:
            return self._by_address[index, subindex]
        except KeyError:
            raise CanopenError("object", f"{index:04X}h/{subindex}", "an object of the catalogue") from None

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        return self._by_address.get((index, subindex))

    def attribute(self, name: str) -> Entry:
        """The entry with this image attribute."""
        try:
            return self._by_attribute[name]
        except KeyError:
            raise CanopenError("image attribute", name, ", ".join(self._by_attribute)) from None

    @property
    def entries(self) -> Iterable[Entry]:
        for spec in self.objects:
            yield from spec.entries
