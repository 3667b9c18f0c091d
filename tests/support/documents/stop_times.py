"""Longest time from a stop in the PLC, and from its death, to the Controlword on a full CAN bus, in virtual time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from random import Random

from pdgw.base.durations import MS, SECOND
from pdgw.dsp402.states import Command, State
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.plc.exchange.plc import Plc
from pdgw.peers.world import World
from pdgw.peers.world.can_bus import Member
from pdgw.profidrive.telegrams import telegram
from tests.support.documents.parts import write_part
from tests.support.gateways.daemon import OFF, ON, axis, configuration
from tests.support.gateways.profinet_daemon import Plant
from tests.support.wire.ethernet import FakeEthernet
from tests.support.wire.profinet import PLC_MAC

PLACE = ("safety.md", "stop times")
BUSES = {1: (3, 1_000_000), 2: (3, 500_000), 4: (3, 250_000), 8: (2, 125_000), 16: (2, 62_500)}
"""Axes and bit rate by cycle in ms: the worst-case load is 63 to 82 %."""
_PLC = "192.168.0.10"
_STOPS = (Command.QUICK_STOP, Command.DISABLE_VOLTAGE)


@dataclass(frozen=True)
class Link:
    """A link and the delay of its network each way, as a share of the age limit."""

    name: str
    keys: str
    delay: float = 0.0


LINKS = (
    Link("loopback, or `direct = true`", f'listen = "192.168.0.5"\npeer = "{_PLC}"\ndirect = true'),
    Link("routed, no delay", f'listen = "192.168.0.5"\npeer = "{_PLC}"'),
    Link("routed, delay 1/3 of the age limit each way", f'listen = "192.168.0.5"\npeer = "{_PLC}"', 1 / 3),
    Link("PROFINET", 'type = "profinet"\ninterface = "eth1"\nstation_name = "press-1"'),
)


@dataclass(frozen=True)
class Row:
    """Longest times in nanoseconds, and what bounds them."""

    link: Link
    cycle_ms: int
    stop_ns: int
    death_ns: int

    @property
    def delay_ns(self) -> int:
        return int(self.link.delay * 6 * self.cycle_ms * MS)

    @property
    def stop_bound_ns(self) -> int:
        """To the next scan, through the network, and one cycle each in the send queue and on the bus."""
        return self.delay_ns + 3 * self.cycle_ms * MS + MS

    @property
    def death_bound_ns(self) -> int:
        """The last frame through the network, the watchdog time (3 cycles), and one cycle each for the gateway and the bus."""
        return self.delay_ns + 5 * self.cycle_ms * MS + MS


class Site(ABC):
    """A gateway with turning axes on a full bus, and the stops that it sends."""

    def __init__(self, link: Link, cycle_ms: int) -> None:
        self.chance = Random(f"{link.name} {cycle_ms}")
        self.axes, bitrate = BUSES[cycle_ms]
        can = f'[can]\ninterface = "virtual"\nchannel = "full"\nbitrate = {bitrate}\n'
        transport = f"cycle_time_ms = {cycle_ms}\n{link.keys}"
        config = configuration("".join(axis(number + 1) for number in range(self.axes)), can=can, transport=transport)
        self.world = World(link.name)
        self.world.simulate(config)
        self.loop = self.world.loop
        self.port = FakeEthernet(self.loop)
        self.daemon = build_gateway(config, self.world, self.port)
        self.world.network.conditions.delay_ns += Row(link, cycle_ms, 0, 0).delay_ns
        self.stops: dict[int, int] = {}
        """Time of the first stop by COB-ID."""
        self.world.bus("full").taps.append(self._note)
        self.last_scan = 0
        self.daemon.start()
        self.start_plc()

    @abstractmethod
    def start_plc(self) -> None:
        """Start a PLC, or start it again."""

    @abstractmethod
    def fall_silent(self) -> None:
        """The PLC dies."""

    @abstractmethod
    def command(self, word: int) -> None:
        """STW1 of all axes from now on."""

    def _note(self, now: int, sender: Member, can_id: int, data: bytes) -> None:
        word = int.from_bytes(data[-2:], "little")
        if sender.name == "gateway" and 0x200 < can_id < 0x280 and any(command.matches(word) for command in _STOPS):
            self.stops.setdefault(can_id, now)

    def turn(self) -> None:
        self.command(OFF)
        self.loop.until(lambda: all(item.good and item.released for item in self.daemon.axes), "ready", 60 * SECOND)
        self.loop.run_for(SECOND)
        self.command(ON)
        self.loop.until(
            lambda: all(self._drive(number).model.state is State.OPERATION_ENABLED for number in range(self.axes)),
            "operation",
            60 * SECOND,
        )
        self.loop.run_for(SECOND // 2 + self.chance.randrange(self.daemon.cycle_ns))
        self.stops.clear()

    def _drive(self, number: int) -> SimulatedDrive:
        device = self.world.simulations["can"].device(number + 1)
        assert isinstance(device, SimulatedDrive)
        return device

    def stopped(self, since: int) -> int:
        """Time until the last axis has its stop."""
        self.loop.until(lambda: len(self.stops) == self.axes, "all stops", 10 * SECOND)
        return max(self.stops.values()) - since


class UdpSite(Site):
    """The PLC sends frames with the tick."""

    def start_plc(self) -> None:
        port = self.world.network.open(_PLC, 0, "PLC")
        self.plc = Plc(self.loop, port, self.daemon.address, [telegram(1)] * self.axes, self.daemon.cycle_ns)
        self.plc.before_frame.append(self._scan)
        self.plc.start()

    def _scan(self, now: int) -> None:
        self.last_scan = now
        for number in range(self.axes):
            self.plc.set(number, {"NSOLL_A": 0x1000 + self.chance.randrange(0x100)})

    def fall_silent(self) -> None:
        self.plc.stop()

    def command(self, word: int) -> None:
        for number in range(self.axes):
            self.plc.set(number, {"STW1": word})


class ProfinetSite(Site):
    """The PLC is an IO controller: its frames have the period of the cycle."""

    @cached_property
    def plant(self) -> Plant:
        """The controller and its network."""
        plant = Plant(self.daemon, self.port, self.world)
        plant.plc.project = replace(plant.plc.project, reduction_ratio=self.daemon.cycle_ns // MS)
        return plant

    def start_plc(self) -> None:
        self.plant.killed = False
        self.plant.connect()

    def fall_silent(self) -> None:
        self.plant.killed = True
        self.last_scan = max(time for time, frame in self.plant.frames if frame[6:12] == PLC_MAC)

    def command(self, word: int) -> None:
        for number in range(self.axes):
            self.plant.set(number + 1, word, 0x1000 + self.chance.randrange(0x100))


def measure(link: Link, cycle_ms: int, samples: int = 8) -> Row:
    """Stops, and half as many deaths, at several times of the cycle."""
    site = (ProfinetSite if link is LINKS[-1] else UdpSite)(link, cycle_ms)
    stops, deaths = [], []
    for _ in range(samples):
        site.turn()
        site.command(0x047D)
        stops.append(site.stopped(site.loop.now()))
    for _ in range(samples // 2):
        site.turn()
        site.fall_silent()
        deaths.append(site.stopped(site.last_scan))
        site.loop.run_for(SECOND)
        site.start_plc()
    site.loop.close()
    return Row(link, cycle_ms, max(stops), max(deaths))


def rows() -> Iterator[Row]:
    """All rows of the table."""
    for link in LINKS:
        for cycle_ms in BUSES:
            yield measure(link, cycle_ms)


def write() -> None:
    """Write the table into the document."""
    lines = ["| link | cycle | from the stop in the PLC | from its last scan |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {row.link.name} | {row.cycle_ms} ms | {row.stop_ns / MS:.1f} ms | {row.death_ns / MS:.1f} ms |"
        for row in rows()
    ]
    write_part(*PLACE, "\n".join(lines) + "\n")
