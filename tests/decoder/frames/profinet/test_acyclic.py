"""Parameter access: paired over repeated reads, fragments, several callers and lost packets."""

from __future__ import annotations

import struct
from dataclasses import replace
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import (
    Attribute,
    ParameterAddress,
    Request,
    RequestId,
    Response,
    Values,
    encode_request,
    encode_response,
)
from pdgw.profinet.rpc.client import RecordCall, RecordCaller
from pdgw.profinet.rpc.dcerpc import MAX_BODY, PacketType, decode_packet, encode_packet, object_uuid
from pdgw.profinet.rpc.records import RECORD_GLOBAL, AccessError, RecordBlock, RecordRefused
from pdgw.profinet.rpc.server import RecordServer
from pdgw.tools.decoder.frames.profinet.acyclic import AcyclicDecoder
from pdgw.tools.decoder.frames.profinet.connect import StationNames
from pdgw.tools.decoder.frames.profinet.cyclic import CyclicDecoder
from pdgw.tools.decoder.frames.records import (
    AcyclicRecord,
    OtherRecord,
    ParameterRequestRecord,
    ParameterResponseRecord,
    Record,
)

PLC, OTHER_PLC, DEVICE = b"\x0a\0\0\x01", b"\x0a\0\0\x03", b"\x0a\0\0\x02"
AR = UUID(int=1)


class Handler:
    """A device whose next answer the test sets; None: not ready."""

    def __init__(self) -> None:
        self.answer: bytes | None = None

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        if self.answer is None:
            raise RecordRefused(AccessError.STATE_CONFLICT)
        return self.answer

    def write(self, block: RecordBlock, data: bytes) -> None:
        self.answer = None


class Exchange:
    """A PLC and a device whose packets the decoder sees, a millisecond apart."""

    def __init__(self, plc: bytes = PLC, activity: int = 7) -> None:
        self.handler = Handler()
        self.server = RecordServer(self.handler, 4096)
        self.caller = RecordCaller(UUID(int=activity), object_uuid(1, 1, 0x400), AR)
        self.plc = plc

    def call(self, decoder: AcyclicDecoder, call: RecordCall, time_ms: int) -> list[Record]:
        peers = frozenset((self.plc, DEVICE))
        records = []
        for packet in call.packets:
            records.append(decoder.decode(1, time_ms * MS, "", packet, peers))
            for answer in self.server.receive(packet, self.plc):
                records.append(decoder.decode(1, (time_ms + 1) * MS, "", answer, peers))
        return records

    def write(self, decoder: AcyclicDecoder, request: Request, time_ms: int) -> list[Record]:
        return self.call(decoder, self.caller.write(0, 1, 1, RECORD_GLOBAL, encode_request(request)), time_ms)

    def read(self, decoder: AcyclicDecoder, time_ms: int) -> list[Record]:
        return self.call(decoder, self.caller.read(0, 1, 1, RECORD_GLOBAL), time_ms)


def change(pnu: int, value: int) -> Request:
    return Request(3, RequestId.CHANGE, 1, (ParameterAddress(pnu),), (Values(DataType.UNSIGNED16, (value,)),))


class Observer(CyclicDecoder):
    """Keeps the telegrams that were observed."""

    def __init__(self) -> None:
        super().__init__((), lambda _: None)
        self.telegrams: list[tuple[int, int]] = []

    def observe(self, do_id: int, number: int) -> None:
        self.telegrams.append((do_id, number))


def observed() -> tuple[AcyclicDecoder, list[tuple[int, int]]]:
    observer = Observer()
    return AcyclicDecoder(observer, StationNames()), observer.telegrams


def test_a_response_is_paired_with_its_request_over_repeated_reads() -> None:
    decoder, telegrams = observed()
    exchange = Exchange()
    written = exchange.write(decoder, change(922, 9), 0)
    assert isinstance(written[0], ParameterRequestRecord)
    assert "P922.0 = 9" in written[0].summary
    assert isinstance(written[1], AcyclicRecord)
    assert written[1].latency_ns == MS
    refused = exchange.read(decoder, 5)[1]
    assert "state conflict" in refused.summary
    assert not telegrams
    exchange.handler.answer = encode_response(Response(3, RequestId.CHANGE, 1, 1))
    answer = exchange.read(decoder, 10)[1]
    assert isinstance(answer, ParameterResponseRecord)
    assert answer.request == change(922, 9)
    assert answer.latency_ns == 11 * MS
    assert telegrams == [(1, 9)]


def test_rejected_telegram_change_has_no_effect() -> None:
    decoder, telegrams = observed()
    exchange = Exchange()
    exchange.write(decoder, change(922, 9), 0)
    exchange.handler.answer = encode_response(Response(3, RequestId.CHANGE, 1, 1, (Values.error(0x11),)))
    answer = exchange.read(decoder, 1)[1]
    assert "P922.0 = error 11h: request cannot be executed in this state" in answer.summary
    assert not telegrams


def test_reading_p922_shows_the_telegram_too() -> None:
    decoder, telegrams = observed()
    exchange = Exchange()
    exchange.write(decoder, Request(8, RequestId.REQUEST, 2, (ParameterAddress(965), ParameterAddress(922))), 0)
    values = (Values(DataType.UNSIGNED16, (0x329,)), Values(DataType.UNSIGNED16, (100,)))
    exchange.handler.answer = encode_response(Response(8, RequestId.REQUEST, 2, 2, values))
    exchange.read(decoder, 1)
    assert telegrams == [(2, 100)]


def test_a_description_of_the_telegram_parameter_is_not_a_telegram() -> None:
    decoder, telegrams = observed()
    exchange = Exchange()
    exchange.write(
        decoder, Request(8, RequestId.REQUEST, 2, (ParameterAddress(922, 2, attribute=Attribute.DESCRIPTION),)), 0
    )
    values = (Values(DataType.UNSIGNED16, (1,)),)
    exchange.handler.answer = encode_response(Response(8, RequestId.REQUEST, 2, 1, values))
    exchange.read(decoder, 1)
    assert not telegrams


def test_two_plcs_with_the_same_reference_are_not_mixed_up() -> None:
    decoder, _ = observed()
    one, other = Exchange(PLC, 7), Exchange(OTHER_PLC, 8)
    one.write(decoder, change(930, 1), 0)
    other.write(decoder, change(925, 2), 1)
    for exchange, pnu in ((one, 930), (other, 925)):
        exchange.handler.answer = encode_response(Response(3, RequestId.CHANGE, 1, 1))
        answer = exchange.read(decoder, 2)[1]
        assert isinstance(answer, ParameterResponseRecord)
        assert answer.request is not None
        assert answer.request.addresses[0].pnu == pnu


def test_response_without_its_request_is_shown_alone() -> None:
    decoder, _ = observed()
    exchange = Exchange()
    exchange.handler.answer = encode_response(Response(9, RequestId.CHANGE, 1, 1))
    answer = exchange.read(decoder, 0)[1]
    assert isinstance(answer, ParameterResponseRecord)
    assert (answer.request, answer.latency_ns) == (None, None)


def test_fragments_are_put_together() -> None:
    decoder, _ = observed()
    exchange = Exchange()
    exchange.handler.answer = bytes(3000)
    records = exchange.call(decoder, exchange.caller.read(0, 1, 1, 0xAFF0), 0)
    assert [record.summary.rpartition(",")[2] for record in records[1:3]] == [
        " fragment 0 after 1.000 ms",
        " fragment 1 after 1.000 ms",
    ]
    last = records[-1]
    assert "AFF0h (I&M0), slot 1.1, 3000 bytes" in last.summary
    assert len(records) == 1 + -(-(3000 + 84) // MAX_BODY)


def test_data_other_than_a_parameter_request_is_reported() -> None:
    decoder, _ = observed()
    exchange = Exchange()
    record = exchange.call(decoder, exchange.caller.write(0, 1, 1, RECORD_GLOBAL, b"\x01\x07\x00\x01"), 0)[0]
    assert not isinstance(record, ParameterRequestRecord)
    assert "Request ID: '07h'" in record.summary


def test_a_cancelled_write_is_named_by_its_request() -> None:
    decoder, _ = observed()
    exchange = Exchange()
    (packet,) = exchange.caller.write(0, 1, 1, RECORD_GLOBAL, encode_request(change(922, 9))).packets
    header, _ = decode_packet(packet)
    peers = frozenset((PLC, DEVICE))
    asked = decoder.decode(1, 0, "", packet, peers)
    assert isinstance(asked, ParameterRequestRecord)
    of = f": {asked.text} after 2.000 ms"
    for kind, body, text in (
        (PacketType.CANCEL, struct.pack("<II", 0, 1), "write cancelled"),
        (PacketType.CANCEL_ACK, struct.pack("<III", 0, 1, 1), "write cancel acknowledged"),
        (PacketType.FAULT, struct.pack("<I", 0x1C00000D), "write fault: cancelled (1C00000Dh)"),
    ):
        record = decoder.decode(1, 2 * MS, "", encode_packet(replace(header, packet_type=kind), body), peers)
        assert record.summary == text + of


@pytest.mark.parametrize("size", [0, 1, 79, 80, 99, 140])
def test_a_packet_cut_off_is_a_record(size: int) -> None:
    decoder, _ = observed()
    packet = Exchange().caller.write(0, 1, 1, RECORD_GLOBAL, encode_request(change(922, 9))).packets[0]
    record = decoder.decode(1, 0, "", packet[:size], frozenset((PLC, DEVICE)))
    assert isinstance(record, OtherRecord | AcyclicRecord)
    assert record.document()


@given(
    data=st.binary(max_size=60), operation=st.integers(0, 8), packet_type=st.integers(0, 12), flags=st.integers(0, 255)
)
def test_any_body_is_a_record(data: bytes, operation: int, packet_type: int, flags: int) -> None:
    decoder, _ = observed()
    packet = bytearray(Exchange().caller.read(0, 1, 1, RECORD_GLOBAL).packets[0][:80]) + data
    packet[1], packet[2] = packet_type, flags
    struct.pack_into("<H", packet, 68, operation)
    struct.pack_into("<H", packet, 74, len(data))
    assert decoder.decode(1, 0, "", bytes(packet), frozenset((PLC, DEVICE))).document()
