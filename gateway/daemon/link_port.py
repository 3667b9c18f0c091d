"""The port of the link to the PLC, which is opened before anything else, and the link of a transport on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from pdgw.gateway.base.platform import Platform
from pdgw.gateway.base.store import ParameterStore
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.links.link import Link, UdpLink
from pdgw.gateway.objects.drive_object import DriveObject

if TYPE_CHECKING:
    from pdgw.gateway.links.profinet.ethernet import EthernetPort

Opener = Callable[[Sequence[DriveObject]], Link]
"""Makes the link of the drive objects, in the order of the frame."""


def open_port(
    config: GatewayConfig, platform: Platform, store: ParameterStore, ethernet: EthernetPort | None, opened: ExitStack
) -> tuple[tuple[str, int], Opener]:
    """Open the port of the link, and have it closed by ``opened``: its address, and what makes the link.

    ``ethernet``: as of ``Daemon``. GatewayError if the port cannot be opened.
    """
    transport, loop = config.transport, platform.loop
    if transport.type == "profinet":
        # Imported here: the other transport starts without it.
        from pdgw.gateway.links.profinet.ethernet import RawEthernet  # noqa: PLC0415
        from pdgw.gateway.links.profinet.io_device import ProfinetLink  # noqa: PLC0415

        interface = transport.interface or ""
        port = RawEthernet(loop, interface) if ethernet is None else ethernet
        opened.callback(port.close)
        return (interface, 0), lambda objects: ProfinetLink(port, config, store, loop, objects)
    udp = platform.open_udp(str(transport.listen), transport.cyclic_port, "cyclic port")
    opened.callback(udp.close)
    offset = platform.tick_offset()
    return udp.address, lambda objects: UdpLink(
        udp, transport, [item.telegram for item in objects], loop.counters, offset
    )
