"""The tables that people wrote in the documents."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]


def rows(document: str, head: str) -> Iterator[list[str]]:
    """The cells of each row of the table whose head begins so."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    table = text.partition(f"\n| {head}")[2].partition("\n\n")[0]
    for line in table.splitlines()[2:]:
        yield [cell.strip() for cell in line.strip("|").split("|")]


def number_of(cell: str) -> int:
    found = re.match(r"\d+", cell)
    assert found is not None, cell
    return int(found[0])


def named(cell: str) -> list[str]:
    """Texts in back quotes, without tables of the configuration (``[units]``)."""
    return [name for name in re.findall(r"`([^`]+)`", cell) if not name.startswith("[")]
