"""Builds the whole gateway of a configuration: the cyclic exchange and everything that runs beside it.

A real computer has a status port, a flight recorder, SNMP and a service manager; a simulated one has parameter access only.
"""

from __future__ import annotations

import logging
from contextlib import ExitStack
from typing import TYPE_CHECKING

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.log_budget import LogBudget
from pdgw.gateway.base.platform import Platform
from pdgw.gateway.base.run_directory import prepared, run_directory
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.acyclic import record_service
from pdgw.gateway.service.operating_system import ServiceManager
from pdgw.gateway.service.running import Service
from pdgw.gateway.service.status_port import StatusServer
from pdgw.gateway.trace.recorder import FlightRecorder

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pdgw.gateway.links.profinet.ethernet import EthernetPort

log = logging.getLogger("gateway")


def build_gateway(
    config: GatewayConfig,
    platform: Platform | None = None,
    ethernet: EthernetPort | None = None,
    *,
    name: str = "gateway",
) -> Daemon:
    """A gateway that is ready to ``run``, or to ``start`` on the loop of ``platform``.

    ``platform``: clock, buses and ports, None for this computer. ``ethernet``: the interface of the PROFINET link, None opens the
    configured one. ``name``: what the file of the flight recorder is called.

    Raises GatewayError or CanopenError when a port, a file or a CAN interface is not available; nothing stays open then.
    """
    with ExitStack() as opened:
        daemon = Daemon(config, platform, ethernet)
        opened.callback(daemon.release)
        for service in _services(daemon, name):
            opened.callback(service.stop)
            daemon.services.append(service)
        opened.pop_all()
    return daemon


def _services(daemon: Daemon, name: str) -> Iterator[Service]:
    transport = daemon.config.transport
    yield LogBudget(daemon.loop)
    yield record_service(daemon)
    if not daemon.platform.has_services:
        return
    if transport.snmp_community is not None:
        from pdgw.gateway.links.profinet.snmp import SnmpService, open_port  # noqa: PLC0415 (few gateways have it)

        yield SnmpService(daemon, open_port(transport.interface or ""))
    recorder = _flight_recorder(daemon, name)
    if recorder is not None:
        yield recorder
    if transport.status_port:
        yield StatusServer(daemon, transport.status_port)
    manager = ServiceManager.of_this_process()
    manager.count_in(daemon.loop.counters)
    daemon.watch.listeners.append(manager)
    yield manager


def _flight_recorder(daemon: Daemon, name: str) -> FlightRecorder | None:
    """Without room for it, the gateway runs anyway."""
    trace = daemon.config.trace
    directory = trace.directory or run_directory()
    if not trace.enabled or directory is None:
        return None
    try:
        return FlightRecorder(daemon, prepared(directory), name)
    except GatewayError as error:
        log.warning("%s; the gateway runs without it", error)
        return None
