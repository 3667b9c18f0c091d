"""The SNMP agent of a PROFINET gateway on UDP port 161 of its interface, bounded in each turn of the loop."""

from __future__ import annotations

import logging
import socket
from collections.abc import Mapping
from typing import Final, Protocol

from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.ports import refusal
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.links.link import Link
from pdgw.gateway.links.profinet.io_device import ProfinetLink
from pdgw.profinet.discovery import mib
from pdgw.profinet.discovery.snmp import REQUEST_MAX, Agent, Oid, Variable, Writing

log = logging.getLogger("gateway")

PORT: Final = 161
_SO_BINDTODEVICE = 25
_AT_ONCE = 2
"""Requests of one turn: what else waits stays in the kernel, and a flood is lost there."""


def open_port(interface: str) -> socket.socket:
    """The agent's socket; GatewayError if the port cannot be opened."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_BINDTODEVICE, interface.encode() + b"\0")
        sock.bind(("0.0.0.0", PORT))
    except OSError as error:
        sock.close()
        raise GatewayError(
            f"snmp_community: UDP port {PORT} of {interface} cannot be used ({refusal(error, PORT)}); port 161 needs "
            "CAP_NET_BIND_SERVICE, and no other SNMP agent may listen there"
        ) from error
    sock.setblocking(False)
    return sock


_FIELDS: Final = {mib.SYS_CONTACT: "sys_contact", mib.SYS_NAME: "sys_name", mib.SYS_LOCATION: "sys_location"}
"""Fields of the store."""
_TEXT_MAX: Final = 255


class Station(Protocol):
    """The gateway, as the agent shows it."""

    config: GatewayConfig
    link: Link
    loop: Loop
    store: ParameterStore


class SnmpService:
    """Answer requests with a configured community; the write community changes three texts. ``sock``: from ``open_port``."""

    def __init__(self, daemon: Station, sock: socket.socket) -> None:
        assert isinstance(daemon.link, ProfinetLink)
        self._daemon = daemon
        self._device = daemon.link.device
        self._loop = daemon.loop
        self._sock = sock
        self._started = daemon.loop.now()
        transport = daemon.config.transport
        self._link = daemon.link
        self._pending: dict[Oid, str] = {}
        """Written, and not in the store yet."""
        lengths = dict.fromkeys(_FIELDS, _TEXT_MAX)
        key = transport.snmp_write_community
        writing = None if key is None else Writing(key.encode("latin-1"), lengths, self._write)
        self.agent = Agent((transport.snmp_community or "").encode("latin-1"), self._objects, writing)
        daemon.loop.counters.add(
            "snmp", "ignored", "datagrams", "requests without an answer", lambda: self.agent.ignored
        )

    def _objects(self) -> list[Variable]:
        parameters = self._daemon.store.parameters
        system = {oid: str(getattr(parameters, field)) for oid, field in _FIELDS.items()}
        self._pending = {oid: text for oid, text in self._pending.items() if text != system[oid]}
        system |= self._pending
        system[mib.SYS_LOCATION] = system[mib.SYS_LOCATION] or parameters.im1_location
        uptime = self._loop.now() - self._started
        return mib.objects(self._device.station, self._device.cm.records.octets, system, uptime)

    def _write(self, texts: Mapping[Oid, str]) -> None:
        for oid, text in texts.items():
            self._pending[oid] = text
            log.info("SNMP: %s set to %r", _FIELDS[oid], text)
            self._link.keep(_FIELDS[oid], text)

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
