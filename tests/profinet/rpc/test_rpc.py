"""DCE/RPC record access against scapy's layers and tshark, and its behaviour on a bad network."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.pnio_rpc import (
    IM0Block,
    IODReadReq,
    IODReadRes,
    IODWriteReq,
    IODWriteRes,
    PNIOServiceReqPDU,
    PNIOServiceResPDU,
)
from scapy.layers.dcerpc import DceRpc4
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap

from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.rpc import dcerpc, epm, identification
from pdgw.profinet.rpc.client import RecordCall, RecordCaller, RecordResult
from pdgw.profinet.rpc.dcerpc import Flags, PacketType
from pdgw.profinet.rpc.records import (
    RECORD_GLOBAL,
    RECORD_LOCAL,
    RECORD_MULTIPLE,
    AccessError,
    BlockType,
    RecordBlock,
    RecordRefused,
    UnknownArUuid,
    decode_arguments,
    decode_block,
    split_multiple,
)
from pdgw.profinet.rpc.server import FRAGMENT_TIMEOUT_NS, STRAGGLER_NS, RecordServer
from tests.support.readers import tshark
from tests.support.wire.profinet import join_multiple

ACTIVITY = UUID("11111111-2222-3333-4444-555555555555")
DEVICE = dcerpc.object_uuid(1, 2, 3)
READ_P965 = bytes.fromhex("02 01 00 01 10 00 03 C5 00 00")


@dataclass
class Echo:
    """Keeps what was written; reads return it."""

    record: bytes = b""
    writes: list[bytes] = field(default_factory=list)
    reads: int = 0
    refuse: RecordRefused | None = None

    def write(self, block: RecordBlock, data: bytes) -> None:
        if self.refuse is not None:
            raise self.refuse
        self.record = data
        self.writes.append(data)

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        if self.refuse is not None:
            raise self.refuse
        self.reads += 1
        return self.record


def caller(max_record: int = 4096) -> RecordCaller:
    return RecordCaller(ACTIVITY, DEVICE, max_record=max_record)


def finish(call: RecordCall, server: RecordServer) -> RecordResult:
    """Carry every packet over a perfect network."""
    for packet in call.packets:
        for answer in server.receive(packet, "plc"):
            result = call.receive(answer)
            if isinstance(result, RecordResult):
                return result
    raise AssertionError("no result")


# -- independent readers ----------------------------------------------------------------------------------------------


def test_scapy_reads_the_same_write_and_response() -> None:
    server = RecordServer(Echo(), 4096, boot_time=7)
    call = caller().write(0x3A00, 2, 1, RECORD_LOCAL, READ_P965)
    (packet,) = call.packets
    rpc = DceRpc4(packet)
    assert rpc[DceRpc4].opnum == 3
    assert str(rpc[DceRpc4].act_id) == str(ACTIVITY)
    write = rpc[IODWriteReq]
    assert (write.API, write.slotNumber, write.subslotNumber, write.index) == (0x3A00, 2, 1, RECORD_LOCAL)
    assert write.recordDataLength == len(READ_P965)
    assert bytes(rpc).endswith(READ_P965)
    (answer,) = server.receive(packet, "plc")
    response = DceRpc4(answer)
    assert response[PNIOServiceResPDU].status == 0
    assert response[IODWriteRes].status == 0
    assert response[DceRpc4].server_boot == 7


@pytest.mark.parametrize("little", [True, False])
def test_the_server_serves_packets_scapy_builds(little: bool) -> None:
    handler = Echo(record=b"answer")
    server = RecordServer(handler, 4096)
    for block, operation in (
        (IODWriteReq(seqNum=5, slotNumber=1, subslotNumber=1, index=RECORD_LOCAL, ARUUID=UUID(int=0)) / READ_P965, 3),
        (
            IODReadReq(
                seqNum=6, slotNumber=1, subslotNumber=1, index=RECORD_LOCAL, ARUUID=UUID(int=0), recordDataLength=500
            ),
            2,
        ),
    ):
        rpc = DceRpc4(
            endian="little" if little else "big",
            opnum=operation,
            act_id=ACTIVITY,
            seqnum=5 - operation,
            object=DEVICE,
            flags1=0x20,
        ) / PNIOServiceReqPDU(args_max=4096, max_count=4096, blocks=[block])
        answers = server.receive(bytes(rpc), "plc")
        response = DceRpc4(answers[0])
        assert response[PNIOServiceResPDU].status == 0
        kind = IODReadRes if operation == 2 else IODWriteRes
        assert response[kind].seqNum == (6 if operation == 2 else 5)
    assert handler.writes == [READ_P965]


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_dissects_every_kind_of_packet_without_complaint(tmp_path: Path) -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    # With the nil UUID tshark 4.0 expects a target AR in the write block too and calls the packet malformed.
    plc = RecordCaller(ACTIVITY, DEVICE, UUID(int=1))
    packets: list[bytes] = []

    def carry(call: RecordCall) -> None:
        for packet in call.packets:
            packets.append(packet)
            packets.extend(server.receive(packet, "plc"))

    carry(plc.write(0, 1, 1, RECORD_GLOBAL, READ_P965))
    handler.record = bytes.fromhex("02 01 00 01 06 01 03 29")
    carry(plc.read(0, 1, 1, RECORD_GLOBAL))
    handler.refuse = RecordRefused(AccessError.STATE_CONFLICT)
    carry(plc.read(0, 1, 1, RECORD_GLOBAL))
    carry(plc.write(0, 1, 1, RECORD_GLOBAL, READ_P965))
    handler.refuse = UnknownArUuid()
    carry(plc.read(0, 1, 1, RECORD_GLOBAL))
    handler.refuse = None
    handler.record = identification.encode_im0(identification.Im0(0x1234, "PDGW", "SN7", 3, ("V", 1, 2, 3)))
    carry(plc.read(0, 0, 1, identification.INDEX, implicit=True))
    for number in (1, 2, 3, 4):
        values = tuple(b"x" * 3 for _ in identification.TEXT_FIELDS[number])
        handler.record = identification.encode_im(number, values)
        carry(plc.read(0, 0, 1, identification.INDEX + number))
    capture = tmp_path / "rpc.pcap"
    frames = [
        Ether()
        / IP(src="127.0.0.1", dst="127.0.0.1")
        / (UDP(sport=34964, dport=50000) if packet[1] == 2 else UDP(sport=50000, dport=34964))
        / packet
        for packet in packets
    ]
    wrpcap(str(capture), frames)
    names = [
        "dcerpc.pkt_type",
        "dcerpc.opnum",
        "pn_io.index",
        "pn_io.slot_nr",
        "pn_io.record_data_length",
        "pn_io.error_code",
        "pn_io.error_decode",
        "pn_io.error_code1",
        "pn_io.error_code2",
        "_ws.malformed",
        "pn_io.profidrive.parameter.request_reference",
        "pn_io.profidrive.parameter.number",
        "pn_io.profidrive.parameter.format",
        "pn_io.profidrive.parameter.value_w",
        "pn_io.order_id",
        "pn_io.im_serial_number",
    ]
    rows = tshark.fields(capture, names)
    assert len(rows) == len(packets)
    assert all(row["_ws.malformed"] == "" for row in rows)
    assert {row["dcerpc.pkt_type"] for row in rows} == {"0", "2"}
    request, _, _, answer = rows[:4]
    assert int(request["pn_io.index"], 16) == RECORD_GLOBAL
    assert request["pn_io.profidrive.parameter.request_reference"] in {"2", "0x02"}
    assert int(request["pn_io.profidrive.parameter.number"], 0) == 965
    assert int(answer["pn_io.profidrive.parameter.format"], 0) == 0x06
    assert int(answer["pn_io.profidrive.parameter.value_w"], 0) == 0x0329
    codes = ("pn_io.error_code", "pn_io.error_decode", "pn_io.error_code1", "pn_io.error_code2")
    assert [int(rows[5][name], 0) for name in codes] == [0xDE, 0x80, 0xB5, 0]
    assert [int(rows[7][name], 0) for name in codes] == [0xDF, 0x80, 0xB5, 0]
    assert [int(rows[9][name], 0) for name in codes] == [0xDE, 0x81, 0x40, 5]
    assert rows[11]["pn_io.order_id"].startswith("PDGW")
    assert rows[11]["pn_io.im_serial_number"].startswith("SN7")
    assert (rows[10]["dcerpc.opnum"], rows[12]["dcerpc.opnum"]) == ("5", "2")


def test_im0_is_what_scapy_builds() -> None:
    item = identification.Im0(0x0102, "GATEWAY", "4711", 5, ("V", 1, 2, 3), 6, 0x3A00, 7)
    reference = IM0Block(
        VendorIDHigh=1,
        VendorIDLow=2,
        OrderID=b"GATEWAY".ljust(20),
        IMSerialNumber=b"4711".ljust(16),
        IMHardwareRevision=5,
        IMSWRevisionPrefix="V",
        IMSWRevisionFunctionalEnhancement=1,
        IMSWRevisionBugFix=2,
        IMSWRevisionInternalChange=3,
        IMRevisionCounter=6,
        IMProfileID=0x3A00,
        IMProfileSpecificType=7,
        IMSupported=0x1E,
    )
    assert identification.encode_im0(item) == bytes(reference)
    assert identification.decode_im0(bytes(reference)) == item


@pytest.mark.parametrize(
    ("record", "said"),
    [(b"", "0 bytes"), (bytes(59), "59 bytes"), (bytes(60), "block header of I&M0"), (bytes(61), "61 bytes")],
)
def test_invalid_im0_record_is_reported(record: bytes, said: str) -> None:
    with pytest.raises(ProfidriveError, match=said):
        identification.decode_im0(record)


# -- behaviour --------------------------------------------------------------------------------------------------------


@given(st.binary(min_size=1, max_size=4096))
def test_records_of_every_length_come_back_in_fragments_or_not(data: bytes) -> None:
    server = RecordServer(Echo(), 4096)
    plc = caller()
    call = plc.write(0, 0, 1, RECORD_GLOBAL, data)
    assert len(call.packets) == (1 if len(data) + 84 <= dcerpc.MAX_BODY else -(-(len(data) + 84) // dcerpc.MAX_BODY))
    assert all(len(packet) <= 1472 for packet in call.packets)
    assert finish(call, server).status.value == 0
    assert finish(plc.read(0, 0, 1, RECORD_GLOBAL), server).data == data


def test_fragments_in_any_order_and_repeated_are_one_execution() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    data = bytes(range(256)) * 15
    packets = caller().write(0, 0, 1, RECORD_GLOBAL, data).packets
    assert len(packets) == 3
    for packet in (packets[2], packets[0], packets[2]):
        assert server.receive(packet, "plc") == []
    assert len(server.receive(packets[1], "plc")) == 1
    assert len(server.receive(packets[1], "plc")) == 1, "repeated"
    assert handler.writes == [data]


def test_fragment_is_acknowledged_on_request() -> None:
    server = RecordServer(Echo(), 4096)
    packet = caller().write(0, 0, 1, RECORD_GLOBAL, bytes(3000)).packets[0]
    wanting = bytearray(packet)
    wanting[2] &= ~Flags.NO_FACK
    (fack,) = server.receive(bytes(wanting), "plc")
    header, body = dcerpc.decode_packet(fack)
    assert header.packet_type is PacketType.FACK
    assert header.fragment == 0
    assert len(body) == 16


def test_a_repeated_call_is_answered_again_and_executed_once() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    packet = caller().write(0, 0, 1, RECORD_GLOBAL, READ_P965).packets[0]
    answers = [server.receive(packet, "plc") for _ in range(3)]
    assert answers[0] == answers[1] == answers[2] != []
    assert handler.writes == [READ_P965]
    assert server.repeated == 2


def test_late_packet_of_an_older_call_is_ignored() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    plc = caller()
    old = plc.write(0, 0, 1, RECORD_GLOBAL, b"old").packets[0]
    new = plc.write(0, 0, 1, RECORD_GLOBAL, b"new").packets[0]
    server.receive(old, "plc")
    server.receive(new, "plc")
    named: list[tuple[str, str]] = []
    server.on_dropped = lambda *item: named.append(item)
    for count in (1, 2):
        assert server.receive(old, "plc") == []
        assert server.dropped == count
    assert handler.writes == [b"old", b"new"]
    ((who, why),) = named
    assert who == "plc"
    assert why.startswith("sequence number 0 is below 1 of its last call (interface dea00001-")


def test_sequence_numbers_of_another_interface_are_independent() -> None:
    """Some controllers count their look-ups and their calls of one activity apart."""
    handler = Echo()
    server = RecordServer(handler, 4096)
    plc = caller()
    call = plc.write(0, 0, 1, RECORD_GLOBAL, READ_P965).packets[0]
    header, body = dcerpc.decode_packet(plc.write(0, 0, 1, RECORD_GLOBAL, b"later").packets[0])
    lookup = replace(header, interface=epm.INTERFACE[0], interface_version=epm.INTERFACE[1])
    server.receive(dcerpc.encode_packet(lookup, body), "plc", 0)
    assert server.receive(call, "plc", 1) != []
    ping = bytearray(call)
    ping[1] = PacketType.PING
    assert server.receive(bytes(ping), "plc", 1) == server.receive(call, "plc", 1)
    assert (handler.writes, server.dropped) == ([READ_P965], 0)


def test_restarted_caller_with_small_sequence_numbers_is_served_later() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    plc = caller()
    first = plc.write(0, 0, 1, RECORD_GLOBAL, b"old").packets[0]
    server.receive(plc.write(0, 0, 1, RECORD_GLOBAL, b"new").packets[0], "plc", 0)
    assert server.receive(first, "plc", STRAGGLER_NS) == []
    assert server.receive(first, "plc", STRAGGLER_NS + 1) != []


def test_equal_sequence_numbers_of_two_plcs_are_independent() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    packet = caller().write(0, 0, 1, RECORD_GLOBAL, READ_P965).packets[0]
    server.receive(packet, "one")
    server.receive(packet, "two")
    assert len(handler.writes) == 2


def test_ping_is_answered_with_the_state_of_the_call() -> None:
    server = RecordServer(Echo(), 4096)
    packet = bytearray(caller().write(0, 0, 1, RECORD_GLOBAL, READ_P965).packets[0])
    ping = bytearray(packet)
    ping[1] = PacketType.PING
    assert dcerpc.decode_packet(server.receive(bytes(ping), "plc")[0])[0].packet_type is PacketType.NOCALL
    answer = server.receive(bytes(packet), "plc")
    assert server.receive(bytes(ping), "plc") == answer


def test_unknown_interface_and_operation_are_rejected() -> None:
    server = RecordServer(Echo(), 4096)
    call = caller().write(0, 0, 1, RECORD_GLOBAL, READ_P965)
    other = bytearray(call.packets[0])
    other[24] ^= 1
    header, body = dcerpc.decode_packet(server.receive(bytes(other), "a")[0])
    assert header.packet_type is PacketType.REJECT
    assert dcerpc.decode_status(body, little=header.little_endian) == 0x1C010003
    other = bytearray(call.packets[0])
    other[68] = 0x33
    header, body = dcerpc.decode_packet(server.receive(bytes(other), "b")[0])
    assert dcerpc.decode_status(body, little=header.little_endian) == 0x1C010002
    with pytest.raises(ProfidriveError, match="1C010002h"):
        call.receive(server.receive(bytes(other), "b")[0])


def test_a_refused_access_carries_its_status_in_both_places() -> None:
    handler = Echo(refuse=RecordRefused(AccessError.INVALID_INDEX))
    server = RecordServer(handler, 4096)
    answer = server.receive(caller().write(0, 0, 1, 0x1234, b"x").packets[0], "plc")[0]
    header, body = dcerpc.decode_packet(answer)
    status, arguments = decode_arguments(body, little=header.little_endian)
    assert status == 0xDF80B000
    block, _ = decode_block(arguments)
    assert (block.status.value, block.length) == (0xDF80B000, 0)
    assert "invalid index" in block.status.text


def test_a_write_is_answered_with_the_length_it_had() -> None:
    answer = RecordServer(Echo(), 4096).receive(caller().write(0, 0, 1, 0x1234, b"three").packets[0], "plc")[0]
    header, body = dcerpc.decode_packet(answer)
    status, arguments = decode_arguments(body, little=header.little_endian)
    block, behind = decode_block(arguments)
    assert (status, block.type, block.status.value, block.length, behind) == (0, BlockType.WRITE_RESPONSE, 0, 5, b"")


def test_a_record_longer_than_the_reader_takes_is_refused_not_cut() -> None:
    server = RecordServer(Echo(record=bytes(500)), 4096)
    result = finish(caller(max_record=400).read(0, 0, 1, RECORD_GLOBAL), server)
    assert (result.status.code, result.status.code1) == (0xDE, AccessError.INVALID_PARAMETER)
    assert result.data == b""


def test_a_call_longer_than_the_device_takes_is_rejected() -> None:
    server = RecordServer(Echo(), 1000)
    call = caller().write(0, 0, 1, RECORD_GLOBAL, bytes(3000))
    with pytest.raises(ProfidriveError, match="1C01000B"):
        finish(call, server)


@given(st.binary(max_size=400))
def test_any_datagram_is_survived(data: bytes) -> None:
    server = RecordServer(Echo(), 4096)
    assert server.receive(data, "plc") == []
    header = caller().read(0, 0, 1, RECORD_GLOBAL).packets[0][:80]
    for answer in server.receive(header[:74] + len(data).to_bytes(2, "little") + header[76:] + data, "plc"):
        dcerpc.decode_packet(answer)


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_im_records_round_trip_and_refuse_what_is_not_text(number: int) -> None:
    values = tuple(b"ab".ljust(size) for _, size in identification.TEXT_FIELDS[number])
    record = identification.encode_im(number, values)
    assert identification.decode_im(number, record) == values
    with pytest.raises(ProfidriveError, match=f"I&M{number}"):
        identification.decode_im(number, record[:-1])
    with pytest.raises(ProfidriveError):
        identification.decode_im(number, b"\xff" + record[1:])
    if number != identification.SIGNATURE:
        with pytest.raises(ProfidriveError, match="ASCII"):
            identification.decode_im(number, record[:6] + b"\x07" + record[7:])


def test_several_writes_in_one_have_their_own_status_each() -> None:
    class Picky(Echo):
        def write(self, block: RecordBlock, data: bytes) -> None:
            if block.index == 2:
                raise RecordRefused(AccessError.INVALID_INDEX)
            super().write(block, data)

    handler = Picky()
    plc = caller()

    def write(index: int, data: bytes) -> tuple[RecordBlock, bytes]:
        return RecordBlock(BlockType.WRITE_REQUEST, index, UUID(int=0), 0, 1, 1, index, len(data)), data

    data = join_multiple([write(1, b"a"), write(2, b"bb"), write(3, b"ccc")])
    assert split_multiple(data) == [write(1, b"a"), write(2, b"bb"), write(3, b"ccc")]
    call = plc.write(0xFFFFFFFF, 0xFFFF, 0xFFFF, RECORD_MULTIPLE, data)
    (answer,) = RecordServer(handler, 4096).receive(call.packets[0], "plc")
    assert handler.writes == [b"a", b"ccc"]
    response = DceRpc4(answer)
    assert response[PNIOServiceResPDU].status == 0
    header, body = dcerpc.decode_packet(answer)
    _, arguments = decode_arguments(body, little=header.little_endian)
    inner = [decode_block(arguments[at : at + 64])[0] for at in range(64, len(arguments), 64)]
    assert [(block.index, block.status.value) for block in inner] == [(1, 0), (2, 0xDF80B000), (3, 0)]


def test_several_writes_in_one_that_are_damaged_write_nothing() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    result = finish(caller().write(0, 0, 0, RECORD_MULTIPLE, bytes(70)), server)
    assert (result.status.code, result.status.code1) == (0xDF, AccessError.INVALID_PARAMETER)
    assert handler.writes == []


def test_fragments_that_come_too_late_are_a_new_call() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    packets = caller().write(0, 0, 1, RECORD_GLOBAL, bytes(3000)).packets
    server.receive(packets[0], "plc", 0)
    server.receive(packets[1], "plc", FRAGMENT_TIMEOUT_NS + 1)
    assert server.receive(packets[2], "plc", FRAGMENT_TIMEOUT_NS + 2) == []
    assert handler.writes == []
    assert server.receive(packets[0], "plc", FRAGMENT_TIMEOUT_NS + 3) != []
    assert handler.writes == [bytes(3000)]


def test_unfinished_calls_are_bounded_and_block_no_other_call() -> None:
    handler = Echo()
    server = RecordServer(handler, 4096)
    packets = caller().write(0, 0, 1, RECORD_GLOBAL, bytes(3000)).packets
    server.receive(packets[0], "plc", 0)
    for number in range(100):
        other = RecordCaller(UUID(int=number), DEVICE)
        server.receive(other.write(0, 0, 1, RECORD_GLOBAL, bytes(3000)).packets[0], "mischief", 0)
    for packet in packets:
        answers = server.receive(packet, "plc", 1)
    assert len(answers) == 1
    assert handler.writes == [bytes(3000)]
