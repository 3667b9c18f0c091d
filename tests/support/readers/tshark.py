"""tshark as an independent reader: fields of every packet of a capture."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.buses import PATIENCE_S

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")


def fields(capture: Path, names: Sequence[str], options: Sequence[str] = ()) -> list[dict[str, str]]:
    """The named tshark fields of each packet, first occurrence, as tshark prints them."""
    command = ["tshark", "-n", "-r", str(capture), "-T", "fields", "-E", "occurrence=f", "-E", "separator=/t", *options]
    for name in names:
        command += ["-e", name]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=PATIENCE_S)
    return [dict(zip(names, line.split("\t"), strict=True)) for line in result.stdout.splitlines()]
