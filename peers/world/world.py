"""The world: virtual time, buses, network and devices. It is the ``Edge`` of a gateway that runs in it."""

from __future__ import annotations

import contextlib
from collections import deque
from random import Random
from typing import Any, Final

from pdgw.base.durations import SECOND
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.gateway.base.platform import CanInterface
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.simulation.config import add_device, simulated_devices
from pdgw.peers.simulation.devices import Simulation
from pdgw.peers.world.can_bus import PLACES, Member, SimulatedCan
from pdgw.peers.world.udp import SimulatedNetwork, SimulatedUdpPort

GATEWAY: Final = "gateway"
"""Name of the gateway's member on a bus."""


class World:
    """``seed``: decides all random choices. ``begin``: start time in nanoseconds."""

    has_services = False

    def __init__(self, seed: int | str = 0, begin: int = SECOND) -> None:
        self.seed = seed
        self.loop = VirtualLoop(begin)
        self.network = SimulatedNetwork(self.loop, self.chance("network"))
        self._offsets = self.chance("ticks")
        self.simulations: dict[str, Simulation] = {}
        self._buses: dict[str, SimulatedCan] = {}
        self._gateways: dict[str, Member] = {}
        self.gateway_places = PLACES
        """Queue size of the gateway's controllers, including the frames on the wire."""
        self._unplugged: set[str] = set()

    def chance(self, name: str) -> Random:
        """A separate source of random numbers, so that the draws of one part do not change those of others."""
        return Random(f"{self.seed} {name}")

    def bus(self, channel: str, bitrate: int | None = None) -> SimulatedCan:
        """The bus of a channel, created on first use."""
        if channel not in self._buses:
            rate = bitrate or DEFAULT_BITRATE
            self._buses[channel] = SimulatedCan(self.loop, channel, rate, self.chance(f"bus {channel}"))
        return self._buses[channel]

    def drive(self, channel: str, node_id: int, *, powered: bool = True, **options: Any) -> SimulatedDrive:
        """Add a drive on a bus. If not ``powered``, it waits for its ``start``."""
        port = self.bus(channel).join(f"node {node_id}")
        drive = SimulatedDrive(port, node_id, loop=self.loop, **options)
        if powered:
            drive.start()
        return drive

    def encoder(self, channel: str, node_id: int, *, powered: bool = True, **options: Any) -> SimulatedEncoder:
        """Add an encoder on a bus. If not ``powered``, it waits for its ``start``."""
        port = self.bus(channel).join(f"node {node_id}")
        encoder = SimulatedEncoder(port, node_id, loop=self.loop, **options)
        if powered:
            encoder.start()
        return encoder

    def simulate(self, config: GatewayConfig) -> None:
        """Start the simulated devices of a gateway's configuration; ``simulations`` has them by the name of their bus."""
        for bus in config.can:
            simulation = self.simulations[bus.name] = Simulation(self.loop)
            join = self.bus(str(bus.channel), bus.bitrate).join
            for device in simulated_devices(config, bus):
                add_device(simulation, device, join(f"node {device.node_id}"))
            simulation.start()

    def gateway_port(self, channel: str) -> Member:
        """The gateway's controller on a bus; KeyError without one."""
        return self._gateways[channel]

    def unplug(self, channel: str, unplugged: bool = True) -> None:
        """Remove the gateway's CAN interface from its computer, or put it back."""
        if not unplugged:
            self._unplugged.discard(channel)
        elif channel not in self._unplugged:
            self._unplugged.add(channel)
            self._gateways[channel].unplug()

    # -- the edge of a gateway ------------------------------------------------------------------------------------------

    def open_can(self, config: CanInterface) -> Member:
        """Open the gateway's controller on the bus of this channel."""
        channel = str(config.channel)
        if channel in self._unplugged:
            raise CanopenError("CAN interface", channel, "one that is plugged in")
        port = self._gateways[channel] = self.bus(channel, config.bitrate).join(GATEWAY, self.gateway_places)
        port.set_bitrate(config.bitrate or 0)
        return port

    def open_udp(self, listen: str, port: int, purpose: str) -> SimulatedUdpPort:
        """Open a port of the gateway."""
        return self.network.open(listen, port, purpose)

    def tick_offset(self) -> int:
        """The start of a gateway's ticks."""
        return self._offsets.getrandbits(32)


class WorldChannel:
    """Datagrams between ``host`` and a gateway."""

    def __init__(self, world: World, gateway: Address, host: str = "engineer") -> None:
        self._loop = world.loop
        self._gateway = gateway
        self._port = world.network.open(host, 0, "parameter client")
        self._received: deque[bytes] = deque()
        self._arrived = Event(world.loop)
        self._port.start(self._take)

    @property
    def local_address(self) -> Address:
        return self._port.address

    def send(self, data: bytes) -> None:
        self._port.send(data, self._gateway)

    def receive(self, timeout_s: float) -> bytes | None:
        timeout = int(timeout_s * SECOND)
        if not self._received:
            self._arrived.clear()
            if self._loop.running is not None:
                self._arrived.wait(timeout)
            else:
                with contextlib.suppress(TimeoutError):
                    self._loop.until(self._arrived.is_set, "a datagram", timeout)
        return self._received.popleft() if self._received else None

    def now(self) -> float:
        return self._loop.now() / SECOND

    def sleep(self, seconds: float) -> None:
        if self._loop.running is not None:
            self._loop.sleep(int(seconds * SECOND))
        else:
            self._loop.run_for(int(seconds * SECOND))

    def close(self) -> None:
        self._port.close()

    def _take(self) -> None:
        while (datagram := self._port.receive()) is not None:
            self._received.append(datagram[0])
            self._arrived.set()
