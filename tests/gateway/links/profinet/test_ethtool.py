"""Speed and duplex mode of an interface, from its driver and in LLDP; tshark reads the names."""

from __future__ import annotations

import socket
import sys
from pathlib import Path

import pytest

from pdgw.gateway.links.profinet.ethernet import medium_of, read_medium
from pdgw.profinet.discovery import lldp
from pdgw.profinet.station import Medium, Station
from tests.support.readers import tshark, tshark_frames
from tests.support.wire.profinet import IDENTITY

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
