"""A controller and the device from Identify to Release, in virtual time."""

from __future__ import annotations

from pdgw.durations import MS
from pdgw.peers.controller.controller import Phase
from pdgw.profinet.connection.cmdev import AbortCode
from pdgw.profinet.device import Connected, Disconnected
from pdgw.profinet.rpc.dcerpc import PacketType
from tests.support.wire.profinet import Wire, project

AXIS = (1, 2)


def test_a_controller_finds_the_device_by_name_and_exchanges_data() -> None:
    wire = Wire()
    wire.connect()
    assert len(wire.told(Connected)) == 1
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
    assert [event.ended.code for event in wire.told(Disconnected)] == [AbortCode.RELEASED] * 3


def test_silent_controller_is_lost_within_the_data_hold_time() -> None:
    wire = Wire(of_project=project(reduction_ratio=8, data_hold=3))
    wire.connect()
    wire.run(100 * MS)
    wire.to_device = False
    since = wire.now
    wire.run(1000 * MS, lambda: not wire.device.connected)
    assert wire.now - since <= 24 * MS
    (lost,) = wire.told(Disconnected)
    assert lost.ended.code is AbortCode.DATA_HOLD
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
