"""Names and types of objects, and PDO layouts made of the mappings of a recording.

Source: CiA DS 301 V4.02 chapters 7.4.1 (data types) and 7.5.2.36 (PDO mapping). Objects come from an EDS/DCF (``Entry``
lists) or from the catalogues of this project. Left out: MPDOs.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final

from pdgw.ds301.bus.can_frame import EXTENDED_ID
from pdgw.ds301.communication import EMCY_COB_ID, SYNC_COB_ID, TIME_COB_ID, profile_of
from pdgw.ds301.objects import CanType, Entry
from pdgw.ds301.pdo import COB_ID_INVALID, is_communication_parameter, is_mapping_parameter
from pdgw.dsp402.identification.overlay import NO_CHOICE, Families, Overlay, entries_of, with_units
from pdgw.dsp402.objects import DRIVE_PROFILE, FURTHER_OBJECTS, known_objects
from pdgw.dsp406.device import encoder_objects
from pdgw.dsp406.kinds import DEVICES, ENCODER_PROFILE
from pdgw.tools.decoder.frames.canopen.can_records import PdoLayout
from pdgw.tools.decoder.frames.fields import Field, Raw, entry_field
from pdgw.tools.decoder.frames.records import ProcessDataLayout

_DUMMY_LAST: Final = 0x001F
"""Indices of the data types themselves: mapped, they are gaps."""
_COB_ID_OBJECTS: Final = (SYNC_COB_ID, TIME_COB_ID, EMCY_COB_ID)


class ObjectNames:
    """The entries of one device by address, and the families it may be of."""

    def __init__(self, entries: Iterable[Entry], families: tuple[Overlay, ...] | None = None) -> None:
        self._entries = {entry.address: entry for entry in entries}
        self.families = NO_CHOICE.known if families is None else families

    def of(self, families: tuple[Overlay, ...]) -> ObjectNames:
        """The same for a device with known identity; a device of no drive family stays unchanged."""
        return self if not self.families or families == self.families else ObjectNames(self._entries.values(), families)

    def field(self, entry: Entry) -> Field:
        """An entry as it is shown."""
        return entry_field(entry, self.families)

    def emcy_text(self, code: int) -> str:
        """The manufacturer's name of an EMCY error code, empty where there is none."""
        return ""

    def get(self, index: int, subindex: int) -> Entry | None:
        return self._entries.get((index, subindex))

    def name(self, index: int, subindex: int) -> str:
        """The object's name, empty where it is not known."""
        entry = self.get(index, subindex)
        return entry.name if entry else ""

    def fields(self) -> Iterator[Field]:
        """The entries as fields of PDOs."""
        return map(self.field, self._entries.values())

    def decode(self, index: int, subindex: int, data: bytes) -> Raw | str:
        """The value of SDO data; the bytes themselves if the type is unknown or does not fit."""
        entry = self.get(index, subindex)
        if entry is None:
            return int.from_bytes(data, "little") if len(data) in {1, 2, 4, 8} else data
        if entry.type is CanType.VISIBLE_STRING:
            return data.rstrip(b"\0").decode("latin-1")
        if entry.type.char and entry.type.bits == 8 * len(data):
            value: int | float | bool = struct.unpack("<" + entry.type.char, data)[0]
            return int(value) if isinstance(value, bool) else value
        return data

    def text(self, index: int, subindex: int, data: bytes) -> str:
        """The value for the reader: with unit, state or address where the object has one."""
        value = self.decode(index, subindex, data)
        if isinstance(value, str):
            return repr(value)
        if isinstance(value, bytes):
            return value.hex(" ") or "no data"
        if subindex and isinstance(value, int) and is_mapping_parameter(index):
            mapped = Mapped.from_parameter(value)
            name = self.name(mapped.index, mapped.subindex)
            return f"{mapped.index:04X}h.{mapped.subindex} {mapped.bits} bits" + (f" ({name})" if name else "")
        if isinstance(value, int) and _is_cob_id(index, subindex):
            return f"{value & EXTENDED_ID:03X}h" + (" (not valid)" if value & COB_ID_INVALID else "")
        entry = self.get(index, subindex)
        if entry is None:
            return f"{value} ({data.hex(' ')})"
        return self.field(entry).text(value).removeprefix(entry.name).strip()


def _is_cob_id(index: int, subindex: int) -> bool:
    """Whether an entry is the COB-ID of a PDO, SYNC, TIME or EMCY."""
    pdo = is_communication_parameter(index)
    return (pdo and subindex == 1) or (index in _COB_ID_OBJECTS and subindex == 0)


class _Catalogue(ObjectNames):
    """The objects of the profile, and those of families of drives."""

    def __init__(self, families: tuple[Overlay, ...]) -> None:
        profile = (entry for spec in (*FURTHER_OBJECTS, *known_objects()) for entry in spec.entries)
        super().__init__((*with_units(profile, families), *entries_of(families).values()), families)
        faults = (fault for family in families for fault in family.drive_faults.values())
        self._faults = {fault.error_code: fault.name for fault in faults}

    def of(self, families: tuple[Overlay, ...]) -> ObjectNames:
        return catalogue(families)

    def emcy_text(self, code: int) -> str:
        return self._faults.get(code, "")


@lru_cache(maxsize=64)
def catalogue(families: tuple[Overlay, ...]) -> ObjectNames:
    """The objects of a drive that is of one of these families, for nodes no EDS was given for."""
    return _Catalogue(families)


def any_drive(families: Families = NO_CHOICE) -> ObjectNames:
    """The objects of a drive without known identity."""
    return catalogue(families.known)


@cache
def encoder_catalogue() -> ObjectNames:
    """The objects of the encoder profile, for all device types."""
    specs = [spec for device in DEVICES.values() for spec in encoder_objects(device)]
    return ObjectNames((entry for spec in reversed(specs) for entry in spec.entries), ())


def profile_catalogue(device_type: int, families: tuple[Overlay, ...]) -> ObjectNames | None:
    """The objects of the profile a device type 1000h names; None for other profiles."""
    profile = profile_of(device_type)
    if profile == DRIVE_PROFILE:
        return catalogue(families)
    return encoder_catalogue() if profile == ENCODER_PROFILE else None


@dataclass(frozen=True, slots=True)
class Mapped:
    """One object mapped into a PDO."""

    index: int
    subindex: int
    bits: int

    @classmethod
    def from_parameter(cls, value: int) -> Mapped:
        """Out of a mapping parameter (index, sub-index, length)."""
        return cls(value >> 16 & 0xFFFF, value >> 8 & 0xFF, value & 0xFF)


def _field(mapped: Mapped, names: ObjectNames) -> Field:
    entry = names.get(mapped.index, mapped.subindex)
    if entry is None:
        entry = Entry(mapped.index, mapped.subindex, f"{mapped.index:04X}h.{mapped.subindex}", CanType.U32)
    return names.field(entry)


def _char(mapped: Mapped, entry: Entry | None) -> str:
    """The struct character of a whole standard type, empty otherwise."""
    if entry is not None and entry.type.char and entry.type.bits == mapped.bits:
        return entry.type.char.replace("?", "B")
    if entry is not None and entry.type is CanType.BOOLEAN:
        return ""
    return {8: "B", 16: "H", 32: "I", 64: "Q"}.get(mapped.bits, "")


def pdo_layout(
    name: str, node: int, axis: int, mapping: Sequence[Mapped], names: ObjectNames, origin: str
) -> PdoLayout | None:
    """The layout of a mapping; None when it is empty or longer than a PDO."""
    bits = sum(mapped.bits for mapped in mapping)
    if not mapping or not 0 < bits <= 64 or any(not mapped.bits for mapped in mapping):
        return None
    entries = [names.get(mapped.index, mapped.subindex) for mapped in mapping]
    chars = [_char(mapped, entry) for mapped, entry in zip(mapping, entries, strict=True)]
    gaps = [mapped.index <= _DUMMY_LAST for mapped in mapping]
    shown = ProcessDataLayout(tuple(_field(m, names) for m, gap in zip(mapping, gaps, strict=True) if not gap))
    addresses = tuple((m.index, m.subindex) for m, gap in zip(mapping, gaps, strict=True) if not gap)
    size = (bits + 7) // 8
    if all(chars):
        parts = "".join(f"{m.bits // 8}x" if gap else char for m, gap, char in zip(mapping, gaps, chars, strict=True))
        return PdoLayout(name, node, axis, shown, size, origin, struct.Struct("<" + parts), (), addresses)
    cuts = tuple(
        (m.bits, bool(entry and entry.type.char.islower()), not gap)
        for m, entry, gap in zip(mapping, entries, gaps, strict=True)
    )
    return PdoLayout(name, node, axis, shown, size, origin, None, cuts, addresses)
