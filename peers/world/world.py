"""The world: virtual time, buses, network and devices, with a gateway and a PLC for tests."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from random import Random
from types import TracebackType
from typing import Any, Final, Protocol

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.load import DEFAULT_BITRATE
from pdgw.ds301.loop.loop import Event
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.durations import SECOND
from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.config import AxisConfig, GatewayConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import Address
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange import plc
from pdgw.peers.plc.notation import find
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.peers.simulation.config import add_device, simulated_devices
from pdgw.peers.simulation.devices import Simulation
from pdgw.peers.world.can_bus import PLACES, Member, SimulatedCan
from pdgw.peers.world.udp import SimulatedNetwork, SimulatedUdpPort
from pdgw.profidrive.telegrams import telegram

# A gateway for a test: in a world of its own, with the simulated devices of its configuration and a PLC.


class SimulatedDevice(Protocol):
    """A simulated drive or encoder."""

    def inject(self, fault: int | str) -> None:
        """Raise a fault by its name; those of a drive have the numbers 1-12, too. Its cause stays until ``clear``.

        CanopenError or Dsp406Error with the faults of the device for another one.
        """

    def clear(self) -> None:
        """Remove the causes of all faults, so that a fault reset is accepted."""


class Gateway:
    """``with Gateway(config) as gateway``: runs until the end of the block, in virtual time.

    ``config``: a configuration, or the path of its file; GatewayError if the file is wrong. ``world`` and ``daemon`` exist before
    the block, so that a test can add devices that the configuration does not simulate.
    """

    def __init__(self, config: GatewayConfig | Path | str, seed: int | str = 0) -> None:
        chosen = config if isinstance(config, GatewayConfig) else load_config(config)
        self.world = World(seed)
        self.world.simulate(chosen)
        self.daemon = build_gateway(chosen, self.world)

    def __enter__(self) -> Gateway:
        self.daemon.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.daemon.stop()
        self.world.loop.until(self.daemon.stopped.is_set, "the end of the gateway")

    @cached_property
    def plc(self) -> Plc:
        """The PLC. It sends only while a test calls it."""
        return Plc(self.world, self.daemon)

    def device(self, do_id: int) -> SimulatedDevice:
        """The simulated device of a drive object. GatewayError without such a device."""
        config = self.daemon.config
        simulated = [item for item in config.objects if item.simulate]
        item = simulated[place_of(do_id, simulated, "no simulated device")]
        device = self.world.simulations[config.bus_of(item).name].device(item.node_id)
        assert isinstance(device, SimulatedDrive | SimulatedEncoder)
        return device

    def status(self) -> dict[str, Any]:
        """The document of ``pdgw status --json`` (docs/operation.md)."""
        return snapshot(self.daemon)

    def sentence(self, do_id: int) -> str:
        """Why an axis or encoder does not move, as in ``pdgw status``. GatewayError for an unknown DO-ID."""
        objects = self.daemon.objects
        return objects[place_of(do_id, self.daemon.config.objects, NOT_CONFIGURED)].enable_status.sentence


# A PLC for tests: its frames and those of one gateway, in virtual time.


NOT_CONFIGURED: Final = "not in the configuration"
_LATER_NS: Final = 3600 * SECOND
"""Longer than a step waits."""


def place_of(do_id: int | None, objects: Sequence[AxisConfig | EncoderConfig], what: str) -> int:
    """The place of a drive object among these; None is the first one. GatewayError with ``what`` they are if it is not there."""
    known = [item.do_id for item in objects]
    if do_id is None:
        return 0
    if do_id not in known:
        raise GatewayError(f"do_id = {do_id}: {what}, allowed: {known}")
    return known.index(do_id)


class Plc(plc.Plc):
    """A PLC in a world: what ``endpoint`` sends and receives.

    It reads telegrams and cycle time from the gateway's configuration and sends only while a test calls it.
    """

    def __init__(self, world: World, gateway: Daemon) -> None:
        telegrams = [telegram(item.telegram) for item in gateway.config.objects]
        super().__init__(world.loop, world.network.open("plc", 0, "PLC"), gateway.address, telegrams, gateway.cycle_ns)
        self._objects = gateway.config.objects

    def exchange(self, seconds: float, do_id: int | None = None, **setpoints: int) -> None:
        """Send one frame per cycle for this number of seconds. ``setpoints`` change first, as raw values by name.

        ``do_id``: None for the first drive object. Raises ProfidriveError for a signal that the telegram lacks or a value that
        does not fit, GatewayError for an unknown DO-ID.
        """
        self.endpoint.set(self._index(do_id), setpoints)
        for _ in range(max(1, round(seconds * SECOND) // self.cycle_ns)):
            self.cycle()

    def run(self, seconds: float, do_id: int | None = None, *, on: bool | None = None, **steps: Any) -> None:
        """Run steps for this number of seconds: ``run(2, on=True, speed="1500 rpm")``.

        ``on``: True sends OFF, then ON when the drive is ready; False is OFF1. ``steps``: those of a scenario of the PLC
        simulator by name, in order. 100 % of a speed in rpm is ``rated_speed_rpm`` of the axis, else 3000 rpm. Raises
        GatewayError for a step that the telegram does not have, AssertionError if a step does not succeed or needs more time.
        """
        index = self._index(do_id)
        named = ({} if on is None else {"enable" if on else "off1": True}) | steps
        numbers = [item.number for item in self.endpoint.telegrams]
        chosen = self._objects[index]
        rated = chosen.rated_speed_rpm if isinstance(chosen, AxisConfig) else None
        references = {} if rated is None else {"speed_rpm": float(rated)}
        scenario = scenario_of(numbers, [{"axis": index + 1, name: value} for name, value in named.items()], references)
        engine = Engine(scenario, self.endpoint)
        for _ in range(max(1, round(seconds * SECOND) // self.cycle_ns)):
            engine.step(self.loop.now())
            self.cycle()
        current, late = engine.current, not engine.finished
        if late:
            engine.step(self.loop.now() + _LATER_NS)  # what it waits for fails, with the measured values
        failed = [f"{result.name}: {result.measured}" for result in engine.results if not result.passed]
        if late:
            failed.append(f"{current}: not within {seconds:g} s")
        if failed:
            raise AssertionError("; ".join(failed))

    def actual(self, name: str, do_id: int | None = None) -> int:
        """A raw actual value, or a bit of one (``"ZSW1.FAULT_PRESENT"``).

        GatewayError while the values are invalid, for a signal that the telegram lacks and for an unknown DO-ID.
        """
        index = self._index(do_id)
        word = find(name, self.endpoint.telegrams[index].actuals)
        values = self.actuals[index]
        if values is None:
            raise GatewayError(f"{name}: no valid actual values: {self.endpoint.why_no_values(index)}")
        return word.of(values)

    def _index(self, do_id: int | None) -> int:
        return place_of(do_id, self._objects, NOT_CONFIGURED)


# The world: virtual time, buses, network and devices. It is the ``Edge`` of a gateway that runs in it.


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


# The connection of a parameter client to a gateway in the world.


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
