"""The world: virtual time, buses, network and devices. It is the ``Edge`` of a gateway that runs in it."""

from __future__ import annotations

from random import Random
from typing import Any

from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.errors import CanopenError
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.durations import SECOND
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.tables.environment import CanConfig
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.simulation.configured_devices import add_device, simulated_devices
from pdgw.peers.simulation.devices import Simulation
from pdgw.peers.world.can_bus import PLACES, Member, SimulatedCan
from pdgw.peers.world.udp import SimulatedNetwork, SimulatedUdpPort


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

    def open_can(self, config: CanConfig) -> Member:
        """Open the gateway's controller on the bus of this channel."""
        channel = str(config.channel)
        if channel in self._unplugged:
            raise CanopenError("CAN interface", channel, "one that is plugged in")
        port = self._gateways[channel] = self.bus(channel, config.bitrate).join("gateway", self.gateway_places)
        return port

    def open_udp(self, listen: str, port: int, purpose: str) -> SimulatedUdpPort:
        """Open a port of the gateway."""
        return self.network.open(listen, port, purpose)

    def tick_offset(self) -> int:
        """The start of a gateway's ticks."""
        return self._offsets.getrandbits(32)
