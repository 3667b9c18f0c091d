"""Checks and adjustments at the port by a controller: invalid ones rejected, others compared with LLDP, diagnosed, reported."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdgw.base.durations import MS, SECOND
from pdgw.profinet import ethernet
from pdgw.profinet.blocks.port import PortDataAdjust, PortDataCheck
from pdgw.profinet.connection.cmdev import Event
from pdgw.profinet.discovery import lldp
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.records.physical_device import INTERFACE, PORT, WRITABLE, PortFault, check
from pdgw.profinet.station import Identity, Medium, Station
from pdgw.profinet.wire import WireError
from tests.profinet.records.test_records import read, write
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import INTERFACE_ADJUST, PLC_MAC, PORT_ADJUST, PORT_CHECK, Wire, project

PORT_PLACE, INTERFACE_PLACE = (0, *PORT), (0, *INTERFACE)
MAU_CHECK = bytes.fromhex("0200 0010 0100 0000 0000 8001 020c 0004 0100 0010")
NO_PEER, WRONG_STATION, WRONG_PORT, WRONG_MAU = "8001 8005", "8001 8000", "8001 8001", "8000 8001"


def connected(*records: tuple[int, int, bytes]) -> Wire:
    """Connected; the controller wrote these records (subslot, index, data) before PrmEnd."""
    wire = Wire(of_project=project(records=[(0, 0, *record) for record in records]))
    wire.connect()
    return wire


def hear(wire: Wire, name: str = "plc-1", port: str = "port-001", *, legacy: bool = False) -> None:
    """A neighbour's LLDP frame arrives."""
    neighbour = Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), name, port=port, lldp_legacy=legacy)
    wire.device.on_frame(lldp.encode(neighbour), wire.now)
    wire.run(50 * MS)


def present(wire: Wire) -> str:
    """ChannelErrorType and ExtChannelErrorType of each diagnosis of the port, as the record 800Ah has them."""
    data = read(wire, PORT_PLACE, Index.DIAGNOSIS_CHANNEL_SUBSLOT).data
    if not data:
        return ""
    assert data[18:20] == bytes.fromhex("8002"), "extended channel diagnosis"
    entries = [data[at : at + 12] for at in range(20, len(data), 12)]
    return ", ".join(entry[4:8].hex(" ", 2) for entry in entries)


@pytest.mark.parametrize("index", [index for _, index in WRITABLE])
def test_invalid_port_or_interface_record_is_rejected(index: int) -> None:
    wire = connected()
    place = next((0, *place) for place, known in WRITABLE if known == index)
    for garbage in (b"", b"check", bytes(40), bytes.fromhex("0201 0002 0100"), PORT_CHECK + b"tail", b"\xff" * 64):
        assert write(wire, place, index, garbage).status.value == 0xDF80B800, garbage
        assert read(wire, place, index).data == b""
    assert wire.device.connected


def test_port_records_are_refused_at_every_other_place() -> None:
    records = {(PORT, 0x802B): PORT_CHECK, (PORT, 0x802F): PORT_ADJUST, (INTERFACE, 0x8071): INTERFACE_ADJUST}
    wire = connected()
    for place in ((0, 1), INTERFACE, PORT):
        for (right, index), data in records.items():
            expected = 0 if place == right else 0xDF80B000
            assert write(wire, (0, *place), index, data).status.value == expected, (place, index)


@pytest.mark.parametrize(
    "part",
    [
        "020a 0004 0100 00 00",  # no peer
        "020a 0003 0100 02",  # two peers, none there
        "020a 0009 0100 01 ff 706f7274",  # a name longer than the block
        "020e 0008 0100 0000 0010 0000",  # an adjustment
        "020c 0006 0100 0010 0000",  # too long
    ],
)
def test_a_check_that_holds_a_damaged_or_unknown_block_is_refused(part: str) -> None:
    content = bytes.fromhex(part)
    data = bytes.fromhex(f"0200 {8 + len(content):04x} 0100 0000 0000 8001") + content
    assert write(connected(), PORT_PLACE, 0x802B, data).status.value == 0xDF80B800


@given(st.binary(max_size=80), st.sampled_from(sorted(WRITABLE)))
def test_any_bytes_as_a_port_record_are_accepted_or_a_wire_error(data: bytes, key: tuple[tuple[int, int], int]) -> None:
    for whole in (data, WRITABLE[key].TYPE.to_bytes(2, "big") + (len(data) + 2).to_bytes(2, "big") + b"\1\0" + data):
        with contextlib.suppress(WireError):
            check(*key, whole)


def test_wrong_neighbour_is_diagnosed_until_the_right_one_is_received() -> None:
    wire = connected((0x8001, 0x802B, PORT_CHECK))
    for legacy in (False, True):
        hear(wire, legacy=legacy)
        assert present(wire) == ""
        hear(wire, name="plc-2", legacy=legacy)
        assert present(wire) == WRONG_STATION
        hear(wire, port="port-002", legacy=legacy)
        assert present(wire) == WRONG_PORT
        hear(wire, name="plc-2", port="port-002", legacy=legacy)
        assert present(wire) == f"{WRONG_STATION}, {WRONG_PORT}"
    hear(wire)
    assert present(wire) == ""


def test_missing_neighbour_is_diagnosed_ten_seconds_after_link_up() -> None:
    wire = connected((0x8001, 0x802B, PORT_CHECK))
    wire.run(9 * SECOND)
    assert present(wire) == ""
    wire.run(6 * SECOND)
    assert present(wire) == NO_PEER
    hear(wire)
    assert present(wire) == ""
    wire.run(26 * SECOND)
    assert present(wire) == NO_PEER, "its time to live of 20 s is over"


def test_another_speed_than_the_projects_is_diagnosed() -> None:
    wire = connected((0x8001, 0x802B, MAU_CHECK))
    assert present(wire) == ""
    wire.station.medium = Medium(0x001E)
    wire.run(6 * SECOND)
    assert present(wire) == WRONG_MAU


def test_start_and_end_of_a_port_fault_are_alarms() -> None:
    wire = connected((0x8001, 0x802B, PORT_CHECK))
    hear(wire, name="plc-2")
    hear(wire)
    told = [(alarm.slot, alarm.subslot, alarm.alarm_type) for alarm in wire.plc.learned.alarms]
    assert told == [(0, 0x8001, 0x0001), (0, 0x8001, 0x000C)]


def test_the_checks_of_a_relationship_end_with_it() -> None:
    wire = connected((0x8001, 0x802B, PORT_CHECK), (0x8001, 0x802F, PORT_ADJUST), (0x8000, 0x8071, INTERFACE_ADJUST))
    hear(wire, name="plc-2")
    assert wire.device.diagnosis.of(PORT)
    assert wire.station.lldp_adjusted
    wire.device.end(Event.STOPPED, wire.now)
    assert not wire.device.diagnosis.of(PORT)
    assert not wire.station.lldp_adjusted


def lldp_frames(wire: Wire, seconds: int) -> list[bytes]:
    wire.frames.clear()
    wire.run(seconds * SECOND)
    return [frame for frame in wire.frames if frame[12:14] == ethernet.ETHERTYPE_LLDP.to_bytes(2, "big")]


def test_lldp_is_sent_as_the_controller_requests() -> None:
    wire = connected((0x8000, 0x8071, INTERFACE_ADJUST))
    frame = lldp_frames(wire, 6)[-1]
    assert b"\x07gateway" in frame
    assert b"port-001.gateway" not in frame
    assert not write(wire, INTERFACE_PLACE, 0x8071, INTERFACE_ADJUST[:-1] + b"\1").status.value
    assert b"port-001.gateway" in lldp_frames(wire, 6)[-1]
    assert not write(wire, PORT_PLACE, 0x802F, PORT_ADJUST).status.value
    assert lldp_frames(wire, 20) == []


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_the_port_records_and_the_diagnosis_by_their_names(tmp_path: Path) -> None:
    wire = connected((0x8001, 0x802B, PORT_CHECK), (0x8001, 0x802F, PORT_ADJUST))
    hear(wire, name="plc-2", port="port-002")
    wire.run(100 * MS)
    names = ["pn_io.peer_port_id", "pn_io.peer_chassis_id", "pn_io.peer_to_peer_boundary_value_bit0"]
    names += ["pn_io.channel_error_type", "pn_io.ext_channel_error_type8001"]
    rows = tshark_frames.read(wire.frames, tmp_path / "port.pcap", names, every=True)
    (peer,) = {(row[names[0]], row[names[1]]) for row in rows if row[names[0]]}
    assert peer == ("port-001", "plc-1")
    assert {row[names[2]] for row in rows} == {"", "0x00000001"}
    faults = {(int(row[names[3]], 0), int(row[names[4]], 0)) for row in rows if row[names[3]]}
    assert faults == {PortFault.STATION_NAME.value, PortFault.PORT_NAME.value}


@pytest.mark.parametrize(("length", "status"), [(0, 0), (1, 0xDF80B800)])
def test_only_the_usual_preamble_is_accepted(length: int, status: int) -> None:
    wire = connected()
    part = bytes.fromhex("0226 0006 0100 0000") + length.to_bytes(2, "big")
    head = bytes.fromhex("0100 0000 0000 8001")
    record = bytes.fromhex("0202") + (len(head) + len(part) + 2).to_bytes(2, "big") + head + part + bytes(2)
    assert write(wire, PORT_PLACE, 0x802F, record).status.value == status


def test_every_part_of_a_check_or_adjustment_is_read_back_as_it_was_written() -> None:
    assert [type(part).__name__ for part in PortDataCheck.decode(PORT_CHECK).parts()] == ["CheckPeers"]
    padded = bytes.fromhex("0200 0028") + PORT_CHECK[4:] + bytes(2) + MAU_CHECK[12:]
    assert len(list(PortDataCheck.decode(padded).parts())) == 2, "some controllers pad"
    assert [type(part).__name__ for part in PortDataCheck.decode(MAU_CHECK).parts()] == ["CheckMauType"]
    assert [type(part).__name__ for part in PortDataAdjust.decode(PORT_ADJUST).parts()] == ["AdjustPeerToPeerBoundary"]
    wire = connected((0x8001, 0x802B, PORT_CHECK), (0x8000, 0x8071, INTERFACE_ADJUST))
    assert read(wire, PORT_PLACE, 0x802B).data == PORT_CHECK
    expected = read(wire, (0, 0, 1), 0xF842).data
    assert PORT_CHECK in expected
    assert INTERFACE_ADJUST in expected
