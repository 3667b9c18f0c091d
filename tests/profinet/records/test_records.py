"""Records of the device: what is readable by whom, and with which error not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from uuid import UUID

import pytest

from pdgw.base.durations import MS
from pdgw.profinet.blocks.alarm import DiagnosisBlock, MessageClass, Severity
from pdgw.profinet.blocks.connect_blocks import ArType
from pdgw.profinet.blocks.record_blocks import (
    ArData,
    ExpectedIdentification,
    LogData,
    PortDataReal,
    PortStatistic,
    RealIdentification,
)
from pdgw.profinet.connection.cmdev import AbortCode, Event
from pdgw.profinet.model import API_PROFIDRIVE
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc.client import RecordResult
from pdgw.profinet.rpc.records import (
    NIL,
    RECORD_MULTIPLE,
    AccessError,
    BlockType,
    RecordBlock,
    decode_block,
    encode_block,
)
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.connect import AR_UUID, Caller, blocks
from tests.support.wire.profinet import INTERFACE_ADJUST, PLC_IP, PORT_ADJUST, PORT_CHECK, Wire, join_multiple

PORT = (0, 0, 0x8001)
POINT = (API_PROFIDRIVE, 1, 1)


def connected() -> Wire:
    wire = Wire()
    wire.connect()
    return wire


def read(wire: Wire, place: tuple[int, int, int], index: int, *, implicit: bool = False) -> RecordResult:
    results: list[RecordResult] = []
    wire.plc.read(place, index, results.append, implicit=implicit)
    wire.run(100 * MS, lambda: bool(results))
    return results[0]


def write(wire: Wire, place: tuple[int, int, int], index: int, data: bytes) -> RecordResult:
    results: list[RecordResult] = []
    wire.plc.write(place, index, data, results.append)
    wire.run(100 * MS, lambda: bool(results))
    return results[0]


def test_parameter_requests_reach_the_application_and_its_answer_comes_back() -> None:
    wire = connected()
    request = bytes.fromhex("02010001100003c50000")
    assert not write(wire, POINT, 0xB02E, request).status.value
    assert wire.application.records[1, 1, 0xB02E] == request
    assert read(wire, POINT, 0xB02E).data == request
    result = read(wire, (API_PROFIDRIVE, 2, 1), 0xB02E)
    assert (result.status.code, result.status.code1) == (0xDE, AccessError.STATE_CONFLICT)


@pytest.mark.parametrize(
    ("place", "index", "error"),
    [
        ((0x9999, 0, 1), 0xAFF0, AccessError.INVALID_AREA),
        ((0, 9, 1), 0xAFF0, AccessError.INVALID_SLOT),
        ((0, 0, 2), 0xAFF0, AccessError.INVALID_SLOT),
        ((0, 0, 1), 0x0001, AccessError.INVALID_INDEX),
        ((0, 1, 1), 0x8001, AccessError.INVALID_AREA),
        ((0, 0, 1), Index.PORT_DATA_REAL, AccessError.INVALID_INDEX),
        ((API_PROFIDRIVE, 9, 1), Index.REAL_SLOT, AccessError.INVALID_SLOT),
        ((0, 1, 1), Index.REAL_SLOT, AccessError.INVALID_AREA),
        ((API_PROFIDRIVE, 9, 1), Index.EXPECTED_SLOT, AccessError.INVALID_SLOT),
        ((0x9999, 0, 1), Index.REAL_API, AccessError.INVALID_AREA),
    ],
)
def test_missing_record_is_an_error_and_never_an_empty_success(
    place: tuple[int, int, int], index: int, error: AccessError
) -> None:
    result = read(connected(), place, index)
    assert (result.status.code, result.status.decode, result.status.code1) == (0xDE, 0x80, error)


@pytest.mark.parametrize("index", [Index.EXPECTED_AR, Index.MODULE_DIFF, Index.REAL_AR, Index.DIAGNOSIS_ALL_AR])
def test_relationship_records_are_not_readable_without_a_relationship(index: int) -> None:
    result = read(connected(), (0, 0, 1), index, implicit=True)
    assert result.status.code1 == AccessError.STATE_CONFLICT


def test_an_unknown_relationship_reads_nothing() -> None:
    wire = connected()
    wire.plc._records.ar_uuid = UUID(int=1)
    result = read(wire, (0, 0, 1), Index.REAL_API)
    assert (result.status.code, result.status.decode, result.status.code1, result.status.code2) == (0xDE, 0x81, 0x40, 5)


def test_real_and_expected_identification_show_the_model() -> None:
    wire = connected()
    real = RealIdentification.decode(read(wire, (0, 0, 1), Index.REAL_AR).data)
    expected = ExpectedIdentification.decode(read(wire, (0, 0, 1), Index.EXPECTED_AR).data)
    assert real.apis == expected.apis
    found = [(api.api, slot.slot, slot.ident, len(slot.submodules)) for api in real.apis for slot in api.slots]
    assert found == [(0, 0, 1, 3), (0x3A00, 1, 0x1001, 2), (0x3A00, 2, 0x1001, 2), (0x3A00, 3, 0x1002, 2)]


@pytest.mark.parametrize(
    ("index", "places"),
    [
        (0x8000, [(1, 1)]),
        (0x8001, [(1, 1)]),
        (0xC000, [(1, 1), (1, 2)]),
        (0xC001, [(1, 1), (1, 2)]),
        (0xF000, [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]),
    ],
    ids=["expected subslot", "real subslot", "expected slot", "real slot", "real API"],
)
def test_identification_has_only_the_requested_submodules(index: int, places: list[tuple[int, int]]) -> None:
    data = read(connected(), POINT, index).data
    kind = ExpectedIdentification if index in {0x8000, 0xC000} else RealIdentification
    (api,) = kind.decode(data).apis
    assert api.api == API_PROFIDRIVE
    assert [(slot.slot, item.subslot) for slot in api.slots for item in slot.submodules] == places


@pytest.mark.parametrize(
    ("index", "found"),
    [
        (0x800A, {(1, 1): 1, (2, 1): 1, (1, 2): 0}),
        (0xC00A, {(1, 2): 1, (2, 2): 1, (3, 1): 0}),
        (0xE00A, {(3, 1): 2}),
        (0xF00A, {(3, 1): 2}),
    ],
    ids=["subslot", "slot", "relationship", "API"],
)
def test_a_diagnosis_record_has_the_diagnosis_of_its_scope(index: int, found: dict[tuple[int, int], int]) -> None:
    wire = connected()
    for slot in (1, 2):
        wire.device.set_diagnosis((slot, 1), MessageClass.MAINS)
    mains = bytes.fromhex("6800 9001")
    for place, entries in found.items():
        assert read(wire, (API_PROFIDRIVE, *place), index).data.count(mains) == entries
    assert (index == 0xE00A) == (mains in read(wire, (0, 0, 1), index).data), "none in the API of the interface"


def test_octets_of_the_port_are_32_bits_wide() -> None:
    wire = connected()
    wire.device.cm.records.octets[:] = [0x1_0000_0005, 0xFFFF_FF00]
    statistic = PortStatistic.decode(read(wire, PORT, Index.STATISTIC).data)
    assert 5 <= statistic.in_octets < 10_000
    assert statistic.out_octets >= 0xFFFF_FF00 or statistic.out_octets < 10_000


def test_diagnosis_is_readable_while_it_is_present() -> None:
    wire = connected()
    assert read(wire, POINT, Index.DIAGNOSIS_CHANNEL_SUBSLOT).data == b""
    wire.device.set_diagnosis((1, 1), MessageClass.MAINS)
    block = DiagnosisBlock.decode(read(wire, POINT, Index.DIAGNOSIS_CHANNEL_SUBSLOT).data)
    assert (block.api, block.slot, block.subslot) == POINT
    assert block.entries == bytes.fromhex("8000 6800 9001")
    assert read(wire, POINT, Index.DIAGNOSIS_ALL_AR).data == block.encode()
    assert read(wire, (API_PROFIDRIVE, 2, 1), Index.DIAGNOSIS_CHANNEL_SUBSLOT).data == b""


def test_records_of_interface_and_port_are_kept_as_long_as_the_relationship() -> None:
    wire = connected()
    assert not write(wire, PORT, Index.PORT_DATA_ADJUST, PORT_ADJUST).status.value
    assert read(wire, PORT, Index.PORT_DATA_ADJUST).data == PORT_ADJUST
    refused = write(wire, (0, 0, 1), Index.PORT_DATA_ADJUST, PORT_ADJUST)
    assert (refused.status.code, refused.status.code1) == (0xDF, AccessError.INVALID_INDEX)
    assert write(wire, PORT, Index.PORT_DATA_ADJUST, bytes(2000)).status.code1 == AccessError.WRITE_LENGTH
    wire.connect()
    assert read(wire, PORT, Index.PORT_DATA_ADJUST).data == b""


def test_records_of_a_relationship_are_empty_without_one() -> None:
    wire = connected()
    assert not write(wire, PORT, Index.PORT_DATA_ADJUST, PORT_ADJUST).status.value
    result = read(wire, PORT, Index.PORT_DATA_ADJUST, implicit=True)
    assert (result.status.value, result.data) == (0, b"")


def test_a_read_without_a_relationship_is_as_an_implicit_one() -> None:
    wire = connected()
    wire.plc._records.ar_uuid = NIL
    assert RealIdentification.decode(read(wire, (0, 0, 1), Index.REAL_API).data).apis
    assert read(wire, (0, 0, 1), Index.EXPECTED_AR).status.code1 == AccessError.STATE_CONFLICT


def test_application_gets_the_address_of_an_implicit_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = connected()
    told: list[bool] = []

    def answer(block: RecordBlock, *, implicit: bool) -> bytes:
        told.append(implicit)
        return b""

    monkeypatch.setattr(wire.application, "read", answer)
    read(wire, POINT, 0xB02E)
    read(wire, POINT, 0xB02E, implicit=True)
    assert told == [False, True]


def test_the_port_is_shown_with_and_without_a_link() -> None:
    wire = connected()
    shown = []
    for up in (True, False):
        wire.station.link_up = up
        port = PortDataReal.decode(read(wire, PORT, Index.PORT_DATA_REAL, implicit=True).data)
        shown.append((port.mau_type, port.link_state))
    assert shown == [(0x0010, 1), (0, 2)]


def test_the_log_keeps_the_last_sixteen_ends() -> None:
    wire = Wire()
    for _ in range(18):
        wire.connect()
        wire.device.end(Event.STOPPED, wire.now)
        wire.run(MS)
    wire.connect()
    log = LogData.decode(read(wire, (0, 0, 1), Index.LOG_DATA).data)
    assert len(log.entries) == 16


def test_input_and_output_data_of_a_submodule_are_readable_with_their_statuses() -> None:
    axis = (API_PROFIDRIVE, 1, 2)
    wire = connected()
    wire.device.set_input((1, 2), bytes.fromhex("02370800"), good=True)
    wire.plc.set_output((1, 2), bytes.fromhex("047f1000"))
    wire.run(20 * MS)
    assert read(wire, axis, 0x8028).data == bytes.fromhex("0015 000c 0100 01 80 01 80 0004 02370800")
    output = bytes.fromhex("0016 001c 0100 0000 01 01 0004 80 047f1000 80 0014 000a 0100 0000 80 00000000 80")
    assert read(wire, axis, 0x8029, implicit=True).data == output
    wire.plc.set_output((1, 2), bytes.fromhex("047f1000"), good=False)
    wire.run(20 * MS)
    assert read(wire, axis, 0x8029).data[6:8] == b"\0\1", "the device uses the substitute value"
    assert read(wire, (0, 0, 1), 0x8028).data == bytes.fromhex("0015 0008 0100 01 80 01 80 0000")
    assert read(wire, (0, 0, 1), 0x8029).status.value == 0xDE80B000, "a submodule without data has none of it"
    caller = Caller()  # without a relationship
    block = RecordBlock(BlockType.READ_REQUEST, 1, NIL, *axis, 0x8028, 100)
    assert caller.call(encode_block(block), 5)[0].value == 0xDE80B500


def test_records_of_maintenance_and_of_the_whole_device_have_diagnosis_by_severity() -> None:
    wire = connected()
    wire.device.set_diagnosis((1, 1), MessageClass.MAINS)
    wire.device.set_diagnosis((2, 1), MessageClass.BRAKE, severity=Severity.MAINTENANCE_REQUIRED)
    wire.device.set_diagnosis((2, 1), MessageClass.INFEED, severity=Severity.MAINTENANCE_DEMANDED)
    classes = {"mains": bytes.fromhex("9001"), "brake": bytes.fromhex("900d"), "infeed": bytes.fromhex("900c")}

    def found(place: tuple[int, int, int], index: int) -> list[str]:
        data = read(wire, place, index).data
        return [name for name, code in classes.items() if code in data]

    second = (API_PROFIDRIVE, 2, 1)
    for low, expected in {0x0A: [], 0x10: ["brake"], 0x11: ["infeed"], 0x12: ["brake"], 0x13: ["infeed"]}.items():
        assert found(second, 0x8000 + low) == found(second, 0xC000 + low) == expected
        assert found(second, 0xF000 + low) == (expected or ["mains"])
    assert found(second, 0x800C) == ["brake", "infeed"]
    assert found((0, 0, 1), 0xF80C) == ["mains", "brake", "infeed"]


def test_a_refused_record_does_not_end_the_relationship() -> None:
    wire = connected()
    assert write(wire, POINT, 0x1234, b"x").status.value
    wire.run(100 * MS)
    assert wire.device.connected


def test_writes_count_only_from_the_controllers_own_address() -> None:
    caller = Caller()
    assert not caller.connect(blocks())[0].value
    block = RecordBlock(BlockType.WRITE_REQUEST, 1, AR_UUID, API_PROFIDRIVE, 1, 1, 0xB02E, 4)
    arguments = encode_block(block) + b"data"
    unknown_sender = Caller(caller.wire, ("192.168.0.9", 50_000))
    status, _ = unknown_sender.call(arguments, 3)
    assert (status.code, status.decode, status.code1, status.code2) == (0xDF, 0x81, 0x40, 5)
    other = encode_block(replace(block, ar_uuid=UUID(int=3))) + b"data"
    assert caller.call(other, 3)[0].value == 0xDF814005
    multiple = join_multiple([(block, b"data")])
    outer = RecordBlock(BlockType.WRITE_REQUEST, 2, AR_UUID, 0xFFFFFFFF, 0xFFFF, 0xFFFF, RECORD_MULTIPLE, len(multiple))
    assert unknown_sender.call(encode_block(outer) + multiple, 3)[0].value == 0xDF814005
    assert caller.wire.application.writes == 0
    assert caller.call(arguments, 3)[0].value == 0
    assert caller.wire.application.writes == 1


def test_writes_before_prm_end_have_their_own_status() -> None:
    caller = Caller()
    caller.connect(blocks())

    def inner(number: int, slot: int, subslot: int, index: int, data: bytes) -> tuple[RecordBlock, bytes]:
        api = API_PROFIDRIVE if slot else 0
        return RecordBlock(BlockType.WRITE_REQUEST, number, AR_UUID, api, slot, subslot, index, len(data)), data

    data = join_multiple(
        [
            inner(1, 0, 0x8000, Index.INTERFACE_ADJUST, INTERFACE_ADJUST),
            inner(2, 0, 0x8000, 0x8051, b"media redundancy"),
            inner(3, 0, 0x8001, Index.PORT_DATA_CHECK, PORT_CHECK),
            inner(4, 1, 1, 0xB02E, b"request"),
        ]
    )
    outer = RecordBlock(BlockType.WRITE_REQUEST, 9, AR_UUID, 0xFFFFFFFF, 0xFFFF, 0xFFFF, RECORD_MULTIPLE, len(data))
    status, answer = caller.call(encode_block(outer) + data, 3)
    assert not status.value
    statuses = [decode_block(answer[at : at + 64])[0].status.value for at in range(64, len(answer), 64)]
    assert statuses == [0, 0xDF80B000, 0, 0]
    assert caller.wire.device.relation is not None


def test_writing_extends_a_slow_parameterisation() -> None:
    caller = Caller()
    caller.connect(blocks())
    wire = caller.wire
    block = RecordBlock(BlockType.WRITE_REQUEST, 1, AR_UUID, 0, 0, 0x8001, Index.PORT_DATA_CHECK, len(PORT_CHECK))
    for _ in range(5):
        wire.now += 15_000 * MS
        wire.device.poll(wire.now)
        wire.device.outgoing()
        assert caller.call(encode_block(block) + PORT_CHECK, 3)[0].value == 0
    assert wire.device.relation is not None


def test_the_log_keeps_how_relationships_ended() -> None:
    wire = connected()
    wire.plc.release(wire.now)
    wire.run(50 * MS)
    wire.connect()
    log = LogData.decode(read(wire, (0, 0, 1), Index.LOG_DATA).data)
    assert [item.status for item in log.entries] == [AbortCode.RELEASED.status.value]
    assert wire.plc.learned.ended == ""
    assert str(wire.device.station.ip.address) != PLC_IP


def test_the_relationships_of_the_device_can_be_read_with_the_status_of_their_frames() -> None:
    wire = Wire()
    wire.connect()
    wire.run(20 * MS)
    results: list[RecordResult] = []
    wire.plc.read((0, 0, 1), Index.AR_DATA, results.append)
    wire.run(20 * MS)
    (entry,) = ArData.decode(results[0].data).ars
    assert (entry.ar_uuid, entry.ar_type, entry.station_name) == (wire.plc.ar_uuid, ArType.IO, "plc-1")
    assert [api.api for api in entry.apis] == [0, API_PROFIDRIVE]
    relation = wire.device.relation
    assert relation is not None
    assert relation.provider is not None
    assert relation.consumer is not None
    assert [(item.frame_id, item.data_status) for item in entry.iocrs] == [
        (relation.plan.inputs.frame_id if relation.plan.inputs else 0, 0x35),
        (relation.consumer.frame_id, 0x35),
    ]
    assert entry.iocrs[0].cycle_counter
    assert (entry.local_reference, entry.remote_reference) == (relation.reference, wire.plc.project.alarm().reference)


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_the_relationships_with_their_frames_and_references(tmp_path: Path) -> None:
    wire = Wire()
    wire.connect()
    wire.run(20 * MS)
    wire.plc.read((0, 0, 1), Index.AR_DATA, lambda result: None)
    wire.frames.clear()
    wire.run(20 * MS)
    names = ["pn_io.index", "pn_io.number_of_ars", "pn_io.frame_id", "pn_io.localalarmref", "pn_io.ar_type"]
    rows = tshark_frames.read(wire.frames, tmp_path / "ar.pcap", names, every=True)
    (row,) = [row for row in rows if row["pn_io.number_of_ars"]]
    relation = wire.device.relation
    assert relation is not None
    assert relation.consumer is not None
    assert row["pn_io.number_of_ars"] == "1"
    assert int(row["pn_io.ar_type"].split(",")[-1], 0) == ArType.IO
    assert relation.consumer.frame_id in [int(part, 0) for part in row["pn_io.frame_id"].split(",")]
    assert int(row["pn_io.localalarmref"].split(",")[0], 0) == relation.reference
