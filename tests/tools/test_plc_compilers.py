"""The generated code before independent readers: blark (pip install blark), and matiec and STruC++ where they are in the path."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import cast

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from tests.support.plc.structured_text import config_of, program

EXAMPLES = Path(__file__).parents[2] / "examples"
LIBRARY = os.environ.get("MATIEC_LIBRARY", "/usr/share/matiec/lib")
COMPILERS = {
    "iec2c": ["-l", "-I", LIBRARY, "-T", ".", "plc.st"],  # matiec
    "strucpp": ["plc.st", "-o", "plc.cpp"],
}
"""Commands with their arguments."""

UNIT = re.compile(r"^(TYPE|FUNCTION_BLOCK|FUNCTION|PROGRAM) .*?^(?:END_STRUCT; )?END_\1$", re.DOTALL | re.MULTILINE)


@cache
def complaint_of_blark(unit: str) -> Exception | None:
    """Blark reads some 70 lines a second, so that a unit of several telegrams is read once."""
    if "PDGW_TEST_PLC" not in os.environ:
        pytest.skip("blark needs two minutes for all telegrams: make test-plc")
    parse = pytest.importorskip("blark.parse", reason="no blark (pip install 'profidrive-gateway[plc]')")
    return cast("Exception | None", parse.parse_source_code(unit).exception)


def complaints_of_blark(text: str) -> list[Exception | None]:
    return [found for unit in UNIT.finditer(text) if (found := complaint_of_blark(unit[0])) is not None]


@pytest.mark.parametrize("number", TELEGRAMS)
def test_blark_reads_the_code_of_every_telegram(number: int) -> None:
    text = program(config_of(number))
    assert "".join(UNIT.sub("", text).split()).count("END_") == 0, "units that are not read"
    assert complaints_of_blark(text) == []


def test_blark_reads_the_program_of_the_examples() -> None:
    assert complaints_of_blark((EXAMPLES / "axis_sequence.st").read_text()) == []


def test_blark_refuses_a_damaged_unit() -> None:
    assert complaints_of_blark("FUNCTION_BLOCK Damaged\nVAR\n    a : INT\nEND_VAR\nEND_FUNCTION_BLOCK")


@pytest.mark.parametrize("number", TELEGRAMS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_compilers_accept_the_code_of_every_telegram(compiler: str, number: int, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} in the path (iec2c of matiec needs MATIEC_LIBRARY, its folder lib)")
    (tmp_path / "plc.st").write_text(program(config_of(number)))
    command = [compiler, *COMPILERS[compiler]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, [line for line in done.stderr.splitlines() if "error" in line]) == (0, [])
