"""DCP as engineering tools and controllers use it, against scapy and tshark."""

from __future__ import annotations

from ipaddress import IPv4Address
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.contrib.pnio import ProfinetIO
from scapy.contrib.pnio_dcp import ProfinetDCP
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet import ethernet
from pdgw.profinet.discovery import dcp
from pdgw.profinet.discovery.dcp import DcpResponder, Flash, IpSet, NameSet, Option, ResetToFactory, Service, SetError
from pdgw.profinet.station import Identity, IpSuite, Neighbour, Station, check_name
from tests.support.readers import tshark, tshark_frames

MAC = bytes.fromhex("0200000001f4")
PLC = bytes.fromhex("020000000001")
SUITE = IpSuite(IPv4Address("192.168.0.2"), IPv4Address("255.255.255.0"), IPv4Address("192.168.0.1"))


class Rig:
    """A responder and whether its relationship is up."""

    def __init__(self) -> None:
        identity = Identity(MAC, 0xFFFF, 0x0402, "profidrive-gateway", "PDGW")
        self.station = Station(identity, "gateway", SUITE)
        self.connected = False
        self.dcp = DcpResponder(self.station, lambda: self.connected)

    def ask(self, payload: bytes, destination: bytes = MAC, now: int = 0) -> bytes | None:
        frame = ethernet.frame(destination, PLC, payload)
        return self.dcp.receive(frame, 14, now)

    def set(self, option: Option, value: bytes, qualifier: int = 1) -> SetError:
        block = dcp.encode_block(option, qualifier.to_bytes(2, "big") + value)
        answer = self.ask(dcp.encode(0xFEFD, Service.SET, dcp.ServiceType.REQUEST, 1, block))
        assert answer is not None
        ((code, content),) = dcp.split(answer[26 : 26 + int.from_bytes(answer[24:26], "big")])
        assert (code, content[:2]) == (Option.RESPONSE.value, bytes(option.value))
        return SetError(content[2])

    def identify(self, blocks: bytes, delay: int = 1, destination: bytes = ethernet.DCP_MULTICAST) -> list[bytes]:
        self.ask(dcp.encode(0xFEFE, Service.IDENTIFY, dcp.ServiceType.REQUEST, 9, blocks, delay), destination)
        return self.dcp.poll(1 << 62)


ALL = dcp.encode_block(Option.ALL, b"")


def test_an_identify_is_answered_with_every_block_of_the_table_in_its_order() -> None:
    (frame,) = Rig().identify(ALL)
    assert frame[:6] == PLC
    assert frame[14:16] == bytes.fromhex("feff")
    answer = ProfinetDCP(frame[16:])
    assert (answer.service_id, answer.service_type, answer.xid) == (5, 1, 9)
    blocks = answer.dcp_blocks
    codes = [(block.option, block.sub_option) for block in blocks]
    assert codes == [(1, 2), (2, 1), (2, 2), (2, 3), (2, 4), (2, 5), (2, 7)]
    assert (blocks[0].ip, blocks[0].netmask, blocks[0].gateway) == ("192.168.0.2", "255.255.255.0", "192.168.0.1")
    assert blocks[0].block_info == 1
    assert blocks[2].name_of_station == b"gateway"
    assert (blocks[3].vendor_id, blocks[3].device_id) == (0xFFFF, 0x0402)


def test_identify_of_scapy_is_answered_for_our_name() -> None:
    for name, answered in ((b"gateway", 1), (b"other", 0), (b"gatewa", 0)):
        rig = Rig()
        length = len(name)
        request = ProfinetIO(frameID=0xFEFE) / ProfinetDCP(
            service_id=5,
            service_type=0,
            reserved=1,
            option=2,
            sub_option=2,
            dcp_block_length=length,
            dcp_data_length=4 + length,
            name_of_station=name,
        )
        frame = bytes(Ether(src="02:00:00:00:00:01", dst="01:0e:cf:00:00:00", type=0x8892) / request)
        rig.dcp.receive(frame, 14, 0)
        assert len(rig.dcp.poll(1 << 62)) == answered


@pytest.mark.parametrize(
    ("filters", "answered"),
    [
        (dcp.encode_block(Option.NAME, b"gateway"), True),
        (dcp.encode_block(Option.MAC, MAC), True),
        (dcp.encode_block(Option.IP, SUITE.encode()), True),
        (dcp.encode_block(Option.VENDOR, b"profidrive-gateway"), True),
        (dcp.encode_block(Option.DEVICE_ID, bytes.fromhex("ffff0402")), True),
        (dcp.encode_block(Option.ROLE, b"\1\0"), True),
        (dcp.encode_block(Option.ALIAS, b"port-001.plc"), True),
        (dcp.encode_block(Option.NAME, b"gateway") + dcp.encode_block(Option.ROLE, b"\1\0"), True),
        (dcp.encode_block(Option.NAME, b"gateway") + dcp.encode_block(Option.ROLE, b"\2\0"), False),
        (dcp.encode_block(Option.NAME, b""), False),
        (dcp.encode_block(Option.ALIAS, b"port-002.plc"), False),
        (dcp.encode_block(Option.SIGNAL, b""), False),
        (bytes.fromhex("09090000"), False),
        (bytes.fromhex("0202ffff"), False),
        (b"", False),
    ],
)
def test_every_filter_of_an_identify_must_match(filters: bytes, answered: bool) -> None:
    rig = Rig()
    rig.station.neighbour = Neighbour(b"\7plc", b"\7port-001", PLC, 0, 1)
    assert bool(rig.identify(filters)) is answered


def test_identify_answer_is_delayed_by_the_own_mac_address() -> None:
    rig = Rig()
    rig.ask(dcp.encode(0xFEFE, Service.IDENTIFY, dcp.ServiceType.REQUEST, 9, ALL, 300), ethernet.DCP_MULTICAST, now=5)
    delay = (0x01 * 256 + 0xF4) % 300 * 10 * MS
    assert rig.dcp.deadline == 5 + delay
    assert rig.dcp.poll(4 + delay) == []
    assert len(rig.dcp.poll(5 + delay)) == 1


def test_a_delay_factor_above_6400_is_not_answered_and_0_is_answered_at_once() -> None:
    assert Rig().identify(ALL, 6401) == []
    rig = Rig()
    rig.ask(dcp.encode(0xFEFE, Service.IDENTIFY, dcp.ServiceType.REQUEST, 9, ALL, 0), ethernet.DCP_MULTICAST, now=7)
    assert len(rig.dcp.poll(7)) == 1


def test_a_flood_of_identify_keeps_a_bounded_number_of_answers() -> None:
    rig = Rig()
    for number in range(1000):
        frame = bytearray(
            ethernet.frame(
                ethernet.DCP_MULTICAST, PLC, dcp.encode(0xFEFE, Service.IDENTIFY, dcp.ServiceType.REQUEST, 9, ALL, 6400)
            )
        )
        frame[8:10] = number.to_bytes(2, "big")
        rig.dcp.receive(bytes(frame), 14, 0)
    assert len(rig.dcp.poll(1 << 62)) == 16


def test_get_answers_known_options_and_rejects_unknown_ones() -> None:
    rig = Rig()
    payload = dcp.encode(0xFEFD, Service.GET, dcp.ServiceType.REQUEST, 3, bytes.fromhex("0101 0202 0209 0901"))
    frame = rig.ask(payload)
    assert frame is not None
    length = int.from_bytes(frame[14 + 10 : 14 + 12], "big")
    found = dcp.split(frame[26 : 26 + length])
    assert found == [
        (Option.MAC.value, bytes(2) + MAC),
        (Option.NAME.value, bytes(2) + b"gateway"),
        (Option.RESPONSE.value, bytes((2, 9, SetError.SUBOPTION))),
        (Option.RESPONSE.value, bytes((9, 1, SetError.OPTION))),
    ]


def test_get_and_set_count_only_when_sent_to_this_station_alone() -> None:
    rig = Rig()
    block = dcp.encode_block(Option.NAME, bytes.fromhex("0001") + b"other")
    payload = dcp.encode(0xFEFD, Service.SET, dcp.ServiceType.REQUEST, 1, block)
    assert rig.ask(payload, ethernet.DCP_MULTICAST) is None
    assert rig.ask(payload, b"\xff" * 6) is None
    assert rig.station.name == "gateway"


def test_name_ip_flash_and_reset_are_accepted_and_reported() -> None:
    rig = Rig()
    suite = IpSuite(IPv4Address("10.0.0.5"), IPv4Address("255.0.0.0"))
    assert rig.set(Option.NAME, b"press-1.hall") is SetError.OK
    assert rig.set(Option.IP, suite.encode(), qualifier=0) is SetError.OK
    assert rig.set(Option.SIGNAL, b"\1\0") is SetError.OK
    assert (rig.station.name, rig.station.ip) == ("press-1.hall", suite)
    assert rig.set(Option.RESET, b"", qualifier=4) is SetError.OK
    assert (rig.station.name, rig.station.ip.is_set) == ("", False)
    assert rig.dcp.events == [NameSet("press-1.hall", True), IpSet(suite, False), Flash(), ResetToFactory()]


def test_the_old_factory_reset_5_5_clears_the_station_as_5_6_does() -> None:
    rig = Rig()
    assert rig.set(Option.FACTORY_RESET, b"\0", qualifier=0) is SetError.VALUE
    assert rig.set(Option.FACTORY_RESET, b"", qualifier=0) is SetError.OK
    assert (rig.station.name, rig.station.ip.is_set) == ("", False)
    assert rig.dcp.events == [ResetToFactory()]
    answer = rig.ask(dcp.encode(0xFEFD, Service.GET, dcp.ServiceType.REQUEST, 3, bytes(Option.OPTIONS.value)))
    assert answer is not None
    ((_, content),) = dcp.split(answer[26 : 26 + int.from_bytes(answer[24:26], "big")])
    assert bytes((5, 5)) in [content[at : at + 2] for at in range(2, len(content), 2)]


@pytest.mark.parametrize("option", [Option.NAME, Option.IP])
def test_a_set_of_the_present_value_is_accepted_while_connected(option: Option) -> None:
    rig = Rig()
    rig.connected = True
    value = {Option.NAME: b"gateway", Option.IP: SUITE.encode()}[option]
    assert rig.set(option, value) is SetError.OK
    assert (rig.station.name, rig.station.ip) == ("gateway", SUITE)


@pytest.mark.parametrize("option", [Option.NAME, Option.IP, Option.FACTORY_RESET, Option.RESET])
def test_while_a_relationship_is_up_name_ip_and_reset_are_refused_and_nothing_changes(option: Option) -> None:
    rig = Rig()
    rig.connected = True
    value = {Option.NAME: b"other", Option.IP: bytes(12)}.get(option, b"")
    assert rig.set(option, value, qualifier=4 if not value else 1) is SetError.IN_OPERATION
    assert (rig.station.name, rig.station.ip) == ("gateway", SUITE)
    assert rig.dcp.events == []
    assert rig.set(Option.SIGNAL, b"\1\0") is SetError.OK


@pytest.mark.parametrize(
    ("option", "value", "qualifier", "error"),
    [
        (Option.NAME, b"Upper", 1, SetError.VALUE),
        (Option.NAME, b"-a", 1, SetError.VALUE),
        (Option.NAME, b"10.0.0.1", 1, SetError.VALUE),
        (Option.NAME, b"port-001.a", 1, SetError.VALUE),
        (Option.NAME, b"a" * 64, 1, SetError.VALUE),
        (Option.NAME, b".".join([b"a" * 60] * 4), 1, SetError.VALUE),
        (Option.IP, bytes(11), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("7f000001ffffff0000000000"), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("e0000001ffffff0000000000"), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("0a000001ff00ff0000000000"), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("0a000001ffffff000a000101"), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("0a0000010000000000000000"), 1, SetError.VALUE),
        (Option.IP, bytes.fromhex("00000000ffffff0000000000"), 1, SetError.VALUE),
        (Option.SIGNAL, b"\2\0", 1, SetError.VALUE),
        (Option.RESET, b"", 1, SetError.VALUE),
        (Option.ROLE, b"\1\0", 1, SetError.SUBOPTION),
        (Option.START, b"", 0, SetError.OK),
        (Option.STOP, b"", 0, SetError.OK),
    ],
)
def test_invalid_set_is_rejected_with_its_error(option: Option, value: bytes, qualifier: int, error: SetError) -> None:
    rig = Rig()
    assert rig.set(option, value, qualifier) is error
    assert (rig.station.name, rig.station.ip) == ("gateway", SUITE)


def test_an_unknown_service_is_answered_as_not_supported() -> None:
    frame = Rig().ask(bytes.fromhex("fefd 06 00 00000001 0000 0000"))
    assert frame is not None
    assert ProfinetDCP(frame[16:]).service_type == dcp.ServiceType.NOT_SUPPORTED


@pytest.mark.parametrize(
    "blocks",
    [b"", b"\2", bytes.fromhex("0202 03"), bytes.fromhex("0202 0203 01")],
    ids=["nothing", "half a pair", "a pair and a half", "two pairs and a half"],
)
def test_a_get_of_anything_but_pairs_is_not_answered(blocks: bytes) -> None:
    rig = Rig()
    assert rig.ask(dcp.encode(0xFEFD, Service.GET, dcp.ServiceType.REQUEST, 3, blocks)) is None
    assert rig.dcp.ignored == 1


def test_answers_byte_by_byte() -> None:
    rig = Rig()
    head = PLC + MAC + bytes.fromhex("8892")

    def answer(payload: str) -> bytes:
        frame = rig.ask(bytes.fromhex(payload))
        assert frame is not None
        return frame

    def frame(payload: str) -> bytes:
        return (head + bytes.fromhex(payload)).ljust(60, b"\0")

    # A missing value is reported: BlockInfo 0 without an address. Control options cannot be read.
    rig.station.ip = IpSuite()
    assert answer("fefd 03 00 00000007 0000 0002 0102") == frame(
        "fefd 03 01 00000007 0000 0012 0102 000e 0000 00000000 00000000 00000000"
    )
    assert answer("fefd 03 00 00000007 0000 0004 0503 0506") == frame(
        "fefd 03 01 00000007 0000 0010 0504 0003 0503 02 00 0504 0003 0506 02 00"
    )
    # Two settings in one request, and an odd length that is padded: each has its answer.
    name = "0202 0003 0001 61 00"
    assert answer(f"fefd 04 00 00000008 0000 0010 {name} 0503 0004 0000 0100") == frame(
        "fefd 04 01 00000008 0000 0010 0504 0003 0202 00 00 0504 0003 0503 00 00"
    )
    assert (rig.station.name, rig.dcp.refused) == ("a", 0)
    rig.connected = True
    assert answer("fefd 04 00 00000009 0000 0008 0202 0003 0001 62 00") == frame(
        "fefd 04 01 00000009 0000 0008 0504 0003 0202 06 00"
    )
    assert rig.dcp.refused == 1
    assert answer("fefd 07 00 0000000a 0000 0000") == frame("fefd 07 05 0000000a 0000 0000")
    assert rig.ask(bytes.fromhex(f"fefd 04 01 0000000b 0000 0008 {name}")) is None, "an answer is no request"


def test_unassignable_address_is_rejected_and_not_stored() -> None:
    rig = Rig()
    rig.dcp = DcpResponder(rig.station, lambda: False, lambda suite: False)
    assert rig.set(Option.IP, bytes.fromhex("0a000001ffffff0000000000")) is SetError.LOCAL == 5
    assert rig.set(Option.RESET, b"", qualifier=4) is SetError.OK
    assert (rig.station.name, rig.station.ip) == ("", SUITE)
    assert rig.dcp.events == [ResetToFactory()]


@pytest.mark.parametrize("length", [7, 8, 0x7FFF])
def test_a_block_longer_than_the_frame_is_not_answered(length: int) -> None:
    rig = Rig()
    blocks = bytes.fromhex(f"0202 {length:04x} 0001 6f6b6179")
    assert rig.ask(dcp.encode(0xFEFD, Service.SET, dcp.ServiceType.REQUEST, 1, blocks)) is None
    assert rig.identify(bytes.fromhex(f"0202 {length:04x} 676174657761")) == []
    assert (rig.station.name, rig.dcp.events) == ("gateway", [])


@pytest.mark.parametrize("name", ["a", "plc-1", "x" * 63, "a.b.c", "port-01", "1.2.3", "0"])
def test_names_the_standard_allows(name: str) -> None:
    check_name(name)


@pytest.mark.parametrize("name", ["", "a..b", "a-", "a_b", "é", "port-001-00002", "1.2.3.4", "a" * 64])
def test_names_the_standard_forbids(name: str) -> None:
    with pytest.raises(ProfidriveError, match="station name"):
        check_name(name)


@given(st.binary(max_size=80), st.sampled_from([0xFEFD, 0xFEFE, 0xFEFF]), st.sampled_from([3, 4, 5, 6]))
def test_any_dcp_frame_is_survived(blocks: bytes, frame_id: int, service: int) -> None:
    rig = Rig()
    payload = dcp.HEADER.pack(frame_id, service, 0, 1, 1, len(blocks)) + blocks
    for destination in (MAC, ethernet.DCP_MULTICAST):
        rig.ask(payload, destination)
        rig.ask(payload[: len(blocks)], destination)


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_every_answer(tmp_path: Path) -> None:
    rig = Rig()
    frames = rig.identify(ALL)
    set_name = dcp.encode_block(Option.NAME, bytes.fromhex("0001") + b"other")
    for payload in (
        dcp.encode(0xFEFD, Service.GET, dcp.ServiceType.REQUEST, 3, bytes.fromhex("0101 0202 0209")),
        dcp.encode(0xFEFD, Service.SET, dcp.ServiceType.REQUEST, 4, set_name),
    ):
        frame = rig.ask(payload)
        assert frame is not None
        frames += [ethernet.frame(MAC, PLC, payload), frame]
    names = ["pn_dcp.suboption_device_nameofstation", "pn_dcp.suboption_ip_ip", "pn_dcp.service_id"]
    rows = tshark_frames.read(frames, tmp_path / "dcp.pcap", names)
    assert rows[0]["pn_dcp.suboption_device_nameofstation"] == "gateway"
    assert rows[0]["pn_dcp.suboption_ip_ip"] == "192.168.0.2"
    assert [int(row["pn_dcp.service_id"], 0) for row in rows] == [5, 3, 3, 4, 4]
