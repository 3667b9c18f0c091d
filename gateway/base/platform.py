"""The gateway's interface to its environment: a clock, CAN interfaces, UDP ports.

``SystemPlatform`` is the machine it runs on; a simulated world implements the same with virtual time.
"""

from __future__ import annotations

import secrets
from typing import Protocol

import can

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.port import CanPort, open_port
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.udp import DatagramPort, UdpSocket


class CanInterface(Protocol):
    """What a [can] table says about its interface."""

    @property
    def interface(self) -> str: ...

    @property
    def channel(self) -> int | str | None: ...

    @property
    def bitrate(self) -> int | None: ...

    @property
    def extra(self) -> dict[str, object]: ...


class Platform(Protocol):
    """Source of clock, buses and ports."""

    has_services: bool
    """Whether it has a status port, a flight recorder, SNMP and a service manager: a simulated world has none of them."""

    @property
    def loop(self) -> Loop:
        """Everything of the gateway runs on it."""

    def open_can(self, config: CanInterface) -> CanPort:
        """A CAN interface; CanopenError if it cannot be opened."""

    def open_udp(self, listen: str, port: int, purpose: str) -> DatagramPort:
        """A UDP port; GatewayError if it cannot be opened."""

    def tick_offset(self) -> int:
        """A random number of 32 bits, another one with each start of a gateway."""


def open_configured_bus(config: CanInterface) -> can.BusABC:
    """The python-can bus of a [can] table; CanopenError if it cannot be opened."""
    return open_bus(config.interface, config.channel, config.bitrate, **config.extra)


class SystemPlatform:
    """The machine: monotonic clock, python-can interfaces, sockets."""

    has_services = True

    def __init__(self) -> None:
        self.loop = SystemLoop()

    def open_can(self, config: CanInterface) -> CanPort:
        return open_port(self.loop, open_configured_bus(config))

    def open_udp(self, listen: str, port: int, purpose: str) -> DatagramPort:
        return UdpSocket(self.loop, listen, port, purpose)

    def tick_offset(self) -> int:
        return secrets.randbits(32)
