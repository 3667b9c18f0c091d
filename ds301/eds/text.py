"""EDS/DCF files as sections and entries with their line numbers, from whatever bytes a real file consists of.

Source: CiA 306 V1.3 (an INI file in ASCII). Differences that an INI reader ignores are not repairs: case of names, blanks and
tabs around them, line ends, comment lines. Not here: the meaning of the sections, see ``ds301.eds.importer``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from pdgw.base.phrases import printable
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.eds.values import same_value


@dataclass(frozen=True, slots=True)
class Repair:
    """One thing of a file that was not right, and what is used instead.

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

    def __init__(self, *problems: Problem) -> None:
        self.problems = problems
        first = problems[0]
        super().__init__(f"EDS line {first.line}", first.found, first.reason)

    def __str__(self) -> str:
        return "; ".join(str(problem) for problem in self.problems)


@dataclass(frozen=True, slots=True)
class Item:
    """``key=value`` of a line, or another line with an empty key."""

    line: int
    section: str
    key: str
    value: str


@dataclass(slots=True)
class Report:
    """Collects the repairs and errors of an import."""

    repairs: list[Repair] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def repair(self, item: Item, used: str) -> None:
        self.repairs.append(Repair(item.line, item.section, item.key, item.value, used))

    def refuse(self, item: Item, reason: str) -> None:
        self.problems.append(Problem(item.line, item.section, item.key, item.value, reason))


@dataclass(slots=True)
class Section:
    """A section under its canonical name; ``items`` by lower-case key, in the order of the file."""

    name: str
    line: int
    items: dict[str, Item] = field(default_factory=dict)

    def get(self, key: str) -> Item:
        """The entry of a key; an empty one where it is missing."""
        return self.items.get(key.lower()) or Item(self.line, self.name, key, "")

    def text(self, key: str) -> str:
        """The value of a key, "" where it is missing."""
        return self.get(key).value


_KNOWN = {
    name.lower(): name
    for name in (
        *("FileInfo", "DeviceInfo", "DummyUsage", "Comments", "DeviceComissioning"),  # as CiA 306 spells it
        *("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"),
    )
} | {"devicecommissioning": "DeviceComissioning"}

_TYPES = ("objecttype", "datatype", "compactsubobj", "vendornumber", "productnumber", "revisionnumber")
"""Keys that must not have two different values."""
_VALUES = ("defaultvalue", "parametervalue", "lowlimit", "highlimit")
"""Keys that have no value if the file gives two different ones. Of all others the first counts, as for an INI reader."""
_OBJECT = re.compile(r"(?:0x)?([0-9a-f]{4})h?(?:[\s_.]*sub[\s_]*(?:0x)?([0-9a-f]+)|(name|value))?", re.IGNORECASE)


_OTHER_FILES = {
    rb"PK\x03\x04": "a ZIP archive: unpack it",
    rb"%PDF": "a PDF document",
    rb"<(?:!doctype\s+)?html": "a web page: download the file itself",
    rb"<.*<EtherCATInfo": "an ESI file (EtherCAT)",
    rb"<.*(?:profibus|profinet)": "a GSDML file (PROFINET)",
    rb"<.*canopen": "an XDD or XDC file (CANopen in XML)",
    rb"<\?xml": "an XML file",
}
"""Files of other kinds by their first bytes."""


def decode(data: bytes, report: Report) -> str:
    """The text of a file; a repair names an encoding other than ASCII or UTF-8. Rejects binary data and files of other kinds."""
    head = data[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    for pattern, kind in _OTHER_FILES.items():
        if re.match(pattern, head, re.IGNORECASE | re.DOTALL):
            raise EdsError(Problem(1, "", "file", "", f"{kind}, expected an EDS or DCF"))
    encodings: tuple[str, ...] = ("utf-8", "cp1252", "latin-1")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ("utf-16",)
    elif data.startswith(b"\xef\xbb\xbf"):
        encodings = ("utf-8-sig", "cp1252", "latin-1")
    elif data and not any(data[1:64:2]):
        encodings = ("utf-16-le",)
    elif data and not any(data[:64:2]):
        encodings = ("utf-16-be",)
    line = 0
    for encoding in encodings:
        try:
            text = data.decode(encoding)
            break
        except UnicodeDecodeError as error:
            line = line or data.count(b"\n", 0, error.start) + 1
    else:
        raise EdsError(Problem(line, "", "encoding", encoding, "cut or damaged text"))
    if encoding != "utf-8":
        report.repair(Item(line or 1, "", "encoding", encoding), "utf-8")
    used = text.rstrip("\0\x1a")
    if "\0" in used:
        line = used.count("\n", 0, used.index("\0")) + 1
        raise EdsError(Problem(line, "", "text", "\0", "binary data, not an EDS or DCF"))
    if used != text:
        report.repair(Item(used.count("\n") + 1, "", "end of file", text[len(used)]), "")
    shown = printable(used)
    if shown != used:
        report.repair(Item(0, "", "control characters", ""), "escaped")
    return shown


def _canonical_name(name: str) -> str:
    """The name of a section as CiA 306 spells it."""
    if match := _OBJECT.fullmatch(name):
        sub = "" if match[2] is None else f"sub{int(match[2], 16):X}"
        return match[1].upper() + sub + (match[3] or "").capitalize()
    return _KNOWN.get(name.lower(), name)


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
        key, separator, value = (part.strip() for part in content.partition("="))
        if section is None or not separator or not re.fullmatch(r"[^:=\[;#][^:=;]*", key):
            report.repair(Item(line, "" if section is None else section.name, "", content), "")
            continue
        # CiA 306 has comment lines only; every reader also accepts text after blank and semicolon as a comment.
        used = re.split(r"(?:^|\s);", value, maxsplit=1)[0].strip()
        if used != value:
            report.repair(Item(line, section.name, key, value), used)
        _add(section, Item(line, section.name, key, used), report)
    # Not the section whose entries canopen's reader uses as defaults of every other.
    return {name: section for name, section in sections.items() if name not in ("", "DEFAULT")}


def _header(content: str, line: int, sections: dict[str, Section], report: Report) -> Section:
    inside, bracket, rest = content[1:].partition("]")
    spelled = inside.partition(";")[0].strip()
    name = _canonical_name(spelled)
    changed = re.sub("sub0+(?=.)", "sub", spelled.lower()) != name.lower()
    item = Item(line, name, "", content)
    if not bracket and name not in _KNOWN.values() and not _OBJECT.fullmatch(name):
        report.refuse(item, "the header of a section must end with ]")
    elif name in ("", "DEFAULT"):
        report.repair(item, "")
    elif changed or not bracket or (rest.strip() and rest.strip()[0] not in ";#"):
        report.repair(item, f"[{name}]")
    if name in sections:
        report.repair(item, f"joined with line {sections[name].line}")
    return sections.setdefault(name, Section(name, line))


def _add(section: Section, item: Item, report: Report) -> None:
    key = item.key.lower()
    known = section.items.setdefault(key, item)
    if known is item:
        return
    used = known if known.value else item
    if known.value and item.value and not same_value(known.value, item.value):
        if key in _TYPES:
            report.refuse(item, f"contradicts {known.value!r} in line {known.line}")
        elif key in _VALUES:
            used = Item(item.line, item.section, item.key, "")
    report.repair(item, used.value)
    section.items[key] = used
