"""The IO controller on an Ethernet interface, with the machine's clock."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from ipaddress import IPv4Address, IPv4Interface

from pdgw.ds301.loop.loop import SystemLoop
from pdgw.durations import MS, SECOND
from pdgw.gateway.links.profinet.ethernet import RawEthernet
from pdgw.peers.controller.controller import IoController
from pdgw.peers.controller.project import Project
from pdgw.profinet.station import Identity, IpSuite, Station

_WAIT_NS = 100 * MS


class RunningController:
    """A controller on ``interface``; GatewayError when it cannot be opened. ``device``: address assigned to the device."""

    def __init__(self, interface: str, project: Project, device: IPv4Interface, name: str = "pdgw-plc") -> None:
        self._loop = SystemLoop()
        self.port = RawEthernet(self._loop, interface)
        suite = IpSuite(device.ip, device.netmask, IPv4Address(0))
        station = Station(Identity(self.port.mac, 0xFFFF, 0x0001, "pdgw-plc", "PDGW"), name)
        self.controller = IoController(station, project, suite, seed=time.time_ns() & 0xFFFFFFFF)
        self.fresh = 0
        """Frames with new input data."""

    def run(self, seconds: float, until: Callable[[], object] = lambda: False) -> bool:
        """Run the controller. True as soon as ``until`` is true, False at the end of the time."""
        end = time.monotonic_ns() + int(seconds * SECOND)
        while not until():
            now = time.monotonic_ns()
            if now >= end:
                return False
            self.step(min(end, now + _WAIT_NS))
        return True

    def step(self, latest: int) -> None:
        """Wait for the next event, at most until ``latest``, and process it."""
        controller, port = self.controller, self.port
        self._send()
        due = controller.next_deadline()
        now = time.monotonic_ns()
        wait = max(0, min(latest, latest if due is None else due) - now)
        select.select(port.descriptors, (), (), wait / SECOND)
        now = time.monotonic_ns()
        for receive in (port.receive, port.receive_other):
            while (frame := receive()) is not None:
                self.fresh += controller.on_frame(frame, now)
        while (datagram := port.receive_datagram()) is not None:
            controller.on_datagram(*datagram, now)
        controller.poll(now)
        self._send()

    def _send(self) -> None:
        for address, data in self.controller.outgoing():
            if address is None:
                self.port.send(data)
            else:
                self.port.send_datagram(bytes(data), address)

    def close(self) -> None:
        """Close the interface."""
        self.port.close()
        self._loop.close()
