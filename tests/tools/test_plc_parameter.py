"""The blocks of the parameter channel: their requests are those of the codec, and they read its responses."""

from __future__ import annotations

from typing import Any

import pytest

from pdgw.peers.plc.structured_text.compiler import Compiler
from pdgw.tools.plc.library import template

BLOCKS = Compiler(lambda: 0, template("parameter")).units


def called(name: str, **inputs: object) -> dict[str, Any]:
    block = BLOCKS[name.upper()]
    values = block.initial | {key.upper(): value for key, value in inputs.items()}
    block.body(values)
    return values


def octets(text: str) -> list[int]:
    """Sixteen bytes that begin with these."""
    return [*bytes.fromhex(text), *bytes(16)][:16]


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [
        ({"Number": 965}, "01 01 00 01 10 00 03C5 0000"),
        ({"Number": 0x1018, "SubIndex": 3, "IsArray": True, "DoId": 1}, "01 01 01 01 10 01 1018 0003"),
        (
            {"Number": 922, "DoId": 1, "Write": True, "Format": 0x42, "Size": 2, "Value": 9},
            "01 02 01 01 10 00 039A 0000 42 01 0009",
        ),
        (
            {"Number": 65000, "DoId": 3, "Write": True, "Format": 0x43, "Size": 4, "Value": 0x01020304},
            "01 02 03 01 10 00 FDE8 0000 43 01 01020304",
        ),
        (
            {"Number": 1, "Write": True, "Format": 0x41, "Size": 1, "Value": 0x7F},
            "01 02 00 01 10 00 0001 0000 41 01 7F00",
        ),
    ],
)
def test_requests_are_those_of_the_parameter_channel(inputs: dict[str, object], expected: str) -> None:
    made = called("PDGW_ParameterRequest", **inputs)
    assert bytes(made["BYTES"][: made["LENGTH"]]) == bytes.fromhex(expected)
    assert not any(made["BYTES"][made["LENGTH"] :])


@pytest.mark.parametrize(
    ("answer", "valid", "error", "number", "value"),
    [
        ("02 01 00 01 06 01 0329", True, False, 0, 0x0329),
        ("02 01 01 01 43 01 01020304", True, False, 0, 0x01020304),
        ("02 01 01 01 41 01 7F00", True, False, 0, 0x7F),
        ("02 02 01 01", True, False, 0, 0),
        ("02 81 01 01 44 01 0000", True, True, 0, 0),
        ("02 81 01 01 44 01 0011", True, True, 0x11, 0x11),
        ("03 01 00 01 06 01 0329", False, False, 0, None),
        ("02 01 01 01 43 01 0102", False, False, 0, 0),
    ],
)
def test_responses_are_read(answer: str, valid: bool, error: bool, number: int, value: int | None) -> None:
    length = len(bytes.fromhex(answer))
    read = called("PDGW_ParameterResponse", Bytes=octets(answer), Length=length, RequestNumber=2)
    assert (read["VALID"], read["ERROR"], read["ERRORNUMBER"]) == (valid, error, number)
    assert value is None or read["VALUE"] == value


def test_the_number_of_a_request_changes_and_is_never_0() -> None:
    block = BLOCKS["PDGW_PARAMETERREQUEST"]
    values = block.initial
    seen = []
    for _ in range(300):
        block.body(values)
        seen.append(values["REQUESTNUMBER"])
    assert seen[:2] == [1, 2]
    assert seen[254:256] == [255, 1]
