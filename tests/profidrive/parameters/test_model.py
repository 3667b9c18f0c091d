"""The answers of the parameter model, without gateway or drive, and the fault buffer against a plain model."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.parameters.catalogue import ParameterSpec, Scope
from pdgw.profidrive.parameters.codec import (
    MAX_ELEMENTS,
    ZERO,
    Attribute,
    ParameterAddress,
    Request,
    RequestId,
    Response,
    Values,
    decode_response,
    encode_request,
)
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused
from pdgw.profidrive.parameters.faults import SIZE, Fault, FaultBuffer
from pdgw.profidrive.parameters.model import BoundParameter, Parameter, answer, converted, respond

_BLOCK = 240
NUMBER, ARRAY, TEXT, READ_ONLY, SIGNED = 922, 945, 919, 964, 60001


def spec(pnu: int, data_type: DataType, **more: object) -> ParameterSpec:
    return ParameterSpec(pnu, f"P{pnu}", "of the test", data_type, Scope.DRIVE_OBJECT, **more)  # type: ignore[arg-type]


@dataclass
class Device:
    """A drive object with one parameter of each kind; ``written`` is what its setters got."""

    locked: bool = False
    name: bytes = b"axis 1"
    written: list[int] = field(default_factory=list)

    def parameter(self, pnu: int) -> Parameter:
        declared: dict[int, BoundParameter] = {
            NUMBER: BoundParameter(
                spec(NUMBER, DataType.UNSIGNED16, low=1, high=100, texts=("off", "on")), lambda: 9, self.written.append
            ),
            ARRAY: BoundParameter(spec(ARRAY, DataType.UNSIGNED16, array=True), lambda: [10, 11, 12, 13]),
            TEXT: BoundParameter(spec(TEXT, DataType.VISIBLE_STRING), lambda: self.name),
            READ_ONLY: BoundParameter(spec(READ_ONLY, DataType.UNSIGNED16), lambda: 5),
            SIGNED: BoundParameter(spec(SIGNED, DataType.INTEGER16, low=-5, high=5), lambda: -3, self.written.append),
        }
        if pnu not in declared:
            raise ParameterRefused(Number.IMPERMISSIBLE_PNU)
        return declared[pnu]

    def check_writable(self, pnu: int) -> None:
        if self.locked:
            raise ParameterRefused(Number.NO_OPERATION_PRIORITY)


def read(*addresses: ParameterAddress, device: Device | None = None, block: int = _BLOCK) -> Response:
    return respond(Request(1, RequestId.REQUEST, 1, addresses), device or Device(), block)


def write(*pairs: tuple[ParameterAddress, Values], device: Device | None = None, block: int = _BLOCK) -> Response:
    addresses, values = zip(*pairs, strict=True)
    return respond(Request(1, RequestId.CHANGE, 1, tuple(addresses), tuple(values)), device or Device(), block)


def word(*numbers: int) -> Values:
    return Values(DataType.UNSIGNED16, numbers)


def error(number: Number, subindex: int | None = None) -> Values:
    return Values.error(number, subindex)


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        (ParameterAddress(NUMBER), word(9)),
        (ParameterAddress(NUMBER, 0, 1), word(9)),
        (ParameterAddress(TEXT), Values(DataType.VISIBLE_STRING, b"axis 1")),
        (ParameterAddress(TEXT, 0, 6), Values(DataType.VISIBLE_STRING, b"axis 1")),
        (ParameterAddress(ARRAY, 0, 4), word(10, 11, 12, 13)),
        (ParameterAddress(ARRAY, 3, 1), word(13)),
        (ParameterAddress(NUMBER, 1, 1, Attribute.TEXT), Values(DataType.VISIBLE_STRING, b"on" + b" " * 14)),
        (
            ParameterAddress(NUMBER, 0, 2, Attribute.TEXT),
            Values(DataType.VISIBLE_STRING, b"off".ljust(16) + b"on".ljust(16)),
        ),
        (ParameterAddress(NUMBER, 0, 0, Attribute.TEXT), Values(DataType.VISIBLE_STRING, b"off".ljust(16))),
    ],
)
def test_a_value_or_text_is_read(address: ParameterAddress, expected: Values) -> None:
    assert read(address).values == (expected,)


REFUSED_READS = [
    (ParameterAddress(0), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(4711), error(Number.IMPERMISSIBLE_PNU)),
    (ParameterAddress(NUMBER, 1, 1), error(Number.NO_ARRAY)),
    (ParameterAddress(NUMBER, 0, 2), error(Number.NO_ARRAY)),
    (ParameterAddress(TEXT, 0, 7), error(Number.NO_ARRAY)),
    (ParameterAddress(ARRAY), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(ARRAY, 4, 1), error(Number.FAULTY_SUBINDEX)),
    (ParameterAddress(ARRAY, 2, 3), error(Number.FAULTY_SUBINDEX, 4)),
    (ParameterAddress(ARRAY, 9, 2), error(Number.FAULTY_SUBINDEX, 9)),
    (ParameterAddress(ARRAY, 2, 0), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(NUMBER, 0, 1, 0x40), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(NUMBER, 0, MAX_ELEMENTS + 1), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(NUMBER, 0xFFFF, 1), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(NUMBER, 0, 2, Attribute.DESCRIPTION), error(Number.ADDRESS_IMPERMISSIBLE)),
    (ParameterAddress(NUMBER, 13, 1, Attribute.DESCRIPTION), error(Number.FAULTY_SUBINDEX)),
    (ParameterAddress(READ_ONLY, 0, 1, Attribute.TEXT), error(Number.NO_TEXT_ARRAY)),
    (ParameterAddress(NUMBER, 2, 1, Attribute.TEXT), error(Number.FAULTY_SUBINDEX)),
    (ParameterAddress(NUMBER, 1, 2, Attribute.TEXT), error(Number.FAULTY_SUBINDEX)),
]


@pytest.mark.parametrize(("address", "expected"), REFUSED_READS)
def test_what_cannot_be_read_is_answered_with_its_error(address: ParameterAddress, expected: Values) -> None:
    assert read(address).values == (expected,)


def test_highest_address_is_answered_as_missing() -> None:
    assert read(ParameterAddress(ARRAY, 0xFFFE, 1)).values == (error(Number.FAULTY_SUBINDEX),)
    assert read(ParameterAddress(ARRAY, 0, MAX_ELEMENTS)).values == (error(Number.FAULTY_SUBINDEX, 4),)


REFUSED_WRITES = [
    (ParameterAddress(READ_ONLY), word(1), error(Number.VALUE_CANNOT_BE_CHANGED)),
    (ParameterAddress(NUMBER), word(0), error(Number.LIMIT_EXCEEDED)),
    (ParameterAddress(NUMBER), word(101), error(Number.LIMIT_EXCEEDED)),
    (ParameterAddress(NUMBER, 1, 1), word(5), error(Number.NO_ARRAY)),
    (ParameterAddress(NUMBER, 0, 2), word(5, 5), error(Number.NO_ARRAY)),
    (ParameterAddress(NUMBER), Values(DataType.UNSIGNED32, (5,)), error(Number.INCORRECT_DATA_TYPE)),
    (ParameterAddress(NUMBER), Values(DataType.INTEGER16, (5,)), error(Number.INCORRECT_DATA_TYPE)),
    (ParameterAddress(NUMBER), Values(DataType.BYTE, (5,)), error(Number.INCORRECT_DATA_TYPE)),
    (ParameterAddress(NUMBER), Values(DataType.OCTET_STRING, b"\0\5"), error(Number.INCORRECT_DATA_TYPE)),
    (ParameterAddress(NUMBER), ZERO, error(Number.ILLEGAL_FORMAT)),
    (ParameterAddress(NUMBER), Values.error(1), error(Number.ILLEGAL_FORMAT)),
    (ParameterAddress(NUMBER), word(5, 6), error(Number.NUMBER_OF_VALUES_INCONSISTENT)),
    (ParameterAddress(NUMBER, 0, 1), word(5, 6), error(Number.NUMBER_OF_VALUES_INCONSISTENT)),
    (ParameterAddress(NUMBER, attribute=Attribute.DESCRIPTION), word(5), error(Number.DESCRIPTION_CANNOT_BE_CHANGED)),
    (ParameterAddress(NUMBER, 0, 1, Attribute.TEXT), word(5), error(Number.TEXT_CANNOT_BE_CHANGED)),
    (ParameterAddress(4711), word(5), error(Number.IMPERMISSIBLE_PNU)),
]


@pytest.mark.parametrize(("address", "values", "expected"), REFUSED_WRITES)
def test_what_cannot_be_written_is_answered_with_its_error_and_changes_nothing(
    address: ParameterAddress, values: Values, expected: Values
) -> None:
    device = Device()
    response = write((address, values), device=device)
    assert response.values == (expected,)
    assert response.negative
    assert device.written == []


@pytest.mark.parametrize("number", [1, 100])
def test_a_value_at_its_limit_is_written_and_the_answer_is_empty(number: int) -> None:
    device = Device()
    response = write((ParameterAddress(NUMBER), word(number)), device=device)
    assert (response.values, response.count, response.negative) == ((), 1, False)
    assert device.written == [number]


def test_one_element_of_a_number_is_the_number() -> None:
    device = Device()
    assert not write((ParameterAddress(NUMBER, 0, 1), word(7)), device=device).negative
    assert device.written == [7]


def test_word_is_accepted_for_a_signed_number_of_its_size() -> None:
    device = Device()
    assert not write((ParameterAddress(SIGNED), Values(DataType.WORD, (0xFFFD,))), device=device).negative
    assert device.written == [-3]


@given(value=st.integers(-(1 << 31), (1 << 31) - 1))
def test_a_double_word_keeps_its_bits(value: int) -> None:
    bits = Values(DataType.DOUBLE_WORD, (value & 0xFFFFFFFF,))
    assert converted(bits, DataType.INTEGER32) == Values(DataType.INTEGER32, (value,))


def test_without_operation_priority_nothing_is_written_and_everything_is_read() -> None:
    device = Device(locked=True)
    assert write((ParameterAddress(NUMBER), word(5)), device=device).values == (error(Number.NO_OPERATION_PRIORITY),)
    assert read(ParameterAddress(NUMBER), device=device).values == (word(9),)
    assert device.written == []


def test_a_failed_parameter_does_not_stop_the_others_and_keeps_its_place() -> None:
    device = Device()
    response = write(
        (ParameterAddress(NUMBER), word(5)),
        (ParameterAddress(READ_ONLY), word(6)),
        (ParameterAddress(NUMBER), word(7)),
        device=device,
    )
    assert response.values == (ZERO, error(Number.VALUE_CANNOT_BE_CHANGED), ZERO)
    assert device.written == [5, 7]
    assert response.count == 3


def test_missing_drive_object_is_an_error() -> None:
    response = respond(
        Request(1, RequestId.REQUEST, 9, (ParameterAddress(NUMBER), ParameterAddress(ARRAY))), None, _BLOCK
    )
    assert response.values == (error(Number.DO_DOES_NOT_EXIST),) * 2


def test_what_does_not_fit_in_the_block_is_refused_and_room_is_left_for_the_errors_of_the_rest() -> None:
    # Header 4, area of the array 2 + 8; each further parameter may need 6.
    whole = 4 + 10
    assert read(ParameterAddress(ARRAY, 0, 4), block=whole).values == (word(10, 11, 12, 13),)
    assert read(ParameterAddress(ARRAY, 0, 4), block=whole - 1).values == (error(Number.RESPONSE_TOO_LONG),)
    both = (ParameterAddress(ARRAY, 0, 4), ParameterAddress(4711))
    assert read(*both, block=whole + 6).values == (word(10, 11, 12, 13), error(Number.IMPERMISSIBLE_PNU))
    assert read(*both, block=whole + 5).values == (error(Number.RESPONSE_TOO_LONG), error(Number.IMPERMISSIBLE_PNU))
    # No room is kept for those that are answered already: an error of 4 bytes before.
    assert read(*reversed(both), block=whole + 4).values == (error(Number.IMPERMISSIBLE_PNU), word(10, 11, 12, 13))


def test_the_padding_of_an_odd_string_takes_room_too() -> None:
    text = ParameterAddress(NUMBER, 0, 1, Attribute.TEXT)
    odd = Device(name=b"drive")
    assert read(ParameterAddress(TEXT), device=odd, block=4 + 2 + 6).values == (
        Values(DataType.VISIBLE_STRING, b"drive"),
    )
    assert read(ParameterAddress(TEXT), device=odd, block=4 + 2 + 5).values == (error(Number.RESPONSE_TOO_LONG),)
    assert read(text, block=4 + 2 + 16).values == (Values(DataType.VISIBLE_STRING, b"off".ljust(16)),)


@given(
    addresses=st.lists(
        st.builds(
            ParameterAddress,
            pnu=st.sampled_from([0, NUMBER, ARRAY, TEXT, READ_ONLY, 4711]),
            subindex=st.integers(0, 5),
            elements=st.integers(0, 5),
            attribute=st.sampled_from([0x10, 0x20, 0x30, 0x40]),
        ),
        min_size=1,
        max_size=39,
    )
)
def test_no_answer_is_longer_than_the_block_and_each_parameter_has_its_place(addresses: list[ParameterAddress]) -> None:
    # Every parameter may need an error: a block has room for at least those.
    block = 4 + 6 * len(addresses) + 60
    data = encode_request(
        Request(7, RequestId.REQUEST, 1, tuple(a for a in addresses if a.pnu) or (ParameterAddress(1),))
    )
    response = answer(data, lambda _: Device(), block)
    assert response is not None
    assert len(response) <= block
    decoded = decode_response(response)
    assert len(decoded.values) == decoded.count == struct.unpack_from(">B", data, 3)[0]


def test_a_request_without_a_header_has_no_answer_and_a_broken_one_has_its_error() -> None:
    find: Callable[[int], Device] = lambda _: Device()  # noqa: E731
    assert answer(b"\1\1\1", find, _BLOCK) is None
    broken = answer(bytes.fromhex("01 03 00 01 10 01 10 18 00 03"), find, _BLOCK)
    assert broken == bytes.fromhex("01 80 00 01 44 01 00 21")


def test_request_addresses_its_drive_object() -> None:
    asked: list[int] = []

    def find(do_id: int) -> Device:
        asked.append(do_id)
        return Device()

    answer(encode_request(Request(1, RequestId.REQUEST, 3, (ParameterAddress(NUMBER),))), find, _BLOCK)
    assert asked == [3]


# -- the description ------------------------------------------------------------------------------------------------------


def test_description_has_the_properties_of_the_parameter() -> None:
    (whole,) = read(ParameterAddress(NUMBER, 0, 1, Attribute.DESCRIPTION)).values
    assert whole.format is DataType.OCTET_STRING
    assert isinstance(whole.values, bytes)
    assert len(whole.values) == 46
    # Identifier: text array, not standardised, writable, UNSIGNED16; name from byte 14, then the limits.
    assert whole.values[:4] == bytes.fromhex("0506 0000")
    assert whole.values[14:30] == b"P922".ljust(16)
    assert whole.values[30:38] == struct.pack(">II", 1, 100)
    assert Description.decode(whole.values) == Description(
        DataType.UNSIGNED16, "P922", writable=True, has_texts=True, low=1, high=100
    )


@pytest.mark.parametrize(
    ("pnu", "identifier", "count"), [(READ_ONLY, 0x0306, 0), (ARRAY, 0x4306, 4), (TEXT, 0x0309, 6)]
)
def test_identifier_and_number_of_elements(pnu: int, identifier: int, count: int) -> None:
    first, second = read(
        ParameterAddress(pnu, 1, 1, Attribute.DESCRIPTION), ParameterAddress(pnu, 2, 1, Attribute.DESCRIPTION)
    ).values
    assert (first, second) == (Values(DataType.V2, (identifier,)), word(count))
    # The element of a description needs no "No. of Elements", and there are twelve.
    unnumbered, twelfth = read(
        ParameterAddress(pnu, 1, 0, Attribute.DESCRIPTION), ParameterAddress(pnu, 12, 1, Attribute.DESCRIPTION)
    ).values
    assert (unnumbered, twelfth) == (Values(DataType.V2, (identifier,)), Values(DataType.V2, (0,)))


@given(
    data_type=st.sampled_from([DataType.INTEGER16, DataType.UNSIGNED32, DataType.INTEGER32]),
    array=st.booleans(),
    writable=st.booleans(),
    texts=st.booleans(),
    count=st.integers(0, 99),
    limits=st.tuples(st.integers(0, 1000), st.integers(0, 1000)),
    reset_only=st.booleans(),
    unit=st.none() | st.tuples(st.integers(0, 0xFF), st.integers(-0x80, 0x7F)),
)
def test_descriptions_round_trip(
    data_type: DataType,
    array: bool,
    writable: bool,
    texts: bool,
    count: int,
    limits: tuple[int, int],
    reset_only: bool,
    unit: tuple[int, int] | None,
) -> None:
    low = -limits[0] if data_type.char.islower() else limits[0]
    item = Description(data_type, "a name", array, count, writable, texts, low, limits[1], reset_only, unit)
    whole = item.values(0).values
    assert isinstance(whole, bytes)
    assert Description.decode(whole) == item


@pytest.mark.parametrize("size", [45, 47])
def test_a_description_of_another_size_is_none(size: int) -> None:
    with pytest.raises(ProfidriveError, match=f"'{size} bytes' is not allowed, expected 46 bytes"):
        Description.decode(bytes(size))


def test_name_of_a_description_has_16_ascii_characters() -> None:
    whole = Description(DataType.UNSIGNED16, "Länge der längsten Achse").values(0).values
    assert Description.decode(bytes(whole)).name == "L?nge der l?ngst"  # type: ignore[arg-type]


# -- the fault buffer -------------------------------------------------------------------------------------------------


class FaultBufferMachine(RuleBasedStateMachine):
    """The model is a plain list of 64 places."""

    def __init__(self) -> None:
        super().__init__()
        self.buffer = FaultBuffer()
        self.model: list[Fault | None] = [None] * SIZE
        self.changes = 0

    @rule(number=st.integers(1, 111))
    def fault(self, number: int) -> None:
        fault = Fault(number, 0x1000 + number, 0, self.changes)
        self.buffer.enter(fault)
        self.changes += 1
        for place in range(8):
            if self.model[place] is None:
                self.model[place] = fault
                break

    @rule()
    def acknowledge(self) -> None:
        self.buffer.acknowledge()
        if self.model[0] is not None:
            self.model = [None] * 8 + self.model[:-8]
            self.changes += 1

    @rule()
    def clear(self) -> None:
        self.buffer.clear()
        if any(self.model):
            self.model = [None] * SIZE
            self.changes += 1

    @invariant()
    def buffer_equals_the_model(self) -> None:
        assert [self.buffer.entry(n) for n in range(SIZE)] == self.model
        assert self.buffer.situations == sum(self.model[n] is not None for n in range(0, SIZE, 8))
        assert self.buffer.counter == self.changes % 65536


TestFaultBuffer = FaultBufferMachine.TestCase


def test_a_ninth_fault_is_counted_and_the_first_eight_stay() -> None:
    buffer = FaultBuffer()
    for number in range(1, 10):
        buffer.enter(Fault(number, 0, 0, 0))
    assert [buffer.entry(n) and buffer.entry(n).number for n in range(8)] == list(range(1, 9))  # type: ignore[union-attr]
    assert buffer.counter == 9


def test_a_fault_that_may_take_fewer_places_leaves_the_others() -> None:
    buffer = FaultBuffer()
    for number in range(1, 5):
        buffer.enter(Fault(number, 0, 0, 0), places=2)
    buffer.enter(Fault(9, 0, 0, 0))
    assert [fault.number for n in range(8) if (fault := buffer.entry(n))] == [1, 2, 9]
    assert buffer.counter == 5


def test_the_eldest_situation_falls_out_after_eight_acknowledgements() -> None:
    buffer = FaultBuffer()
    for number in range(1, 10):
        buffer.enter(Fault(number, 0, 0, 0))
        buffer.acknowledge()
    numbers = [fault.number for n in range(0, SIZE, 8) if (fault := buffer.entry(n))]
    assert numbers == [9, 8, 7, 6, 5, 4, 3]
