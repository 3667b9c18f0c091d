"""Texts of the system group: written by SNMP, kept in the store, cleared by a reset to factory."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from scapy.asn1.asn1 import ASN1_OID
from scapy.layers.snmp import SNMP, SNMPget, SNMPset, SNMPvarbind

from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.profinet.snmp import SnmpService
from pdgw.profinet.discovery.dcp import ResetToFactory
from tests.support.gateways.daemon import axis
from tests.support.gateways.profinet_daemon import configuration, plant

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
