"""The data sheet of a node: its object dictionary from an EDS or DCF file, with errors a user can act on.

Files are read as they are found in the field: repaired, then read by canopen's own importer. Source: CiA 306 V1.3, CiA 301
(object codes, data types). What that importer cannot read is repaired, or left out, and listed with its line. Compact sub-
objects and compact PDOs are written out, which is not a repair; lists and counts follow the objects. A file is rejected if its
identity or the type of an object is missing or has two meanings. Not here: type definitions (DEFTYPE, DEFSTRUCT) and modules;
unused sections are kept.
"""

from __future__ import annotations

import configparser
import io
import logging
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path

import canopen
from canopen.objectdictionary import eds

from pdgw.base.files import read_file
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import NODE_IDS, pdo_objects
from pdgw.ds301.eds.text import EdsError, Item, Problem, Repair, Report, Section, decode, parse
from pdgw.ds301.eds.values import (
    DATA_TYPES,
    DOMAIN,
    UNSIGNED8,
    is_plain,
    number,
    value_text,
    without_comment,
)
from pdgw.ds301.eds.writer import Texts, object_lists, object_texts, text_of
from pdgw.ds301.objects import COMMUNICATION_AREA
from pdgw.ds301.pdo import PDOS_MAX, PdoDirection, is_communication_parameter, is_mapping_parameter

log = logging.getLogger("gateway")


def load_dictionary(
    path: Path, node_id: int, needed: Sequence[int], device: str, error_type: type[CanopenError] = CanopenError
) -> canopen.ObjectDictionary:
    """The object dictionary of an EDS/DCF, its repairs logged.

    Raises ``error_type``, naming the file and what is wrong with it: not readable, not valid, or without one of the objects
    ``needed`` that make it the data sheet of ``device``.
    """
    try:
        imported = import_eds(path, node_id)
    except EdsError as error:
        raise error_type("EDS", str(path), f"a usable EDS or DCF ({error})") from error
    if imported.repairs:
        log.info("%s: %d repairs; list them with pdgw drives", path, len(imported.repairs))
    dictionary = imported.dictionary
    for index in needed:
        if index not in dictionary:
            raise error_type("EDS", str(path), f"a data sheet of {device} with object {index:04X}h")
    return dictionary


MAX_SIZE = 4 << 20
"""Bytes; the largest data sheets are a few hundred kilobytes."""
MAX_ENTRIES = 1 << 15
"""Objects and sub-indices; a few lines of compact sub-objects make many."""

_NULL, _DOMAIN_OBJECT, _DEFTYPE, _DEFSTRUCT, _VAR, _ARRAY, _RECORD = 0x0, 0x2, 0x5, 0x6, 0x7, 0x8, 0x9
_IDENTITY_KEYS = ("VendorNumber", "ProductNumber", "RevisionNumber")
_DEVICE_KEYS = (
    *(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)),
    *("SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging"),
    *("NrOfRXPDO", "NrOfTXPDO", "LSS_Supported"),
)
_NUMBERS = {
    "DeviceInfo": (*_IDENTITY_KEYS, *_DEVICE_KEYS),
    "DeviceComissioning": ("Baudrate", "NodeID"),
    "DummyUsage": tuple(f"Dummy{code:04d}" for code in range(1, 8)),
}
"""The entries that canopen reads as numbers, as it spells them."""
_KEYS = {
    key.lower(): key
    for key in ("VendorName", "ProductName", "OrderCode", "StorageLocation", "Factor", "Unit", "Description")
}
"""The texts that canopen reads, as it spells them."""
_SUBINDEX_MAX = 0xFE
"""Sub-index 255 is the structure of an object."""
_LIMITS = ("LowLimit", "HighLimit")
_VALUE_KEYS = ("DefaultValue", "ParameterValue", *_LIMITS)
_ELEMENT_KEYS = ("accesstype", "datatype", "pdomapping", "defaultvalue", "lowlimit", "highlimit")
"""Properties that the sub-indices of a compact object inherit from it."""

_HANDLED = frozenset((*_ELEMENT_KEYS, "parametername", "objecttype", "parametervalue", "subnumber", "compactsubobj"))

_ACCESS = ("ro", "wo", "rw", "rwr", "rww", "const")
_ACCESS_SPELLED = {
    **dict.fromkeys(("r", "read", "readonly"), "ro"),
    **dict.fromkeys(("w", "write", "writeonly"), "wo"),
    **dict.fromkeys(("constant", "c"), "const"),
}

_FILES = 32
"""Maximum number of parsed files in the cache."""


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
        raise EdsError(Problem(0, "", "node-ID", str(node_id), "a node-ID must be 1..127"))
    return _of_node(_read(source), node_id)


@lru_cache(maxsize=len(NODE_IDS))
def _of_node(content: bytes, node_id: int) -> EdsImport:
    """A file as of one node: a node that is brought up again is not imported again."""
    sheet, relative = _imported(content)
    dictionary = eds.import_eds(io.StringIO(relative), node_id)
    own = dictionary.indices
    dictionary.indices = {index: own.get(index, item) for index, item in sheet.dictionary.indices.items()}
    dictionary.names = {name: own.get(item.index, item) for name, item in sheet.dictionary.names.items()}
    return EdsImport(dictionary, sheet.repairs, sheet.text)


@lru_cache(maxsize=_FILES)
def _imported(content: bytes) -> tuple[EdsImport, str]:
    """A file with its dictionary for node-ID 0, and the text of what is relative to the node-ID.

    Reading costs tens of milliseconds, and the devices of a machine are often alike.
    """
    report = Report()
    others, objects = _repaired(parse(decode(content, report), report), report)
    if report.problems:
        raise EdsError(*sorted(report.problems, key=lambda problem: problem.line))
    text = text_of(others | objects)
    try:
        dictionary = eds.import_eds(io.StringIO(text), 0)
    except (KeyError, ValueError, configparser.Error) as error:  # not known to happen with any file
        raise EdsError(Problem(0, "", "file", "", f"canopen cannot import it ({error})")) from error
    relative = {name[:4] for name, entries in objects.items() if any("$NODEID" in text for text in entries.values())}
    own = text_of(others | {name: entries for name, entries in objects.items() if name[:4] in relative})
    return EdsImport(dictionary, tuple(sorted(report.repairs, key=lambda repair: repair.line)), text), own


def _read(source: str | PathLike[str] | bytes) -> bytes:
    if isinstance(source, bytes):
        return source
    try:
        return read_file(Path(source), MAX_SIZE)
    except OSError as error:
        raise EdsError(Problem(0, "", "file", str(source), error.strerror or str(error))) from error


# -- the file ---------------------------------------------------------------------------------------------------------


def _repaired(sections: dict[str, Section], report: Report) -> tuple[Texts, Texts]:
    """The sections that describe file and device, and those of the objects."""
    _add_compact_pdos(sections)
    texts: Texts = {}
    objects: dict[str, dict[int, Section]] = {}
    for name, section in list(sections.items()):
        match = re.fullmatch(r"([0-9A-F]{4})(?:sub([0-9A-F]+)|Name|Value)?", name)
        if match is None:
            texts[name] = _section_texts(section, report)
            continue
        sections.setdefault(match[1], Section(match[1], section.line))
        subs = objects.setdefault(match[1], {})
        if match[2] and int(match[2], 16) > 0xFF:
            report.refuse(Item(section.line, name, "sub-index", match[2]), "a sub-index must be 0..FF")
        elif match[2]:
            subs[int(match[2], 16)] = section
    if not objects:
        report.refuse(Item(1, "", "objects", ""), "not an EDS or DCF: it describes no object, expected at least 1000h")
    described: Texts = {}
    for name in sorted(objects):
        described |= _object_texts(sections[name], objects[name], sections, report)
        if len(described) > MAX_ENTRIES:
            raise EdsError(Problem(0, "", "file", f"{len(described)} entries", f"too long, allowed: {MAX_ENTRIES}"))
    present = [int(name, 16) for name in sorted(objects) if name in described]
    for index in filter(is_communication_parameter, present):
        name, mapping = f"{index:04X}", index + PDOS_MAX
        if mapping not in present:
            report.refuse(Item(sections[name].line, name, "", name), f"a PDO without its mapping object {mapping:04X}h")
    return texts | object_lists([index for index in present if index >= COMMUNICATION_AREA[0]]), described


def _add_compact_pdos(sections: dict[str, Section]) -> None:
    """CompactPDO: the sheet describes only those objects of its PDOs that differ from the default."""
    device = sections.setdefault("DeviceInfo", Section("DeviceInfo", 0))
    try:
        compact, *counts = (number(device.text(key)) or 0 for key in ("CompactPDO", "NrOfRXPDO", "NrOfTXPDO"))
    except ValueError:
        return
    described = {name[:4] for name in sections}
    most = (len(direction.bases) for direction in PdoDirection)
    rpdos, tpdos = (max(0, min(count, limit)) for count, limit in zip(counts, most, strict=True))
    for spec in pdo_objects(rpdos, tpdos, ()) if compact else ():
        if f"{spec.index:04X}" not in described:
            sections.update({name: _section(name, 0, texts) for name, texts in object_texts(spec).items()})


def _section(name: str, line: int, texts: Mapping[str, str]) -> Section:
    return Section(name, line, {key.lower(): Item(line, name, key, value) for key, value in texts.items()})


def _number(section: Section, key: str, report: Report, *, required: bool = False) -> int | None:
    """A number, None without one. A spelling that not every reader accepts is a repair."""
    item = section.get(key)
    try:
        value = number(item.value)
    except ValueError as error:
        value = None
        if required:
            report.refuse(item, str(error))
    if item.value and (value is None or not is_plain(item.value)):
        report.repair(item, "" if value is None else str(value))
    return value


def _section_texts(section: Section, report: Report) -> dict[str, str]:
    """A section that describes file or device, or one that only its writer uses."""
    if section.name == "Comments":
        lines = [item.value for key, item in section.items.items() if re.fullmatch(r"line[0-9]+", key)]
        return {"Lines": str(len(lines))} | {f"Line{line}": text for line, text in enumerate(lines, 1)}
    texts = _texts(section)
    for key in _NUMBERS.get(section.name, ()):
        texts.pop(section.get(key).key, None)
        value = _number(section, key, report, required=key in _IDENTITY_KEYS)
        if value is not None or section.name == "DummyUsage":
            texts[key] = str(value or 0)
    return texts


# -- one object -------------------------------------------------------------------------------------------------------


def _object_texts(main: Section, subs: dict[int, Section], sections: Mapping[str, Section], report: Report) -> Texts:
    """The sections of an object; none where it is a type definition or has been refused."""
    name, found = main.name, main.get("ObjectType")
    _write_out_compact(main, subs, sections, report)
    stated = _number(main, "ObjectType", report)
    if stated is None:
        stated = _VAR
    typed = main.text("DataType")
    structured = max(subs, default=0) > 0 or (subs and not typed)
    if not (structured or typed or stated == _DOMAIN_OBJECT or (not found.value and main.items)):
        if stated not in (_NULL, _DEFTYPE, _DEFSTRUCT):
            report.refuse(found, "an object without entries: it has neither sub-indices nor a data type")
        return {}
    kinds = (_RECORD, _ARRAY) if structured else (_VAR, _DOMAIN_OBJECT)
    kind = stated if stated in kinds else kinds[0]
    if kind != stated:
        report.repair(found, f"0x{kind:X}")
    if not structured:
        return {name: _entry_texts(main, kind, sections, report)}
    if 0 not in subs:
        subs[0] = _count(name, main.line, max(subs), "rw" if is_mapping_parameter(int(name, 16)) else "ro")
        report.repair(Item(main.line, f"{name}sub0", "", ""), f"highest sub-index {max(subs)}")
    head = {"ParameterName": _name(main, report), "ObjectType": f"0x{kind:X}", "SubNumber": str(len(subs))}
    return {name: head | _texts(main, _HANDLED)} | {
        f"{name}sub{sub:X}": _entry_texts(subs[sub], _VAR, sections, report, count=sub == 0) for sub in sorted(subs)
    }


def _write_out_compact(
    main: Section, subs: dict[int, Section], sections: Mapping[str, Section], report: Report
) -> None:
    """CompactSubObj, [xxxxName] and [xxxxValue] written out as sub-indices; described ones stay."""
    item = main.get("CompactSubObj")
    stated = _number(main, "CompactSubObj", report) or 0
    count = max(0, min(stated, _SUBINDEX_MAX))
    if count != stated:
        report.repair(item, str(count))
    if count:
        subs.setdefault(0, _count(main.name, item.line, count, "ro"))
    names, values = (sections.get(main.name + kind, Section("", 0)) for kind in ("Name", "Value"))
    for sub in set(range(1, count + 1)) - subs.keys():
        name, value = f"{main.name}sub{sub:X}", values.get(str(sub))
        texts = {
            "ParameterName": names.text(str(sub)) or f"{main.text('ParameterName')}{sub}",
            "ParameterValue": value.value,
        }
        inherited = {key: known for key, known in main.items.items() if key in _ELEMENT_KEYS}
        subs[sub] = Section(name, item.line, inherited | _section(name, value.line, texts).items)


def _count(name: str, line: int, highest: int, access: str) -> Section:
    """Sub-index 0 of an object."""
    texts = {"ParameterName": "Highest sub-index supported", "DataType": f"0x{UNSIGNED8:04X}", "AccessType": access}
    return _section(f"{name}sub0", line, texts | {"DefaultValue": str(highest)})


def _name(section: Section, report: Report) -> str:
    name = section.text("ParameterName")
    if not name:
        name = f"Object {section.name}"
        report.repair(section.get("ParameterName"), name)
    return name


def _texts(section: Section, handled: Collection[str] = ()) -> dict[str, str]:
    """The texts as they are, in canopen's spelling of their keys, without those of ``handled`` keys."""
    return {_KEYS.get(key, item.key): item.value for key, item in section.items.items() if key not in handled}


def _entry_texts(
    section: Section, kind: int, sections: Mapping[str, Section], report: Report, *, count: bool = False
) -> dict[str, str]:
    """A VAR, or one sub-index; ``count``: sub-index 0."""
    data_type = _data_type(section, kind, sections, report, count=count)
    access = section.get("AccessType")
    word = re.sub(r"[\s_/-]", "", without_comment(access.value).lower())
    used = word if word in _ACCESS else _ACCESS_SPELLED.get(word, "ro" if count else "rw")
    if access.value.lower() != used:
        report.repair(access, used)
    texts = {
        "ParameterName": _name(section, report),
        "ObjectType": f"0x{kind:X}",
        "DataType": f"0x{data_type:04X}",
        "AccessType": used,
        "PDOMapping": str(_number(section, "PDOMapping", report) or 0),
    }
    for key in _VALUE_KEYS:
        item = section.get(key)
        try:
            text = value_text(data_type, item.value, limit=key in _LIMITS)
        except ValueError:
            text = ""
        # Hexadecimal two's complement of a signed number is right, though canopen does not apply its sign.
        if text != item.value and not (text.startswith("-") and item.value.lower().startswith("0x")):
            report.repair(item, text)
        if text:
            texts[key] = text
    low, high = (texts.get(key, "") for key in _LIMITS)
    if is_plain(low) and is_plain(high) and int(low, 0) > int(high, 0):
        for key in _LIMITS:
            report.repair(section.get(key), "")
            del texts[key]
    return texts | _texts(section, _HANDLED)


def _data_type(section: Section, kind: int, sections: Mapping[str, Section], report: Report, *, count: bool) -> int:
    """The simple data type; DOMAIN (bytes) for an unknown one."""
    item, used = section.get("DataType"), UNSIGNED8 if count else DOMAIN
    code = _number(section, "DataType", report, required=True)
    if code in DATA_TYPES:
        return code
    if code is None and not count and kind != _DOMAIN_OBJECT:
        if not item.value:
            report.refuse(item, "the data type is missing")
        return DOMAIN
    if code is not None:
        # An editor's own data type.
        declared = sections.get(f"{code:X}sub1", Section("", 0)).text("DefaultValue")
        used = int(declared, 0) if is_plain(declared) and int(declared, 0) in DATA_TYPES else DOMAIN
    report.repair(item, f"0x{used:04X}")
    return used
