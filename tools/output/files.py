"""Files that a command is to write."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import typer

from pdgw.gateway.errors import GatewayError


def to_be_written(option: typer.CallbackParam, file: Path | None) -> Path | None:
    """The callback of an option that names a file: GatewayError before the work when there is no place for it."""
    if file is not None:
        wrong = errno.EISDIR if file.is_dir() else 0 if file.parent.is_dir() else errno.ENOENT
        if wrong:
            raise GatewayError(f"{option.opts[0]} {file}: cannot be written ({os.strerror(wrong)})")
    return file
