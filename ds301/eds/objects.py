"""One object of an EDS/DCF file in canonical form: its kind, its sub-indices, the types and values of its entries.

Source: CiA 306 V1.3 chapter "object dictionary", CiA 301 (object codes, data types). Left out: type definitions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pdgw.ds301.communication import PREDEFINED_ERROR_FIELD
from pdgw.ds301.eds.text import Item, Report, Section
from pdgw.ds301.eds.values import (
    BOOLEAN,
    DATA_TYPES,
    DOMAIN,
    NUMBER_OF_BITS,
    UNSIGNED8,
    ValueRefused,
    is_plain,
    is_unsigned_pattern,
    limit_text,
    number,
    value_text,
)
from pdgw.ds301.pdo import PDO_PARAMETERS, is_mapping_parameter

_NULL, _DOMAIN_OBJECT, _DEFTYPE, _DEFSTRUCT, _VAR, _ARRAY, _RECORD = 0x0, 0x2, 0x5, 0x6, 0x7, 0x8, 0x9
_NO_ENTRIES = (_NULL, _DEFTYPE, _DEFSTRUCT)
_SINGLE = (_VAR, _DOMAIN_OBJECT)
_STRUCTURE = 0xFF
"""Sub-index with the object's structure: no element, not counted in sub-index 0."""

_ACCESS = ("ro", "wo", "rw", "rwr", "rww", "const")
_ACCESS_SPELLED = {
    **dict.fromkeys(("r", "read", "readonly"), "ro"),
    **dict.fromkeys(("w", "write", "writeonly"), "wo"),
    **dict.fromkeys(("r/w", "wr", "readwrite", "read/write"), "rw"),
    **dict.fromkeys(("constant", "c"), "const"),
}
_ELEMENT_TYPE_KEYS = ("accesstype", "datatype", "pdomapping")
"""Properties shared by all elements of an array."""
_ELEMENT_KEYS = (*_ELEMENT_TYPE_KEYS, "defaultvalue", "lowlimit", "highlimit")
"""Properties that the sub-indices of a compact object inherit from it."""
_WRITABLE_COUNTS = frozenset((PREDEFINED_ERROR_FIELD, *filter(is_mapping_parameter, PDO_PARAMETERS)))
"""Objects whose sub-index 0 is a value the master may write, not the number of sub-indices."""

_ENTRY_KEYS = ("ParameterName", "DataType", "AccessType", "DefaultValue", "ParameterValue", "PDOMapping")
_KEYS = {
    key.lower(): key
    for key in (*_ENTRY_KEYS, "ObjectType", "LowLimit", "HighLimit", "SubNumber", "StorageLocation", "Factor", "Unit")
} | {"description": "Description"}
_HANDLED = frozenset(
    key.lower() for key in (*_ENTRY_KEYS, "ObjectType", "LowLimit", "HighLimit", "SubNumber", "CompactSubObj")
)

Texts = dict[str, dict[str, str]]
"""The text to write: keys and values by section."""


@dataclass(slots=True)
class ObjectSections:
    """The sections of one object."""

    index: int
    main: Section | None = None
    subs: dict[int, Section] = field(default_factory=dict)
    names: Section | None = None
    values: Section | None = None


def check_count(section: Section, key: str, count: int, report: Report) -> None:
    """A count that is not the number of things counted is a repair."""
    found = section.text(key)
    try:
        right = number(found) == count and is_plain(found)
    except ValueRefused:
        right = False
    if not right:
        report.repair(section.where(key), section.name, key, found, str(count))


class ObjectWriter:
    """One object in canonical form."""

    def __init__(self, item: ObjectSections, user_types: Mapping[int, str], report: Report) -> None:
        self._item = item
        self._user_types = user_types
        self._report = report
        self._name = f"{item.index:04X}"
        # An object of which only sub-indices or names are described starts at the first of them.
        described = [*item.subs.values(), *(section for section in (item.names, item.values) if section is not None)]
        self._main = item.main or Section(self._name, min((section.line for section in described), default=0))
        self._compact = self._compact_count()

    @property
    def entries(self) -> int:
        """Sub-indices the object has when its compact ones are written out, at least 1."""
        return max(1, len(self._item.subs), self._compact + 1)

    def write(self) -> Texts:
        """The sections of the object; none where it is a type definition or has been refused."""
        kind = self._kind()
        if kind is None or kind in _NO_ENTRIES:
            return {}
        self._expand_compact()
        if kind in _SINGLE:
            return {self._name: {"ObjectType": f"0x{kind:X}"} | self._entry(self._main, 0, kind)}
        return self._structured(kind)

    def _kind(self) -> int | None:
        """The object code the content proves; None when refused."""
        item, main = self._item, self._main
        several = any(subindex > 0 for subindex in item.subs) or self._compact > 0
        typed = bool(main.text("DataType"))
        found = main.text("ObjectType")
        try:
            stated = number(found)
        except ValueRefused:
            stated = -1
        if item.main is None:
            self._report.repair(main.line, self._name, "", "", f"[{self._name}]")
        if stated in _NO_ENTRIES and item.main is not None and not several:
            return stated
        if several or (item.subs and not typed):
            kind = stated if stated in (_ARRAY, _RECORD) else _RECORD
        elif stated in _SINGLE or typed:
            kind = stated if stated in _SINGLE else _VAR
        elif stated is None and not item.subs:
            kind = _VAR
        else:
            reason = "an object without entries: it has neither sub-indices nor a data type"
            self._report.refuse(main.where("ObjectType"), self._name, "ObjectType", found, reason)
            return None
        assert kind is not None
        if kind in _SINGLE:
            for section in item.subs.values():
                self._report.repair(section.line, section.name, "", f"[{section.name}]", "")
        default_kind = not found and kind == _VAR  # CiA 306: a missing ObjectType is VAR
        if item.main is not None and not default_kind and (stated != kind or not is_plain(found)):
            self._report.repair(main.where("ObjectType"), self._name, "ObjectType", found, f"0x{kind:X}")
        return kind

    def _compact_count(self) -> int:
        item = self._main.get("CompactSubObj")
        if item is None:
            return 0
        try:
            count = number(item.value) or 0
        except ValueRefused as error:
            self._report.refuse(item.line, self._name, item.key, item.value, str(error))
            return 0
        if not 0 <= count <= 254:
            self._report.refuse(item.line, self._name, item.key, item.value, "the number of sub-indices must be 0..254")
            return 0
        return count

    def _expand_compact(self) -> None:
        """CompactSubObj, [xxxxName] and [xxxxValue] written out as sub-indices; described ones stay."""
        item, main = self._item, self._main
        count = self._compact
        unused = [section for section in (item.names, item.values) if section is not None]
        if not count:
            for section in unused:
                self._report.repair(section.line, section.name, "", f"[{section.name}]", "")
            return
        kept = {key: value for key, value in main.items.items() if key in _ELEMENT_KEYS}
        line = main.where("CompactSubObj")
        if 0 not in item.subs:
            item.subs[0] = _count_section(self._name, line, count, "ro")
        for subindex in range(1, count + 1):
            if subindex in item.subs:
                continue
            section = Section(f"{self._name}sub{subindex:X}", line, dict(kept))
            section.items["parametername"] = Item("ParameterName", f"{main.text('ParameterName')}{subindex}", line)
            if item.names is not None and (name := item.names.get(str(subindex))) is not None:
                section.items["parametername"] = Item("ParameterName", name.value, name.line)
            if item.values is not None and (value := item.values.get(str(subindex))) is not None:
                section.items["parametervalue"] = Item("ParameterValue", value.value, value.line)
            item.subs[subindex] = section

    def _structured(self, kind: int) -> Texts:
        item, main, report = self._item, self._main, self._report
        self._complete_array(kind)
        highest = max((subindex for subindex in item.subs if subindex != _STRUCTURE), default=0)
        if 0 not in item.subs:
            access = "rw" if item.index in _WRITABLE_COUNTS else "ro"
            item.subs[0] = _count_section(self._name, main.line, highest, access)
            report.repair(main.line, f"{self._name}sub0", "", "", f"highest sub-index {highest}")
        subs: Texts = {}
        for subindex in sorted(item.subs):
            entry = self._entry(item.subs[subindex], subindex, kind)
            subs[f"{self._name}sub{subindex:X}"] = {"ObjectType": "0x7"} | entry
        self._check_highest(subs[f"{self._name}sub0"], highest)
        types = {
            subs[name]["DataType"] for name in subs if not name.endswith(("sub0", "subFF")) and "DataType" in subs[name]
        }
        if kind == _ARRAY and len({int(text, 0) for text in types}) > 1:
            # An ARRAY's elements have one type; canopen would give missing elements the type of the first.
            report.repair(main.where("ObjectType"), self._name, "ObjectType", main.text("ObjectType"), f"0x{_RECORD:X}")
            kind = _RECORD
        if item.main is not None and not self._compact:
            check_count(main, "SubNumber", len(item.subs), report)
        head = {
            "ParameterName": self._parameter_name(main),
            "ObjectType": f"0x{kind:X}",
            "SubNumber": str(len(item.subs)),
        }
        return {self._name: head | self._others(main)} | subs

    def _complete_array(self, kind: int) -> None:
        """Elements an ARRAY must have - its counts agree on them - and whose sections are missing."""
        subs = self._item.subs
        elements = sorted(subindex for subindex in subs if 0 < subindex < _STRUCTURE)
        if kind != _ARRAY or not elements:
            return
        first = subs[elements[0]]
        if any(_type_and_access(subs[subindex]) != _type_and_access(first) for subindex in elements):
            return
        highest = elements[-1]
        count = self._agreed_count()
        for subindex in range(1, max(highest, count) + 1):
            if subindex not in subs:
                items = {key: item for key, item in first.items.items() if key in _ELEMENT_TYPE_KEYS}
                items["parametername"] = Item("ParameterName", f"{first.text('ParameterName')} {subindex}", first.line)
                section = subs[subindex] = Section(f"{self._name}sub{subindex:X}", self._main.line, items)
                self._report.repair(self._main.line, section.name, "", "", f"as [{first.name}]")

    def _agreed_count(self) -> int:
        """The highest sub-index by SubNumber and sub-index 0, 0 where they do not agree."""
        try:
            stated = number(self._main.text("SubNumber"))
            default = number(self._item.subs[0].text("DefaultValue")) if 0 in self._item.subs else None
        except ValueRefused:
            return 0
        return default if default is not None and stated == default + 1 and default < _STRUCTURE else 0

    def _check_highest(self, entry: dict[str, str], highest: int) -> None:
        """A constant sub-index 0 is the highest sub-index; more than are described may be optional ones."""
        default = entry.get("DefaultValue", "")
        constant = entry.get("AccessType") in ("ro", "const") and self._item.index not in _WRITABLE_COUNTS
        counting = int(entry.get("DataType", "0"), 0) in NUMBER_OF_BITS
        if constant and counting and is_plain(default) and int(default, 0) < highest:
            section = self._item.subs[0]
            self._report.repair(section.where("DefaultValue"), section.name, "DefaultValue", default, str(highest))
            entry["DefaultValue"] = str(highest)

    def _parameter_name(self, section: Section) -> str:
        name = section.text("ParameterName")
        if name:
            return name
        used = f"Object {section.name}"
        self._report.repair(section.where("ParameterName"), section.name, "ParameterName", "", used)
        return used

    def _others(self, section: Section) -> dict[str, str]:
        return {_KEYS.get(key, item.key): item.value for key, item in section.items.items() if key not in _HANDLED}

    def _entry(self, section: Section, subindex: int, kind: int) -> dict[str, str]:
        """Everything of a VAR or of one sub-index but its ObjectType."""
        texts = {"ParameterName": self._parameter_name(section)}
        data_type = self._data_type(section, subindex, kind)
        if data_type is None:
            return texts
        texts["DataType"] = f"0x{data_type:04X}"
        access = self._access(section, subindex, kind)
        if access is not None:
            texts["AccessType"] = access
        for key in ("DefaultValue", "ParameterValue"):
            if (item := section.get(key)) is not None:
                text = self._converted(section, item, *_attempt(value_text, data_type, item.value))
                if text:
                    texts[key] = text
        texts["PDOMapping"] = self._pdo_mapping(section)
        for key, lower in (("LowLimit", True), ("HighLimit", False)):
            if (item := section.get(key)) is not None:
                text = self._converted(section, item, *_attempt(limit_text, data_type, item.value, lower=lower))
                if text:
                    texts[key] = text
        self._check_limits(section, data_type, texts)
        return texts | self._others(section)

    def _converted(self, section: Section, item: Item, text: str, repaired: bool, reason: str) -> str:
        if reason:
            self._report.refuse(item.line, section.name, item.key, item.value, reason)
        elif repaired:
            self._report.repair(item.line, section.name, item.key, item.value, text)
        return text

    def _check_limits(self, section: Section, data_type: int, texts: dict[str, str]) -> None:
        low, high = texts.get("LowLimit", ""), texts.get("HighLimit", "")
        if data_type in DATA_TYPES and is_plain(low) and is_plain(high) and int(low, 0) > int(high, 0):
            if is_unsigned_pattern(data_type, section.text("HighLimit")):
                # 00h to FFh of an INTEGER8 mean its bits, which are all values of the type.
                for key in ("LowLimit", "HighLimit"):
                    self._report.repair(section.where(key), section.name, key, section.text(key), "")
                    del texts[key]
                return
            reason = f"above the high limit {high}"
            self._report.refuse(section.where("LowLimit"), section.name, "LowLimit", section.text("LowLimit"), reason)

    def _data_type(self, section: Section, subindex: int, kind: int) -> int | None:
        """The simple data type; None when refused."""
        found = section.text("DataType")
        line = section.where("DataType")
        try:
            code = number(found)
        except ValueRefused as error:
            self._report.refuse(line, section.name, "DataType", found, str(error))
            return None
        if code is None:
            code = self._implied_type(subindex, kind)
            if code is None:
                self._report.refuse(line, section.name, "DataType", found, "the data type is missing")
                return None
            self._report.repair(line, section.name, "DataType", found, f"0x{code:04X}")
            return code
        used = code if code in DATA_TYPES else self._user_type(code)
        if used != code or not is_plain(found):
            self._report.repair(line, section.name, "DataType", found, f"0x{used:04X}")
        return used

    def _user_type(self, code: int) -> int:
        """The declared type of a data type of the file; DOMAIN (bytes) for an unknown one."""
        try:
            used = number(self._user_types.get(code, ""))
        except ValueRefused:
            used = None
        return used if used is not None and used in DATA_TYPES else DOMAIN

    def _implied_type(self, subindex: int, kind: int) -> int | None:
        if kind == _DOMAIN_OBJECT:
            return DOMAIN
        if kind in _SINGLE:
            return None
        if subindex == 0:
            return UNSIGNED8
        text = self._common_text("DataType") if kind == _ARRAY else ""
        return number(text) if is_plain(text) else None

    def _common_text(self, key: str) -> str:
        """The common value of ``key`` in all elements of an array that have one, else ""."""
        subs = self._item.subs.items()
        found = {section.text(key).lower() for subindex, section in subs if 0 < subindex < _STRUCTURE} - {""}
        return found.pop() if len(found) == 1 else ""

    def _access(self, section: Section, subindex: int, kind: int) -> str | None:
        found = section.text("AccessType")
        word = found.lower()
        if word in _ACCESS:
            return word
        used = _ACCESS_SPELLED.get(re.sub(r"[\s_-]", "", word), "")
        if not used and not word and kind not in _SINGLE:
            used = "ro" if subindex == 0 else self._common_text("AccessType") * (kind == _ARRAY)
        line = section.where("AccessType")
        if used not in _ACCESS:
            self._report.refuse(line, section.name, "AccessType", found, "expected " + ", ".join(_ACCESS))
            return None
        self._report.repair(line, section.name, "AccessType", found, used)
        return used

    def _pdo_mapping(self, section: Section) -> str:
        item = section.get("PDOMapping")
        if item is None:
            return "0"
        text, repaired, reason = _attempt(value_text, BOOLEAN, item.value)
        if not reason and not text:
            text = "0"
            repaired = True
        self._converted(section, item, text, repaired, reason)
        return str(int(text, 0)) if text else "0"


def _attempt(
    convert: Callable[..., tuple[str, bool]], data_type: int, text: str, **options: bool
) -> tuple[str, bool, str]:
    """The converted text, whether it repairs something, and the reason of a refusal."""
    try:
        return *convert(data_type, text, **options), ""
    except ValueRefused as error:
        return "", False, str(error)


def _count_section(name: str, line: int, highest: int, access: str) -> Section:
    """Sub-index 0 of an object."""
    texts = {
        "ParameterName": "Highest sub-index supported",
        "DataType": f"0x{UNSIGNED8:04X}",
        "AccessType": access,
        "DefaultValue": str(highest),
        "PDOMapping": "0",
    }
    return Section(f"{name}sub0", line, {key.lower(): Item(key, value, line) for key, value in texts.items()})


def _type_and_access(section: Section) -> tuple[str, str]:
    return section.text("DataType").lower(), section.text("AccessType").lower()
