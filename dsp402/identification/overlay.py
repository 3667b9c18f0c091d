"""Overlay files: facts that the data sheets of a family of drives lack, one TOML file per family in ``dsp402/families``.

Those of the user are values of a configuration, or added by ``add_family``. An overlay is selected by the identity object 1018h
or by name. It adds to the data sheet and the answers of the device, and never replaces them. Every file names its sources and
what is unverified.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from functools import cache, cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from pdgw.base.files import read_file
from pdgw.base.validation import Problem, problems
from pdgw.ds301.objects import Access, CanType, Entry, ObjectKind, ObjectSpec, array
from pdgw.dsp402.drive_type import ChannelErrorType, DriveFault, Dsp402Error, Quirks, Turntable
from pdgw.dsp402.units.mechanics import FamilyUnits
from pdgw.dsp402.units.units import parse_unit

_FILE_MAX = 1 << 20
FAMILIES = Path(__file__).parents[1] / "families"
_DATA_SHEETS = Path(__file__).parents[1] / "eds"
_ADDRESS = re.compile(r"([0-9A-Fa-f]{4})h(?:/([0-9]{1,3}))?")
_CHANNELS = {channel.text: channel for channel in ChannelErrorType}
_TYPES = {item.name: item for item in CanType if item.char}


def _address(value: object) -> object:
    """``6C01h/1`` as (index, sub-index)."""
    if isinstance(value, str):
        found = _ADDRESS.fullmatch(value)
        if found is None:
            raise ValueError(f"{value!r} is not an object, expected for example 2003h or 6C01h/1")
        return int(found[1], 16), int(found[2] or 0)
    return value


def _channel(value: object) -> object:
    if isinstance(value, str):
        if value not in _CHANNELS:
            raise ValueError(f"{value!r} is not a channel error type, expected one of {', '.join(_CHANNELS)}")
        return _CHANNELS[value]
    return value


def _type(value: object) -> object:
    if isinstance(value, str):
        if value not in _TYPES:
            raise ValueError(f"{value!r} is not a data type, expected one of {', '.join(_TYPES)}")
        return _TYPES[value]
    return value


Address = Annotated[tuple[int, int], BeforeValidator(_address)]


class OverlayError(Dsp402Error):
    """An overlay file with a key that is wrong."""

    def __init__(self, name: str, problem: Problem) -> None:
        super().__init__(f"overlay {name}: {'.'.join(map(str, problem.location))}", problem.value, problem.text)
        self.args = (f"overlay {name}: {problem.line}",)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Match(_Model):
    """Devices of the family: every given key must match."""

    vendor_id: Annotated[int, Field(ge=1, le=0xFFFF_FFFF)] | None = None
    """1018h/1; without it the name alone decides."""
    product_codes: tuple[int, ...] = ()
    """1018h/2: the product codes."""
    product_code_range: tuple[int, int] | None = None
    """Or the first and last product code."""
    names: tuple[str, ...] = ()
    """Patterns (``EPOS4*``) of the device name 1008h or the product name of the data sheet, in any case."""


class Object(_Model):
    """One object of the manufacturer, which can travel in a PDO."""

    address: Address
    name: str
    type: Annotated[CanType, BeforeValidator(_type)]
    access: Access = Access.RO
    unit: str = ""


class Fault(_Model):
    """One fault number of the manufacturer."""

    name: str
    code: Annotated[int, Field(ge=1, le=0xFFFF)]
    """EMCY error code, 603Fh."""
    error_register: Annotated[int, Field(ge=0, le=0xFF)]
    """1001h."""
    channel: Annotated[ChannelErrorType, BeforeValidator(_channel)]


def _index(value: object) -> object:
    address = _address(value)
    return address[0] if isinstance(address, tuple) else address


def _fraction(value: object) -> object:
    return Fraction(value) if isinstance(value, int) else value


class Units(_Model):
    """As ``FamilyUnits``."""

    velocity: str = ""
    velocity_step: Annotated[int, BeforeValidator(_index)] = 0
    only_while_one: frozenset[Annotated[int, BeforeValidator(_index)]] = frozenset()
    increments_per_revolution: Annotated[Fraction, BeforeValidator(_fraction), Field(gt=0)] | None = None
    position: str = ""
    counts_per_revolution: Annotated[Fraction, BeforeValidator(_fraction), Field(gt=0)] | None = None
    acceleration: str = ""
    ignores: frozenset[Annotated[int, BeforeValidator(_index)]] = frozenset()
    ask: str = ""

    @model_validator(mode="after")
    def _units_are_units(self) -> Units:
        for order, text in enumerate((self.position, self.velocity, self.acceleration)):
            if text:
                try:
                    parse_unit(text, order, ("position", "velocity", "acceleration")[order])
                except Dsp402Error as error:
                    raise ValueError(str(error)) from error
        return self


Bit = Annotated[int, Field(ge=11, le=15)]


class TurntableKeys(_Model):
    """As ``Turntable``, with numbers of bits."""

    mode: int
    shortest: Bit
    ccw: Bit


class QuirkKeys(_Model):
    """As ``Quirks``."""

    turntable: TurntableKeys | None = None
    range_is_limit: bool | None = None
    mode_shown_in_operation_only: bool = False
    fault_reset_edges: Annotated[int, Field(ge=1, le=4)] = 1
    boot_ms: Annotated[int, Field(ge=0, le=60_000)] = 0
    fault_number: Address | None = None
    sync_loss_periods: Annotated[int, Field(ge=0, le=1000)] = 0


class Overlay(_Model):
    """One family of drives."""

    name: str
    """The file's name."""
    title: str
    sources: Annotated[tuple[str, ...], Field(min_length=1)]
    unverified: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()
    """Hints for the configuration: facts that the drive cannot report."""
    match: Match = Match()
    eds: str = ""
    """Data sheet of the family in ``dsp402/eds``, for a device with the product code it describes."""
    objects: dict[str, Object] = {}
    """Objects of the manufacturer by their image attribute."""
    unit_texts: dict[str, tuple[Address, ...]] = {}
    """Units of the profile's objects for a reader, where they say more than the profile does, with the objects that have them."""
    modes: dict[int, str] = {}
    """The manufacturer's modes of operation."""
    homing_methods: tuple[int, ...] = ()
    """Homing methods of a drive without 60E3h."""
    homing_texts: dict[int, str] = {}
    """Texts of the manufacturer's homing methods."""
    faults: dict[int, Fault] = {}
    """Faults by the manufacturer's number."""
    act_after_restart: frozenset[Annotated[int, BeforeValidator(_index)]] = frozenset()
    """Objects of the manufacturer whose new values act after storing (1010h) and a restart."""
    quirks: QuirkKeys = QuirkKeys()
    units: Units = Units()

    def __hash__(self) -> int:
        return hash(self.name)

    def fits(self, vendor_id: int, product_code: int, name: str = "") -> bool:
        """Whether a device with this identity and name is of the family."""
        match = self.match
        if match.vendor_id is not None and match.vendor_id != vendor_id:
            return False
        if match.product_codes and product_code not in match.product_codes:
            return False
        first, last = match.product_code_range or (product_code, product_code)
        if not first <= product_code <= last:
            return False
        if match.names:
            return any(fnmatchcase(name.lower(), pattern.lower()) for pattern in match.names)
        return match.vendor_id is not None

    @cached_property
    def entries(self) -> Mapping[str, Entry]:
        """The manufacturer's objects by their image attribute."""
        return {
            attribute: Entry(
                *item.address, item.name, item.type, item.access, True, unit=item.unit, attribute=attribute
            )
            for attribute, item in self.objects.items()
        }

    @cached_property
    def specs(self) -> tuple[ObjectSpec, ...]:
        """The manufacturer's objects in the order of their indices; an array has the name of its first entry."""
        of_index: dict[int, list[Entry]] = {}
        for entry in sorted(self.entries.values(), key=lambda entry: entry.address):
            of_index.setdefault(entry.index, []).append(entry)
        return tuple(
            array(index, first.name, first, *others)
            if first.subindex
            else ObjectSpec(index, first.name, ObjectKind.VAR, (first,))
            for index, (first, *others) in of_index.items()
        )

    @cached_property
    def _units(self) -> Mapping[tuple[int, int], str]:
        texts = {address: text for text, addresses in self.unit_texts.items() for address in addresses}
        return texts | {entry.address: entry.unit for entry in self.entries.values()}

    def unit_of(self, index: int, subindex: int) -> str:
        """The unit of an object for a reader; empty where the family says nothing about it."""
        return self._units.get((index, subindex), "")

    @property
    def control_bits(self) -> Mapping[str, int]:
        """The manufacturer's bits of the Controlword: masks by name."""
        turntable = self.drive_quirks.turntable
        if turntable is None:
            return {}
        return {"TURNTABLE_SHORTEST": turntable.shortest, "TURNTABLE_CCW": turntable.ccw}

    @property
    def drive_faults(self) -> Mapping[int, DriveFault]:
        return {
            number: DriveFault(number, item.name, item.code, item.error_register, item.channel)
            for number, item in self.faults.items()
        }

    @property
    def eds_path(self) -> Path | None:
        """The data sheet of the family, if the package has one."""
        return _DATA_SHEETS / self.eds if self.eds else None

    @property
    def family_units(self) -> FamilyUnits:
        return FamilyUnits(**dict(self.units))

    @property
    def drive_quirks(self) -> Quirks:
        keys = dict(self.quirks)
        turntable = self.quirks.turntable
        if turntable is not None:
            keys["turntable"] = Turntable(turntable.mode, 1 << turntable.shortest, 1 << turntable.ccw)
        return Quirks(**keys)


def parse_overlay(name: str, text: str) -> Overlay:
    """The overlay of a file's text; Dsp402Error names the file, the key and what is allowed."""
    try:
        document: dict[str, Any] = tomllib.loads(text)
        return Overlay.model_validate({"name": name, **document})
    except tomllib.TOMLDecodeError as error:
        raise Dsp402Error("overlay", name, f"a TOML file ({error})") from error
    except ValidationError as error:
        raise OverlayError(name, problems(error, Overlay)[0]) from error


_added: dict[str, Overlay] = {}
"""Those of ``add_family``."""


@cache
def overlays() -> Mapping[str, Overlay]:
    """Every overlay by its name: those of the package, then those of ``add_family``."""
    return {
        path.stem: parse_overlay(path.stem, path.read_text("utf-8")) for path in sorted(FAMILIES.glob("*.toml"))
    } | _added


def own_family(file: str | PathLike[str]) -> Overlay:
    """A user's own family of drives, with the name of its file; the path of ``eds`` is relative to it.

    Dsp402Error names the file, the key and what is allowed. Another family of that name is an error, the same one again is not.
    """
    path = Path(file).resolve()
    try:
        text = read_file(path, _FILE_MAX).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise Dsp402Error("drive family", str(path), f"a file that can be read ({reason})") from error
    own = parse_overlay(path.stem, text)
    if own.eds:
        own = own.model_copy(update={"eds": str(path.parent / own.eds)})
    if overlays().get(own.name, own) != own:
        raise Dsp402Error("drive family", str(path), f"another file name: there is a family {own.name} already")
    return own


def add_family(file: str | PathLike[str]) -> Overlay:
    """As ``own_family``, and known to this process from then on. For programs: a configuration has its own ones."""
    own = own_family(file)
    _added[own.name] = own
    overlays.cache_clear()
    return own


def overlay(name: str) -> Overlay:
    """The overlay with a name; Dsp402Error lists the names there are."""
    try:
        return overlays()[name]
    except KeyError:
        raise Dsp402Error("drive family", name, ", ".join(overlays())) from None


@dataclass(frozen=True, slots=True)
class Families:
    """What is known of families of drives: every overlay, and the choice of the user."""

    own: tuple[Overlay, ...] = ()
    """The user's own ones, beside those of ``overlays``."""
    named: Overlay | None = None
    """The family of the device, whatever its identity is; None: its identity decides."""

    @property
    def known(self) -> tuple[Overlay, ...]:
        """Every overlay."""
        return tuple({**overlays(), **{item.name: item for item in self.own}}.values())

    def of(self, vendor_id: int, product_code: int, name: str = "") -> Overlay | None:
        """The named family, else that of a device with this identity (1018h/1, 1018h/2) and name: the closest that fits."""
        if self.named is not None:
            return self.named
        fitting = [item for item in self.known if item.fits(vendor_id, product_code, name)]
        return max(fitting, key=lambda item: (_by_product(item.match), bool(item.match.names)), default=None)

    def possible(self, vendor_id: int | None, product_code: int = 0, name: str = "") -> tuple[Overlay, ...]:
        """The possible families of a device: all while its vendor-ID is unknown, else the matching one, if any."""
        if vendor_id is None:
            return self.known
        found = self.of(vendor_id, product_code, name)
        return () if found is None else (found,)

    def units_of(self, vendor_id: int, product_code: int, name: str) -> FamilyUnits:
        """Known facts about the units of a device with this identity.

        For a device without family, its own objects count, unless its maker has families with units of their own.
        """
        family = self.of(vendor_id, product_code, name)
        if family is not None:
            return family.family_units
        if any(item.match.vendor_id == vendor_id for item in self.known):
            device = f"vendor-ID {vendor_id:X}h, product code {product_code:X}h, name {name!r}"
            return FamilyUnits(
                ask=(
                    f"no family of this manufacturer matches {device}, and the families have different units: set family or"
                )
            )
        return FamilyUnits()


NO_CHOICE: Final = Families()
"""The identity of the device decides."""


def _by_product(match: Match) -> bool:
    return bool(match.product_codes or match.product_code_range)


@cache
def entries_of(families: tuple[Overlay, ...]) -> Mapping[tuple[int, int], Entry]:
    """The manufacturer's objects of these families by address."""
    entries = [entry for family in families for spec in family.specs for entry in spec.entries]
    return {entry.address: entry for entry in reversed(entries)}


def with_units(entries: Iterable[Entry], families: tuple[Overlay, ...]) -> tuple[Entry, ...]:
    """Objects with the units these families give them."""
    found = ((entry, [text for item in families if (text := item.unit_of(*entry.address))]) for entry in entries)
    return tuple(replace(entry, unit=texts[0]) if texts else entry for entry, texts in found)


@cache
def modes_of(families: tuple[Overlay, ...]) -> Mapping[int, str]:
    """The manufacturer's modes of these families; a number that means several things has all of them."""
    texts: dict[int, list[str]] = {}
    for family in families:
        for number, text in family.modes.items():
            texts.setdefault(number, []).append(text)
    return {number: " or ".join(dict.fromkeys(found)) for number, found in texts.items()}
