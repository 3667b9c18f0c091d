"""Conformance class A: the test cases whose names and notes the Automated RT Tester's users publish, against the whole link.

The test specification itself is PI's and not public; what each case asks here follows its public notes and IEC 61158-6-10.
Requests of DCP are built and answers read by scapy. A power cycle is a new link on the stored parameters, with the interface's
address gone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
from scapy.contrib.pnio_dcp import ProfinetDCP
from scapy.layers.l2 import Ether

from pdgw.base.durations import MS, SECOND
from pdgw.profinet.discovery import lldp
from pdgw.profinet.station import Identity, IpSuite, Station
from tests.gateway.links.profinet.test_link import Rig
from tests.support.wire.profinet import (
    ALIAS,
    DEVICE_IP,
    DEVICE_MAC,
    GET,
    IDENTIFY,
    MULTICAST,
    NAME,
    PERMANENT,
    PLC_MAC,
    PORT_CHECK,
    SET,
    TEMPORARY,
    Wire,
    dcp_frame,
    encoded,
    project,
)

IP_SUITE, RESET, FACTORY_RESET, SIGNAL, ALL = (1, 2), (5, 6), (5, 5), (5, 3), (0xFF, 0xFF)
OK, OPTION, SUBOPTION, VALUE, IN_OPERATION = 0, 1, 2, 3, 6


@pytest.fixture
def dut(tmp_path: Path) -> Rig:
    """The device under test, without name and address."""
    rig = Rig(tmp_path)
    set_block(rig, RESET, b"", 4)
    rig.run(20 * MS)
    return rig


def power_cycle(dut: Rig) -> None:
    dut.run(20 * MS)
    dut.port.address = IpSuite()
    dut.start()


def exchange(dut: Rig, frame: bytes, wait: int = 20 * MS) -> list[ProfinetDCP]:
    """The DCP answers that scapy reads."""
    dut.port.sent.clear()
    dut.port.arrive(None, frame)
    dut.loop.run_for(wait)
    frames = [bytes(data) for _, data in dut.port.sent if data[12:14] == b"\x88\x92" and data[14] == 0xFE]
    dut.port.sent.clear()
    return [Ether(frame)[ProfinetDCP] for frame in frames]


def set_block(dut: Rig, option: tuple[int, int], value: bytes, qualifier: int = PERMANENT) -> int:
    """The BlockError of the answer to a Set."""
    block = encoded(option, qualifier.to_bytes(2, "big") + value)
    (answer,) = exchange(dut, dcp_frame(*SET, block, DEVICE_MAC.hex(":")))
    assert (answer.service_type, answer.xid) == (1, 7)
    assert bytes(answer)[10:16] == bytes.fromhex("0504 0003") + bytes(option)
    return bytes(answer)[16]


def identify(
    dut: Rig, *filters: tuple[tuple[int, int], bytes], delay: int = 1, vlan: bool = False
) -> list[ProfinetDCP]:
    blocks = b"".join(encoded(option, content) for option, content in filters)
    return exchange(dut, dcp_frame(*IDENTIFY, blocks, MULTICAST, delay, vlan), delay * 10 * MS + 20 * MS)


def shown(dut: Rig) -> tuple[str, str]:
    """Name and address from Identify all."""
    (answer,) = identify(dut, (ALL, b""))
    blocks = {(block.option, block.sub_option): block for block in answer.dcp_blocks}
    return blocks[NAME].name_of_station.decode(), blocks[IP_SUITE].ip


def test_dcp_1_a_permanent_address_survives_every_power_cycle(dut: Rig) -> None:
    assert set_block(dut, IP_SUITE, DEVICE_IP.encode()) == OK
    for _ in range(8):
        power_cycle(dut)
        assert shown(dut)[1] == str(DEVICE_IP.address)


def test_dcp_2_a_permanent_name_survives_power_cycles(dut: Rig) -> None:
    assert set_block(dut, NAME, b"press-2") == OK
    for _ in range(2):
        power_cycle(dut)
        assert shown(dut)[0] == "press-2"


def test_dcp_3_a_temporary_name_is_gone_after_a_power_cycle(dut: Rig) -> None:
    assert set_block(dut, NAME, b"press-2", TEMPORARY) == OK
    assert shown(dut)[0] == "press-2"
    power_cycle(dut)
    assert shown(dut)[0] == ""


def test_dcp_4_wrong_requests_are_answered_with_their_error(dut: Rig) -> None:
    assert set_block(dut, IP_SUITE, b"\xff" * 12) == VALUE
    assert set_block(dut, NAME, b"UPPER") == VALUE
    assert set_block(dut, (2, 3), b"\1\2\3\4") == SUBOPTION
    assert set_block(dut, (9, 9), b"") == OPTION
    assert shown(dut) == ("", "0.0.0.0")


def test_dcp_idn_each_filter_finds_the_device_and_no_other_value_does(dut: Rig) -> None:
    set_block(dut, NAME, b"dut")
    for option, content, answers in (
        (NAME, b"dut", 1),
        (NAME, b"du", 0),
        ((2, 1), b"profidrive-gateway", 1),
        ((2, 3), bytes.fromhex("ffff0402"), 1),
        ((2, 3), bytes.fromhex("ffff0403"), 0),
        ((2, 4), b"\1\0", 1),
        (ALL, b"", 1),
    ):
        assert len(identify(dut, (option, content))) == answers, (option, content)
    assert len(identify(dut, (ALL, b""), delay=0)) == 1


def test_dcp_alias_the_port_and_name_of_the_neighbour_find_the_device(dut: Rig) -> None:
    assert identify(dut, (ALIAS, b"port-003.b")) == []
    neighbour = Station(Identity(PLC_MAC, 1, 1, "switch", "B"), "b", port="port-003", lldp_legacy=True)
    dut.port.arrive(None, lldp.encode(neighbour))
    assert len(identify(dut, (ALIAS, b"port-003.b"))) == 1


@pytest.mark.parametrize("name", [b"a", b"a" * 63, b"a.b.c", b"1-a", b".".join([b"a" * 60] * 3), b"port-1", b"10.0.0"])
def test_dcp_name_1_a_legal_name_is_accepted_and_kept(dut: Rig, name: bytes) -> None:
    assert set_block(dut, NAME, name) == OK
    power_cycle(dut)
    assert shown(dut)[0] == name.decode()


@pytest.mark.parametrize("name", [b"a-", b"-a", b"a..b", b"a_b", b"a" * 64, b"port-001", b"port-001-00001", b"1.2.3.4"])
def test_dcp_name_2_an_illegal_name_is_refused_and_the_old_one_kept(dut: Rig, name: bytes) -> None:
    set_block(dut, NAME, b"dut")
    assert set_block(dut, NAME, name) == VALUE
    power_cycle(dut)
    assert shown(dut)[0] == "dut"


@pytest.mark.parametrize(("option", "qualifier"), [(RESET, 4), (FACTORY_RESET, 0)])
def test_dcp_reset_to_factory_clears_name_and_address(dut: Rig, option: tuple[int, int], qualifier: int) -> None:
    set_block(dut, NAME, b"dut")
    set_block(dut, IP_SUITE, DEVICE_IP.encode())
    assert set_block(dut, option, b"", qualifier) == OK
    assert shown(dut) == ("", "0.0.0.0")
    power_cycle(dut)
    assert shown(dut) == ("", "0.0.0.0")


def test_dcp_options_suboptions_every_listed_option_answers_get_or_set(dut: Rig) -> None:
    (answer,) = exchange(dut, dcp_frame(*GET, bytes((2, 5)), DEVICE_MAC.hex(":")))
    content = bytes(answer)[16 : 10 + answer.dcp_data_length]
    listed = {(content[at], content[at + 1]) for at in range(0, len(content) - 1, 2)}
    assert {NAME, IP_SUITE, RESET, FACTORY_RESET, SIGNAL, (1, 1), (2, 1), (2, 3), (2, 4), (2, 5), ALL} <= listed
    for option in sorted(listed - {ALL}):
        (answer,) = exchange(dut, dcp_frame(*GET, bytes(option), DEVICE_MAC.hex(":")))
        first = bytes(answer)[10:12]
        assert first == (bytes((5, 4)) if option[0] == 5 else bytes(option))


def test_dcp_router_a_router_outside_the_subnet_is_refused(dut: Rig) -> None:
    inside, outside = bytes.fromhex("c0a80002ffffff00c0a80001"), bytes.fromhex("c0a80002ffffff00c0a80101")
    assert set_block(dut, IP_SUITE, outside) == VALUE
    assert set_block(dut, IP_SUITE, inside) == OK
    (answer,) = identify(dut, (ALL, b""))
    assert answer.dcp_blocks[0].gateway == "192.168.0.1"


def test_dcp_access_name_address_and_reset_are_refused_while_connected(dut: Rig) -> None:
    set_block(dut, NAME, b"gateway")
    dut.connect()
    assert set_block(dut, NAME, b"other") == IN_OPERATION
    assert set_block(dut, IP_SUITE, bytes.fromhex("c0a80063ffffff0000000000")) == IN_OPERATION
    assert set_block(dut, RESET, b"", 4) == IN_OPERATION
    assert set_block(dut, NAME, b"gateway") == set_block(dut, IP_SUITE, DEVICE_IP.encode(), TEMPORARY) == OK


def test_dcp_vlan_a_tagged_identify_is_answered(dut: Rig) -> None:
    assert len(identify(dut, (ALL, b""), vlan=True)) == 1


@pytest.mark.parametrize(("last", "kept"), [(PERMANENT, True), (TEMPORARY, False)])
def test_dcp_ip_parameter_remanence_the_last_set_decides(dut: Rig, last: int, kept: bool) -> None:
    set_block(dut, IP_SUITE, bytes.fromhex("c0a80063ffffff0000000000"), 1 - last)
    power_cycle(dut)
    set_block(dut, IP_SUITE, DEVICE_IP.encode(), last)
    for _ in range(2):
        power_cycle(dut)
        assert shown(dut)[1] == (str(DEVICE_IP.address) if kept else "0.0.0.0")


def test_dcp_signal_the_device_flashes_for_three_seconds(dut: Rig) -> None:
    def flashing() -> bool:
        return bool(cast("dict[str, Any]", dut.link.status()["station"])["flashing"])

    assert set_block(dut, SIGNAL, b"\1\0", 0) == OK
    assert flashing()
    dut.loop.run_for(3 * SECOND)
    assert not flashing()


def test_behaviour_the_device_connects_again_after_every_power_cycle(dut: Rig) -> None:
    for _ in range(3):
        set_block(dut, NAME, b"gateway")
        dut.connect()
        dut.link.close()
        power_cycle(dut)


def test_pdev_check_oneport_a_wrong_neighbour_is_an_alarm_of_the_port() -> None:
    wire = Wire(of_project=project(records=[(0, 0, 0x8001, 0x802B, PORT_CHECK)]))
    wire.connect()
    for name in ("wrong", "plc-1"):
        station = Station(Identity(PLC_MAC, 1, 1, "b", "B"), name, lldp_legacy=True)
        wire.device.on_frame(lldp.encode(station), wire.now)
        wire.run(100 * MS)
    told = [(alarm.subslot, alarm.alarm_type, alarm.payload[:2].hex()) for alarm in wire.plc.learned.alarms]
    assert told == [(0x8001, 0x0001, "8002"), (0x8001, 0x000C, "8002")]


@pytest.mark.parametrize("ratio", [1, 2, 4, 8, 16])
def test_data_hold_timer_three_to_six_frames_are_sent_before_the_alarm(ratio: int) -> None:
    wire = Wire(of_project=project(reduction_ratio=ratio, data_hold=3))
    wire.connect()
    wire.run(100 * MS)
    wire.to_device = False
    wire.frames.clear()
    wire.run(200 * MS, lambda: not wire.device.connected)
    wire.carry()
    from_device = [frame for frame in wire.frames if frame[6:12] == DEVICE_MAC and frame[12:14] == b"\x81\x00"]
    ids = [int.from_bytes(frame[18:20], "big") for frame in from_device]
    assert ids[-1] == 0xFE01, "the alarm ERR ends it"
    assert 2 <= len(ids[:-1]) <= 6
    assert len(set(ids[:-1])) == 1
