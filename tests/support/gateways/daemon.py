"""A daemon in a world of its own, with simulated devices, a PLC and a parameter client: all in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar
from unittest.mock import patch

from pdgw.base.durations import SECOND
from pdgw.gateway.client import udp as client_module
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.defaults import SIMULATED_KEYS
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.configuration.toml_file import toml_text
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.acyclic import AcyclicServer
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.plc.exchange import plc
from pdgw.peers.world import Gateway, World, WorldChannel
from pdgw.profidrive.telegrams import telegram
from tests.support.gateways.fault_display import drive_state

D = TypeVar("D", SimulatedDrive, SimulatedEncoder)
OFF, ON = 0x047E, 0x047F
POSITIONER = "[axis.positioner]\n" + toml_text(SIMULATED_KEYS)
"""The keys of a simulated positioner, after those of its axis."""
SIMULATED_POSITIONER = f"simulate = true\n{POSITIONER}"
PATIENCE = 10 * SECOND
"""Longest wait for a normal gateway."""


def configuration(axes: str, *, can: str = "", transport: str = "", name: str = "") -> GatewayConfig:
    """Free ports, a watchdog that a parameter request between two frames does not trip; ``axes`` are complete tables."""
    if "watchdog_factor" not in transport and "cycle_time_ms" not in transport:
        transport = f"watchdog_factor = 75\n{transport}"
    can = can or '[can]\ninterface = "virtual"\nchannel = "world"\n'
    called = f'name = "{name}"\n' if name else ""
    head = f"{called}{can}[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n{transport}\n"
    trace = "" if "[trace]" in can + transport + axes else "[trace]\nenabled = false\n"
    return parse_config(head + axes + trace)


def axis(number: int, *, telegram_number: int = 1, more: str = "simulate = true") -> str:
    return f"[[axis]]\ndo_id = {number}\nnode_id = {number}\ntelegram = {telegram_number}\n{more}\n"


def world_of(daemon: Daemon) -> World:
    assert isinstance(daemon.platform, World)
    return daemon.platform


def _device(daemon: Daemon, kind: type[D], node_id: int, bus: str) -> D:
    device = world_of(daemon).simulations[bus].device(node_id)
    assert isinstance(device, kind)
    return device


def drive_of(daemon: Daemon, node_id: int = 1, bus: str = "can") -> SimulatedDrive:
    """A simulated drive of the daemon's world."""
    return _device(daemon, SimulatedDrive, node_id, bus)


def encoder_of(daemon: Daemon, node_id: int = 20) -> SimulatedEncoder:
    """A simulated encoder of the daemon's world."""
    return _device(daemon, SimulatedEncoder, node_id, "can")


def switch_off(daemon: Daemon, device: SimulatedDrive | SimulatedEncoder) -> None:
    """Switch off a device that is not the only one on its bus: another one acknowledges the frames of the gateway."""
    world_of(daemon).bus("world").join("another device")
    device.node.power_off()


def until(daemon: Daemon, condition: Callable[[], object], what: str, patience: int = PATIENCE) -> None:
    """Run the world until a condition is true."""
    world_of(daemon).loop.until(condition, what, patience)


def online(daemon: Daemon, patience: int = PATIENCE) -> None:
    """Run the world until every node was brought up once."""
    clients = daemon.clients
    until(daemon, lambda: all(client.generation for client in clients), "online", patience)


class Plc(plc.Plc):
    """Sends a frame and lets a cycle pass, whenever the test says so; ``silent`` it only lets time pass."""

    def __init__(self, daemon: Daemon, numbers: list[int], host: str = "plc") -> None:
        self.daemon = daemon
        world = world_of(daemon)
        port = world.network.open(host, 0, "PLC")
        super().__init__(
            world.loop, port, daemon.address, [telegram(n, daemon.config.telegrams) for n in numbers], daemon.cycle_ns
        )
        self.change: Callable[[bytearray], bytes] = bytes
        """Make of a frame what is sent."""

    def frame(self, now: int) -> bytes:
        return self.change(self.endpoint.build(now))

    def exchange(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.cycle()

    def seen(self) -> str:
        return f"{super().seen()} {snapshot(self.daemon)}"

    def state(self, index: int = 0) -> int:
        return drive_state(self.value("ZSW1", index))

    def enable(self, index: int = 0) -> None:
        self.endpoint.set(index, {"STW1": OFF})
        self.exchange()  # the last ZSW1 may be older than this OFF
        self.exchange()
        self.until(lambda: self.state(index) == 0x01, "ready")
        self.endpoint.set(index, {"STW1": ON})
        self.until(lambda: self.state(index) == 0x07, "operation")

    def turn(self, speed: int) -> None:
        """The first axis, in operation, shows this speed as NIST_A."""
        self.endpoint.set(0, {"NSOLL_A": speed})
        self.until(lambda: self.value("NIST_A") == speed, "the speed")


@contextmanager
def running(config: GatewayConfig, before: Callable[[Daemon], None] | None = None, seed: int = 0) -> Iterator[Daemon]:
    gateway = Gateway(config, seed)
    if before is not None:
        before(gateway.daemon)
    with gateway:
        yield gateway.daemon
    assert gateway.world.loop.task_errors == 0
    gateway.world.loop.close()


@contextmanager
def operating(
    config: GatewayConfig | None = None, before: Callable[[Daemon], None] | None = None
) -> Iterator[tuple[Daemon, Plc]]:
    """A gateway, by default with one simulated axis, and its PLC; the first axis is in operation."""
    with running(config or configuration(axis(1)), before) as daemon:
        plc = Plc(daemon, [item.telegram.number for item in daemon.objects])
        plc.enable()
        yield daemon, plc


def client(daemon: Daemon, address: tuple[str, int], do_id: int, **options: object) -> ParameterClient:
    """A parameter client in the daemon's world."""
    return ParameterClient(address, do_id, channel=WorldChannel(world_of(daemon), address), **options)  # type: ignore[arg-type]


def record_server(daemon: Daemon) -> AcyclicServer:
    """What serves the parameter channel of a daemon on UDP."""
    return next(item for item in daemon.services if isinstance(item, AcyclicServer))


@contextmanager
def serving(
    config: GatewayConfig, do_id: int | None = None, connect: Callable[[Daemon], object] | None = None
) -> Iterator[tuple[Daemon, ParameterClient]]:
    """A daemon whose nodes are online, and a client of its parameter channel (of the first drive object).

    ``connect`` puts devices on the buses that the configuration does not simulate.
    """
    with running(config) as daemon:
        if connect is not None:
            connect(daemon)
        online(daemon)
        first = daemon.objects[0].do_id if do_id is None else do_id
        with client(daemon, record_server(daemon).address, first) as made:
            yield daemon, made


@contextmanager
def reached(daemon: Daemon) -> Iterator[None]:
    """Parameter clients that are made meanwhile, those of commands too, reach the daemon's world."""
    machine = client_module.UdpChannel

    def channel(address: tuple[str, int]) -> client_module.Channel:
        return WorldChannel(world_of(daemon), address) if address[0] == daemon.address[0] else machine(address)

    with patch.object(client_module, "UdpChannel", channel):
        yield


@contextmanager
def exchanging(plc: Plc) -> Iterator[None]:
    """The PLC keeps exchanging frames whenever time passes."""
    going = True

    def exchange() -> None:
        if going:
            plc.send()
            plc.loop.call_later(plc.daemon.cycle_ns, exchange)

    exchange()
    try:
        yield
    finally:
        going = False
