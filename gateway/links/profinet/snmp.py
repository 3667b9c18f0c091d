"""The SNMP agent of a PROFINET gateway on UDP port 161 of its interface, bounded in each turn of the loop."""

from __future__ import annotations

import logging
import socket
from typing import Final

from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.profinet.link import ProfinetLink
from pdgw.profinet import mib
from pdgw.profinet.snmp import REQUEST_MAX, Agent, Variable

log = logging.getLogger("gateway")

PORT: Final = 161
_SO_BINDTODEVICE = 25
_AT_ONCE = 2
"""Requests of one turn: what else waits stays in the kernel, and a flood is lost there."""


def open_port(interface: str) -> socket.socket:
    """The agent's socket; GatewayError where the port cannot be had."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_BINDTODEVICE, interface.encode() + b"\0")
        sock.bind(("0.0.0.0", PORT))
    except OSError as error:
        sock.close()
        raise GatewayError(
            f"snmp_community: UDP port {PORT} of {interface} cannot be used ({error.strerror or error}); port 161 needs "
            "CAP_NET_BIND_SERVICE, and no other SNMP agent may listen there"
        ) from error
    sock.setblocking(False)
    return sock


class SnmpService:
    """Answers who asks with the configured community; only reads. ``sock``: that of ``open_port``."""

    def __init__(self, daemon: Daemon, sock: socket.socket) -> None:
        assert isinstance(daemon.link, ProfinetLink)
        self._daemon = daemon
        self._device = daemon.link.device
        self._loop = daemon.loop
        self._sock = sock
        self._started = daemon.loop.now()
        community = daemon.config.transport.snmp_community or ""
        self.agent = Agent(community.encode("latin-1"), self._objects)
        daemon.loop.counters.add("snmp", "ignored", "datagrams", "without an answer", lambda: self.agent.ignored)

    def _objects(self) -> list[Variable]:
        location = self._daemon.store.parameters.im1_location
        uptime = self._loop.now() - self._started
        return mib.objects(self._device.station, self._device.cm.records.octets, location, uptime)

    def start(self) -> None:
        self._loop.add_reader(self._sock.fileno(), self._on_readable)

    def stop(self) -> None:
        self._loop.remove_reader(self._sock.fileno())
        self._sock.close()

    def _on_readable(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                data, address = self._sock.recvfrom(REQUEST_MAX + 1)
                answer = self.agent.answer(data)
                if answer is not None:
                    self._sock.sendto(answer, address)
            except BlockingIOError:
                return
            except OSError as error:
                log.warning("SNMP: %s", error)
                return
