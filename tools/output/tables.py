"""Tables for terminals."""

from __future__ import annotations

from rich import box
from rich.table import Table


def plain_table(*titles: str, title: str | None = None, narrow: tuple[str, ...] = ()) -> Table:
    """A table without a frame whose texts are folded, never cut; ``narrow`` columns are not folded before the others."""
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for name in titles:
        table.add_column(name, overflow="fold", no_wrap=name in narrow)
    return table
