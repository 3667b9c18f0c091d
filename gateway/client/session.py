"""Read and write parameters in the user's terms: whole arrays, lists, types from the device."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

from pdgw.ds301.communication import IDENTITY
from pdgw.ds301.objects import Entry
from pdgw.dsp402.identification.overlay import NO_CHOICE, entries_of, with_units
from pdgw.dsp402.objects import DRIVE_OBJECTS, STATUSWORD, known_objects
from pdgw.dsp402.states import state_of
from pdgw.dsp406.objects import MODULE_IDENTIFICATION, PROFILE
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.address import Target, parse_target, parse_value
from pdgw.gateway.client.udp import ParameterClient
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.catalogue import ENCODER_IDENTIFICATION, LIST_PNUS, OBJECT_PNUS, PARAMETERS
from pdgw.profidrive.parameters.codec import MAX_ELEMENTS, MAX_PARAMETERS, Attribute, ParameterAddress, Values
from pdgw.profidrive.parameters.description import NAME_LENGTH, Description, Pnu
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber, error_text
from pdgw.profidrive.signals import SIGNALS

_ENCODER_OBJECTS = {row.index: row for row in PROFILE}
_STRINGS = {DataType.VISIBLE_STRING, DataType.OCTET_STRING}
Progress = Callable[[int, int], None]


@cache
def _known_names() -> Mapping[int, Set[str]]:
    """The names of every object of the profiles and of all families of drives."""
    found: dict[int, set[str]] = {}
    items: tuple[Any, ...] = (*known_objects(), *entries_of(NO_CHOICE.known).values(), *PROFILE)
    for item in items:
        found.setdefault(item.index, set()).add(item.name)
    return found


def full_name(pnu: int, described: str) -> str:
    """The complete name of an object: a description has only sixteen characters for it (PROFIdrive 6.2.1.4).

    The described name itself if no name, or several names, start with it.
    """
    fitting = [name for name in _known_names().get(pnu, ()) if name[:NAME_LENGTH].rstrip() == described]
    return fitting[0] if len(fitting) == 1 else described


@dataclass(frozen=True, slots=True)
class Element:
    """One element as it was answered; ``error`` is an error number."""

    pnu: int
    subindex: int
    format: DataType | None
    value: int | float | str | None
    error: int | None = None

    @property
    def failed(self) -> bool:
        return self.error is not None

    @property
    def error_text(self) -> str:
        """Text of the error."""
        return "" if self.error is None else f"{self.error:02X}h: {error_text(self.error)}"

    def document(self) -> dict[str, object]:
        """For ``--json``."""
        failure = None if self.error is None else {"number": self.error, "text": error_text(self.error)}
        name = self.format.name if self.format else None
        return {"pnu": self.pnu, "subindex": self.subindex, "format": name, "value": self.value, "error": failure}


def meant(element: Element) -> str:
    """The address that was meant by a decimal number that is none of a parameter but looks like an object: 6041."""
    digits = str(element.pnu)
    if element.error not in NOT_THERE or not digits.isdecimal() or int(digits, 16) not in _known_names():
        return ""
    return f"did you mean {digits}h?"


def address_text(pnu: int, subindex: int | None = None) -> str:
    """``P922``, ``1018h.3``."""
    name = f"{pnu:04X}h" if pnu in OBJECT_PNUS else f"P{pnu}"
    return name if subindex is None else f"{name}.{subindex}"


def elements_of(address: ParameterAddress, answer: Values) -> list[Element]:
    """The elements an answer brought, or its one error."""
    pnu, subindex = address.pnu, address.subindex
    if answer.failed:
        where = int(answer.values[1]) if len(answer.values) > 1 else subindex
        return [Element(pnu, where, None, None, int(answer.values[0]))]
    if isinstance(answer.values, bytes):
        text = answer.text if answer.format is DataType.VISIBLE_STRING else answer.values.hex(" ")
        return [Element(pnu, subindex, answer.format, text)]
    return [Element(pnu, subindex + place, answer.format, value) for place, value in enumerate(answer.values)]


class Session:
    """A client that knows the descriptions of its parameters."""

    def __init__(self, client: ParameterClient) -> None:
        self.client = client
        self._descriptions: dict[int, Description | None] = {}
        self._is_encoder: bool | None = None
        self._drive_objects: dict[tuple[int, int], Entry] = {}

    @property
    def is_encoder(self) -> bool:
        """Whether the device is an encoder, by its profile identification (P965)."""
        if self._is_encoder is None:
            (answer,) = self.client.request([ParameterAddress(Pnu.PROFILE)])
            self._is_encoder = answer.values == ENCODER_IDENTIFICATION.to_bytes(2, "big")
        return self._is_encoder

    @property
    def drive_objects(self) -> Mapping[tuple[int, int], Entry]:
        """The objects of the profile and of the families the drive may be of, by its identity 1018h."""
        if not self._drive_objects:
            answers = self.client.request([ParameterAddress(IDENTITY, subindex, 1) for subindex in (1, 2)])
            vendor, product = (None if answer.failed else int(answer.values[0]) for answer in answers)
            families = NO_CHOICE.possible(vendor, product or 0)
            profile = with_units(DRIVE_OBJECTS.entries, families)
            self._drive_objects = {entry.address: entry for entry in profile} | dict(entries_of(families))
        return self._drive_objects

    def name_and_unit(self, pnu: int, subindex: int) -> tuple[str, str]:
        """Name and unit from the catalogues, which differ for drives and encoders; empty if unknown."""
        if pnu in PARAMETERS:
            spec = PARAMETERS[pnu]
            place = spec.elements[subindex] if subindex < len(spec.elements) else ""
            return f"{spec.name} {place}".strip(), spec.unit
        if pnu not in OBJECT_PNUS:
            return "", ""
        if not self.is_encoder:
            entry = self.drive_objects.get((pnu, subindex))
            return (entry.name, entry.unit) if entry is not None else ("", "")
        row = _ENCODER_OBJECTS.get(pnu)
        if row is None:
            return "", ""
        number = subindex - (self._first_field if pnu == MODULE_IDENTIFICATION else 1)
        field = row.fields[number] if 0 <= number < len(row.fields) else ""
        return f"{row.name} {field}".strip(), row.unit

    @cached_property
    def _first_field(self) -> int:
        """The sub-index of the first field of 650Ah: 1, or 0 of a device that has them as the profile prints them."""
        (last,) = self.read_first([Target(MODULE_IDENTIFICATION, 3)])
        return int(last.error != ParameterErrorNumber.FAULTY_SUBINDEX)

    def _request(
        self,
        addresses: Sequence[ParameterAddress],
        values: Sequence[Values] | None = None,
        progress: Progress | None = None,
    ) -> list[Values]:
        """The answers of as many requests as are necessary."""
        answers: list[Values] = []
        for start in range(0, len(addresses), MAX_PARAMETERS):
            part = slice(start, start + MAX_PARAMETERS)
            answers += self.client.request(list(addresses[part]), None if values is None else list(values[part]))
            if progress is not None:
                progress(len(answers), len(addresses))
        return answers

    def describe(self, pnus: Iterable[int], progress: Progress | None = None) -> dict[int, Description | None]:
        """The descriptions the device gives; None for a parameter that has none (or is not there)."""
        missing = [pnu for pnu in dict.fromkeys(pnus) if pnu not in self._descriptions]
        addresses = [ParameterAddress(pnu, 0, 0, Attribute.DESCRIPTION) for pnu in missing]
        answers = self._request(addresses, progress=progress)
        self._descriptions |= zip(missing, map(_description, answers), strict=True)
        return self._descriptions

    def texts(self, pnu: int) -> list[str]:
        """The text array, empty where there is none."""
        texts: list[str] = []
        while True:
            (answer,) = self.client.request([ParameterAddress(pnu, len(texts), 1, Attribute.TEXT)])
            if answer.failed or not isinstance(answer.values, bytes):
                return texts
            texts.append(answer.values.decode("ascii", "replace").rstrip())

    def read(self, targets: Sequence[Target], progress: Progress | None = None) -> list[Element]:
        """Every element of the targets, in order; what failed is among them."""
        whole = [target.pnu for target in targets if target.first is None]
        descriptions = self.describe(whole)
        addresses = [address for target in targets for address in _addresses(target, descriptions.get(target.pnu))]
        answers = self._request(addresses, progress=progress)
        return [item for pair in zip(addresses, answers, strict=True) for item in elements_of(*pair)]

    def read_first(self, targets: Sequence[Target]) -> list[Element]:
        """One element of each target."""
        addresses = [ParameterAddress(item.pnu, item.first or 0, int(item.first is not None)) for item in targets]
        return [elements_of(*pair)[0] for pair in zip(addresses, self._request(addresses), strict=True)]

    def write(self, writes: Sequence[tuple[Target, Values]], progress: Progress | None = None) -> list[Element]:
        """Write values; an element for each write, with its error where it failed."""
        addresses = [_write_address(target, values) for target, values in writes]
        values = [values for _, values in writes]
        results: list[Element] = []
        for address, answer, value in zip(addresses, self._request(addresses, values, progress), values, strict=True):
            results += elements_of(address, answer if answer.failed else value)
        return results

    def write_texts(self, writes: Sequence[tuple[Target, str]], given: DataType | None = None) -> list[Element]:
        """Write values with the type ``given``; without it, with those that the device reports."""
        targets = [target for target, _ in writes]
        types = map(self._type_of, targets, self.read_first(targets)) if given is None else [given] * len(targets)
        return self.write(
            [(target, parse_value(text, data_type)) for (target, text), data_type in zip(writes, types, strict=True)]
        )

    def _type_of(self, target: Target, present: Element) -> DataType:
        """The type of the present value, else of the description."""
        if present.format is not None:
            return present.format
        description = self.describe([target.pnu])[target.pnu]
        if description is not None:
            return description.type
        raise GatewayError(
            f"{address_text(target.pnu, target.first)}: the device does not report the data type "
            f"({present.error_text}); set it with --type"
        )

    def pnus(self) -> list[int]:
        """All parameters the device lists in P980 ff."""
        found: list[int] = []
        seen: set[int] = set()
        follower = LIST_PNUS[0]
        while follower in LIST_PNUS and follower not in seen:
            seen.add(follower)
            elements = self.read([Target(follower)])
            if elements[0].failed:
                raise GatewayError(f"P{follower}, the list of parameters: {elements[0].error_text}")
            values = [int(element.value) for element in elements if isinstance(element.value, int)]
            follower = values[-1] if values else 0
            found += [value for value in values[:-1] if value]
        return found


def read_parameters(address: tuple[str, int], do_id: int, *parameters: str) -> list[Element]:
    """Read elements of a drive object, in order: ``read_parameters(("127.0.0.1", 34964), 1, "P922", "6041h", "1018h.1-4")``.

    ``address``: host and UDP port of the record channel of a gateway or another PROFIdrive device. Refused elements are in the
    result (``failed``, ``error_text``). Raises GatewayError for an invalid text, or without an answer.
    """
    targets = [parse_target(text) for text in parameters]
    with ParameterClient(address, do_id) as client:
        return Session(client).read(targets)


def _description(answer: Values) -> Description | None:
    try:
        return Description.decode(answer.values) if isinstance(answer.values, bytes) else None
    except ProfidriveError:
        return None


def _addresses(target: Target, description: Description | None) -> list[ParameterAddress]:
    pnu = target.pnu
    if target.elements is not None:
        elements = target.elements
    elif description is not None and description.array:
        elements = range(description.count)
    else:
        return [ParameterAddress(pnu)]
    if pnu in OBJECT_PNUS:
        # The entries of an object may have different types, and may be missing.
        return [ParameterAddress(pnu, subindex, 1) for subindex in elements]
    return [
        ParameterAddress(pnu, start, min(MAX_ELEMENTS, elements.stop - start))
        for start in range(elements.start, elements.stop, MAX_ELEMENTS)
    ]


def _write_address(target: Target, values: Values) -> ParameterAddress:
    if target.first is None:
        return ParameterAddress(
            target.pnu, 0, 0 if values.format in _STRINGS or len(values.values) == 1 else len(values.values)
        )
    return ParameterAddress(target.pnu, target.first, 1 if values.format in _STRINGS else len(values.values))


def meaning(element: Element, *, encoder: bool) -> str:
    """The meaning of a value: bits by name, states, errors."""
    if element.failed:
        return ", ".join(part for part in (element.error_text, meant(element)) if part)
    value = element.value
    if not isinstance(value, int):
        return ""
    if element.pnu in {Pnu.STW1, Pnu.ZSW1}:
        word = SIGNALS[PARAMETERS[element.pnu].name]
        return ", ".join(bit.name for bit in word.bits if bit.of(value))
    if element.pnu == STATUSWORD[0] and not encoder:
        state = state_of(value)
        return f"{value & 0xFFFF:04X}h {state.value if state else 'no state'}"
    if element.pnu in OBJECT_PNUS and value > 9:
        return f"{value:X}h"
    return ""


NOT_THERE = {ParameterErrorNumber.IMPERMISSIBLE_PNU, ParameterErrorNumber.FAULTY_SUBINDEX}
"""Errors that say that an element does not exist."""
