"""The IO controller on an Ethernet interface with the machine's clock, and the PLC simulator on it: scenarios and keyboard."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from ipaddress import IPv4Address, IPv4Interface
from uuid import uuid4

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.links.profinet.ethernet import RawEthernet
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.exchange import ControllerExchange
from pdgw.peers.controller.project import Project
from pdgw.peers.plc.client import PlcRunner
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import ApplicationMode, Telegram
from pdgw.profinet.blocks.connect_blocks import TICK_NS
from pdgw.profinet.model import (
    DAP_SLOT,
    SEND_CLOCKS,
    Module,
    ObjectKind,
    access_module,
    object_module,
)
from pdgw.profinet.rpc.client import RecordCaller
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


_RETRY_NS = SECOND
_CONNECT_S = 30
_HOLD_NS = 1500 * MS
"""Requested data hold time, at least three cycles: this controller is not a real-time system."""


def project_of(station_name: str, telegrams: Sequence[Telegram], cycle_ns: int) -> Project:
    """Axes and encoders in the order of their telegrams. GatewayError when PROFINET has no such cycle."""
    clock = next((item for item in SEND_CLOCKS if item * TICK_NS == cycle_ns), SEND_CLOCKS[-1])
    ratio = cycle_ns // (clock * TICK_NS)
    if ratio not in {1 << power for power in range(10)} or ratio * clock * TICK_NS != cycle_ns:
        raise GatewayError(f"--cycle-ms {cycle_ns / MS:g}: allowed with --profinet are 0.25, 0.5, 1, 2, 4 ... 512")
    modules: dict[int, Module] = {DAP_SLOT: access_module()}
    for slot, telegram in enumerate(telegrams, start=1):
        kind = ObjectKind.ENCODER if telegram.mode is ApplicationMode.ENCODER else ObjectKind.AXIS
        modules[slot] = object_module(kind, telegram)
    return Project(station_name, modules, clock, ratio, max(3, _HOLD_NS // cycle_ns))


class ProfinetPlc(PlcRunner):
    """A PLC that connects to the station of this name. When the relationship ends, it reports why and connects again."""

    endpoint: PlcEndpoint

    def __init__(
        self, interface: str, station_name: str, device: IPv4Interface, endpoint: PlcEndpoint, cycle_ns: int
    ) -> None:
        super().__init__(endpoint, cycle_ns)
        project = project_of(station_name, endpoint.telegrams, cycle_ns)
        self._running = RunningController(interface, project, device)
        self._controller = self._running.controller
        self._exchange = ControllerExchange(endpoint, self._controller)
        self._retry = 0
        self._why = ""
        """Reason of the last failed attempt."""

    def connect(self) -> None:
        """Connect and wait for data. GatewayError with the reason after a timeout."""
        controller = self._controller
        end = time.monotonic() + _CONNECT_S
        while controller.phase is not Phase.DATA and time.monotonic() < end:
            self._wait(_RETRY_NS // 10)
        if controller.phase is not Phase.DATA:
            why = controller.learned.ended or self._why or controller.phase.value
            raise GatewayError(f"station {controller.project.station_name}: not connected, {why}")

    def _wait(self, ns: int) -> None:
        controller = self._controller
        now = time.monotonic_ns()
        if controller.phase in {Phase.IDLE, Phase.ENDED} and now >= self._retry:
            self._retry = now + _RETRY_NS
            self._why = controller.learned.ended
            controller.start(now)
        before = self._running.fresh
        self._running.step(now + ns)
        if self._running.fresh != before:
            self._exchange.take(time.monotonic_ns())

    def _send(self, *, muted: bool = False) -> None:
        self._controller.silent = muted
        if not muted and self._controller.provider is not None:
            self._exchange.send()
            self.endpoint.counters["sent"] += 1

    def _open_parameters(self) -> ParameterClient:
        controller = self._controller
        caller = RecordCaller(uuid4(), controller.device_object, controller.ar_uuid)
        return ParameterClient(controller.device_address, 1, caller=caller)

    def close(self) -> None:
        super().close()
        if self._controller.phase is Phase.DATA:
            self._controller.release(time.monotonic_ns())
            self._running.run(1, lambda: self._controller.phase is Phase.ENDED)
        self._running.close()
