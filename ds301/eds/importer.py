"""Import of EDS and DCF files as they are found in the field: repaired, then read by canopen's own importer.

Source: CiA 306 V1.3. A file is converted to the form that every reader understands. An entry with one possible meaning is
repaired and listed with its line; one with none, or two, is rejected with every line to correct. Compact sub-objects are
written out, which is not a repair. Not here: type definitions (DEFTYPE, DEFSTRUCT), modules and ``CompactPDO``; unused sections
are kept.
"""

from __future__ import annotations

import configparser
import copy
import io
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, eds

from pdgw.ds301.connection_set import NODE_IDS
from pdgw.ds301.eds.objects import ObjectSections, ObjectWriter, Texts, check_count
from pdgw.ds301.eds.text import (
    MAX_SIZE,
    EdsError,
    Item,
    Problem,
    Repair,
    Report,
    Section,
    decode,
    parse,
)
from pdgw.ds301.eds.values import ValueRefused, is_plain, number
from pdgw.ds301.eds.writer import MANDATORY
from pdgw.ds301.objects import COMMUNICATION_AREA, MANUFACTURER_AREA
from pdgw.ds301.pdo import PDOS_MAX, PdoDirection

MAX_ENTRIES = 1 << 15
"""Objects and sub-indices; a few lines of compact sub-objects make many."""

_TRUE_FALSE = {"true": "1", "yes": "1", "false": "0", "no": "0"}

_IDENTITY_KEYS = ("VendorNumber", "ProductNumber", "RevisionNumber")
_DEVICE_KEYS = (
    *(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
    *("SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging"),
    *("NrOfRXPDO", "NrOfTXPDO", "LSS_Supported"),
)
_LISTS = ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
_PDO_PARTS = tuple((direction.communication_index, direction.mapping_index) for direction in PdoDirection)


_FILES = 32
"""Maximum number of parsed files in the cache."""
_RELATIVE = "$NODEID"


@dataclass(frozen=True, slots=True)
class EdsImport:
    """An imported file: canopen's dictionary, what had to be repaired, and the repaired file.

    The dictionaries of one file share the objects that do not depend on the node-ID: they are for reading.
    """

    dictionary: canopen.ObjectDictionary
    repairs: tuple[Repair, ...]
    text: str


def import_eds(source: str | PathLike[str] | bytes, node_id: int) -> EdsImport:
    """The object dictionary of an EDS or DCF, a file or its content, for a node-ID (1..127).

    CanopenError when the file cannot be read or the node-ID is none; EdsError, which is one, names each line of a file
    that cannot be used.
    """
    if node_id not in NODE_IDS:
        raise EdsError((Problem(0, "", "node-ID", str(node_id), "a node-ID must be 1..127"),))
    sheet, relative = _imported(_read(source))
    return EdsImport(_at_node(sheet.dictionary, relative, node_id), sheet.repairs, sheet.text)


@lru_cache(maxsize=_FILES)
def _imported(content: bytes) -> tuple[EdsImport, tuple[int, ...]]:
    """A file with what is relative to the node-ID read as for node-ID 0, and the indices where that is.

    Reading costs tens of milliseconds, and the devices of a machine are often alike.
    """
    report = Report()
    sections = parse(decode(content, report), report)
    text = _written(_normalised(sections, report))
    if report.problems:
        raise EdsError(tuple(sorted(report.problems, key=lambda problem: problem.line)))
    try:
        dictionary = eds.import_eds(io.StringIO(text), 0)
    except (KeyError, ValueError, configparser.Error) as error:  # not known to happen with any file
        raise EdsError((Problem(0, "", "file", "", f"canopen cannot import it ({error})"),)) from error
    repairs = tuple(sorted(report.repairs, key=lambda repair: repair.line))
    relative = tuple(index for index, item in dictionary.items() if any(map(_is_relative, _variables(item))))
    return EdsImport(dictionary, repairs, text), relative


def _variables(item: ODVariable | ODArray | ODRecord) -> Iterable[ODVariable]:
    return (item,) if isinstance(item, ODVariable) else item.subindices.values()


def _is_relative(variable: ODVariable) -> bool:
    return variable.relative or _RELATIVE in getattr(variable, "value_raw", "")


def _at_node(sheet: canopen.ObjectDictionary, relative: Iterable[int], node_id: int) -> canopen.ObjectDictionary:
    """The dictionary of one node: objects with values relative to its node-ID are its own."""
    dictionary = copy.copy(sheet)
    dictionary.indices, dictionary.names = dict(sheet.indices), dict(sheet.names)
    if sheet.node_id is not None:
        dictionary.node_id = node_id
    for index in relative:
        shared = sheet.indices[index]
        if isinstance(shared, ODVariable):
            own = _variable_at(shared, node_id)
        else:
            own = copy.copy(shared)
            own.subindices, own.names = {}, {}
            for variable in shared.subindices.values():
                own.add_member(_variable_at(variable, node_id))
        own.parent = dictionary
        dictionary.indices[index] = own
        if sheet.names[own.name] is shared:  # two objects may have one name
            dictionary.names[own.name] = own
    return dictionary


def _variable_at(shared: ODVariable, node_id: int) -> ODVariable:
    own = copy.copy(shared)
    if own.relative and isinstance(own.default, int):
        own.default += node_id
    if _RELATIVE in getattr(own, "value_raw", "") and isinstance(own.value, int):
        own.value += node_id
    return own


def _read(source: str | PathLike[str] | bytes) -> bytes:
    if isinstance(source, bytes):
        return source
    try:
        with Path(source).open("rb") as file:
            return file.read(MAX_SIZE + 1)
    except OSError as error:
        raise EdsError((Problem(0, "", "file", str(source), error.strerror or str(error)),)) from error


def _written(texts: Texts) -> str:
    lines: list[str] = []
    for name, entries in texts.items():
        lines += [f"[{name}]", *(f"{key}={value}" for key, value in entries.items()), ""]
    return "\n".join(lines)


# -- the file ---------------------------------------------------------------------------------------------------------


def _normalised(sections: Mapping[str, Section], report: Report) -> Texts:
    objects, others = _sorted_out(sections, report)
    if not objects:
        report.refuse(1, "", "objects", "", "not an EDS or DCF: it describes no object, expected at least 1000h")
    texts: Texts = {}
    described: Texts = {}
    present: list[int] = []
    user_types = _user_types(others)
    writers = {index: ObjectWriter(objects[index], user_types, report) for index in sorted(objects)}
    entries = sum(writer.entries for writer in writers.values())
    if entries > MAX_ENTRIES:
        raise EdsError((Problem(0, "", "file", f"{entries} entries", f"too long, allowed: {MAX_ENTRIES}"),))
    for index, writer in writers.items():
        written = writer.write()
        if written:
            described.update(written)
            present.append(index)
    texts["FileInfo"] = _verbatim(_required("FileInfo", others, report))
    texts["DeviceInfo"] = _device_info(_required("DeviceInfo", others, report), report)
    for name, section in others.items():
        if name == "DeviceComissioning":
            texts[name] = _commissioning(section, report)
        elif name == "DummyUsage":
            texts[name] = _dummies(section, report)
        elif name == "Comments":
            texts[name] = _comments(section, report)
        elif name not in texts and name not in _LISTS:
            texts[name] = _verbatim(section)
    texts.update(_object_lists(others, present, report))
    _check_pdos(objects, present, report)
    return texts | described


def _sorted_out(
    sections: Mapping[str, Section], report: Report
) -> tuple[dict[int, ObjectSections], dict[str, Section]]:
    """Objects by index, and the other sections."""
    objects: dict[int, ObjectSections] = {}
    others: dict[str, Section] = {}
    for name, section in sections.items():
        match = re.fullmatch(r"([0-9A-F]{4})(?:sub([0-9A-F]+)|(Name|Value))?", name)
        if match is None:
            others[name] = section
            continue
        subindex = None if match[2] is None else int(match[2], 16)
        if subindex is not None and subindex > 0xFF:
            report.refuse(section.line, name, "sub-index", match[2], "a sub-index must be 0..FF")
            continue
        index = int(match[1], 16)
        item = objects.setdefault(index, ObjectSections(index))
        if subindex is not None:
            item.subs[subindex] = section
        elif match[3] == "Name":
            item.names = section
        elif match[3] == "Value":
            item.values = section
        else:
            item.main = section
    return objects, others


def _user_types(others: Mapping[str, Section]) -> dict[int, str]:
    """Data types that an editor defined in sections of its own, such as [A0sub1]: code -> DefaultValue."""
    types = {}
    for name, section in others.items():
        if match := re.fullmatch(r"([0-9a-f]{2,3})sub1", name, re.IGNORECASE):
            types[int(match[1], 16)] = section.text("DefaultValue")
    return types


def _required(name: str, others: Mapping[str, Section], report: Report) -> Section:
    section = others.get(name)
    if section is None:
        report.repair(0, name, "", "", "added, empty")
        return Section(name, 0)
    return section


def _verbatim(section: Section) -> dict[str, str]:
    return {item.key: item.value for item in section.items.values()}


def _check_pdos(objects: Mapping[int, ObjectSections], present: Iterable[int], report: Report) -> None:
    known = set(present)
    for communication, mapping in _PDO_PARTS:
        for pdo in range(PDOS_MAX):
            if communication + pdo in known and mapping + pdo not in known:
                item = objects[communication + pdo]
                section = item.main or next(iter(item.subs.values()))
                reason = f"a PDO without its mapping object {mapping + pdo:04X}h"
                report.refuse(section.line, section.name, "", f"{communication + pdo:04X}", reason)


# -- sections that describe file and device ---------------------------------------------------------------------------


def _pdotext(section: Section, item: Item, report: Report, *, refuse: bool = False) -> str | None:
    """A plain number, None where the entry is left out: it says nothing, or no number and nothing depends on it."""
    text = _TRUE_FALSE.get(item.value.lower(), item.value)
    try:
        value = number(text)
    except ValueRefused as error:
        if refuse:
            report.refuse(item.line, section.name, item.key, item.value, str(error))
        else:
            report.repair(item.line, section.name, item.key, item.value, "")
        return None
    if value is None:
        report.repair(item.line, section.name, item.key, item.value, "")
        return None
    if is_plain(item.value):
        return item.value
    report.repair(item.line, section.name, item.key, item.value, str(value))
    return str(value)


def _device_info(section: Section, report: Report) -> dict[str, str]:
    numbers = {key.lower(): key for key in (*_IDENTITY_KEYS, *_DEVICE_KEYS)}
    names = {key.lower(): key for key in ("VendorName", "ProductName", "OrderCode")}
    texts = {}
    for key, item in section.items.items():
        if key in numbers:
            text = _pdotext(section, item, report, refuse=numbers[key] in _IDENTITY_KEYS)
            if text is not None:
                texts[numbers[key]] = text
        else:
            texts[names.get(key, item.key)] = item.value
    return texts


def _commissioning(section: Section, report: Report) -> dict[str, str]:
    numbers = {"baudrate": "Baudrate", "nodeid": "NodeID"}
    texts = {}
    for key, item in section.items.items():
        if key not in numbers:
            texts[item.key] = item.value
        elif (text := _pdotext(section, item, report)) is not None:
            texts[numbers[key]] = str(int(text, 0))  # canopen reads decimal numbers only here
    return texts


def _dummies(section: Section, report: Report) -> dict[str, str]:
    required = {f"dummy{code:04d}": f"Dummy{code:04d}" for code in range(1, 8)}
    texts = {}
    for key, name in required.items():
        item = section.items.get(key)
        text = None if item is None else _pdotext(section, item, report)
        if item is None:
            report.repair(section.line, section.name, name, "", "0")
        texts[name] = "0" if text is None else str(int(text, 0))
    return texts | {item.key: item.value for key, item in section.items.items() if key not in required}


def _comments(section: Section, report: Report) -> dict[str, str]:
    lines = {}
    for key, item in section.items.items():
        if match := re.fullmatch(r"line([0-9]{1,6})", key):
            lines[int(match[1])] = item.value
    texts = {"Lines": str(len(lines))}
    check_count(section, "Lines", len(lines), report)
    texts.update({f"Line{line}": lines[key] for line, key in enumerate(sorted(lines), 1)})
    return texts


def _object_lists(others: Mapping[str, Section], present: list[int], report: Report) -> Texts:
    """The three lists, with exactly the objects that are described."""
    wanted = dict.fromkeys(index for index in present if index >= COMMUNICATION_AREA[0])
    listed: dict[str, list[int]] = {name: [] for name in _LISTS}
    seen: set[int] = set()
    for name in _LISTS:
        section = others.get(name)
        for key, item in () if section is None else section.items.items():
            if not key.isdecimal():
                continue
            index = _listed_index(item.value, wanted)
            if index is None or index in seen:
                report.repair(item.line, name, item.key, item.value, "")
                continue
            if not is_plain(item.value) or int(item.value, 0) != index:
                report.repair(item.line, name, item.key, item.value, f"0x{index:04X}")
            seen.add(index)
            listed[name].append(index)
    for index in wanted:
        if index not in seen:
            name = _list_of(index)
            section = others.get(name)
            report.repair(0 if section is None else section.line, name, "", "", f"0x{index:04X}")
            listed[name].append(index)
    texts: Texts = {}
    for name, indices in listed.items():
        section = others.get(name)
        if section is not None:
            check_count(section, "SupportedObjects", len(indices), report)
        texts[name] = {"SupportedObjects": str(len(indices))}
        texts[name].update({str(place): f"0x{index:04X}" for place, index in enumerate(indices, 1)})
    return texts


def _listed_index(text: str, wanted: Collection[int]) -> int | None:
    """The described object an entry of a list means; hexadecimal without 0x where only that is described."""
    try:
        value = number(text)
    except ValueRefused:
        value = None
    if value in wanted:
        return value
    plain = re.fullmatch(r"[0-9A-Fa-f]{4}", text)
    if plain is not None and int(text, 16) in wanted:
        return int(text, 16)
    return None


def _list_of(index: int) -> str:
    if index in MANDATORY:
        return "MandatoryObjects"
    return "ManufacturerObjects" if index in MANUFACTURER_AREA else "OptionalObjects"
