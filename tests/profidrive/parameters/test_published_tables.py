"""Types, descriptions and refusals of the parameter channel against published tables, written down here once more.

Sources: OPC 30144 annex B.2 (type codes), tables of units and of identifier bits in drive manuals.
"""

from __future__ import annotations

import struct

import pytest

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import PARAMETERS
from pdgw.profidrive.parameters.codec import (
    Attribute,
    ParameterAddress,
    Request,
    RequestId,
    Response,
    Values,
    decode_response,
    encode_response,
)
from pdgw.profidrive.parameters.description import Description, Pnu
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer, respond

CODES = {
    "BOOLEAN": (1, 1),
    "INTEGER8": (2, 1),
    "INTEGER16": (3, 2),
    "INTEGER32": (4, 4),
    "INTEGER64": (55, 8),
    "UNSIGNED8": (5, 1),
    "UNSIGNED16": (6, 2),
    "UNSIGNED32": (7, 4),
    "UNSIGNED64": (56, 8),
    "FLOATING_POINT": (8, 4),
    "FLOATING_POINT64": (15, 8),
    "VISIBLE_STRING": (9, 1),
    "OCTET_STRING": (10, 1),
    "UNICODE_STRING": (39, 2),
    "TIME_OF_DAY_WITH_DATE": (12, 6),
    "DATE": (50, 7),
    "TIME_OF_DAY": (52, 4),
    "TIME_DIFFERENCE_WITH_DATE": (53, 6),
    "TIME_DIFFERENCE": (54, 4),
    "N2": (113, 2),
    "N4": (114, 4),
    "V2": (115, 2),
    "L2": (116, 2),
    "R2": (117, 2),
    "T2": (118, 2),
    "T4": (119, 4),
    "D2": (120, 2),
    "E2": (121, 2),
    "C4": (122, 4),
    "X2": (123, 2),
    "X4": (124, 4),
}


@pytest.mark.parametrize(("name", "code", "size"), [(name, *row) for name, row in CODES.items()])
def test_type_codes_and_sizes_are_the_published_ones(name: str, code: int, size: int) -> None:
    assert DataType.from_code(code) is DataType[name]
    assert DataType[name].size == size


@pytest.mark.parametrize(
    ("hexadecimal", "value"),
    [
        ("37 01 FF FF FF FF FF FF FF FE", -2),
        ("38 01 FF FF FF FF FF FF FF FE", 2**64 - 2),
        ("0F 01 3F F8" + " 00" * 6, 1.5),
    ],
)
def test_64_bit_values_of_a_device_are_read_as_they_are(hexadecimal: str, value: float) -> None:
    data = bytes.fromhex("01 01 01 01" + hexadecimal)
    response = decode_response(data)
    assert response.values[0].values == (value,)
    assert encode_response(response) == data


class Device:
    """Two parameters of the profile."""

    def parameter(self, pnu: int) -> Parameter:
        return BoundParameter(PARAMETERS[pnu], lambda: 3000, (lambda _: None) if pnu == 952 else None)

    def check_writable(self, pnu: int) -> None:
        pass


def described(pnu: int, element: int) -> Values:
    address = ParameterAddress(pnu, element, 1, Attribute.DESCRIPTION)
    return respond(Request(1, RequestId.REQUEST, 1, (address,)), Device(), 240).values[0]


def test_p60000_is_described_with_its_unit() -> None:
    identifier = described(Pnu.REFERENCE_SPEED, 1)
    assert not identifier.values[0] & 0x0100, "standardisation factor and variable attribute are relevant"
    assert described(Pnu.REFERENCE_SPEED, 3).values == (1.0,)
    assert described(Pnu.REFERENCE_SPEED, 4).values == bytes((11, 67)), "rotation, revolutions per minute"


def test_p948_is_a_time_difference_in_milliseconds() -> None:
    assert PARAMETERS[Pnu.FAULT_TIME].type.code == 54
    whole = BoundParameter(PARAMETERS[Pnu.FAULT_TIME], lambda: [0] * 64).description()
    assert Description.decode(bytes(whole.values(0).values)).unit == (4, -3)  # type: ignore[arg-type]


def test_p952_is_described_as_reset_only() -> None:
    assert described(Pnu.FAULT_SITUATIONS, 1).values[0] & 0xFF00 == 0x2100


def test_description_elements_have_the_types_of_the_profile() -> None:
    types = ["V2", "UNSIGNED16", "FLOATING_POINT", *["OCTET_STRING"] * 2, "VISIBLE_STRING", *["OCTET_STRING"] * 3]
    assert [described(952, element).format.name for element in range(1, 13)] == [*types, "V2", "UNSIGNED16", "V2"]


def test_pnu_0_is_an_impermissible_address() -> None:
    assert answer(bytes.fromhex("01 01 01 01 10 00 00 00 00 00"), lambda _: Device(), 240) == bytes.fromhex(
        "01 81 01 01 44 01 00 16"
    )


@pytest.mark.parametrize("request_id", [0x00, 0x03, 0x41, 0x7F, 0x81, 0xFF])
def test_an_unknown_request_id_is_answered_with_80h(request_id: int) -> None:
    data = struct.pack(">BBBBBBHH", 7, request_id, 1, 1, 0x10, 0, 922, 0)
    assert answer(data, lambda _: Device(), 240) == bytes.fromhex("07 80 01 01 44 01 00 21")


def test_time_with_date_is_rejected_with_an_error_number() -> None:
    request = Request(
        1, RequestId.CHANGE, 1, (ParameterAddress(952),), (Values(DataType.TIME_OF_DAY_WITH_DATE, bytes(6)),)
    )
    assert respond(request, Device(), 240) == Response(1, RequestId.CHANGE, 1, 1, (Values.error(0x05),))
