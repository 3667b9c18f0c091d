"""The generated code before independent readers: blark (pip install blark), and matiec's iec2c where it is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from tests.support.structured_text import config_of, program

IEC2C = shutil.which("iec2c")
LIBRARY = os.environ.get("MATIEC_LIBRARY", "/usr/share/matiec/lib")


@pytest.mark.parametrize("number", TELEGRAMS)
def test_blark_reads_the_code_of_every_telegram(number: int) -> None:
    parse = pytest.importorskip("blark.parse", reason="no blark (pip install 'profidrive-gateway[plc]')")
    found = parse.parse_source_code(program(config_of(number)))
    found = list(found) if not hasattr(found, "exception") else [found]
    assert [item.exception for item in found] == [None] * len(found)


@pytest.mark.skipif(IEC2C is None, reason="no iec2c of matiec in the path (with MATIEC_LIBRARY, its folder lib)")
@pytest.mark.parametrize("number", TELEGRAMS)
def test_matiec_compiles_the_code_of_every_telegram(number: int, tmp_path: Path) -> None:
    source = tmp_path / "plc.st"
    source.write_text(program(config_of(number)))
    done = subprocess.run(
        [str(IEC2C), "-l", "-I", LIBRARY, "-T", str(tmp_path), str(source)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, [line for line in done.stderr.splitlines() if "error" in line]) == (0, [])
