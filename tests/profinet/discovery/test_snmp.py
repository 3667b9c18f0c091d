"""The SNMP agent: scapy asks and reads, tshark names the objects, and no bytes make it fail or answer much."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.asn1.asn1 import ASN1_OID
from scapy.contrib import lldp as scapy_lldp
from scapy.layers.l2 import Ether
from scapy.layers.snmp import SNMP, SNMPbulk, SNMPget, SNMPnext, SNMPset, SNMPvarbind

from pdgw.profinet.discovery import lldp, mib
from pdgw.profinet.discovery.snmp import REQUEST_MAX, Agent, Kind, Variable, Writing
from pdgw.profinet.station import Medium, Neighbour, Station
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import DEVICE_IP, IDENTITY, PLC_IP, PLC_MAC

LLDP = "1.0.8802.1.1.2.1"
SYS_NAME, LOC_PORT, REM_PORT = "1.3.6.1.2.1.1.5.0", f"{LLDP}.3.7.1.3.1", f"{LLDP}.4.1.1.7.0.1.1"
PNO_NAME, MAU = f"{LLDP}.5.3791.1.2.1.1.6.1", f"{LLDP}.5.4623.1.2.1.1.4.1"
ADDRESS = f"{LLDP}.3.8.1.5.1.4.192.168.0.2"
NEVER, END = "1.3.6.1.2.1.99.0", "2.5"


def agent(neighbour: bool = True) -> Agent:
    station = Station(IDENTITY, "press-1", DEVICE_IP, medium=Medium(30, 3, 0x6C01))
    if neighbour:
        station.neighbour = Neighbour(b"\7plc", b"\7port-001", PLC_MAC, 0, 1)
    system = {mib.SYS_LOCATION: "hall 3"}
    writing = Writing(b"secret", {mib.SYS_NAME: 20, mib.SYS_LOCATION: 20}, system.update)
    return Agent(b"public", lambda: mib.objects(station, (17, 1 << 32 | 4), system, 12_340_000_000), writing)


def ask(pdu: object, community: str = "public", version: int = 1, of: Agent | None = None) -> SNMP | None:
    answer = (of or agent()).answer(bytes(SNMP(version=version, community=community, PDU=pdu)))
    return None if answer is None else SNMP(answer)


def binds(*oids: str) -> list[SNMPvarbind]:
    return [SNMPvarbind(oid=ASN1_OID(oid)) for oid in oids]


def read(*oids: str, of: Agent | None = None) -> list[object]:
    answer = ask(SNMPget(id=9, varbindlist=binds(*oids)), of=of)
    assert answer is not None
    assert (answer.PDU.id.val, answer.PDU.error.val) == (9, 0)
    assert [item.oid.val for item in answer.PDU.varbindlist] == list(oids)
    return [item.value.val for item in answer.PDU.varbindlist]


def walk(of: Agent) -> list[str]:
    oid, seen = "1.0", []
    while True:
        answer = ask(SNMPnext(id=1, varbindlist=binds(oid)), of=of, version=0)
        assert answer is not None
        if answer.PDU.error.val == 2:
            return seen
        oid = answer.PDU.varbindlist[0].oid.val
        seen.append(oid)


def test_topology_is_readable_by_its_published_object_identifiers() -> None:
    found = read(SYS_NAME, LOC_PORT, REM_PORT, PNO_NAME, MAU, ADDRESS, "1.3.6.1.2.1.1.6.0", "1.3.6.1.2.1.1.3.0")
    assert found == [b"press-1", b"port-001.press-1", b"port-001", b"press-1", 30, 1, b"hall 3", 1234]
    interface = "1.3.6.1.2.1.2.2.1"
    assert read(f"{interface}.5.1", f"{interface}.8.1", f"{interface}.10.1", f"{interface}.16.1") == [10**9, 1, 17, 4]
    assert read(f"{interface}.6.1") == [IDENTITY.mac]


def test_topology_shows_a_neighbour_without_profinet_by_its_own_ids() -> None:
    """An office switch: its address as chassis, the interface's name as port, and where it is managed."""
    chassis, source = "02:00:00:00:00:70", "02:00:00:00:00:77"
    frame = (
        Ether(src=source, dst="01:80:c2:00:00:0e", type=0x88CC)
        / scapy_lldp.LLDPDUChassisID(subtype=4, id=chassis)
        / scapy_lldp.LLDPDUPortID(subtype=5, id=b"fa1")
        / scapy_lldp.LLDPDUTimeToLive(ttl=120)
        / scapy_lldp.LLDPDUManagementAddress(
            management_address_subtype=1,
            management_address=bytes((192, 168, 0, 98)),
            interface_numbering_subtype=2,
            interface_number=49,
            object_id=b"",
        )
        / scapy_lldp.LLDPDUEndOfLLDPDU()
    )
    station = Station(IDENTITY, "press-1", DEVICE_IP, neighbour=lldp.decode(bytes(frame), 14, 0))
    served = Agent(b"public", lambda: mib.objects(station, (0, 0), {}, 0))
    remote, managed = f"{LLDP}.4.1.1", f"{LLDP}.4.2.1"
    ids = [f"{remote}.{column}.0.1.1" for column in (4, 5, 6, 7)]
    assert read(*ids, of=served) == [4, bytes.fromhex("020000000070"), 5, b"fa1"]
    row = "0.1.1.1.4.192.168.0.98"
    assert read(f"{managed}.3.{row}", f"{managed}.4.{row}", of=served) == [2, 49]


def test_a_walk_meets_every_object_once_in_ascending_order_and_ends() -> None:
    for neighbour in (True, False):
        seen = walk(agent(neighbour))
        keys = [tuple(map(int, oid.split("."))) for oid in seen]
        assert keys == sorted(set(keys))
        assert len(seen) >= 40
        assert (REM_PORT in seen) is neighbour


def test_getbulk_answers_repetitions_and_stays_within_one_frame() -> None:
    answer = agent().answer(
        bytes(SNMP(version=1, community="public", PDU=SNMPbulk(id=3, max_repetitions=1000, varbindlist=binds("1.0"))))
    )
    assert answer is not None
    assert len(answer) <= REQUEST_MAX
    found = [item.oid.val for item in SNMP(answer).PDU.varbindlist]
    assert found == walk(agent())[: len(found)]
    assert len(found) > 16


def test_missing_object_is_an_error_in_v1_and_an_exception_in_v2c() -> None:
    for pdu, asked in ((SNMPget, NEVER), (SNMPnext, END)):
        old = ask(pdu(id=1, varbindlist=binds(SYS_NAME, asked)), version=0)
        assert old is not None
        assert (old.PDU.error.val, old.PDU.error_index.val) == (2, 2)
    raw = agent().answer(bytes(SNMP(version=1, community="public", PDU=SNMPget(varbindlist=binds(NEVER)))))
    assert raw is not None
    assert raw.endswith(b"\x80\0")
    raw = agent().answer(bytes(SNMP(version=1, community="public", PDU=SNMPnext(varbindlist=binds(END)))))
    assert raw is not None
    assert raw.endswith(b"\x82\0")


@pytest.mark.parametrize(("version", "error"), [(0, 2), (1, 17)])
def test_a_set_changes_nothing_and_is_refused(version: int, error: int) -> None:
    served = agent()
    answer = ask(
        SNMPset(id=5, varbindlist=[SNMPvarbind(oid=ASN1_OID(SYS_NAME), value=b"x")]), version=version, of=served
    )
    assert answer is not None
    assert answer.PDU.error.val == error
    assert read(SYS_NAME, of=served) == [b"press-1"]


SYS_LOCATION, SYS_DESCR = "1.3.6.1.2.1.1.6.0", "1.3.6.1.2.1.1.1.0"


def write(of: Agent, version: int = 1, community: str = "secret", **texts: object) -> tuple[int, int]:
    """Error and its index; ``texts`` by the name of their OID."""
    oids = {"name": SYS_NAME, "location": SYS_LOCATION, "descr": SYS_DESCR}
    variables = [SNMPvarbind(oid=ASN1_OID(oids[name]), value=value) for name, value in texts.items()]
    answer = ask(SNMPset(id=5, varbindlist=variables), community, version, of)
    assert answer is not None
    assert answer.community.val == community.encode()
    return answer.PDU.error.val, answer.PDU.error_index.val


def test_the_writing_community_writes_all_texts_of_a_request_or_none() -> None:
    served = agent()
    assert write(served, name=b"axis 7", location=b"hall 4") == (0, 0)
    assert read(SYS_NAME, SYS_LOCATION, of=served) == [b"axis 7", b"hall 4"]
    for version, errors in ((1, (17, 7, 10, 10)), (0, (2, 3, 3, 3))):
        for error, second in zip(
            errors, ({"descr": b"x"}, {"name": 7}, {"name": b"x" * 21}, {"name": b"\n"}), strict=True
        ):
            assert write(served, version, location=b"hall 5", **second) == (error, 2)
    assert read(SYS_NAME, SYS_LOCATION, of=served) == [b"axis 7", b"hall 4"]
    assert write(served, name=b"") == (0, 0)
    assert read(SYS_NAME, of=served) == [b"press-1"], "the name of station"


def test_another_community_or_version_gets_no_answer() -> None:
    served = agent()
    for community, version in (("private", 1), ("", 1), ("public", 3)):
        assert ask(SNMPget(varbindlist=binds(SYS_NAME)), community, version, served) is None
    assert served.ignored == 3


def test_too_many_variables_get_no_answer_and_too_long_an_answer_is_too_big() -> None:
    assert ask(SNMPget(varbindlist=binds(*["1.3"] * 65))) is None
    long = Agent(b"c", lambda: [Variable((1, 3, 1), Kind.OCTETS, bytes(250))])
    answer = ask(SNMPget(varbindlist=binds(*["1.3.1"] * 8)), "c", of=long)
    assert answer is not None
    assert answer.PDU.error.val == 1


REQUEST = bytes(SNMP(version=1, community="public", PDU=SNMPbulk(id=3, max_repetitions=5, varbindlist=binds("1.0"))))


@given(st.lists(st.tuples(st.integers(0, len(REQUEST) - 1), st.integers(0, 255)), max_size=4), st.integers(0, 60))
def test_a_damaged_request_is_answered_within_one_frame_or_not_at_all(changes: list[tuple[int, int]], cut: int) -> None:
    data = bytearray(REQUEST)
    for at, value in changes:
        data[at] = value
    answer = agent().answer(bytes(data[: len(data) - cut]))
    assert answer is None or len(answer) <= REQUEST_MAX


@given(st.binary(max_size=200))
def test_any_bytes_are_answered_within_one_frame_or_not_at_all(data: bytes) -> None:
    answer = agent().answer(data)
    assert answer is None or len(answer) <= REQUEST_MAX


@given(st.integers(-(1 << 31), (1 << 32) - 1), st.lists(st.integers(0, 0xFFFFFFFF), max_size=20))
def test_scapy_reads_any_value_back(number: int, rest: list[int]) -> None:
    oid = (1, 3, *rest)
    served = Agent(b"public", lambda: [Variable(oid, Kind.INTEGER, number), Variable((2, 1), Kind.OID, oid)])
    assert read(".".join(map(str, oid)), "2.1", of=served) == [number, ".".join(map(str, oid))]


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_names_and_values_of_an_answer(tmp_path: Path) -> None:
    assert shutil.which("tshark")
    request = bytes(SNMP(version=1, community="public", PDU=SNMPget(id=9, varbindlist=binds(SYS_NAME, MAU))))
    answer = agent().answer(request)
    assert answer is not None
    ends = (str(DEVICE_IP.address), 161), (PLC_IP, 50_000)
    names = ["snmp.name", "snmp.value.octets", "snmp.value.int", "snmp.request_id", "snmp.error_status"]
    frame = tshark_frames.datagram(answer, *ends)
    (row,) = tshark_frames.read([frame], tmp_path / "snmp.pcap", names, every=True)
    assert row["snmp.name"] == f"{SYS_NAME},{MAU}"
    assert bytes.fromhex(row["snmp.value.octets"].replace(":", "")) == b"press-1"
    assert (row["snmp.value.int"], row["snmp.request_id"], row["snmp.error_status"]) == ("30", "9", "0")
