"""LLDP: what a neighbour reads of us, and what we read of it."""

from __future__ import annotations

import contextlib
from ipaddress import IPv4Address
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib import lldp as scapy_lldp
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS, SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet.discovery import lldp
from pdgw.profinet.station import Identity, IpSuite, Station
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import Wire

MAC = bytes.fromhex("020000000001")


def station() -> Station:
    suite = IpSuite(IPv4Address("192.168.0.2"), IPv4Address("255.255.255.0"))
    return Station(Identity(MAC, 1, 2, "gateway", "PDGW", "4711"), "press-1", suite)


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_name_port_and_address(tmp_path: Path) -> None:
    names = [
        "lldp.port.id",
        "lldp.chassis.id",
        "lldp.profinet.rtc2_port_status",
        "lldp.mgn.addr.ip4",
        "lldp.time_to_live",
        "lldp.ieee.802_3.pmd_auto_neg_advertised_caps.100base_txfd",
        "lldp.ieee.802_3.pmd_mau_type",
    ]
    (row,) = tshark_frames.read([lldp.encode(station())], tmp_path / "lldp.pcap", names)
    assert row["lldp.port.id"] == "port-001.press-1"
    assert bytes.fromhex(row["lldp.chassis.id"]).startswith(b"gateway ")
    assert row["lldp.mgn.addr.ip4"] == "192.168.0.2"
    assert row["lldp.time_to_live"] == "20"
    assert row["lldp.ieee.802_3.pmd_auto_neg_advertised_caps.100base_txfd"] in {"1", "True"}
    assert row["lldp.ieee.802_3.pmd_mau_type"] == "0x0010"


def test_a_frame_is_this_byte_by_byte() -> None:
    chassis = b"gateway                   PDGW                 4711                 1 V  0  0  0"
    tlvs = [
        bytes.fromhex("0251 07") + chassis,
        bytes.fromhex("0411 07") + b"port-001.press-1",
        bytes.fromhex("0602 0014"),
        bytes.fromhex("fe08 000ecf 02 00000000"),
        bytes.fromhex("fe0a 000ecf 05 020000000001"),
        bytes.fromhex("fe09 00120f 01 03 0400 0010"),
        bytes.fromhex("100c 05 01 c0a80002 02 00000001 00"),
        bytes.fromhex("0000"),
    ]
    assert lldp.encode(station()).hex() == (bytes.fromhex("0180c200000e 020000000001 88cc") + b"".join(tlvs)).hex()


def test_station_without_a_name_sends_only_its_port() -> None:
    nameless = Station(Identity(MAC, 1, 2, "gateway", "PDGW"))
    assert lldp.decode(lldp.encode(nameless), 14, 0).port_id == "port-001"


def test_sent_lldp_is_read_back() -> None:
    neighbour = lldp.decode(lldp.encode(station()), 14, 5)
    assert (neighbour.port_id, neighbour.alias) == ("port-001.press-1", "port-001.press-1")
    assert (neighbour.mac, neighbour.seen_ns, neighbour.lifetime_ns) == (MAC, 5, 20_000_000_000)


def test_a_neighbour_built_by_scapy_is_known_by_its_name() -> None:
    frame = (
        Ether(src="02:00:00:00:00:07", dst="01:80:c2:00:00:0e", type=0x88CC)
        / scapy_lldp.LLDPDUChassisID(subtype=7, id=b"plc")
        / scapy_lldp.LLDPDUPortID(subtype=7, id=b"port-001")
        / scapy_lldp.LLDPDUTimeToLive(ttl=20)
        / scapy_lldp.LLDPDUEndOfLLDPDU()
    )
    neighbour = lldp.decode(bytes(frame), 14, 0)
    assert (neighbour.chassis_id, neighbour.port_id, neighbour.alias) == ("plc", "port-001", "port-001.plc")


def test_neighbour_may_be_named_by_its_mac_address() -> None:
    tlvs = "0207 04 020000000009  0402 07 31  0602 0014  0000"
    neighbour = lldp.decode(MAC * 2 + bytes.fromhex("88cc" + tlvs), 14, 0)
    assert (neighbour.chassis_id, neighbour.port_id, neighbour.alias) == (
        "02-00-00-00-00-09",
        "1",
        "1.02-00-00-00-00-09",
    )


def test_a_port_named_by_its_mac_address_is_shown_as_one() -> None:
    tlvs = "0202 07 61  0407 03 020000000009  0602 0014  0000"
    neighbour = lldp.decode(MAC * 2 + bytes.fromhex("88cc" + tlvs), 14, 0)
    assert (neighbour.port_id, neighbour.alias) == ("02-00-00-00-00-09", "02-00-00-00-00-09.a")


@pytest.mark.parametrize(
    ("tlvs", "said"),
    [
        ("0201 07  0402 07 31  0602 0014  0000", "CHASSIS_ID"),
        ("0202 07 61  0401 07  0602 0014  0000", "PORT_ID"),
        ("0202 07 61  0402 07 31  0601 14  0000", "TTL"),
        ("0202 07 61  0402 07 31  0000  0602 0014", "TTL"),
        ("0202 07 61  0402 07 31  0602 0014  0a01", "TLV length"),
        ("0202 07 61  0402 07 31  0602 00", "TLV length"),
    ],
    ids=["chassis", "port", "lifetime", "behind the end", "header alone", "cut short"],
)
def test_a_mandatory_tlv_that_is_short_or_missing_is_refused(tlvs: str, said: str) -> None:
    with pytest.raises(ProfidriveError, match=said):
        lldp.decode(MAC * 2 + bytes.fromhex("88cc" + tlvs), 14, 0)


def test_a_lifetime_is_its_first_two_bytes() -> None:
    tlvs = "0202 07 61  0402 07 31  0603 000c 00"
    assert lldp.decode(MAC * 2 + bytes.fromhex("88cc" + tlvs), 14, 0).lifetime_ns == 12 * SECOND


def frame_of_a_neighbour(lifetime_s: int) -> bytes:
    suite = IpSuite(IPv4Address("192.168.0.1"), IPv4Address("255.255.255.0"))
    frame = lldp.encode(Station(Identity(bytes.fromhex("020000000007"), 1, 1, "plc", "PLC"), "plc-1", suite))
    ttl = frame.index(bytes.fromhex("06020014"))
    return frame[: ttl + 2] + lifetime_s.to_bytes(2, "big") + frame[ttl + 4 :]


def test_neighbour_is_kept_for_its_lifetime_and_removed_with_the_cable() -> None:
    wire = Wire()
    device = wire.device

    def known() -> str:
        neighbour = wire.station.neighbour
        return neighbour.alias if neighbour else ""

    device.on_frame(frame_of_a_neighbour(12), 0)
    assert known() == "port-001.plc-1"
    wire.run(12 * SECOND - 2 * MS)
    assert known()
    wire.run(2 * MS)
    assert not known(), "he fell silent"
    device.on_frame(frame_of_a_neighbour(12), wire.now)
    device.on_frame(frame_of_a_neighbour(0), wire.now)
    assert not known(), "he says goodbye"
    device.on_frame(frame_of_a_neighbour(12), wire.now)
    device.on_link(False, wire.now)
    assert not known()
    device.on_frame(lldp.encode(wire.station), wire.now)
    assert not known(), "our own frame"


def test_the_device_is_described_in_columns() -> None:
    identity = Identity(MAC, 1, 2, "a product of more than 25 characters", "ORDER", "4711", 3, ("V", 1, 22, 333))
    assert identity.chassis == "a product of more than 25 ORDER                4711                 3 V  1 22333"
    assert identity.annotation == "a product of more than 25 ORDER                    3 V  1 22333"


@given(st.binary(max_size=100))
def test_any_lldp_frame_is_survived(data: bytes) -> None:
    with contextlib.suppress(ProfidriveError):
        lldp.decode(MAC * 2 + b"\x88\xcc" + data, 14, 0)
