"""Check the files that a command will write."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import typer

from pdgw.gateway.errors import GatewayError


def to_be_written(option: typer.CallbackParam, file: Path | None) -> Path | None:
    """Callback of an option that names an output file. GatewayError before the work if the file cannot be written."""
    if file is not None:
        wrong = errno.EISDIR if file.is_dir() else 0 if file.parent.is_dir() else errno.ENOENT
        if wrong:
            raise GatewayError(f"{option.opts[0]} {file}: cannot be written ({os.strerror(wrong)})")
    return file
