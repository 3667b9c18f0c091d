"""A controller and the device from Identify to Release, cases of conformance class A with a relationship, and Ethernet frames.

As in tests/gateway/links/profinet/test_class_a.py the cases follow the tester's public notes and IEC 61158-6-10.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from uuid import UUID

import pytest
from scapy.contrib.lldp import LLDPDU, LLDPDUTimeToLive
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS, SECOND
from pdgw.peers.controller.controller import Phase
from pdgw.profinet import ethernet
from pdgw.profinet.blocks.alarm import MessageClass
from pdgw.profinet.connection.cmdev import AbortCode
from pdgw.profinet.device import Connected, Disconnected
from pdgw.profinet.model import API_PROFIDRIVE
from pdgw.profinet.records.device_records import Index
from pdgw.profinet.rpc import dcerpc, epm
from pdgw.profinet.rpc.dcerpc import PacketType, RpcHeader
from pdgw.profinet.rpc.records import BlockType, Operation, RecordBlock, encode_block
from tests.profinet.records.test_records import read
from tests.profinet.rpc.test_epm import lookup
from tests.support.wire.connect import AR_UUID, INITIATOR, SOURCE, Caller, blocks
from tests.support.wire.profinet import DEVICE_MAC, PLC_MAC, Wire, project

AXIS = (1, 2)


def test_a_controller_finds_the_device_by_name_and_exchanges_data() -> None:
    wire = Wire()
    wire.connect()
    assert len(wire.reported(Connected)) == 1
    wire.plc.set_output(AXIS, bytes.fromhex("047f2000"))
    wire.device.set_input(AXIS, bytes.fromhex("0e371fff"), good=True)
    wire.run(20 * MS)
    assert wire.device.output(AXIS) == bytes.fromhex("047f2000")
    assert wire.plc.input(AXIS) == bytes.fromhex("0e371fff")
    assert wire.fresh > 3
    assert wire.plc.phase is Phase.DATA


def test_release_ends_the_relationship_and_a_new_one_is_possible_at_once() -> None:
    wire = Wire()
    for _ in range(3):
        wire.connect()
        wire.run(50 * MS)
        wire.plc.release(wire.now)
        wire.run(50 * MS)
        assert wire.plc.learned.ended == "released"
        assert wire.device.relation is None
    assert [event.ended.status for event in wire.reported(Disconnected)] == [AbortCode.RELEASED.status] * 3


def test_silent_controller_is_lost_within_the_data_hold_time() -> None:
    wire = Wire(of_project=project(reduction_ratio=8, data_hold=3))
    wire.connect()
    wire.run(100 * MS)
    wire.to_device = False
    since = wire.now
    wire.run(1000 * MS, lambda: not wire.device.connected)
    assert wire.now - since <= 24 * MS
    (lost,) = wire.reported(Disconnected)
    assert lost.ended.status == AbortCode.DATA_HOLD.status
    assert wire.plc.learned.error == 0xCF81FD05


def test_each_call_is_answered_once() -> None:
    wire = Wire()
    wire.connect()
    wire.plc.read((0, 0, 1), 0xF821, lambda result: None)
    wire.run(20 * MS)
    calls = [frame[42:] for frame in wire.frames if frame[12:14] == b"\x08\x00"]
    requests = [(packet[40:56], packet[64:68]) for packet in calls if packet[1] == PacketType.REQUEST]
    responses = [(packet[40:56], packet[64:68]) for packet in calls if packet[1] == PacketType.RESPONSE]
    assert sorted(requests) == sorted(responses)
    assert len(requests) == 4, "Connect, PrmEnd, ApplicationReady, Read"


# -- conformance class A: alarm, diagnosis, AR-ASE, RPC, RTC, LLDP ----------------------------------------------------


LLDP_TYPE, TAGGED = b"\x88\xcc", b"\x81\x00"
POINT = (API_PROFIDRIVE, 1, 1)


def input_frames(wire: Wire) -> Iterator[tuple[int, bytes]]:
    """Time and frame of each cyclic frame of the device."""
    for when, frame in wire.times:
        if frame[6:12] == DEVICE_MAC and frame[12:14] == TAGGED and 0x80 <= frame[18] < 0xC0:
            yield when, frame


@pytest.mark.parametrize("index", [0x800A, 0x800B, 0x800C, 0xC00A, 0xE00A, 0xF00A, 0xF80C])
def test_diagnosis_a_present_diagnosis_is_in_every_record_and_gone_after_it(index: int) -> None:
    wire = Wire()
    wire.connect()
    wire.device.set_diagnosis((1, 1), MessageClass.MAINS)
    assert bytes.fromhex("8000 6800 9001") in read(wire, POINT, index).data
    wire.device.clear_diagnosis((1, 1), MessageClass.MAINS)
    assert read(wire, POINT, index).data == b""


def test_different_access_ways_read_the_same_record() -> None:
    caller = Caller()
    assert not caller.connect(blocks())[0].value
    access = project().ar(UUID(int=9), 9, PLC_MAC, INITIATOR, "tool")
    assert not caller.connect([replace(access, ar_type=6, properties=0x111)])[0].value
    found = []
    for ar_uuid in (AR_UUID, UUID(int=9), UUID(int=0)):
        block = RecordBlock(BlockType.READ_REQUEST, 1, ar_uuid, 0, 0, 1, Index.REAL_API, 4096)
        status, answer = caller.call(encode_block(block), Operation.READ if ar_uuid.int else Operation.READ_IMPLICIT)
        assert not status.value
        found.append(answer[64:])
    assert found[0] == found[1] == found[2] != b""


def test_rpc_epm_the_mapper_names_the_device_and_unknown_calls_are_rejected() -> None:
    wire = Wire()

    def ask(interface: UUID, operation: int, body: bytes) -> tuple[RpcHeader, bytes]:
        header = RpcHeader(PacketType.REQUEST, UUID(int=0), UUID(int=operation + 1), 0, operation, interface=interface)
        header = replace(header, interface_version=epm.INTERFACE[1] if interface == epm.INTERFACE[0] else 1)
        (packet,) = dcerpc.encode_fragments(header, body)
        wire.device.on_datagram(packet, SOURCE, wire.now)
        ((_, answer),) = wire.device.outgoing()
        return dcerpc.decode_packet(bytes(answer))

    header, body = ask(epm.INTERFACE[0], epm.LOOKUP, lookup(most=1))
    assert header.packet_type is PacketType.RESPONSE
    assert body
    assert ask(UUID(int=5), 0, b"")[0].packet_type is PacketType.REJECT


@pytest.mark.parametrize("ratio", [1, 2, 4, 8, 16, 32, 128, 512])
def test_rtc_input_frames_keep_the_cycle_and_their_counter(ratio: int) -> None:
    wire = Wire(of_project=project(reduction_ratio=ratio, data_hold=3))
    wire.connect()
    wire.times.clear()
    wire.run(10 * ratio * MS)
    frames = list(input_frames(wire))
    assert len(frames) >= 9
    times = [when for when, _ in frames]
    assert {later - sooner for sooner, later in pairwise(times)} == {ratio * MS}
    counters = [int.from_bytes(frame[-4:-2], "big") for _, frame in frames]
    steps = {(later - sooner) % 0x10000 for sooner, later in pairwise(counters)}
    assert steps == {ratio * 32 % 0x10000}
    assert {frame[-2] for _, frame in frames} == {0x35}, "primary, valid, run, no problem"


def test_rtc_the_first_valid_frame_is_within_the_data_hold_time() -> None:
    wire = Wire(of_project=project(reduction_ratio=4, data_hold=3))
    wire.connect()
    connect = next(when for when, frame in wire.times if frame[12:14] == b"\x08\x00")
    assert next(input_frames(wire))[0] - connect <= 3 * 4 * MS
    valid = [frame[-2] & 0x04 for _, frame in input_frames(wire)]
    assert all(valid)


def test_lldp_is_sent_every_five_seconds_with_twenty_seconds_to_live() -> None:
    wire = Wire()
    wire.run(21 * SECOND)
    sent = [(when, frame) for when, frame in wire.times if frame[12:14] == LLDP_TYPE]
    assert [when for when, _ in sent] == [number * 5 * SECOND for number in range(5)]
    for _, frame in sent:
        assert Ether(frame)[LLDPDU].getlayer(LLDPDUTimeToLive).ttl == 20


# -- Ethernet frames --------------------------------------------------------------------------------------------------


TO, FROM = bytes.fromhex("010ecf000000"), bytes.fromhex("020000000001")


def test_a_frame_is_header_payload_and_zeros_up_to_60_bytes() -> None:
    assert ethernet.frame(TO, FROM, b"data") == TO + FROM + bytes.fromhex("8892") + b"data" + bytes(42)
    tagged = ethernet.frame(TO, FROM, b"data", tag=0xC000, ethertype=0x88CC)
    assert tagged == TO + FROM + bytes.fromhex("8100 c000 88cc") + b"data" + bytes(38)
    assert len(ethernet.frame(TO, FROM, bytes(46))) == 60
    assert ethernet.frame(TO, FROM, b"x" * 47) == TO + FROM + bytes.fromhex("8892") + b"x" * 47


@pytest.mark.parametrize(
    ("behind", "found"),
    [
        ("8892", (0x8892, 14)),
        ("0800", (0x0800, 14)),
        ("88", (0, 0)),
        ("8100 c000 8892", (0x8892, 18)),
        ("8100 c000 88", (0, 0)),
        ("8100", (0, 0)),
        ("", (0, 0)),
    ],
    ids=["untagged", "another type", "13 bytes", "tagged", "17 bytes", "tag cut short", "addresses alone"],
)
def test_payload_follows_the_type_with_and_without_a_tag(behind: str, found: tuple[int, int]) -> None:
    assert ethernet.payload_of(TO + FROM + bytes.fromhex(behind)) == found
