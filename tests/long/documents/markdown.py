"""Tables of the generated documents."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def numbers(found: Iterable[int]) -> str:
    """Numbers as "1-3, 7, 9": three or more without a gap are a range."""
    runs = [[n for _, n in run] for _, run in groupby(enumerate(found), lambda item: item[1] - item[0])]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs)
