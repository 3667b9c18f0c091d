"""Allowed values in [transport] of a PROFINET device, and the report of errors."""

from __future__ import annotations

from ipaddress import IPv4Address

import pytest

from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.errors import GatewayError
from pdgw.profinet.station import IpSuite

AXIS = '[can]\ninterface = "virtual"\n[[axis]]\ndo_id = 1\nnode_id = 1\ntelegram = 1\n'
PROFINET = 'type = "profinet"\ninterface = "eth1"\n'
LABELS = "allowed: labels of 1..63 of a-z, 0-9, inner hyphens, with dots between"


@pytest.mark.parametrize(
    ("transport", "line"),
    [
        ('type = "profinet"', 'interface is missing: type = "profinet" needs it, for example "eth1"'),
        ('interface = "eth1"', 'interface: allowed only with type = "profinet"'),
        ('ip = "192.168.0.2/24"', 'ip: allowed only with type = "profinet"'),
        (PROFINET + 'router = "192.168.0.1"', "router: must be an address in the network of ip"),
        (PROFINET + 'ip = "192.168.0.2/24"\nrouter = "192.168.1.1"', "router: must be an address in the network"),
        (PROFINET + 'ip = "192.168.0.300/24"', "ip = '192.168.0.300/24': Input is not a valid IPv4 interface"),
        (PROFINET + 'ip = "192.168.0.0/24"', "ip = 192.168.0.0/24: allowed: a host's address below 224.0.0.0"),
        (PROFINET + 'ip = "192.168.0.255/24"', "ip = 192.168.0.255/24: allowed: a host's address below 224.0.0.0"),
        (PROFINET + 'ip = "127.0.0.1/8"', "ip = 127.0.0.1/8: allowed: a host's address below 224.0.0.0"),
        (PROFINET + 'station_name = "Press_1"', f"station_name = 'Press_1': {LABELS}"),
        ('station_name = "press"', 'station_name: allowed only with type = "profinet"'),
        (PROFINET + 'station_name = "."', f"station_name = '.': {LABELS}"),
        (PROFINET + 'station_name = "port-001.press"', "allowed: a first label other than a port name (port-001)"),
        (PROFINET + 'station_name = "10.0.0.1"', "station_name = '10.0.0.1': allowed: no IP address"),
        (PROFINET + f'station_name = "{"a." * 120}a"', "allowed: at most 240"),
    ],
)
def test_a_transport_that_makes_no_sense_is_refused_with_what_is_allowed(transport: str, line: str) -> None:
    with pytest.raises(GatewayError) as error:
        parse_config(f"[transport]\n{transport}\n{AXIS}", "x.toml")
    assert "[transport]" in str(error.value)
    assert line in str(error.value)


def test_a_fixed_address_has_its_mask_and_router() -> None:
    fixed = 'ip = "10.1.2.3/16"\nrouter = "10.1.0.1"\n'
    suite = parse_config(f"[transport]\n{PROFINET}{fixed}{AXIS}").transport.ip_suite
    assert suite == IpSuite(IPv4Address("10.1.2.3"), IPv4Address("255.255.0.0"), IPv4Address("10.1.0.1"))
    assert parse_config(f"[transport]\n{PROFINET}{AXIS}").transport.ip_suite is None


def test_a_station_without_a_name_waits_for_one() -> None:
    assert not parse_config(f'[transport]\n{PROFINET}station_name = ""\n{AXIS}').transport.station_name
