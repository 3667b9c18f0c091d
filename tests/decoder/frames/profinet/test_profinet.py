"""A PROFINET session as a capture: everything is named without settings, and tshark and scapy read the same."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.pnio import ProfinetIO
from scapy.contrib.pnio_dcp import ProfinetDCP
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS
from pdgw.profidrive.telegrams import Direction
from pdgw.profinet.blocks.alarm import MessageClass
from pdgw.profinet.connection.cmdev import ABORT_TEXTS, Event
from pdgw.profinet.model import INTERFACE_SUBSLOT, PORT_SUBSLOT
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc.records import BlockType, PnioStatus, RecordBlock
from pdgw.profinet.wire import VERSION_SIZE
from pdgw.tools.decoder.frames.engine import Decoder, Packet, Settings, given_axes
from pdgw.tools.decoder.frames.fields import Document
from pdgw.tools.decoder.frames.profinet.blocks import BLOCKS, documents
from pdgw.tools.decoder.frames.profinet.connect import (
    AlarmRecord,
    Change,
    DcpRecord,
    LldpRecord,
    RelationRecord,
    read_request,
)
from pdgw.tools.decoder.frames.profinet.frames import _abort_text
from pdgw.tools.decoder.frames.records import AcyclicRecord, CyclicRecord, LinkType, OtherRecord, Record
from tests.profinet.test_readers import session
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import DEVICE_MAC, INTERFACE_ADJUST, PLC_MAC, PORT_CHECK, Wire, join_multiple


@cache
def frames() -> list[bytes]:
    """A whole session, an aborted one and several writes in one call."""
    wire, _ = session()
    aborted = Wire(seed=3)
    aborted.connect()
    writes = [
        (RecordBlock(BlockType.WRITE_REQUEST, n, aborted.plc.ar_uuid, 0, 0, subslot, index, len(data)), data)
        for n, (subslot, index, data) in enumerate(
            [(PORT_SUBSLOT, 0x802B, PORT_CHECK), (INTERFACE_SUBSLOT, 0x8071, INTERFACE_ADJUST), (1, 1, b"unknown!")]
        )
    ]
    aborted.plc.write((0xFFFFFFFF, 0xFFFF, 0xFFFF), 0xE040, join_multiple(writes), lambda result: None)
    aborted.run(20 * MS)
    aborted.device.end(Event.STOPPED, aborted.now)
    aborted.carry()
    return [*wire.frames, *aborted.frames]


def decode(decoder: Decoder, packets: list[bytes]) -> list[Record]:
    return [
        decoder.decode(Packet(number, number * MS, LinkType.ETHERNET, "eth1", packet))
        for number, packet in enumerate(packets, 1)
    ]


def records(settings: Settings | None = None) -> list[Record]:
    return decode(Decoder(settings or Settings()), frames())


def test_every_packet_of_a_session_is_one_of_its_kinds() -> None:
    found = records()
    assert not [record.summary for record in found if isinstance(record, OtherRecord)]
    details = [record.details() for record in found]
    assert not [item for item in details if "error" in item or any("error" in part for part in item.get("blocks", ()))]
    assert {record.kind for record in found} == {"dcp", "lldp", "rpc", "alarm", "frame", "parameter-request"}


def test_station_telegrams_and_controller_are_found_in_the_capture() -> None:
    decoder = Decoder()
    decode(decoder, frames())
    assert (
        decoder.notices[0] == "observed in Connect of gateway: axis 1 telegram 1, axis 2 telegram 1, axis 3 telegram 83"
    )
    assert [(axis.do_id, axis.telegram) for axis in decoder.axes] == [(1, 1), (2, 9), (3, 83)], "of the last Connect"
    texts = [record.summary for record in decode(Decoder(), frames())]
    assert any(text.startswith("plc-1: alarm low ACK") for text in texts)


def test_drive_objects_of_a_configuration_are_in_the_slots_of_their_order() -> None:
    axes = [replace(axis, do_id=do_id) for axis, do_id in zip(given_axes([1, 9, 83]), (5, 3, 9), strict=True)]
    found = records(Settings(axes))
    cyclic = [record for record in found if isinstance(record, CyclicRecord)]
    assert [unit.axis for unit in cyclic[-1].units] == [5, 3, 9]
    assert {record.direction for record in cyclic} == set(Direction)


def test_relationships_start_and_end() -> None:
    changes: list[tuple[Change, str]] = []
    for record in records():
        if isinstance(record, RelationRecord):
            changes.append((record.change, record.connection.controller))
        elif isinstance(record, AlarmRecord) and record.ended is not None:
            assert "ends the relationship, requested" in record.summary
            changes.append((Change.ENDED, record.ended.controller))
    once = [(change, "plc-1") for change in (Change.REQUESTED, Change.GRANTED, Change.READY, Change.ENDED)]
    assert changes == once * 2


def test_diagnosis_alarms_say_what_appears_and_disappears_and_where() -> None:
    texts = [r.summary for r in records() if isinstance(r, AlarmRecord) and ", slot 1.1, " in r.summary]
    assert texts == [
        "gateway: alarm low DATA: diagnosis, slot 1.1, Overtemperature of the electronic components appears",
        "gateway: alarm low DATA: diagnosis, slot 1.1, Mains fault appears",
        "gateway: alarm low DATA: diagnosis disappears, slot 1.1, Overtemperature of the electronic components others remain",
        "gateway: alarm low DATA: diagnosis disappears, slot 1.1, Mains fault disappears",
    ]


def test_answers_are_timed_from_what_they_answer() -> None:
    kinds = {"dcp": 1 * MS, "alarm": 1 * MS}
    for kind, latency in kinds.items():
        found = [r.latency_ns for r in records() if r.kind == kind and isinstance(r, AcyclicRecord) and r.latency_ns]
        assert found
        assert set(found) == {latency}, kind


def test_writes_of_one_call_are_shown_one_by_one_with_their_status() -> None:
    texts = [record.summary for record in records() if "E040h" in record.summary]
    first = "802Bh (port data check), slot 0.8001h; 8071h (interface adjust), slot 0.8000h; 0001h, slot 0.1"
    assert first in texts[0]
    assert f"{first}: invalid index (DF 80 B0 00)" in texts[1]


def test_frames_of_another_station_are_left_out_unless_it_is_the_chosen_one() -> None:
    other = [_with_macs(frame) for frame in frames()]
    decoder = Decoder()
    decode(decoder, frames())
    decoder.notices.clear()
    found = decode(decoder, other)
    assert all(not record.units for record in found)
    assert any("belongs to another station" in record.summary for record in found if isinstance(record, CyclicRecord))
    assert decoder.notices[0].startswith("ignored: another station of gateway with axis 1 telegram 1")
    assert decoder.notices[0].endswith("; choose it with --station")
    named = Decoder(Settings(station="elsewhere"))
    assert all(not record.units for record in decode(named, frames()))


def _with_macs(frame: bytes) -> bytes:
    """The same packets with the MAC address of another device."""
    return frame.replace(DEVICE_MAC, DEVICE_MAC[:-1] + b"\x77")


def test_a_name_and_filter_that_scapy_builds_are_read() -> None:
    name = ProfinetDCP(
        service_id=5,
        service_type=0,
        option=2,
        sub_option=2,
        name_of_station="press-1",
        dcp_block_length=7,
        dcp_data_length=12,
    )
    request = Ether(src=PLC_MAC.hex(":"), dst="01:0e:cf:00:00:00", type=0x8892) / ProfinetIO(frameID=0xFEFE) / name
    (record,) = decode(Decoder(), [bytes(request)])
    assert isinstance(record, DcpRecord)
    assert record.summary.startswith(f"{PLC_MAC.hex(':')}: DCP identify request: name press-1")


# -- tshark -----------------------------------------------------------------------------------------------------------

_HEX = 16
_BEYOND_TSHARK = {Index.REAL_API, Index.EXPECTED_DATA}
"""Records that tshark 4.0 does not read: it has no F000h, and takes the padding between blocks of F842h for a block."""


def _types(block: Document) -> list[int]:
    """Type of a block and of those inside it."""
    return [block["type"], *chain.from_iterable(_types(item) for item in block.get("blocks", ()))]


def _ours(record: Record) -> list[int]:
    """The block types of a packet as the decoder names them, headers of record services included."""
    details = record.details()
    blocks = [kind for block in details.get("blocks", ()) if "type" in block for kind in _types(block)]
    of_record = details.get("record", {})
    blocks += [kind for block in of_record.get("blocks", ()) for kind in _types(block)]
    return blocks


_KINDS = {
    "RTSync": "PTCP, synchronisation",
    "Announce": "PTCP, announcement",
    "FollowUp": "PTCP, follow-up of a synchronisation",
    "Delay": "PTCP, measurement of a line's delay",
    "Fragment": "a fragment of a larger frame",
    "RTC3": "a cyclic frame of RT class 3 (IRT), not decoded",
}
"""What tshark calls a frame that is only named here, and what it is called here."""


@tshark.needs_tshark
@pytest.mark.tshark
def test_frames_that_are_not_read_are_named_as_by_tshark(tmp_path: Path) -> None:
    ids = [*range(0x0102), 0x0FFF, 0x1000, *range(0xFF00, 0xFFA0)]
    packets = [bytes(12) + bytes.fromhex("8892") + frame_id.to_bytes(2) + bytes(44) for frame_id in ids]
    rows = tshark_frames.read(packets, tmp_path / "ids.pcap", ["_ws.col.Info"])
    seen = set()
    for frame_id, record, row in zip(ids, decode(Decoder(), packets), rows, strict=True):
        kind = next((kind for kind in _KINDS if kind in row["_ws.col.Info"]), None)
        called = _KINDS[kind] if kind else "not a cyclic frame"
        assert record.summary == f"FrameID {frame_id:04X}h is {called}, 46 bytes"
        seen.add(kind)
    assert seen == {None, *_KINDS}


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_names_the_same_blocks_records_names_and_alarms(tmp_path: Path) -> None:
    names = [
        "pn_rt.frame_id",
        "pn_io.block_type",
        "pn_io.index",
        "pn_io.alarm_type",
        "pn_io.slot_nr",
        "pn_dcp.suboption_device_nameofstation",
        "pn_dcp.xid",
        "lldp.port.id",
        "pn_rt.cycle_counter",
        "pn_io.channel_error_type",
    ]
    rows = tshark_frames.read(frames(), tmp_path / "session.pcap", names, every=True)
    compared = dict.fromkeys(("blocks", "index", "alarm", "name", "lldp", "counter", "diagnosis"), 0)
    for record, row in zip(records(), rows, strict=True):
        details = record.details()
        types = [int(part, _HEX) for part in row["pn_io.block_type"].split(",") if part]
        headers = {int(kind) for kind in BlockType}
        if "blocks" in details and not isinstance(record, DcpRecord):
            assert _ours(record) == types, record.summary
            compared["blocks"] += 1
        elif "blocks" in details.get("record", ()) and details["record"]["index"] not in _BEYOND_TSHARK:
            assert _ours(record) == [kind for kind in types if kind not in headers], record.summary
            compared["blocks"] += 1
        if "record" in details:
            index = [int(part, _HEX) for part in row["pn_io.index"].split(",")]
            writes = [item["index"] for item in details["record"].get("writes", ())]
            assert index == [details["record"]["index"], *writes]
            compared["index"] += 1
        if isinstance(record, AlarmRecord) and details["pdu"] == "data":
            (block,) = details["blocks"]
            assert block["alarm_type"] == int(row["pn_io.alarm_type"], 0)
            assert record.slot == block["slot"] == int(row["pn_io.slot_nr"], 0)
            compared["alarm"] += 1
            if "diagnoses" in block:
                (entry,) = block["diagnoses"]
                assert MessageClass(entry["error_type"]) == int(row["pn_io.channel_error_type"], 0)
                compared["diagnosis"] += 1
        if isinstance(record, DcpRecord):
            told = [item["value"] for item in details["blocks"] if item["option"] == "NAME"]
            assert told == [row["pn_dcp.suboption_device_nameofstation"]]
            assert details["xid"] == int(row["pn_dcp.xid"], 0)
            compared["name"] += 1
        if isinstance(record, LldpRecord):
            assert details["port_id"] == row["lldp.port.id"]
            compared["lldp"] += 1
        if isinstance(record, CyclicRecord):
            assert (record.frame_id, record.cycle_counter) == (
                int(row["pn_rt.frame_id"], 0),
                int(row["pn_rt.cycle_counter"], 0),
            )
            compared["counter"] += 1
    assert all(compared.values()), compared


@cache
def examples() -> list[bytes]:
    """A frame of each kind, and every call."""
    kinds = {record.kind: frame for record, frame in zip(records(), frames(), strict=True)}
    return [*kinds.values(), *(frame for frame in frames() if frame[12:14] == b"\x08\x00")]


# -- damage -----------------------------------------------------------------------------------------------------------


@given(st.data())
def test_damaged_packets_of_a_session_are_still_records(data: st.DataObject) -> None:
    decoder = Decoder()
    for _ in range(5):
        packet = bytearray(data.draw(st.sampled_from(examples())))
        for _ in range(data.draw(st.integers(0, 3))):
            packet[data.draw(st.integers(12, len(packet) - 1))] = data.draw(st.integers(0, 255))
        packet = packet[: data.draw(st.integers(0, len(packet)))]
        (record,) = decode(decoder, [bytes(packet)])
        assert record.document()
        assert isinstance(record.summary, str)


@given(st.binary(max_size=80))
def test_any_bytes_are_blocks_or_an_error(content: bytes) -> None:
    for kind in BLOCKS:
        found = documents(kind.to_bytes(2, "big") + len(content).to_bytes(2, "big") + content)
        assert found or len(content) < VERSION_SIZE
    assert isinstance(documents(content), list)


def test_a_connect_without_its_answer_has_no_addresses_and_one_without_cyclic_data_no_plan() -> None:
    connection = read_request(b"")
    assert connection.plan(Direction.ACTUAL) is None
    assert connection.addresses(Direction.ACTUAL) is None
    assert connection.controller == ""
    assert connection.answered(b"").device_mac is None


@tshark.needs_tshark
@pytest.mark.tshark
def test_codes_of_an_alarm_err_with_words_are_those_that_tshark_names(tmp_path: Path) -> None:
    assert len(set(ABORT_TEXTS)) >= 44
    head = bytes.fromhex("020000000002 020000000001 8892 fe01 0001 0001 1400 ffff fffe 0004")
    errors = [head + bytes((0xCF, 0x81, 0xFD, code)) + bytes(28) for code in range(256)]
    rows = tshark_frames.read(errors, tmp_path / "errors.pcap", ["_ws.col.Info"])
    for code, row in enumerate(rows):
        text = _abort_text(PnioStatus(0xCF, 0x81, 0xFD, code))
        assert text.endswith(f"(CF 81 FD {code:02X})")
        known = not row["_ws.col.Info"].endswith(('"reserved"', f'"({code:#04x})"'))
        assert text.startswith("error (") is not known, row


@pytest.mark.parametrize(
    ("data", "name", "fields"),
    [
        (
            "0031 0012 0100 0001 00000000 0001 0002 00000007 0000",
            "ImFilterModules",
            {"apis": [{"api": 0, "slots": [{"slot": 2, "ident": 7, "submodules": []}]}]},
        ),
        (
            "0109 0020 0100 0000 00112233445566778899aabbccddeeff 0000 0001 0001 0000 00000102",
            "IrInfoBlock",
            {
                "ir_data_uuid": "00112233-4455-6677-8899-aabbccddeeff",
                "iocrs": [{"reference": 1, "subframe_offset": 0, "subframe_data": 0x102}],
            },
        ),
        (
            "010a 0008 0100 0003 00000001",
            "SrInfoBlock",
            {"redundancy_data_hold_factor": 3, "properties": 1},
        ),
        (
            "010b 0014 0100 0000 0609 000c 0100 0000 00000002 00000000",
            "ArFsuBlock",
            {"blocks": [{"type": 0x609, "name": "block 0609h", "data": "00000000000200000000"}]},
        ),
    ],
)
def test_blocks_of_other_controllers_and_devices_are_read(data: str, name: str, fields: Document) -> None:
    (block,) = documents(bytes.fromhex(data))
    assert {key: block[key] for key in ("name", *fields)} == {"name": name, **fields}
