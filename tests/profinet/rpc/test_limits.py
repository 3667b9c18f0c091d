"""Where codec and server of record access draw their lines: each limit from both sides, each damage by its field."""

from __future__ import annotations

import struct
from dataclasses import replace
from uuid import UUID

import pytest

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc, identification
from pdgw.profinet.rpc.client import RecordCaller, RecordResult
from pdgw.profinet.rpc.dcerpc import MAX_BODY, Flags, PacketType, Reassembly, RpcHeader
from pdgw.profinet.rpc.records import (
    RECORD_MULTIPLE,
    AccessError,
    BlockType,
    Operation,
    RecordBlock,
    decode_arguments,
    decode_block,
    encode_arguments,
    encode_block,
    split_answers,
    split_multiple,
)
from pdgw.profinet.rpc.server import FRAGMENT_TIMEOUT_NS, RecordServer
from tests.profinet.rpc.test_rpc import ACTIVITY, DEVICE, Echo, caller, finish

WRITE = encode_block(RecordBlock(BlockType.WRITE_REQUEST, 1, UUID(int=7), 0, 1, 1, 0x1234, 3)) + b"abc"
READ = encode_block(RecordBlock(BlockType.READ_REQUEST, 1, UUID(int=7), 0, 1, 1, 0x1234, 400))


def damaged(data: bytes, at: int, value: int) -> bytes:
    return data[:at] + bytes((value,)) + data[at + 1 :]


@pytest.mark.parametrize(
    ("data", "field"),
    [
        (WRITE[:63], "record block"),
        (damaged(WRITE, 1, 0x07), "BlockType"),
        (damaged(WRITE, 3, 0x3B), "BlockLength"),
        (damaged(WRITE, 4, 2), "BlockVersion"),
        (damaged(WRITE, 5, 1), "BlockVersion"),
        (WRITE[:-1], "RecordDataLength"),
        (WRITE + b"d", "RecordDataLength"),
        (READ + b"d", "data after the block"),
    ],
    ids=["short", "type", "length", "major", "minor", "data missing", "data too much", "data of a read"],
)
def test_a_damaged_record_block_is_refused_with_its_field(data: bytes, field: str) -> None:
    with pytest.raises(ProfidriveError, match=field):
        decode_block(data)


@pytest.mark.parametrize("little", [True, False])
@pytest.mark.parametrize(
    ("counts", "data", "field"),
    [
        ((0, 3, 3, 0, 3), b"abc", ""),
        ((0, 3, 9, 0, 3), b"abcd", ""),
        ((0, 3, 3, 1, 3), b"abc", "NDR array"),
        ((0, 3, 3, 0, 2), b"abc", "NDR array"),
        ((0, 3, 2, 0, 3), b"abc", "NDR array"),
        ((0, 3, 3, 0, 3), b"ab", "ArgsLength"),
    ],
)
def test_arguments_whose_counts_disagree_are_refused(
    little: bool, counts: tuple[int, ...], data: bytes, field: str
) -> None:
    body = struct.pack("<5I" if little else ">5I", *counts) + data
    if field:
        with pytest.raises(ProfidriveError, match=field):
            decode_arguments(body, little=little)
    else:
        assert decode_arguments(body, little=little) == (0, b"abc")
    with pytest.raises(ProfidriveError, match="NDR header"):
        decode_arguments(body[:19], little=little)


def test_errors_of_record_access_have_the_numbers_of_the_standard() -> None:
    assert {item.name: f"{item:02X}" for item in AccessError} == {
        "READ_ERROR": "A0",
        "WRITE_ERROR": "A1",
        "INVALID_INDEX": "B0",
        "WRITE_LENGTH": "B1",
        "INVALID_SLOT": "B2",
        "TYPE_CONFLICT": "B3",
        "INVALID_AREA": "B4",
        "STATE_CONFLICT": "B5",
        "ACCESS_DENIED": "B6",
        "INVALID_RANGE": "B7",
        "INVALID_PARAMETER": "B8",
        "RESOURCE_UNAVAILABLE": "C3",
    }


def test_a_write_inside_several_must_be_a_write_and_whole() -> None:
    assert [data for _, data in split_multiple(WRITE + b"\0" + WRITE)] == [b"abc", b"abc"]
    aligned = replace(decode_block(WRITE)[0], length=4)
    assert split_multiple(encode_block(aligned) + b"abcd") == [(aligned, b"abcd")]
    for data, field in ((WRITE + b"\0" + WRITE[:-1], "RecordDataLength"), (WRITE + b"\0" + WRITE[:60], "inside E040h")):
        with pytest.raises(ProfidriveError, match=field):
            split_multiple(data)
    read = encode_block(RecordBlock(BlockType.READ_REQUEST, 1, UUID(int=7), 0, 1, 1, 0x1234, 0))
    with pytest.raises(ProfidriveError, match="BlockType inside E040h"):
        split_multiple(read)


# -- packets ----------------------------------------------------------------------------------------------------------

HEADER = RpcHeader(
    PacketType.REQUEST, DEVICE, ACTIVITY, 0x01020304, 3, flags=Flags.IDEMPOTENT, server_boot=9, fragment=0x0506
)


@pytest.mark.parametrize("little", [True, False])
def test_every_field_of_a_header_comes_back(little: bool) -> None:
    header = replace(HEADER, serial=0x0708, little_endian=little)
    packet = dcerpc.encode_packet(header, b"body")
    assert (packet[7], packet[79]) == (7, 8), "the serial number stands in two places"
    assert packet[74:76] == (b"\4\0" if little else b"\0\4")
    assert dcerpc.decode_packet(packet) == (header, b"body")
    assert dcerpc.decode_packet(packet + b"padding") == (header, b"body")


def test_packet_types_have_the_numbers_of_the_standard() -> None:
    names = "REQUEST PING RESPONSE FAULT WORKING NOCALL REJECT ACK CANCEL FACK CANCEL_ACK"
    assert {item.name: item.value for item in PacketType} == {name: at for at, name in enumerate(names.split())}


@pytest.mark.parametrize(
    ("at", "value", "field"),
    [
        (0, 5, "version"),
        (1, 11, "packet type"),
        (4, 0x11, "representation"),
        (78, 1, "authentication"),
        (74, 5, "body"),
    ],
)
def test_a_damaged_header_is_refused_with_its_field(at: int, value: int, field: str) -> None:
    packet = dcerpc.encode_packet(HEADER, b"body")
    with pytest.raises(ProfidriveError, match=field):
        dcerpc.decode_packet(damaged(packet, at, value))
    with pytest.raises(ProfidriveError, match="a header of 80 bytes"):
        dcerpc.decode_packet(packet[:79])
    assert dcerpc.decode_packet(damaged(packet, 1, 10))[0].packet_type is PacketType.CANCEL_ACK


def test_reserved_flags_are_ignored() -> None:
    packet = damaged(dcerpc.encode_packet(HEADER, b""), 2, 0xFF)
    flags = dcerpc.decode_packet(packet)[0].flags
    assert flags == sum(Flags)
    assert packet[68:80] == bytes.fromhex("0300 ffff ffff 0000 0605 00 00")


def test_a_body_is_cut_where_it_no_longer_fits_one_packet() -> None:
    assert len(dcerpc.encode_fragments(HEADER, bytes(MAX_BODY))) == 1
    parts = [dcerpc.decode_packet(packet) for packet in dcerpc.encode_fragments(HEADER, bytes(2 * MAX_BODY + 1))]
    assert [(part.fragment, part.serial, len(body)) for part, body in parts] == [
        (0, 0, MAX_BODY),
        (1, 1, MAX_BODY),
        (2, 2, 1),
    ]
    middle = Flags.IDEMPOTENT | Flags.FRAGMENT | Flags.NO_FACK
    assert [part.flags for part, _ in parts] == [middle, middle, middle | Flags.LAST_FRAGMENT]
    exact = [dcerpc.decode_packet(packet) for packet in dcerpc.encode_fragments(HEADER, bytes(2 * MAX_BODY))]
    assert [Flags.LAST_FRAGMENT in part.flags for part, _ in exact] == [False, True]


def test_a_call_may_have_as_many_bytes_as_the_limit_in_one_packet_or_several() -> None:
    first = replace(HEADER, flags=Flags.FRAGMENT, fragment=0)
    last = replace(HEADER, flags=Flags.FRAGMENT | Flags.LAST_FRAGMENT, fragment=1)
    assert Reassembly(5).add(HEADER, b"12345") == b"12345"
    with pytest.raises(ProfidriveError, match="RPC body"):
        Reassembly(5).add(HEADER, b"123456")
    whole = Reassembly(5)
    assert whole.add(last, b"45") is None
    assert whole.add(first, b"123") == b"12345"
    more = Reassembly(5)
    assert more.add(first, b"123") is None
    with pytest.raises(ProfidriveError, match="RPC fragments"):
        more.add(last, b"456")


class _Counted(bytes):
    """A body that counts how often its length is asked for."""

    asked = 0

    def __len__(self) -> int:
        _Counted.asked += 1
        return super().__len__()


def test_a_fragment_costs_as_much_after_a_thousand_others_as_the_first() -> None:
    parts = Reassembly(1 << 15)
    for number in range(1000):
        assert parts.add(replace(HEADER, flags=Flags.FRAGMENT, fragment=number), _Counted(b"1")) is None
    assert _Counted.asked <= 2 * 1000


@pytest.mark.parametrize("first", [1, 3], ids=["the last one first", "behind the last one first"])
def test_a_fragment_after_the_last_one_is_refused(first: int) -> None:
    """Else each of thousands would search for the one that is missing."""
    parts = Reassembly(1 << 15)
    last = replace(HEADER, flags=Flags.FRAGMENT | Flags.LAST_FRAGMENT, fragment=1)
    behind = replace(HEADER, flags=Flags.FRAGMENT, fragment=3)
    one, other = (last, behind) if first == 1 else (behind, last)
    assert parts.add(one, b"1") is None
    with pytest.raises(ProfidriveError, match="RPC fragment"):
        parts.add(other, b"1")


def test_fragments_without_content_are_bounded_too() -> None:
    parts = Reassembly(5)
    for number in range(5):
        assert parts.add(replace(HEADER, flags=Flags.FRAGMENT, fragment=number), b"") is None
    with pytest.raises(ProfidriveError, match="RPC fragments"):
        parts.add(replace(HEADER, flags=Flags.FRAGMENT, fragment=5), b"")


@pytest.mark.parametrize("little", [True, False])
def test_acknowledgement_has_the_window_size(little: bool) -> None:
    header, body = dcerpc.decode_packet(dcerpc.encode_fack(replace(HEADER, serial=3, little_endian=little), 8))
    assert (header.packet_type, header.fragment, header.flags) == (PacketType.FACK, 0x0506, Flags(0))
    order = "<" if little else ">"
    assert struct.unpack(f"{order}BxHIIHH", body) == (0, 8, MAX_BODY, MAX_BODY, 3, 0)


# -- the server -------------------------------------------------------------------------------------------------------


def test_an_answer_longer_than_the_caller_has_room_for_is_refused() -> None:
    server = RecordServer(Echo(record=bytes(100)), 4096)
    codes = []
    for sequence, room in enumerate((64 + 100, 64 + 99)):
        header = replace(HEADER, sequence=sequence, operation=Operation.READ, fragment=0)
        (answer,) = server.receive(dcerpc.encode_packet(header, encode_arguments(room, READ, 500, little=True)), "plc")
        codes.append(decode_arguments(dcerpc.decode_packet(answer)[1], little=True)[0])
    assert codes == [0, 0xDE80B800]


def test_an_answer_longer_than_the_requested_record_is_refused() -> None:
    server = RecordServer(Echo(record=bytes(401)), 4096)
    header = replace(HEADER, operation=Operation.READ, fragment=0)
    (answer,) = server.receive(dcerpc.encode_packet(header, encode_arguments(4096, READ, 4096, little=True)), "plc")
    assert decode_arguments(dcerpc.decode_packet(answer)[1], little=True)[0] == 0xDE80B800


def test_a_call_repeated_long_after_its_answer_is_not_executed_again() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    (packet,) = caller().write(0, 0, 1, 0x1234, b"x").packets
    first = server.receive(packet, "plc", 5)
    assert server.receive(packet, "plc", 5 + 10 * FRAGMENT_TIMEOUT_NS) == first
    assert handler.writes == [b"x"]


def test_sequence_numbers_continue_after_the_last_one() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    (packet,) = caller().write(0, 0, 1, 0x1234, b"x").packets
    for sequence in (0xFFFFFFFE, 0xFFFFFFFF, 0, 1):
        header, body = dcerpc.decode_packet(packet)
        assert server.receive(dcerpc.encode_packet(replace(header, sequence=sequence), body), "plc", 5)
    assert len(handler.writes) == 4
    header, body = dcerpc.decode_packet(packet)
    assert server.receive(dcerpc.encode_packet(replace(header, sequence=0xFFFFFFFF), body), "plc", 5) == []


def test_the_answer_to_several_writes_says_how_long_it_is() -> None:
    inner = WRITE + b"\0" + WRITE
    (packet,) = caller().write(0, 0, 1, RECORD_MULTIPLE, inner).packets
    (answer,) = RecordServer(Echo(), 4096).receive(packet, "plc")
    block, behind = decode_block(decode_arguments(dcerpc.decode_packet(answer)[1], little=True)[1])
    assert (block.length, len(behind)) == (128, 128)
    assert [inner.length for inner in split_answers(behind)] == [3, 3]


def test_unfinished_calls_of_others_cause_no_second_execution() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    calls = [RecordCaller(UUID(int=number), DEVICE).write(0, 0, 1, 0x1234, b"x").packets[0] for number in range(12)]
    for packet in calls:
        server.receive(packet, "plc")
    server.receive(caller().write(0, 0, 1, 0x1234, bytes(3000)).packets[0], "plc")
    for packet in calls:
        assert server.receive(packet, "plc")
    assert len(handler.writes) == 12


def test_a_record_of_exactly_the_requested_length_is_accepted() -> None:
    server = RecordServer(Echo(record=bytes(400)), 4096)
    assert finish(caller(max_record=400).read(0, 0, 1, 0x1234), server).data == bytes(400)


def test_a_read_whose_block_is_a_write_is_rejected_and_not_executed() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    header = replace(HEADER, operation=Operation.READ, fragment=0)
    (answer,) = server.receive(dcerpc.encode_packet(header, encode_arguments(4096, WRITE, 4096, little=True)), "plc")
    rejected, body = dcerpc.decode_packet(answer)
    assert (rejected.packet_type, dcerpc.decode_status(body, little=True)) == (PacketType.REJECT, 0x1C01000B)
    assert (handler.reads, handler.writes) == (0, [])


def test_maybe_call_is_executed_without_an_answer() -> None:
    handler = Echo()
    (packet,) = caller().write(0, 0, 1, 0x1234, b"x").packets
    assert RecordServer(handler, 4096).receive(damaged(packet, 2, Flags.MAYBE), "plc") == []
    assert handler.writes == [b"x"]


def test_another_version_of_the_interface_is_unknown() -> None:
    (packet,) = caller().write(0, 0, 1, 0x1234, b"x").packets
    (answer,) = RecordServer(Echo(), 4096).receive(damaged(packet, 60, 2), "plc")
    header, body = dcerpc.decode_packet(answer)
    assert (header.packet_type, dcerpc.decode_status(body, little=True)) == (PacketType.REJECT, 0x1C010003)
    with pytest.raises(ProfidriveError, match="4 bytes"):
        dcerpc.decode_status(body[:3], little=True)


def test_ping_for_an_incomplete_call_is_answered_with_working() -> None:
    server = RecordServer(Echo(), 4096)
    packet = caller().write(0, 0, 1, 0x1234, bytes(3000)).packets[0]
    server.receive(packet, "plc")
    ping = damaged(packet, 1, PacketType.PING)
    other = damaged(ping, 64, packet[64] + 1)
    kinds = [dcerpc.decode_packet(server.receive(data, "plc")[0])[0].packet_type for data in (ping, other)]
    assert kinds == [PacketType.WORKING, PacketType.NOCALL]
    assert server.receive(damaged(packet, 1, PacketType.RESPONSE), "plc") == []


def test_eight_unfinished_calls_are_kept_and_of_nine_the_oldest_is_forgotten() -> None:
    for count, answered in ((8, 1), (9, 0)):
        server = RecordServer(Echo(), 4096)
        calls = [RecordCaller(UUID(int=n), DEVICE).write(0, 0, 1, 0x1234, bytes(3000)).packets for n in range(count)]
        for packets in calls:
            server.receive(packets[0], "plc")
        for packet in calls[0][1:]:
            answers = server.receive(packet, "plc")
        assert len(answers) == answered
        assert (server.dropped > 0) is (count == 9)


def test_a_fragment_counts_until_the_time_is_over_and_not_after() -> None:
    for late, answered in ((FRAGMENT_TIMEOUT_NS, 1), (FRAGMENT_TIMEOUT_NS + 1, 0)):
        server = RecordServer(Echo(), 4096)
        first, *others = caller().write(0, 0, 1, 0x1234, bytes(3000)).packets
        server.receive(first, "plc", 5)
        for packet in others:
            answers = server.receive(packet, "plc", 5 + late)
        assert len(answers) == answered


def test_the_longest_record_of_the_device_is_taken() -> None:
    handler = Echo()
    assert finish(caller().write(0, 0, 1, 0x1234, bytes(4096)), RecordServer(handler, 4096)).status.value == 0
    assert handler.writes == [bytes(4096)]


def test_sixty_four_callers_are_remembered() -> None:
    for count, executed in ((63, 1), (64, 2)):
        handler = Echo()
        server = RecordServer(handler, 4096)
        (packet,) = caller().write(0, 0, 1, 0x1234, b"mine").packets
        server.receive(packet, "plc")
        for number in range(count):
            server.receive(RecordCaller(UUID(int=number), DEVICE).write(0, 0, 1, 0x1234, b"x").packets[0], "plc")
        server.receive(packet, "plc")
        assert handler.writes.count(b"mine") == executed


# -- the caller -------------------------------------------------------------------------------------------------------


def test_a_call_names_its_relationship_and_an_implicit_read_none() -> None:
    plc = RecordCaller(ACTIVITY, DEVICE, UUID(int=7), max_record=400)
    write = plc.write(0x3A00, 2, 1, 0x1234, b"abc")
    read, implicit = plc.read(0x3A00, 2, 1, 0x1234), plc.read(0x3A00, 2, 1, 0x1234, implicit=True)
    for sequence, (call, operation, ar_uuid, length) in enumerate(
        [
            (write, Operation.WRITE, UUID(int=7), 3),
            (read, Operation.READ, UUID(int=7), 400),
            (implicit, Operation.READ_IMPLICIT, UUID(int=0), 400),
        ]
    ):
        header, body = dcerpc.decode_packet(call.packets[0])
        assert header == RpcHeader(
            PacketType.REQUEST,
            DEVICE,
            ACTIVITY,
            sequence,
            operation,
            flags=Flags.IDEMPOTENT,
            server_boot=0,
            fragment=0,
            serial=0,
        )
        block, _ = decode_block(decode_arguments(body, little=True)[1])
        assert (block.sequence, block.ar_uuid, block.length) == (sequence, ar_uuid, length)
        assert (block.api, block.slot, block.subslot, block.index) == (0x3A00, 2, 1, 0x1234)


def test_only_the_answer_to_this_call_counts() -> None:
    server = RecordServer(Echo(), 4096)
    plc = caller()
    call, later = plc.write(0, 0, 1, 0x1234, b"x"), plc.write(0, 0, 1, 0x1234, b"x")
    (answer,) = server.receive(call.packets[0], "plc")
    assert later.receive(answer) is None, "of another sequence number"
    unknown_sender = RecordCaller(UUID(int=1), DEVICE).write(0, 0, 1, 0x1234, b"x")
    assert unknown_sender.receive(answer) is None, "of another activity"
    assert call.receive(damaged(answer, 1, PacketType.WORKING)) is None
    assert isinstance(call.receive(answer), RecordResult)


def test_fragments_of_an_answer_are_acknowledged_if_the_device_requests_it() -> None:
    server = RecordServer(Echo(record=bytes(3000)), 4096)
    call = caller().read(0, 0, 1, 0x1234)
    first, *others = server.receive(call.packets[0], "plc")
    assert call.receive(first) == []
    wanting = call.receive(damaged(first, 2, first[2] & ~Flags.NO_FACK))
    assert isinstance(wanting, list)
    assert [dcerpc.decode_packet(item)[0].packet_type for item in wanting] == [PacketType.FACK]
    assert dcerpc.decode_packet(wanting[0])[1][2:4] == b"\10\0", "eight more may follow"
    *_, result = (call.receive(item) for item in others)
    assert isinstance(result, RecordResult)
    assert result.data == bytes(3000)


def test_an_answer_with_the_block_of_another_service_is_refused() -> None:
    call = caller().read(0, 0, 1, 0x1234)
    (wrong,) = RecordServer(Echo(), 4096).receive(caller().write(0, 0, 1, 0x1234, b"x").packets[0], "plc")
    with pytest.raises(ProfidriveError, match="BlockType of the answer"):
        call.receive(wrong)


# -- identification ---------------------------------------------------------------------------------------------------


def test_identification_records_byte_by_byte() -> None:
    assert identification.INDEX == 0xAFF0
    expected = {
        (1, (b"press", b"hall 4")): "0021 0038 0100" + b"press".ljust(32).hex() + b"hall 4".ljust(22).hex(),
        (2, (b"2026-11-22",)): "0022 0012 0100" + b"2026-11-22".ljust(16).hex(),
        (3, (b"text",)): "0023 0038 0100" + b"text".ljust(54).hex(),
        (4, (b"\1\xff",)): "0024 0038 0100 01ff" + bytes(52).hex(),
    }
    for (number, values), record in expected.items():
        assert identification.encode_im(number, values) == bytes.fromhex(record)
        padded = identification.decode_im(number, bytes.fromhex(record))
        assert [value.rstrip(b" \0") for value in padded] == list(values)


@pytest.mark.parametrize(("byte", "allowed"), [(0x1F, False), (0x20, True), (0x7E, True), (0x7F, False)])
def test_texts_of_identification_are_visible_characters(byte: int, allowed: bool) -> None:
    record = damaged(identification.encode_im(1, (b"press", b"")), 6 + 31, byte)
    if allowed:
        assert identification.decode_im(1, record)[0][31] == byte
    else:
        with pytest.raises(ProfidriveError, match="IM_Tag_Function"):
            identification.decode_im(1, record)


@pytest.mark.parametrize("at", range(6))
def test_a_record_with_another_header_is_refused(at: int) -> None:
    record = identification.encode_im(2, (b"2026-11-22",))
    with pytest.raises(ProfidriveError, match="block header of I&M2"):
        identification.decode_im(2, damaged(record, at, record[at] ^ 1))


def test_a_text_of_the_device_is_refused_where_it_is_too_long_or_no_ascii() -> None:
    device = identification.Im0(1, "A" * 20, "B" * 16, 1, ("V", 1, 2, 3))
    record = identification.encode_im0(device)
    assert record[8:44] == b"A" * 20 + b"B" * 16
    assert record[44:] == bytes.fromhex("0001 56 010203 0000 3a00 0000 0101 001e")
    for wrong, field in (
        (replace(device, order_id="A" * 21), "OrderID"),
        (replace(device, serial_number="B" * 17), "IM_Serial_Number"),
        (replace(device, order_id="\xe4"), "OrderID"),
    ):
        with pytest.raises(ProfidriveError, match=field):
            identification.encode_im0(wrong)
