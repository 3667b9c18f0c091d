"""EDS/DCF files as sections and entries with their line numbers, from whatever bytes a real file consists of.

Source: CiA 306 V1.3 (an INI file in ASCII). Differences that an INI reader ignores are not repairs: case of names, blanks and
tabs around them, line ends, comment lines. Not here: the meaning of the sections, see ``ds301.eds.importer``.
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass, field

from pdgw.ds301.eds.values import same_value
from pdgw.ds301.errors import CanopenError

MAX_SIZE = 4 << 20
"""Bytes; the largest data sheets are a few hundred kilobytes."""


@dataclass(frozen=True, slots=True)
class Repair:
    """One thing of a file that was not right and has only one meaning.

    ``line`` counts from 1 (0: the file as a whole), ``used`` "" means that the entry was left out.
    """

    line: int
    section: str
    key: str
    found: str
    used: str


@dataclass(frozen=True, slots=True)
class Problem:
    """A part of a file that cannot be used: place, content and reason."""

    line: int
    section: str
    key: str
    found: str
    reason: str

    def __str__(self) -> str:
        place = " ".join(
            part for part in (f"line {self.line}", f"[{self.section}]" * bool(self.section), self.key) if part
        )
        return f"{place} {self.found!r}: {self.reason}"


class EdsError(CanopenError):
    """A file that cannot be imported; ``problems`` names every line that has to be corrected, in order."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        first = problems[0]
        super().__init__(f"EDS line {first.line}", first.found, first.reason)

    def __str__(self) -> str:
        return "; ".join(str(problem) for problem in self.problems)


@dataclass(slots=True)
class Report:
    """Collects the repairs and errors of an import."""

    repairs: list[Repair] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def repair(self, line: int, section: str, key: str, found: str, used: str) -> None:
        self.repairs.append(Repair(line, section, key, found, used))

    def refuse(self, line: int, section: str, key: str, found: str, reason: str) -> None:
        self.problems.append(Problem(line, section, key, found, reason))


@dataclass(frozen=True, slots=True)
class Item:
    """``key=value`` of a line."""

    key: str
    value: str
    line: int


@dataclass(slots=True)
class Section:
    """A section under its canonical name; ``items`` by lower-case key, in the order of the file."""

    name: str
    line: int
    items: dict[str, Item] = field(default_factory=dict)

    def get(self, key: str) -> Item | None:
        return self.items.get(key.lower())

    def text(self, key: str) -> str:
        """The value of a key, "" where it is missing."""
        item = self.items.get(key.lower())
        return "" if item is None else item.value

    def where(self, key: str) -> int:
        """The line of a key, of the section where it is missing."""
        item = self.items.get(key.lower())
        return self.line if item is None else item.line


KNOWN_SECTIONS = {
    name.lower(): name
    for name in (
        "FileInfo",
        "DeviceInfo",
        "DeviceComissioning",  # as CiA 306 spells it
        "DummyUsage",
        "MandatoryObjects",
        "OptionalObjects",
        "ManufacturerObjects",
        "Comments",
    )
} | {"devicecommissioning": "DeviceComissioning"}

_MEANINGFUL = frozenset(
    (
        *("objecttype", "datatype", "accesstype", "pdomapping", "lowlimit", "highlimit", "defaultvalue"),
        *("parametervalue", "compactsubobj", "vendornumber", "productnumber", "revisionnumber"),
    )
)
"""Keys that must not have two different values; of the others the first counts, as for an INI reader."""

_NOT_KEPT = ("", "DEFAULT")
"""Sections without a name, and the one whose entries canopen's reader would take for defaults of every object."""
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:[\s_.]*sub[\s_]*(?:0x)?([0-9a-f]+))?", re.IGNORECASE)
_OBJECT_PLAIN = re.compile(r"[0-9a-f]{4}(?:sub0*[0-9a-f]{1,2})?", re.IGNORECASE)
_OBJECT_LIST = re.compile(r"([0-9a-f]{4})(name|value)", re.IGNORECASE)


def decode(data: bytes, report: Report) -> str:
    """The text of a file; a repair names an encoding other than ASCII or UTF-8. Rejects binary data."""
    if len(data) > MAX_SIZE:
        raise EdsError((Problem(0, "", "file size", f"{len(data)} bytes", f"too long, allowed: {MAX_SIZE} bytes"),))
    for mark, encoding in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be")):
        if data.startswith(mark):
            return _wide_text(data[len(mark) :], encoding, report)
    head = data[:64]
    for encoding, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
        if zeros and not any(zeros):
            return _wide_text(data, encoding, report)
    if data.startswith(codecs.BOM_UTF8):
        report.repair(1, "", "encoding", "utf-8 with byte order mark", "utf-8")
        data = data[len(codecs.BOM_UTF8) :]
    try:
        return _checked(data.decode())
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
    try:
        encoding, text = "cp1252", data.decode("cp1252")
    except UnicodeDecodeError:
        encoding, text = "latin-1", data.decode("latin-1")
    report.repair(line, "", "encoding", encoding, "utf-8")
    return _checked(text)


def _wide_text(data: bytes, encoding: str, report: Report) -> str:
    report.repair(1, "", "encoding", encoding, "utf-8")
    try:
        return _checked(data.decode(encoding))
    except UnicodeDecodeError as error:
        line = data[: error.start].decode(encoding, "replace").count("\n") + 1
        raise EdsError((Problem(line, "", "encoding", encoding, f"cut or damaged text ({error.reason})"),)) from None


def _checked(text: str) -> str:
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise EdsError((Problem(line, "", "text", "\0", "binary data, not an EDS or DCF"),))
    return text


def canonical_name(name: str) -> tuple[str, bool]:
    """The name of a section as CiA 306 spells it, and whether more than case and leading zeros had to be changed."""
    known = KNOWN_SECTIONS.get(name.lower())
    if known is not None:
        return known, known.lower() != name.lower()
    if match := _OBJECT.fullmatch(name):
        sub = match[2]
        canonical = match[1].upper() + ("" if sub is None else f"sub{int(sub, 16):X}")
        return canonical, not _OBJECT_PLAIN.fullmatch(name)
    if match := _OBJECT_LIST.fullmatch(name):
        return match[1].upper() + match[2].capitalize(), False
    return name, False


def parse(text: str, report: Report) -> dict[str, Section]:
    """The sections by canonical name in the order of the file; repeated ones are joined."""
    sections: dict[str, Section] = {}
    section: Section | None = None
    for line, raw in enumerate(re.split(r"\r\n|\n|\r", text), 1):
        content = raw.strip()
        if not content or content[0] in ";#":
            continue
        if content[0] == "[":
            section = _header(content, line, sections, report)
            continue
        if section is None:
            report.repair(line, "", "", content, "")
            continue
        key, separator, value = content.partition("=")
        key = key.strip()
        if not separator or not re.fullmatch(r"[^:=\[;#][^:=;]*", key):
            report.repair(line, section.name, "", content, "")
            continue
        _add(section, Item(key, _without_comment(section.name, key, value.strip(), line, report), line), report)
    return {name: section for name, section in sections.items() if name not in _NOT_KEPT}


def _header(content: str, line: int, sections: dict[str, Section], report: Report) -> Section:
    inside, bracket, rest = content[1:].partition("]")
    name, changed = canonical_name(inside.partition(";")[0].strip())
    if not bracket and name.lower() not in KNOWN_SECTIONS and not _OBJECT.fullmatch(name):
        report.refuse(line, name, "", content, "the header of a section must end with ]")
    elif name in _NOT_KEPT:
        report.repair(line, name, "", content, "")
    elif changed or not bracket or (rest.strip() and rest.strip()[0] not in ";#"):
        report.repair(line, name, "", content, f"[{name}]")
    known = sections.get(name)
    if known is None:
        known = sections[name] = Section(name, line)
    else:
        report.repair(line, name, "", content, f"joined with line {known.line}")
    return known


def _without_comment(section: str, key: str, value: str, line: int, report: Report) -> str:
    """CiA 306 has comment lines only; every reader also accepts text after blank and semicolon as a comment."""
    match = re.search(r"(?:^|\s);", value)
    if match is None:
        return value
    used = value[: match.start()].strip()
    report.repair(line, section, key, value, used)
    return used


def _add(section: Section, item: Item, report: Report) -> None:
    key = item.key.lower()
    known = section.items.get(key)
    if known is None:
        section.items[key] = item
        return
    if known.value and item.value and key in _MEANINGFUL and not same_value(known.value, item.value):
        reason = f"contradicts {known.value!r} in line {known.line}"
        report.refuse(item.line, section.name, item.key, item.value, reason)
        return
    used = item if not known.value else known
    report.repair(item.line, section.name, item.key, item.value, used.value)
    section.items[key] = used
