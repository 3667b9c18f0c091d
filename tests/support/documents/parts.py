"""Parts of the documents that ``make docs`` writes, each between two comments, and the tables in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path

DOCS = Path(__file__).parents[3] / "docs"


def read_part(document: str, name: str) -> str:
    """The part of a document of ``docs/``."""
    return _split(document, name)[1]


def write_part(document: str, name: str, text: str) -> None:
    """Replace the part of a document of ``docs/``."""
    before, _, after = _split(document, name)
    (DOCS / document).write_text(before + text + after, encoding="utf-8")


def _split(document: str, name: str) -> tuple[str, str, str]:
    begin, end = f"<!-- {name}: written by make docs -->\n\n", f"\n<!-- end of {name} -->\n"
    before, found, rest = (DOCS / document).read_text(encoding="utf-8").partition(begin)
    part, ended, after = rest.partition(end)
    if not found or not ended:
        raise ValueError(f"docs/{document}: {name}: a comment is missing, expected {begin!r} and {end!r}")
    return before + begin, part, end + after


# Tables of the generated documents.


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def numbers(found: Iterable[int]) -> str:
    """Numbers as "1-3, 7, 9": three or more without a gap are a range."""
    runs = [[n for _, n in run] for _, run in groupby(enumerate(found), lambda item: item[1] - item[0])]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
