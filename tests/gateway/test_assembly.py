"""The whole gateway from one function: what a program gets is what ``pdgw run`` runs."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

import pdgw
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.parameters.acyclic import AcyclicServer
from pdgw.gateway.service.operating_system import ServiceManager
from pdgw.gateway.service.status import StatusServer
from pdgw.gateway.trace.recorder import FlightRecorder
from tests.support.gateways.daemon import axis
from tests.support.processes import free_tcp_port

CAN = '[can]\ninterface = "virtual"\nchannel = "assembly"\n'


def text(status_port: int, directory: Path, acyclic_port: int = 0) -> str:
    transport = f"[transport]\ncyclic_port = 0\nacyclic_port = {acyclic_port}\nstatus_port = {status_port}\n"
    return f'{CAN}{transport}[trace]\ndirectory = "{directory}"\n{axis(1, more="")}'


def test_a_library_user_gets_parameters_status_and_flight_recorder(tmp_path: Path) -> None:
    gateway = pdgw.build_gateway(pdgw.parse_config(text(free_tcp_port(), tmp_path)), name="line-3")
    try:
        kinds = [type(service) for service in gateway.services]
        assert kinds == [AcyclicServer, FlightRecorder, StatusServer, ServiceManager]
        assert {path.stem for path in tmp_path.iterdir()} == {"line-3"}
    finally:
        for service in gateway.services:
            service.stop()
        gateway.release()


def test_a_gateway_in_a_world_serves_parameters_and_opens_nothing_of_this_computer(tmp_path: Path) -> None:
    gateway = pdgw.build_gateway(pdgw.parse_config(text(free_tcp_port(), tmp_path)), pdgw.World())
    assert [type(service) for service in gateway.services] == [AcyclicServer]
    assert list(tmp_path.iterdir()) == []


def test_nothing_stays_open_when_the_status_port_is_in_use(tmp_path: Path) -> None:
    records = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    records.bind(("127.0.0.1", 0))
    port = records.getsockname()[1]
    records.close()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        config = pdgw.parse_config(text(taken.getsockname()[1], tmp_path, port))
        with pytest.raises(GatewayError, match="status port"):
            pdgw.build_gateway(config)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))
