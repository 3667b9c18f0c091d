"""The gateway's interface to its environment: a clock, CAN interfaces, UDP ports.

``SystemPlatform`` is the machine it runs on; a simulated world implements the same with virtual time.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Protocol

import can

from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.bus.port import CanPort, open_port
from pdgw.ds301.loop.loop import Loop, SystemLoop
from pdgw.gateway.base.udp import Address, UdpSocket


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


class DatagramPort(Protocol):
    """A bound UDP port."""

    errors: int
    """Datagrams that could not be sent or received."""

    @property
    def address(self) -> Address:
        """The address that it listens on."""

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        """Call ``action`` in the loop whenever datagrams wait."""

    def pause(self) -> None:
        """Do not call it until the next ``start``; data waits in the buffer until then."""

    def only_from(self, sender: Address | None) -> None:
        """Drop nearly all datagrams of other senders if possible; None: accept all again."""

    def receive(self) -> tuple[bytes, Address] | None:
        """The next datagram that waits, or None."""

    @property
    def received_at(self) -> int | None:
        """Arrival time of the last datagram of ``receive``, by the loop's clock; None if unknown."""

    def send(self, data: bytes | bytearray, address: Address) -> None:
        """Send without waiting; data that is not accepted is counted and lost."""

    def close(self) -> None:
        """Release the port."""


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
