"""Process data objects: default COB-IDs, mapping limits and the compiled codec.

Source: CiA DS 301 chapter 9.2 (PDO), 9.3 (pre-defined connection set).
Left out: MPDOs and bit-granular mapping (no object of this project is shorter than a byte).
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from operator import attrgetter
from typing import Final, Self

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import Entry, ObjectAddress

PDO_BYTES = 8
"""Size limit of a PDO in bytes."""
COB_ID_INVALID = 1 << 31
"""Bit 31 of a COB-ID entry: the PDO does not exist / is not valid."""
COB_ID_NO_REMOTE = 1 << 30
"""Bit 30: no remote request of the PDO is answered."""
PDOS_MAX: Final = 0x200
"""Number of PDOs of one direction: indices of their communication parameters, followed by those of their mapping."""
_PREDEFINED: Final = 4
"""PDOs 1 to 4 are in the pre-defined connection set."""
_HIGHEST_SHORT_NODE_ID: Final = 0x3F


class PdoDirection(enum.Enum):
    """Seen from the device: an RPDO is received by the drive, a TPDO is transmitted by it.

    The first index of the communication parameters, and the COB-IDs of the PDOs of node-ID 0.
    """

    RPDO = (0x1400, (0x200, 0x300, 0x400, 0x500, 0x240))
    TPDO = (0x1800, (0x180, 0x280, 0x380, 0x480, 0x1C0))

    # No __init__: mypyc cannot compile an enum that has one.

    @property
    def communication_index(self) -> int:
        return self.value[0]

    @property
    def mapping_index(self) -> int:
        return self.value[0] + PDOS_MAX

    @property
    def bases(self) -> tuple[int, ...]:
        return self.value[1]

    def has_cob_id(self, number: int, node_id: int) -> bool:
        """Whether PDO ``number`` of a node has a COB-ID of its own.

        1-4 are the pre-defined connection set. CiA 301 gives PDO 5 none; it takes the upper half of PDO 1's (TPDO)
        or RPDO 1's range, which is free while no node-ID is above 3Fh.
        """
        return number <= _PREDEFINED or (number <= len(self.bases) and node_id <= _HIGHEST_SHORT_NODE_ID)

    def cob_id(self, number: int, node_id: int) -> int:
        """The COB-ID of PDO ``number`` (1..5) of a node; CanopenError for one that has none (``has_cob_id``)."""
        if not 1 <= number <= len(self.bases):
            raise CanopenError(f"{self.name} number", number, f"1..{len(self.bases)}")
        if not self.has_cob_id(number, node_id):
            raise CanopenError(f"node-ID with {self.name} {number}", node_id, f"1..{_HIGHEST_SHORT_NODE_ID}")
        return self.bases[number - 1] + node_id

    def predefined(self, node_id: int) -> tuple[int, ...]:
        """The COB-IDs of a node in the pre-defined connection set."""
        return tuple(base + node_id for base in self.bases[:_PREDEFINED])


PDO_PARAMETERS: Final = range(PdoDirection.RPDO.communication_index, PdoDirection.TPDO.mapping_index + PDOS_MAX)
"""Indices of all communication and mapping parameters."""


def is_communication_parameter(index: int) -> bool:
    """Whether an index is in the area of the PDO communication parameters."""
    return index in PDO_PARAMETERS and not index & PDOS_MAX


def is_mapping_parameter(index: int) -> bool:
    """Whether an index is in the area of the PDO mapping parameters."""
    return index in PDO_PARAMETERS and bool(index & PDOS_MAX)


def direction_of(index: int) -> PdoDirection:
    """Direction of the PDO that a communication or mapping parameter belongs to."""
    return PdoDirection.RPDO if index < PdoDirection.TPDO.communication_index else PdoDirection.TPDO


def pdo_of(index: int) -> tuple[PdoDirection, int]:
    """Direction and number of the PDO that a communication or mapping parameter belongs to."""
    return direction_of(index), index % PDOS_MAX + 1


_UNPACK: Final = """
def unpack_into(data, image, unpack=unpack):
    try:
        {values}, = unpack(data)
    except error:
        refuse(data)
"""
"""Called for each TPDO in every cycle: attributes named one by one take the interpreter a third of a loop over their names.
``unpack`` is a default, as the interpreter remembers where it found a name for one function of a code only."""
_compile: Final = cache(compile)
"""A device's PDOs are mapped again at each start, mostly the same ones."""


@dataclass(frozen=True)
class Pdo:
    """One PDO: direction, number (1 = first) and mapped entries, with their codec.

    ``pack`` reads the entries' attributes from an image object, ``unpack_into`` writes them to one. Entries without attribute
    are sent as zeros and not looked at.
    """

    direction: PdoDirection
    number: int
    entries: tuple[Entry, ...]
    struct: struct.Struct = field(init=False, repr=False, compare=False)
    size: int = field(init=False)
    attributes: tuple[str, ...] = field(init=False, repr=False)
    pack: Callable[[object], bytes] = field(init=False, repr=False, compare=False)
    """The PDO's bytes from an image's attributes."""
    unpack_into: Callable[[bytes | bytearray, object], None] = field(init=False, repr=False, compare=False)
    """Write the PDO's values to an image; CanopenError when the data is shorter than the mapping."""

    def __post_init__(self) -> None:
        # Objects without an attribute are not used: a dummy, or a fixed part of a mapping.
        cuts = [entry.type.char if entry.attribute else f"{entry.type.bits // 8}x" for entry in self.entries]
        layout = struct.Struct("<" + "".join(cuts))
        attributes = tuple(entry.attribute for entry in self.entries if entry.attribute)
        if not 1 <= layout.size <= PDO_BYTES:
            raise CanopenError(str(self), f"{layout.size} bytes mapped", "1..8 bytes")
        if not attributes or not all(attribute.isidentifier() for attribute in attributes):
            raise CanopenError(
                str(self), ", ".join(map(str, self.entries)), "objects whose values have a name in the images"
            )
        pack, read, first = layout.pack, attrgetter(*attributes), attributes[0]
        made = {
            "struct": layout,
            "size": layout.size,
            "attributes": attributes,
            "pack": (lambda image: pack(*read(image))) if attributes[1:] else lambda image: pack(getattr(image, first)),
            "unpack": layout.unpack_from,
            "error": struct.error,
            "refuse": self._refuse,
        }
        exec(_compile(_UNPACK.format(values=", ".join(f"image.{name}" for name in attributes)), "<PDO>", "exec"), made)
        for name in ("struct", "size", "attributes", "pack", "unpack_into"):
            object.__setattr__(self, name, made[name])

    def _refuse(self, data: bytes | bytearray) -> None:
        raise CanopenError(f"{self} length", len(data), f"{self.size} bytes") from None

    def __str__(self) -> str:
        return f"{self.direction.name}{self.number}"

    @property
    def communication_index(self) -> int:
        return self.direction.communication_index + self.number - 1

    @property
    def mapping_index(self) -> int:
        return self.direction.mapping_index + self.number - 1

    def cob_id(self, node_id: int) -> int:
        return self.direction.cob_id(self.number, node_id)


class PdoReceiver:
    """Takes the frames of a PDO. A class, because a compiled call of a method is the cheapest."""

    def receive(self, data: bytes, now: int) -> None:
        """Take a frame that arrived at ``now``, monotonic nanoseconds."""
        raise NotImplementedError


PdoCallback = Callable[[bytes, int], None]
"""(data, monotonic receive time in ns)."""


class PdoCalls(PdoReceiver):
    """Passes the frames on to a function."""

    def __init__(self, callback: PdoCallback) -> None:
        self._callback = callback

    def receive(self, data: bytes, now: int) -> None:
        self._callback(data, now)


@dataclass(frozen=True)
class PdoLayout:
    """The PDOs a device is operated with."""

    rpdos: tuple[Pdo, ...]
    tpdos: tuple[Pdo, ...]
    optional: Mapping[str, str] = field(default_factory=dict, hash=False)
    """Attributes of the objects that operation does not need, each with what the device does or shows without its object."""
    cyclic_only: frozenset[str] = frozenset()
    """Those of them that are left out where no PDO has room for them: read by SDO they would be too old."""
    essential: frozenset[str] = frozenset()
    """Attributes of the objects that get a PDO before all others, whatever the data sheet says; at most one of each direction."""

    @property
    def entries(self) -> Iterator[Entry]:
        """All objects."""
        for pdo in (*self.rpdos, *self.tpdos):
            yield from pdo.entries


@dataclass(frozen=True, slots=True)
class PdoSlot:
    """One PDO that a device has, as its data sheet shows it."""

    number: int
    cob_id: int | None = None
    """Default of sub-index 1 without its flags; None where the data sheet gives none."""
    cob_id_writable: bool = True
    mapping: tuple[int, ...] = ()
    """Default mapping: index, sub-index, bits of each object in one number."""
    mapping_writable: bool = True
    event_timer: bool = True
    """Sub-index 5 can be written: the PDO comes (of an RPDO: is missed) after this time."""
    type: int | None = None
    """Default transmission type; None where the data sheet gives none."""
    type_writable: bool = True


@dataclass(frozen=True, slots=True)
class PdoCapabilities:
    """Possible contents of PDOs."""

    rpdos: tuple[PdoSlot, ...] = ()
    tpdos: tuple[PdoSlot, ...] = ()
    mappable: frozenset[ObjectAddress] = frozenset()
    """Addresses of the objects the data sheet allows in a PDO."""
    common_timer: bool = False
    """Another object is the event timer of all TPDOs."""

    @classmethod
    def of(cls, layout: PdoLayout) -> Self:
        """Those of a device that has the PDOs of a layout and can map its objects."""
        rpdos, tpdos = (tuple(PdoSlot(pdo.number) for pdo in pdos) for pdos in (layout.rpdos, layout.tpdos))
        return cls(rpdos, tpdos, frozenset(entry.address for entry in layout.entries))
