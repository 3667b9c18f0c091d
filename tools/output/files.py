"""Files that a command will write, and tables for terminals."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import typer
from rich import box
from rich.table import Table

from pdgw.gateway.errors import GatewayError

# Check the files that a command will write.


def to_be_written(option: typer.CallbackParam, file: Path | None) -> Path | None:
    """Callback of an option that names an output file. GatewayError before the work if the file cannot be written."""
    if file is not None:
        wrong = errno.EISDIR if file.is_dir() else 0 if file.parent.is_dir() else errno.ENOENT
        if wrong:
            raise GatewayError(f"{option.opts[0]} {file}: cannot be written ({os.strerror(wrong)})")
    return file


# Format tables for terminals.


def plain_table(*titles: str, title: str | None = None, narrow: tuple[str, ...] = ()) -> Table:
    """A table without borders that folds long texts and never cuts them. Columns in ``narrow`` are folded last."""
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False)
    for name in titles:
        table.add_column(name, overflow="fold", no_wrap=name in narrow)
    return table
