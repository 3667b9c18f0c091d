"""The parameter channel's codec: worked examples of the reference, round trips, errors for bad requests, and published tables.

Sources of the tables: OPC 30144 annex B.2 (type codes), tables of units and of identifier bits in drive manuals.
"""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.catalogue import PARAMETERS
from pdgw.profidrive.parameters.codec import (
    MAX_ELEMENTS,
    ZERO,
    Attribute,
    ParameterAddress,
    Request,
    RequestError,
    RequestId,
    Response,
    Values,
    check_answers,
    decode_request,
    decode_response,
    encode_request,
    encode_response,
    unswap,
)
from pdgw.profidrive.parameters.description import Description, Pnu
from pdgw.profidrive.parameters.error_numbers import ERROR_TEXTS, ParameterErrorNumber
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer, respond

GUIDE = bytes.fromhex("01 01 00 01 10 01 10 18 00 03")


def test_the_guides_example_reads_1018h_sub_3_in_standard_order() -> None:
    request = Request(1, RequestId.REQUEST, 0, (ParameterAddress(0x1018, 3, 1),))
    assert encode_request(request) == GUIDE
    assert decode_request(GUIDE) == request


def test_the_guides_word_swapped_print_is_recognised() -> None:
    assert unswap(bytes.fromhex("01 01 01 00 01 10 18 10 00 03")) == GUIDE
    assert unswap(GUIDE) is None


def test_example_p965_request_and_response() -> None:
    assert encode_request(Request(2, RequestId.REQUEST, 1, (ParameterAddress(965),))) == bytes.fromhex(
        "02010101 1000 03C5 0000"
    )
    expected = bytes.fromhex("02 01 00 01 06 01 03 29")
    response = Response(2, RequestId.REQUEST, 0, 1, (Values(DataType.UNSIGNED16, (0x0329,)),))
    assert encode_response(response) == expected
    assert decode_response(expected) == response
    word = decode_response(bytes.fromhex("02 01 00 01 42 01 03 29"))
    assert word.values == (Values(DataType.WORD, (0x0329,)),)


def test_example_change_p922_to_9() -> None:
    request = Request(3, RequestId.CHANGE, 1, (ParameterAddress(922),), (Values(DataType.WORD, (9,)),))
    assert encode_request(request) == bytes.fromhex("03 02 01 01 10 00 03 9A 00 00 42 01 00 09")
    assert encode_response(Response(3, RequestId.CHANGE, 1, 1)) == bytes.fromhex("03 02 01 01")


def test_example_missing_pnu_5000() -> None:
    answer = Response(7, RequestId.REQUEST, 1, 1, (Values.error(ParameterErrorNumber.IMPERMISSIBLE_PNU),))
    assert encode_response(answer) == bytes.fromhex("07 81 01 01 44 01 00 00")


def test_example_second_of_two_parameters_is_read_only() -> None:
    failed = Values.error(ParameterErrorNumber.VALUE_CANNOT_BE_CHANGED)
    answer = Response(7, RequestId.CHANGE, 1, 2, (ZERO, failed))
    assert encode_response(answer) == bytes.fromhex("07 82 01 02 40 00 44 01 00 01")
    assert decode_response(encode_response(answer)) == answer


@pytest.mark.parametrize(
    ("number", "code"),
    [
        ("IMPERMISSIBLE_PNU", 0x00),
        ("NO_OPERATION_PRIORITY", 0x0B),
        ("NO_TEXT_ARRAY", 0x0F),
        ("NOT_EXECUTABLE_IN_STATE", 0x11),
        ("VALUE_IMPERMISSIBLE", 0x14),
        ("ADDRESS_IMPERMISSIBLE", 0x16),
        ("DO_DOES_NOT_EXIST", 0x19),
        ("SERVICE_NOT_SUPPORTED", 0x21),
        ("MULTI_PARAMETER_NOT_ALLOWED", 0x23),
    ],
)
def test_error_numbers_are_those_of_the_reference(number: str, code: int) -> None:
    assert ParameterErrorNumber[number] == code
    assert code in ERROR_TEXTS


def values_of(data_type: DataType, count: int) -> st.SearchStrategy[Values]:
    if data_type.is_float:
        numbers = st.floats(width=32 if data_type is DataType.FLOATING_POINT else 64, allow_nan=False)
        return st.tuples(*[numbers] * count).map(lambda v: Values(data_type, v))
    if not data_type.char:
        return st.binary(min_size=count * data_type.size, max_size=count * data_type.size).map(
            lambda data: Values(data_type, data)
        )
    return st.tuples(*[st.integers(*data_type.integer_range)] * count).map(lambda v: Values(data_type, v))


value_types = st.sampled_from([t for t in DataType if t not in {DataType.ZERO, DataType.ERROR}])


@st.composite
def areas(draw: st.DrawFn) -> Values:
    return draw(values_of(draw(value_types), draw(st.integers(1, 12))))


addresses = st.builds(
    ParameterAddress,
    pnu=st.integers(1, 0xFFFF),
    subindex=st.integers(0, 0xFFFE),
    elements=st.integers(0, MAX_ELEMENTS),
    attribute=st.sampled_from([int(attribute) for attribute in Attribute]),
)


@st.composite
def requests(draw: st.DrawFn) -> Request:
    chosen = tuple(draw(st.lists(addresses, min_size=1, max_size=39)))
    request_id = draw(st.sampled_from(RequestId))
    values = tuple(draw(areas()) for _ in chosen) if request_id is RequestId.CHANGE else ()
    return Request(draw(st.integers(1, 255)), request_id, draw(st.integers(0, 254)), chosen, values)


@given(request=requests())
def test_requests_round_trip(request: Request) -> None:
    data = encode_request(request)
    assert len(data) % 2 == 0
    assert decode_request(data) == request


@given(
    reference=st.integers(1, 255),
    do_id=st.integers(0, 254),
    values=st.lists(st.one_of(areas(), st.builds(Values.error, st.integers(0, 0xFFFF))), min_size=1, max_size=39),
)
def test_read_responses_round_trip(reference: int, do_id: int, values: list[Values]) -> None:
    response = Response(reference, RequestId.REQUEST, do_id, len(values), tuple(values))
    assert decode_response(encode_response(response)) == response


@given(
    failures=st.lists(
        st.one_of(st.none(), st.tuples(st.integers(0, 200), st.one_of(st.none(), st.integers(0, 999)))),
        min_size=1,
        max_size=39,
    )
)
def test_change_responses_keep_the_place_of_each_failure(failures: list[tuple[int, int | None] | None]) -> None:
    values = tuple(ZERO if failure is None else Values.error(*failure) for failure in failures)
    if all(failure is None for failure in failures):
        values = ()
    response = Response(1, RequestId.CHANGE, 1, len(failures), values)
    assert decode_response(encode_response(response)) == response


BAD_REQUESTS = [
    ("01 01 00 02 10 01 10 18 00 03", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),  # second address missing
    ("01 01 00 01 10 01 10 18 00 03 00", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),  # trailing garbage
    ("01 01 00 00", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),
    ("01 01 00 28", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),  # 40 parameters
    ("01 03 00 01 10 01 10 18 00 03", ParameterErrorNumber.SERVICE_NOT_SUPPORTED),
    ("00 01 00 01 10 01 10 18 00 03", ParameterErrorNumber.ADDRESS_IMPERMISSIBLE),
    ("03 02 01 01 10 00 03 9A 00 00 99 01 00 09", ParameterErrorNumber.ILLEGAL_FORMAT),
    ("03 02 01 01 10 00 03 9A 00 00 42 02 00 09", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),
    ("03 02 01 01 10 00 03 9A 00 00 42 F0 00 09", ParameterErrorNumber.NUMBER_OF_VALUES_INCONSISTENT),
]


@pytest.mark.parametrize(("text", "number"), BAD_REQUESTS)
def test_a_bad_request_is_answered_with_its_error(text: str, number: ParameterErrorNumber) -> None:
    data = bytes.fromhex(text)
    with pytest.raises(RequestError) as error:
        decode_request(data)
    answer = error.value.response()
    assert answer is not None
    assert answer[0] == data[0]
    assert answer[1] == (data[1] | 0x80 if data[1] in (1, 2) else 0x80)
    assert struct.unpack(">BBH", answer[4:]) == (0x44, 1, number)


@pytest.mark.parametrize("text", ["01 81 00 01 44 00", "01 81 00 01 44 03 00 00 00 00 00 00"])
def test_an_error_value_has_a_number_and_perhaps_a_subindex(text: str) -> None:
    with pytest.raises(ProfidriveError, match=r"No\. of Values at offset 5"):
        decode_response(bytes.fromhex(text))


@pytest.mark.parametrize("size", [0, 1, 3])
def test_without_a_header_no_answer_can_be_built(size: int) -> None:
    with pytest.raises(RequestError) as error:
        decode_request(bytes(size))
    assert error.value.response() is None


@given(data=st.binary(max_size=120))
def test_arbitrary_bytes_raise_nothing_but_the_packages_error(data: bytes) -> None:
    for decode in (decode_request, decode_response):
        try:
            decode(data)
        except ProfidriveError as error:
            assert error.field  # noqa: PT017
    unswap(data)


def test_answers_that_do_not_belong_to_the_request_are_refused() -> None:
    request = decode_request(GUIDE)
    good = Response(1, RequestId.REQUEST, 0, 1, (Values(DataType.UNSIGNED32, (5,)),))
    assert check_answers(request, good) == good.values
    for bad in (
        Response(2, RequestId.REQUEST, 0, 1, good.values),
        Response(1, RequestId.REQUEST, 1, 1, good.values),
        Response(1, RequestId.CHANGE, 0, 1),
        Response(1, RequestId.REQUEST, 0, 2, good.values * 2),
    ):
        with pytest.raises(ProfidriveError):
            check_answers(request, bad)


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        (Request(0, RequestId.REQUEST, 0, (ParameterAddress(1),)), "Request Reference"),
        (Request(1, RequestId.REQUEST, 255, (ParameterAddress(1),)), "DO-ID"),
        (Request(1, RequestId.REQUEST, 0, ()), "No. of Parameters"),
        (Request(1, RequestId.REQUEST, 0, (ParameterAddress(0),)), "PNU"),
        (Request(1, RequestId.REQUEST, 0, (ParameterAddress(1, 65535),)), "Subindex"),
        (Request(1, RequestId.REQUEST, 0, (ParameterAddress(1, 0, 235),)), "No. of Elements"),
        (Request(1, RequestId.CHANGE, 0, (ParameterAddress(1),)), "value areas"),
        (
            Request(1, RequestId.CHANGE, 0, (ParameterAddress(1),), (Values(DataType.WORD, (70000,)),)),
            "values of format WORD",
        ),
        (
            Request(1, RequestId.CHANGE, 0, (ParameterAddress(1),), (Values(DataType.FLOATING_POINT, (1e39,)),)),
            "values of format FLOATING_POINT",
        ),
        (
            Request(1, RequestId.CHANGE, 0, (ParameterAddress(1),), (Values(DataType.VISIBLE_STRING, (65, 66)),)),
            "values of format VISIBLE_STRING",
        ),
        (
            Request(1, RequestId.CHANGE, 0, (ParameterAddress(1),), (Values(DataType.UNICODE_STRING, b"abc"),)),
            "values of format UNICODE_STRING",
        ),
    ],
)
def test_a_request_that_cannot_be_sent_names_the_field(request_: Request, field: str) -> None:
    with pytest.raises(ProfidriveError, match=field):
        encode_request(request_)


def test_the_largest_request_is_taken_and_a_larger_one_refused() -> None:
    largest = Request(255, RequestId.REQUEST, 254, (ParameterAddress(0xFFFF, 0xFFFE, MAX_ELEMENTS),) * 39)
    assert decode_request(encode_request(largest)) == largest
    with pytest.raises(ProfidriveError, match=r"No\. of Parameters"):
        encode_request(Request(1, RequestId.REQUEST, 0, (ParameterAddress(1),) * 40))


def test_the_longest_value_area_is_taken_and_a_longer_one_refused() -> None:
    longest = Values(DataType.OCTET_STRING, bytes(MAX_ELEMENTS))
    request = Request(1, RequestId.CHANGE, 1, (ParameterAddress(1),), (longest,))
    assert decode_request(encode_request(request)) == request
    with pytest.raises(ProfidriveError, match=r"No\. of Values"):
        encode_request(
            Request(1, RequestId.CHANGE, 1, (ParameterAddress(1),), (Values(DataType.OCTET_STRING, bytes(235)),))
        )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("03 02 01 01 10 00 03 9A 00 00 99 01 00 09", "format at offset 10: '99h'"),
        ("03 02 01 01 10 00 03 9A 00 00 42 F0 00 09", r"No\. of Values at offset 11: 240"),
        (
            "03 02 01 01 10 00 03 9A 00 00 42 02 00 09",
            "values at offset 12: 'end of data at offset 14' is not allowed, expected 2 more",
        ),
        ("01 01 00 01 10 01 10 18 00 03 00", "data after the last value at offset 10: '1 bytes'"),
    ],
)
def test_bad_request_names_the_wrong_field(text: str, message: str) -> None:
    with pytest.raises(RequestError, match=message):
        decode_request(bytes.fromhex(text))


def test_response_to_a_rejected_request_matches_any_count() -> None:
    request = Request(1, RequestId.REQUEST, 0, (ParameterAddress(1), ParameterAddress(2)))
    refused = Response(1, RequestId.REQUEST, 0, 1, (Values.error(ParameterErrorNumber.SERVICE_NOT_SUPPORTED),))
    assert check_answers(request, refused) == refused.values
    one_value = Response(1, RequestId.REQUEST, 0, 1, (Values(DataType.WORD, (1,)),))
    with pytest.raises(ProfidriveError, match=r"No\. of Parameters of the response"):
        check_answers(request, one_value)


@pytest.mark.parametrize(
    "text",
    [
        "01 01 01 00",  # no address
        "01 01 01 00 01 10 18 10 00 03 00 00",  # a word too many
        "01 01 01 00 01 40 18 10 00 03",  # no attribute
        "02 01 01 00 00 10 9A 03 00 00",  # a change without values
    ],
)
def test_other_requests_do_not_count_as_word_swapped(text: str) -> None:
    assert unswap(bytes.fromhex(text)) is None


def test_several_swapped_addresses_keep_their_subindices() -> None:
    assert unswap(bytes.fromhex("01 01 02 00 01 10 18 10 00 03 01 10 64 60 00 00")) == bytes.fromhex(
        "01 01 00 02 10 01 10 18 00 03 10 01 60 64 00 00"
    )


# -- published tables -------------------------------------------------------------------------------------------------


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
