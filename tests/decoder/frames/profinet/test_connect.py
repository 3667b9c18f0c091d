"""FrameIDs, directions and places from a Connect built by scapy; tshark reads the same."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.pnio_rpc import (
    IOCRAPI,
    ARBlockReq,
    ExpectedSubmodule,
    ExpectedSubmoduleAPI,
    ExpectedSubmoduleBlockReq,
    ExpectedSubmoduleDataDescription,
    IOCRAPIObject,
    IOCRBlockReq,
    IOCRBlockRes,
)
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS
from pdgw.peers.controller.project import Project
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import IOPS_GOOD, STATUS_NORMAL
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.profinet.model import API_PROFIDRIVE, DAP_SLOT, ObjectKind, access_module, object_module
from pdgw.profinet.rpc.dcerpc import Flags, PacketType, RpcHeader, encode_packet, object_uuid
from pdgw.profinet.rpc.records import Operation, encode_arguments
from pdgw.tools.decoder.frames.engine import Decoder, Packet, Settings
from pdgw.tools.decoder.frames.profinet.connect import read_request
from pdgw.tools.decoder.frames.profinet.frame_telegrams import given_axes
from pdgw.tools.decoder.frames.records import CyclicRecord, LinkType, Record
from pdgw.tools.decoder.timeline.builder import TimelineBuilder
from pdgw.tools.decoder.timeline.entries import Anomaly
from tests.profinet.connection.test_connect import CASES
from tests.support.readers import captures, tshark
from tests.support.wire.connect import Caller, Change, blocks

INPUT, OUTPUT = 0x8011, 0x8022
"""FrameIDs: the controller's choice for its inputs, the device's for its outputs."""
DAP = (0, 1)
TELEGRAMS = {1: 9, 3: 100}
"""Telegram by slot; the telegram's submodule has subslot 2."""
OFFSETS = {Direction.ACTUAL: {DAP: 0, (1, 2): 5, (3, 2): 20}, Direction.SETPOINT: {(1, 2): 1, (3, 2): 30}}
IOCS = {Direction.ACTUAL: {(1, 2): 60, (3, 2): 62}, Direction.SETPOINT: {DAP: 0, (1, 2): 25, (3, 2): 75}}
LENGTH = 80


def iocr(kind: int, reference: int, frame_id: int, direction: Direction) -> IOCRBlockReq:
    def items(places: dict[tuple[int, int], int]) -> list[IOCRAPIObject]:
        return [IOCRAPIObject(SlotNumber=s, SubslotNumber=n, FrameOffset=o) for (s, n), o in places.items()]

    api = IOCRAPI(API=0, IODataObjects=items(OFFSETS[direction]), IOCSs=items(IOCS[direction]))
    return IOCRBlockReq(
        IOCRType=kind,
        IOCRReference=reference,
        FrameID=frame_id,
        DataLength=LENGTH,
        IOCRMulticastMACAdd="00:00:00:00:00:00",
        APIs=[api],
    )


def description(kind: int, length: int) -> ExpectedSubmoduleDataDescription:
    return ExpectedSubmoduleDataDescription(
        DataDescription=kind, SubmoduleDataLength=length, LengthIOCS=1, LengthIOPS=1
    )


def submodules(slot: int, number: int, api_number: int) -> ExpectedSubmoduleBlockReq:
    chosen = telegram(number)
    data = ExpectedSubmodule(
        SubslotNumber=2,
        SubmoduleIdentNumber=number,
        SubmoduleProperties_Type=3,
        DataDescription=[description(1, chosen.actuals.size), description(2, chosen.setpoints.size)],
    )
    access = ExpectedSubmodule(SubslotNumber=1, SubmoduleProperties_Type=0, DataDescription=[description(1, 0)])
    api = ExpectedSubmoduleAPI(API=api_number, SlotNumber=slot, ModuleIdentNumber=1, Submodules=[access, data])
    return ExpectedSubmoduleBlockReq(APIs=[api])


def request(api_number: int = API_PROFIDRIVE) -> bytes:
    blocks = [
        ARBlockReq(ARUUID=str(UUID(int=1)), CMInitiatorObjectUUID=str(UUID(int=2)), CMInitiatorStationName=b"plc"),
        iocr(1, 1, INPUT, Direction.ACTUAL),
        iocr(2, 2, 0xFFFF, Direction.SETPOINT),
        *(submodules(slot, number, api_number) for slot, number in TELEGRAMS.items()),
    ]
    return b"".join(bytes(block) for block in blocks)


def response() -> bytes:
    answers = ((1, 1, INPUT), (2, 2, OUTPUT))
    blocks = [IOCRBlockRes(IOCRType=kind, IOCRReference=ref, FrameID=frame_id) for kind, ref, frame_id in answers]
    return b"".join(bytes(block) for block in blocks)


def rpc(packet_type: PacketType, first: int, arguments: bytes, operation: Operation = Operation.CONNECT) -> bytes:
    header = RpcHeader(packet_type, object_uuid(1, 1, 0x400), UUID(int=5), 0, operation, flags=Flags.IDEMPOTENT)
    return encode_packet(header, encode_arguments(first, arguments, max(4096, len(arguments)), little=True))


def ethernet(payload: bytes, *, answer: bool = False, device_port: int = 34964) -> bytes:
    ports = UDP(sport=device_port, dport=50000) if answer else UDP(sport=50000, dport=device_port)
    return bytes(Ether() / IP(src="10.0.0.1", dst="10.0.0.2") / ports / payload)


def connect_packets(status: int = 0, api_number: int = API_PROFIDRIVE) -> list[bytes]:
    first = rpc(PacketType.REQUEST, 4096, request(api_number))
    answer = rpc(PacketType.RESPONSE, status, b"" if status else response())
    return [ethernet(first), ethernet(answer, answer=True)]


def frame(direction: Direction, values: dict[int, tuple[int, ...]]) -> bytes:
    """A frame with the layout of the Connect, after EtherType 8892h."""
    c_sdu = bytearray(LENGTH)
    for slot, number in TELEGRAMS.items():
        half = telegram(number).half(direction)
        offset = OFFSETS[direction][slot, 2]
        half.encode_into(c_sdu, offset, values[slot])
        c_sdu[offset + half.size] = IOPS_GOOD
        c_sdu[IOCS[direction][slot, 2]] = IOPS_GOOD
    frame_id = INPUT if direction is Direction.ACTUAL else OUTPUT
    body = struct.pack(">H", frame_id) + bytes(c_sdu) + struct.pack(">HBB", 64, STATUS_NORMAL, 0)
    return bytes(12) + b"\x88\x92" + body


VALUES = {
    direction: {
        slot: tuple(range(10 * slot, 10 * slot + len(telegram(number).half(direction).signals)))
        for slot, number in TELEGRAMS.items()
    }
    for direction in Direction
}


def decode(decoder: Decoder, packets: list[bytes]) -> list[Record]:
    return [decoder.decode(Packet(1, 0, LinkType.ETHERNET, "", packet)) for packet in packets]


@pytest.mark.parametrize("axes", [(), (9, 1, 100)])
def test_frames_are_read_as_the_connect_places_them(axes: tuple[int, ...]) -> None:
    decoder = Decoder(Settings(given_axes(axes)))
    asked, answered = decode(decoder, connect_packets())
    assert "connect request: actuals FrameID 8011h, setpoints FrameID FFFFh" in asked.summary
    assert "connect response: actuals FrameID 8011h, setpoints FrameID 8022h" in answered.summary
    assert decoder.notices == ["observed in Connect: axis 1 telegram 9, axis 3 telegram 100"]
    for direction in Direction:
        (record,) = decode(decoder, [frame(direction, VALUES[direction])])
        assert isinstance(record, CyclicRecord)
        assert record.direction is direction
        assert {unit.axis: unit.values for unit in record.units} == VALUES[direction]
        assert {unit.layout.telegram for unit in record.units} == {9, 100}
        assert {(unit.iops, unit.iocs) for unit in record.units} == {(IOPS_GOOD, IOPS_GOOD)}


def test_plain_modules_are_not_drive_objects() -> None:
    """Their data may be as long as a telegram's: only PROFIdrive's API has telegrams."""
    decoder = Decoder()
    _, answered = decode(decoder, connect_packets(api_number=0))
    assert "setpoints FrameID 8022h" in answered.summary
    assert decoder.notices == []
    (record,) = decode(decoder, [frame(Direction.ACTUAL, VALUES[Direction.ACTUAL])])
    assert isinstance(record, CyclicRecord)
    assert record.units == ()


def test_given_axes_may_be_in_plain_modules() -> None:
    """Gateways without the profile have their telegrams there."""
    decoder = Decoder(Settings(given_axes((9, 1, 100))))
    decode(decoder, connect_packets(api_number=0))
    (record,) = decode(decoder, [frame(Direction.ACTUAL, VALUES[Direction.ACTUAL])])
    assert isinstance(record, CyclicRecord)
    assert {unit.axis: unit.values for unit in record.units} == VALUES[Direction.ACTUAL]


@pytest.mark.parametrize("little", [True, False])
def test_a_device_may_answer_from_a_port_of_its_own(little: bool) -> None:
    """As most do; the controller's next requests go there. Both byte orders exist."""
    decoder = Decoder()
    asked, _ = connect_packets()
    header = RpcHeader(
        PacketType.RESPONSE, object_uuid(1, 1, 0x400), UUID(int=5), 0, Operation.CONNECT, little_endian=little
    )
    answer = encode_packet(header, encode_arguments(0, response(), 4096, little=little))
    following = rpc(PacketType.REQUEST, 4096, b"", Operation.CONTROL)
    packets = [asked, ethernet(answer, answer=True, device_port=49155), ethernet(following, device_port=49155)]
    _, answered, control = decode(decoder, packets)
    assert "connect response: actuals FrameID 8011h, setpoints FrameID 8022h" in answered.summary
    assert control.summary.startswith("control request")
    unknown_sender = ethernet(b"\x04" + bytes(100), device_port=49155)
    (other,) = decode(decoder, [unknown_sender])
    assert other.summary == "UDP port 50000 -> 49155, 101 bytes"


def test_input_frames_before_the_response_belong_to_the_connect() -> None:
    """A device may send first; a later Connect of the same controller has other places."""
    decoder = Decoder()
    asked, answered = connect_packets()
    early = frame(Direction.ACTUAL, VALUES[Direction.ACTUAL])
    for _ in range(2):
        _, record, _ = decode(decoder, [asked, early, answered])
        assert isinstance(record, CyclicRecord)
        assert {unit.axis: unit.values for unit in record.units} == VALUES[Direction.ACTUAL]


def test_cycle_counter_of_a_new_connect_starts_before_its_response() -> None:
    decoder = Decoder(Settings(given_axes((9, 1, 100))))
    builder = TimelineBuilder(decoder.settings.axes, cycle_ns=4 * MS)
    asked, answered = connect_packets()
    late, early = (
        frame(Direction.ACTUAL, VALUES[Direction.ACTUAL])[:-4] + struct.pack(">HBB", counter, STATUS_NORMAL, 0)
        for counter in (20_000, 0)
    )
    for record in decode(decoder, [asked, answered, late, asked, early, answered]):
        builder.add(record)
    assert not [entry for entry in builder.finish() if isinstance(entry, Anomaly)]


@pytest.mark.parametrize("early", [(), (frame(Direction.ACTUAL, VALUES[Direction.ACTUAL]),)])
def test_rejected_connect_defines_no_layout(early: tuple[bytes, ...]) -> None:
    decoder = Decoder()
    asked, answered = connect_packets(status=0xDB813F00)
    decode(decoder, [asked, *early, answered])
    (record,) = decode(decoder, [frame(Direction.ACTUAL, VALUES[Direction.ACTUAL])])
    assert not record.units
    assert "FrameID of another relationship" in record.summary


REFUSALS = {
    0xDB810104: "faulty ArBlockReq.ar_type (DB 81 01 04)",
    0xDB810107: "faulty ArBlockReq.initiator_mac (DB 81 01 07)",
    0xDB81010C: "faulty length of ArBlockReq.station_name (DB 81 01 0C)",
    0xDB81010D: "faulty ArBlockReq.station_name (DB 81 01 0D)",
    0xDB810200: "faulty type of IocrBlockReq (DB 81 02 00)",
    0xDB810201: "faulty length of IocrBlockReq (DB 81 02 01)",
    0xDB810202: "faulty version of IocrBlockReq (DB 81 02 02)",
    0xDB810203: "faulty version of IocrBlockReq (DB 81 02 03)",
    0xDB81020B: "faulty IocrBlockReq.reduction_ratio (DB 81 02 0B)",
    0xDB810213: "faulty number of IocrBlockReq.apis (DB 81 02 13)",
    0xDB810216: "faulty IocrBlockReq.apis.data.slot (DB 81 02 16)",
    0xDB81021C: "faulty IocrBlockReq.apis.iocs.offset (DB 81 02 1C)",
    0xDB81021D: "faulty IocrBlockReq, field 29 (DB 81 02 1D)",
    0xDB81030A: "faulty ExpectedSubmoduleBlockReq.slots.submodules.subslot (DB 81 03 0A)",
    0xDB81030F: "faulty ExpectedSubmoduleBlockReq.slots.submodules.descriptions.length_iops (DB 81 03 0F)",
    0xDB810310: "faulty ExpectedSubmoduleBlockReq.slots.submodules.descriptions.length_iocs (DB 81 03 10)",
    0xDB81040C: "faulty AlarmCrBlockReq.tag_low (DB 81 04 0C)",
    0xDB810504: "faulty block 0105h, field 4 (DB 81 05 04)",
    0xDB813F00: "error (DB 81 3F 00)",
    0xDB814004: "no AR free (DB 81 40 04)",
    0xDB800104: "error (DB 80 01 04)",
}


@pytest.mark.parametrize(("status", "text"), REFUSALS.items(), ids=[f"{status:08X}" for status in REFUSALS])
def test_rejected_connect_is_shown_with_block_and_field(status: int, text: str) -> None:
    _, refused = decode(Decoder(), connect_packets(status))
    assert refused.summary.startswith(f"connect response, 0 bytes: {text} after ")
    assert refused.details()["status"] == {"raw": status, "text": text}


@pytest.mark.parametrize(("code1", "code2", "edit"), [(one, two, edit) for one, two, _, edit in CASES])
def test_rejection_of_the_device_names_a_field_of_the_block(code1: int, code2: int, edit: Change) -> None:
    status, _ = Caller().connect(edit(blocks()))
    _, refused = decode(Decoder(), connect_packets(status.value))
    assert (status.code1, status.code2) == (code1, code2)
    assert not [word for word in ("error", "field") if word in refused.summary], refused.summary


@pytest.mark.parametrize(
    ("operation", "status", "text"),
    [
        (Operation.CONTROL, 0xDD811408, "faulty ControlBlock.command (DD 81 14 08)"),
        (Operation.RELEASE, 0xDC812808, "faulty ReleaseReq.command (DC 81 28 08)"),
    ],
)
def test_rejected_control_or_release_is_shown_with_its_field(operation: Operation, status: int, text: str) -> None:
    (refused,) = decode(Decoder(), [ethernet(rpc(PacketType.RESPONSE, status, b"", operation), answer=True)])
    assert refused.summary.endswith(f": {text}")


def test_frame_shorter_than_its_connect_is_reported() -> None:
    decoder = Decoder()
    decode(decoder, connect_packets())
    short = bytes(12) + b"\x88\x92" + struct.pack(">H44x", INPUT)
    (record,) = decode(decoder, [short])
    assert record.summary.endswith("(length differs from the length in its Connect)")


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_the_same_of_the_connect(tmp_path: Path) -> None:
    path = tmp_path / "connect.pcap"
    path.write_bytes(captures.pcap([(0, captures.ETHERNET, packet) for packet in connect_packets()]))
    names = ["pn_io.iocr_reference", "pn_io.frame_id", "pn_io.iocr_type", "_ws.malformed"]
    rows = tshark.fields(path, names, ["-E", "occurrence=a"])
    assert not any(row["_ws.malformed"] for row in rows)
    asked, answered = ([int(part, 0) for part in row["pn_io.frame_id"].split(",")] for row in rows)
    # tshark repeats the FrameIDs of the relationships at the end, with what it derived for each.
    assert (asked[:2], answered) == ([INPUT, 0xFFFF], [INPUT, OUTPUT])
    connection = read_request(request())
    assert [plan.frame_id for _, plan in connection.relations] == asked[:2]
    expected = [OFFSETS[Direction.ACTUAL], OFFSETS[Direction.SETPOINT]]
    offsets = [{place: data.offset for place, data in plan.data.items()} for _, plan in connection.relations]
    assert offsets == expected


@given(cut=st.integers(0, len(request())), position=st.integers(0, len(request()) - 1), value=st.integers(0, 255))
def test_a_damaged_connect_is_refused_or_read(cut: int, position: int, value: int) -> None:
    data = bytearray(request())
    data[position] = value
    decoder = Decoder()
    for content in (bytes(data), bytes(data[:cut])):
        packets = [ethernet(rpc(PacketType.REQUEST, 4096, content)), connect_packets()[1]]
        packets += [frame(direction, VALUES[direction]) for direction in Direction]
        assert all(record.document() for record in decode(decoder, packets))
        with contextlib.suppress(ProfidriveError):
            read_request(content)


def test_telegrams_named_by_submodules_define_the_axes() -> None:
    modules = {DAP_SLOT: access_module(), 1: object_module(ObjectKind.AXIS, telegram(7))}
    project = Project("gateway", modules)
    blocks = project.blocks(project.ar(UUID(int=1), 1, bytes.fromhex("020000000001"), object_uuid(1, 1, 1), "plc"))
    asked = rpc(PacketType.REQUEST, 4096, b"".join(block.encode() for block in blocks))
    answered = rpc(PacketType.RESPONSE, 0, response())
    decoder = Decoder()
    decode(decoder, [ethernet(asked), ethernet(answered, answer=True)])
    assert decoder.notices == ["observed in Connect: axis 1 telegram 7"], "telegram 1 has the same lengths"
    assert [(axis.do_id, axis.telegram) for axis in decoder.axes] == [(1, 7)]
