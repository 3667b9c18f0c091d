"""Dotted names in docstrings, comments and documents exist: ``orders.ORDERS``, ``pdgw.Gateway``, ``test_dsc.py``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Final

import pdgw
from tests.support.documents.sources import ROOMS
from tests.test_package import ROOT

_NAME: Final = re.compile(r"`([a-z_]\w*(?:\.[A-Za-z_]\w*)+)(?:\(\))?`", re.ASCII)
_FILES: Final = {"conf", "dcf", "html", "json", "pcap", "pcapng", "pdf", "png", "ring", "scl", "toml", "txt"}
"""Endings of names of files that are not sources."""
_TEXTS: Final = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*.md")
_OTHERS: Final = {"actuals", "apis", "name", "pyarrow", "ring", "setpoints", "statusword", "stw1", "type_"}
"""First parts of what is no module of this package: words and bits of a frame, variables, an extra."""


def modules() -> dict[str, str]:
    """The source of each module by each ending of its dotted name."""
    found: dict[str, str] = {}
    for room in (*ROOMS, "tests"):
        for file in (ROOT / room).rglob("*.py"):
            parts = file.relative_to(ROOT).with_suffix("").parts
            source = file.read_text("utf-8")
            for begin in range(len(parts)):
                name = ".".join(parts[begin:]).removesuffix(".__init__")
                found[name] = found.get(name, "") + source
    return found


def names() -> Iterator[tuple[str, str]]:
    """Each dotted name, and where it is."""
    sources = (file for room in (*ROOMS, "tests") for file in (ROOT / room).rglob("*.py"))
    documents = (file for pattern in _TEXTS for file in ROOT.glob(pattern))
    for file in {*sources, *documents}:
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1):
            yield from ((f"{file.relative_to(ROOT)}:{number}", match[1]) for match in _NAME.finditer(line))


def exists(name: str, known: dict[str, str]) -> bool:
    """A module, what a module defines, an export of ``pdgw``, a source, or something of a library."""
    first, *others = name.removeprefix("pdgw.").split(".")
    if name.rpartition(".")[2] in _FILES or first in _OTHERS:
        return True
    if others == ["py"]:
        return first in known or (ROOT / name).exists()
    parts = [first, *others]
    for end in range(len(parts), 0, -1):
        source = known.get(".".join(parts[:end]))
        if source is not None and all(_defines(source, part) for part in parts[end:]):
            return True
        if source is not None and first in ROOMS:
            return False
    return first in pdgw.__all__ or (first not in ROOMS and find_spec(first) is not None)


def _defines(source: str, name: str) -> bool:
    """Whether a module defines or imports a name, or a class of it has it."""
    return re.search(rf"(?m)^ *(?:def |class |self\.)?{name}\b|^(?:from|import) .*\b{name}\b", source) is not None


def test_every_dotted_name_exists() -> None:
    known = modules()
    wrong = sorted(f"{place} {name}" for place, name in names() if not exists(name, known))
    assert not wrong, "\n".join(wrong)
