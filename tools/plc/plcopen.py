"""Structured Text in other formats: SCL, PLCopen XML.

Convert Structured Text to SCL of TIA Portal: same tokens, but marked variables, quoted names and versions. Write the generated
types and blocks as PLCopen XML (TC6, version 2.01), for CODESYS, Beremiz and others.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version

from pdgw.tools.plc.declarations import Declaration, Declared, Token, declarations, pieces

_SCL_UNITS = ("TYPE", "FUNCTION_BLOCK", "FUNCTION")
_VERSION = "\nVERSION : 0.1"
_BLOCK = f"\n{{ S7_Optimized_Access := 'TRUE' }}{_VERSION}"


def scl(text: str) -> str:
    """Convert a text to an external source of TIA Portal."""
    found = list(pieces(text))
    own = {following(found, at).key for at, token in enumerate(found) if token.key in _SCL_UNITS}
    return "".join(_Scl(found, own).text())


def following(found: Sequence[Token], at: int, count: int = 1) -> Token:
    """The ``count``-th token after this one, without spaces and comments; this one at the end."""
    rest = (token for token in found[at + 1 :] if token.kind not in {"space", "comment"})
    for _ in range(count - 1):
        next(rest, None)
    return next(rest, found[at])


class _Scl:
    def __init__(self, found: Sequence[Token], own: set[str]) -> None:
        self._found = found
        self._own = own
        self._local: set[str] = set()

    def text(self) -> Iterator[str]:
        previous, unit, declares, depth = "", "", False, 0
        for at, token in enumerate(self._found):
            key, text = token.key, token.text
            behind = following(self._found, at)
            if token.kind in {"space", "comment"}:
                yield text
                continue
            if key in _SCL_UNITS:
                unit, self._local = key, self._locals(at, behind.key) if key != "TYPE" else set()
            if key.startswith("VAR") and unit in {"FUNCTION_BLOCK", "FUNCTION"}:
                declares = True
            depth += (text in {"(", "["}) - (text in {")", "]"})
            if key == "END_VAR":
                declares = False
                yield text if behind.key.startswith("VAR") else f"{text}\nBEGIN"
            elif previous in _SCL_UNITS:
                yield f'"{text}"' + {"TYPE": _VERSION, "FUNCTION_BLOCK": _BLOCK}.get(unit, "")
            elif unit == "TYPE" and text == ":" and behind.key == "STRUCT":
                yield "\n"
            elif unit == "FUNCTION" and key == "VAR":
                yield "VAR_TEMP"
            elif unit == "FUNCTION" and previous == ":" and not declares and not self._begun(at):
                yield f"{text}{_BLOCK}"
            elif token.kind != "word" or previous == ".":
                yield text
            elif key in self._local and not (declares and behind.text in {":", ","} and previous not in {":=", "("}):
                named = depth and behind.text in {":=", "=>"} and previous in {"(", ","}
                yield text if named else f"#{text}"
            else:
                yield f'"{text}"' if key in self._own else text
            previous = key

    def _begun(self, at: int) -> bool:
        """Whether the head of the unit has ended: there was a section of variables since its keyword."""
        for token in reversed(self._found[:at]):
            if token.key.startswith("VAR"):
                return True
            if token.key in _SCL_UNITS:
                return False
        return True

    def _locals(self, at: int, name: str) -> set[str]:
        """The variables of a unit. A function's name is one: it is the result."""
        found, declares, ahead = {name} if self._found[at].key == "FUNCTION" else set(), False, True
        for place in range(at + 1, len(self._found)):
            token = self._found[place]
            if token.key.startswith("END_FUNCTION"):
                break
            if token.key.startswith("VAR"):
                declares = ahead = True
            elif token.key == "END_VAR":
                declares = False
            elif token.text == ";":
                ahead = True
            elif token.text == ":":
                ahead = False
            elif declares and ahead and token.kind == "word" and token.key != "CONSTANT":
                found.add(token.key)
        return found


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
