"""Write the generated types and blocks as PLCopen XML (TC6, version 2.01), for CODESYS, Beremiz and others."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from importlib.metadata import version

from pdgw.tools.plc.declarations import Declaration, Declared, declarations

_SPACE, _XHTML = "http://www.plcopen.org/xml/tc6_0201", "http://www.w3.org/1999/xhtml"
_SECTIONS = {
    "VAR_INPUT": "inputVars",
    "VAR_OUTPUT": "outputVars",
    "VAR_IN_OUT": "inOutVars",
    "VAR": "localVars",
}
_UNITS = {"FUNCTION_BLOCK": "functionBlock", "FUNCTION": "function"}
_ELEMENTARY = {
    *("BOOL", "BYTE", "WORD", "DWORD", "LWORD", "SINT", "INT", "DINT", "LINT"),
    *("USINT", "UINT", "UDINT", "ULINT", "REAL", "LREAL", "TIME"),
}
_ARRAY = re.compile(r"ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)$")


def plcopen_xml(text: str) -> str:
    """Convert a generated Structured Text to an XML document."""
    ET.register_namespace("", _SPACE)
    ET.register_namespace("xhtml", _XHTML)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    project = ET.Element(f"{{{_SPACE}}}project")
    _child(
        project,
        "fileHeader",
        companyName="profidrive-gateway",
        productName="pdgw map",
        productVersion=version("profidrive-gateway"),
        creationDateTime=now,
    )
    coordinates = _child(_child(project, "contentHeader", name="pdgw"), "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        _child(_child(coordinates, language), "scaling", x="1", y="1")
    types = _child(project, "types")
    data_types, units = _child(types, "dataTypes"), _child(types, "pous")
    _child(_child(project, "instances"), "configurations")
    for item in declarations(text):
        if item.kind == "TYPE":
            _structure(data_types, item)
        else:
            _unit(units, item)
    ET.indent(project)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(project, encoding="unicode") + "\n"


def _child(parent: ET.Element, tag: str, /, **attributes: str) -> ET.Element:
    return ET.SubElement(parent, f"{{{_SPACE}}}{tag}", attributes)


def _structure(parent: ET.Element, item: Declaration) -> None:
    struct = _child(_child(_child(parent, "dataType", name=item.name), "baseType"), "struct")
    for variable in item.variables:
        _variable(struct, variable)


def _unit(parent: ET.Element, item: Declaration) -> None:
    unit = _child(parent, "pou", name=item.name, pouType=_UNITS[item.kind])
    interface = _child(unit, "interface")
    if item.result:
        _type(_child(interface, "returnType"), item.result)
    for section, name in _SECTIONS.items():
        variables = item.section(section)
        if variables:
            group = _child(interface, name)
            for variable in variables:
                _variable(group, variable)
    _text(_child(_child(unit, "body"), "ST"), item.body)
    if item.comment:
        _text(_child(unit, "documentation"), item.comment)


def _variable(parent: ET.Element, item: Declared) -> None:
    variable = _child(parent, "variable", name=item.name)
    _type(_child(variable, "type"), item.type)
    if item.initial:
        _child(_child(variable, "initialValue"), "simpleValue", value=item.initial)
    if item.comment:
        _text(_child(variable, "documentation"), item.comment)


def _type(parent: ET.Element, name: str) -> None:
    array = _ARRAY.match(name)
    if array is not None:
        found = _child(parent, "array")
        _child(found, "dimension", lower=array[1], upper=array[2])
        _type(_child(found, "baseType"), array[3])
    elif name == "STRING":
        _child(parent, "string")
    elif name in _ELEMENTARY:
        _child(parent, name)
    else:
        _child(parent, "derived", name=name)


def _text(parent: ET.Element, text: str) -> None:
    ET.SubElement(parent, f"{{{_XHTML}}}p").text = text
