"""Format tables for terminals."""

from __future__ import annotations

from rich import box
from rich.table import Table


def plain_table(*titles: str, title: str | None = None, narrow: tuple[str, ...] = ()) -> Table:
    """A table without borders that folds long texts and never cuts them. Columns in ``narrow`` are folded last."""
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for name in titles:
        table.add_column(name, overflow="fold", no_wrap=name in narrow)
    return table
