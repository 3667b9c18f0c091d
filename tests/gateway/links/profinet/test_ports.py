"""The network port of a PROFINET gateway: errors, speed, short cycles, texts of SNMP, and replacement of the device."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from scapy.asn1.asn1 import ASN1_OID
from scapy.contrib.pnio_dcp import ProfinetDCP
from scapy.layers.l2 import Ether
from scapy.layers.snmp import SNMP, SNMPget, SNMPset, SNMPvarbind

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.dsp402.states import State
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.links.profinet.ethernet import RawEthernet, medium_of, read_medium
from pdgw.gateway.links.profinet.snmp import SnmpService
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import project_of
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.blocks.connect_blocks import TICK_NS
from pdgw.profinet.connection.cpm import Verdict
from pdgw.profinet.discovery import lldp
from pdgw.profinet.discovery.dcp import ResetToFactory
from pdgw.profinet.station import Identity, Medium, Station
from tests.support.gateways.daemon import axis, drive_of
from tests.support.gateways.profinet_daemon import OFF, ON, Plant, configuration, plant
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import (
    ALIAS,
    DEVICE_MAC,
    IDENTIFY,
    IDENTITY,
    MULTICAST,
    NAME,
    PERMANENT,
    SET,
    dcp_frame,
    encoded,
)

# -- an interface that is not available ---------------------------------------------------------------------------


@pytest.fixture
def loop() -> Iterator[SystemLoop]:
    loop = SystemLoop()
    yield loop
    loop.close()


def test_a_missing_interface_is_rejected_with_those_that_exist(loop: SystemLoop) -> None:
    with pytest.raises(GatewayError, match=r"interface nowhere0: does not exist, allowed: .*lo"):
        RawEthernet(loop, "nowhere0")


def test_without_the_right_to_raw_frames_the_message_names_the_capability(
    loop: SystemLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> socket.socket:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(socket, "socket", refused)
    with pytest.raises(
        GatewayError, match=r"interface lo: no permission for raw Ethernet \(CAP_NET_RAW is missing\).*setcap"
    ):
        RawEthernet(loop, "lo")


def test_an_interface_that_is_not_ethernet_is_refused(loop: SystemLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[FakeSocket] = []

    class FakeSocket:
        closed = False

        def __init__(self, *_: object) -> None:
            opened.append(self)

        def getsockname(self) -> tuple[str, int, int, int, bytes]:
            return "lo", 0x8892, 4, 772, bytes(6)  # ARPHRD_LOOPBACK

        def setsockopt(self, *_: object) -> None: ...

        def bind(self, address: object) -> None: ...

        def fileno(self) -> int:
            return 1000

        def close(self) -> None:
            self.closed = True

    monkeypatch.setattr(socket, "socket", FakeSocket)
    with pytest.raises(GatewayError, match="interface lo: not an Ethernet interface"):
        RawEthernet(loop, "lo")
    assert opened
    assert all(item.closed for item in opened)


# -- speed and duplex mode, from the driver and in LLDP; tshark reads the names -----------------------------------


VETH = "01000000 00000000 00000000 1027 01 00 00 00 00 00" + "00" * 24
"""As a virtual pair answers: 10 Gbit/s, full duplex, no autonegotiation."""
GIGABIT = "01000000 ef020000 ef020000 e803 01 00 00 00 01 00" + "00" * 24
"""A network card at 1 Gbit/s: 10BASE-T to 1000BASE-T (full duplex alone) by autonegotiation."""
FAST_HALF = "01000000 4f000000 0f000000 6400 00 00 00 00 00 00" + "00" * 24
"""100 Mbit/s, half duplex, autonegotiation supported and off."""
NO_LINK = "01000000 cf000000 cf000000 ffff ff 00 00 00 01 00" + "00" * 8 + "ffff" + "00" * 14


@pytest.mark.parametrize(
    ("answer", "medium"),
    [
        (VETH, Medium(54, 0, 0)),
        (GIGABIT, Medium(30, 3, 0x6C01)),
        (FAST_HALF, Medium(15, 1, 0x6C00)),
        (NO_LINK, Medium(0, 3, 0x6C00)),
    ],
    ids=["virtual pair", "1 Gbit/s", "100 Mbit/s half duplex", "no link"],
)
def test_a_drivers_answer_is_read_as_mau_type_and_capabilities(answer: str, medium: Medium) -> None:
    assert medium_of(bytes.fromhex(answer)) == medium


@pytest.mark.skipif(sys.platform != "linux", reason="ETHTOOL is Linux")
def test_an_interface_without_a_driver_that_answers_is_unknown() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        assert read_medium(sock, "lo") == Medium(0, 0, 0)
        assert read_medium(sock, "nowhere0") == Medium(0, 0, 0)


@tshark.needs_tshark
@pytest.mark.tshark
def test_tshark_reads_the_interfaces_true_speed_in_lldp(tmp_path: Path) -> None:
    prefix = "lldp.ieee.802_3."
    names = [f"{prefix}{name}" for name in ("pmd_mau_type", "mac_phy_auto_neg_status", "pmd_auto_neg_advertised_caps")]
    names += [f"{names[2]}.1000base_tfd", f"{names[2]}.1000base_t", f"{names[2]}.10base_t"]
    frames = [
        lldp.encode(Station(IDENTITY, "gateway", medium=medium_of(bytes.fromhex(text)))) for text in (GIGABIT, VETH)
    ]
    rows = tshark_frames.read(frames, tmp_path / "lldp.pcap", names)
    found = [[int(row[name] or "0", 0) for name in names] for row in rows]
    assert found == [[30, 3, 0x6C01, 1, 0, 1], [54, 0, 0, 0, 0, 0]]


# -- cycles below one millisecond ---------------------------------------------------------------------------------


SPEED = 0x1000
LASTING_NS = 100 * MS


@pytest.mark.parametrize("clock", [8, 16])
def test_drive_follows_and_stops_in_cycles_below_one_millisecond(tmp_path: Path, clock: int) -> None:
    cycle_ns = clock * TICK_NS
    transport = f"cycle_time_ms = {cycle_ns / MS}\nwatchdog_factor = 100"
    with plant(configuration(axis(1), tmp_path / "store.json", transport=transport)) as site:
        site.plc.project = replace(site.plc.project, send_clock=clock, reduction_ratio=1, data_hold=400)
        site.connect()
        site.enable(1, SPEED)
        cyclic = site.link.device.cm.cyclic

        def counts() -> tuple[int, int]:
            return cyclic.sent, cyclic.received[Verdict.ACCEPTED]

        before = counts()
        site.run(LASTING_NS)
        for now, then in zip(counts(), before, strict=True):
            assert now - then == pytest.approx(LASTING_NS // cycle_ns, abs=5)
        assert cyclic.missed == 0
        model = drive_of(site.daemon).model
        site.until(lambda: model.ramp.speed > 0, "motion")
        site.set(1, OFF)
        site.until(lambda: not model.ramp.speed and model.state.name != "OPERATION_ENABLED", "standstill without power")


@pytest.mark.parametrize(("configured", "clock"), [(4, 16), (1, 16), (0.5, 8), (0.3, 8)])
def test_cycle_shorter_than_the_configured_one_is_refused(tmp_path: Path, configured: float, clock: int) -> None:
    transport = f"cycle_time_ms = {configured}"
    with plant(configuration(axis(1), tmp_path / "store.json", transport=transport)) as site:
        site.plc.project = replace(site.plc.project, send_clock=clock, reduction_ratio=1)
        site.plc.start(site.loop.now())
        site.until(lambda: site.plc.phase is Phase.ENDED, "the refusal")
        assert "DB 81 02 0B" in site.plc.learned.ended


@pytest.mark.parametrize(
    ("cycle_ns", "clock", "ratio"), [(MS // 4, 8, 1), (MS // 2, 16, 1), (MS, 32, 1), (512 * MS, 32, 512)]
)
def test_project_of_the_simulated_plc_has_the_cycle(cycle_ns: int, clock: int, ratio: int) -> None:
    project = project_of("press-1", [telegram(1)], cycle_ns)
    assert (project.send_clock, project.reduction_ratio) == (clock, ratio)


@pytest.mark.parametrize("cycle_ns", [MS // 8, 3 * MS // 4, 3 * MS, 1024 * MS, MS + 1])
def test_project_of_the_simulated_plc_refuses_other_cycles(cycle_ns: int) -> None:
    with pytest.raises(GatewayError, match=r"allowed with --profinet are 0\.25, 0\.5, 1, 2"):
        project_of("press-1", [telegram(1)], cycle_ns)


# -- texts of the system group ------------------------------------------------------------------------------------


SYSTEM = {"sys_contact": "1.3.6.1.2.1.1.4.0", "sys_name": "1.3.6.1.2.1.1.5.0", "sys_location": "1.3.6.1.2.1.1.6.0"}
BOTH = 'snmp_community = "public"\nsnmp_write_community = "secret"'


def read(service: SnmpService) -> list[bytes]:
    pdu = SNMPget(varbindlist=[SNMPvarbind(oid=ASN1_OID(oid)) for oid in SYSTEM.values()])
    answer = service.agent.answer(bytes(SNMP(version=1, community="public", PDU=pdu)))
    return [item.value.val for item in SNMP(answer).PDU.varbindlist]


def test_written_texts_are_shown_at_once_kept_and_cleared_by_a_reset(tmp_path: Path) -> None:
    store = tmp_path / "store.json"
    with plant(configuration(axis(1), store, transport=BOTH)) as site, socket.socket() as sock:
        service = SnmpService(site.daemon, sock)
        variables = [SNMPvarbind(oid=ASN1_OID(oid), value=name.encode()) for name, oid in SYSTEM.items()]
        pdu = SNMPset(varbindlist=variables)
        answer = service.agent.answer(bytes(SNMP(version=1, community="secret", PDU=pdu)))
        assert SNMP(answer).PDU.error.val == 0
        assert read(service) == [name.encode() for name in SYSTEM]
        site.run(100 * MS)
        assert read(service) == [name.encode() for name in SYSTEM]
        for name in SYSTEM:
            assert f'"{name}":"{name}"' in store.read_text(encoding="utf-8").replace(" ", "").replace('\\"', '"')
        site.link._keeper.on_event(ResetToFactory(), "press-1")
        site.run(100 * MS)
        assert read(service) == [b"", b"press-1", b""]


@pytest.mark.parametrize("keys", ['snmp_write_community = "x"', 'snmp_community = "x"\nsnmp_write_community = "x"'])
def test_writing_needs_a_community_of_its_own(tmp_path: Path, keys: str) -> None:
    with pytest.raises(GatewayError, match="snmp_write_community: needs a different snmp_community"):
        configuration(axis(1), tmp_path / "store.json", transport=keys)


# -- the new gateway at its place in the topology; no drive starts ------------------------------------------------


SWITCH = Station(Identity(bytes.fromhex("020000000009"), 1, 1, "switch", "S"), "switch", port="port-003")
PLACE = b"port-003.switch"
"""The alias of what is plugged into port 3 of the switch."""


def ask(site: Plant, frame: bytes) -> list[ProfinetDCP]:
    """Send a DCP request; the answers that scapy reads."""
    sent = len(site.frames)
    site.port.arrive(None, frame)
    site.run(50 * MS)
    return [Ether(data)[ProfinetDCP] for _, data in site.frames[sent:] if data[6:12] == DEVICE_MAC and data[14] == 0xFE]


def identify(site: Plant, option: tuple[int, int], content: bytes) -> list[ProfinetDCP]:
    return ask(site, dcp_frame(*IDENTIFY, encoded(option, content), MULTICAST, delay=1))


def test_a_replaced_gateway_is_named_by_its_neighbour_and_starts_nothing(tmp_path: Path) -> None:
    config = configuration(axis(1), tmp_path / "old.json")
    with plant(config) as site:
        site.connect()
        site.enable(1, SPEED)
    spare = config.model_copy(
        update={
            "store": tmp_path / "spare.json",
            "transport": config.transport.model_copy(update={"station_name": ""}),
        }
    )
    with plant(spare) as site:
        site.port.arrive(None, lldp.encode(SWITCH))
        assert identify(site, NAME, b"press-1") == [], "nobody has the name of the project"
        assert identify(site, ALIAS, b"port-002.switch") == []
        (found,) = identify(site, ALIAS, PLACE)
        (name,) = [block for block in found.dcp_blocks if (block.option, block.sub_option) == NAME]
        assert name.name_of_station == b"", "in the state of delivery: the controller may name it"
        content = encoded(NAME, PERMANENT.to_bytes(2, "big") + b"press-1")
        (answer,) = ask(site, dcp_frame(*SET, content, DEVICE_MAC.hex(":")))
        assert bytes(answer)[10:17] == bytes.fromhex("0504 0003 0202 00")
        site.connect()
        assert site.port.address.address == site.plc.learned.ip.address
        # The program of the PLC has gone on: ON and a speed from the first frame.
        model = drive_of(site.daemon).model
        site.set(1, ON, SPEED)
        for _ in range(100):
            site.run(10 * MS)
            assert model.state is not State.OPERATION_ENABLED
            assert not model.velocity_actual
        site.enable(1, SPEED)
        site.run(SECOND)
        assert abs(model.velocity_actual) > 100
    with plant(spare) as site:
        assert site.link.device.station.name == "press-1", "kept over a power cycle"
