"""A whole gateway on PROFINET in virtual time: simulated drives, an IO controller, and a recorder of both buses."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.file import parse_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.links.profinet.io_device import ProfinetLink
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.exchange import ControllerExchange
from pdgw.peers.controller.project import Project
from pdgw.peers.world import World
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet import ethernet
from pdgw.profinet.alarms import apmx
from pdgw.profinet.alarms.apmx import PduType
from pdgw.profinet.blocks.alarm import Priority
from pdgw.profinet.blocks.control import ControlCommand, PrmBeginReq
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.rpc.records import Operation
from pdgw.profinet.station import Identity, Station
from tests.support.gateways.daemon import Plc, until
from tests.support.gateways.daemon import online as nodes_online
from tests.support.gateways.fault_display import drive_state
from tests.support.readers import captures
from tests.support.readers.tshark_frames import datagram
from tests.support.wire.ethernet import FakeEthernet
from tests.support.wire.profinet import DEVICE_IP, DEVICE_MAC, PLC_IP, PLC_MAC

_TURN_NS = MS // 4
_LONGEST_TURN_NS = MS
"""The controller of a plant computes when it is due, at these intervals."""
OFF, ON = 0x047E, 0x047F
_PATIENCE = 20 * SECOND
OTHER_IP, OTHER_MAC = "192.168.0.77", bytes.fromhex("020000000077")
"""Of another controller."""


def configuration(axes: str, store: Path, *, transport: str = "") -> GatewayConfig:
    """A gateway whose watchdog is three cycles; ``axes`` are complete tables."""
    head = f"""
        store = "{store}"
        [can]
        interface = "virtual"
        channel = "world"
        [transport]
        type = "profinet"
        interface = "eth1"
        station_name = "press-1"
        status_port = 0
        {transport}
        """
    return parse_config(head + axes)


class Plant:
    """The controller's side of a daemon; what goes over both buses is kept."""

    def __init__(self, daemon: Daemon, port: FakeEthernet, world: World, *, data_hold: int = 100) -> None:
        assert isinstance(daemon.link, ProfinetLink)
        self.daemon = daemon
        self.link = daemon.link
        self.port = port
        self.loop = world.loop
        modules = self.link.device.model.modules
        self.plc = IoController(
            Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), "plc-1"),
            Project("press-1", modules, data_hold=data_hold),
            DEVICE_IP,
        )
        self.others: dict[Address, deque[bytes]] = {}
        """Datagrams to other clients of the device."""
        self.killed = False
        """The controller does nothing any more."""
        self.frames: list[tuple[int, bytes]] = []
        self.can: list[tuple[int, int, bytes]] = []
        for network in daemon.networks.values():
            network.listeners.append(
                lambda message: self.can.append((self.loop.now(), message.arbitration_id, bytes(message.data)))
            )
        self._turn()

    def _turn(self) -> None:
        now = self.loop.now()
        if not self.killed:
            self.plc.poll(now)
            for address, data in self.plc.outgoing():
                self._keep(data, (PLC_IP, ACYCLIC_PORT), address, PLC_MAC, DEVICE_MAC)
                self.port.arrive(address, bytes(data))
        while self.port.sent:
            address, sent = self.port.sent.popleft()
            self._keep(sent, (str(DEVICE_IP.address), ACYCLIC_PORT), address, DEVICE_MAC, PLC_MAC)
            if address in self.others:
                self.others[address].append(bytes(sent))
            elif self.killed:
                continue
            elif address is None:
                self.plc.on_frame(sent, now)
            else:
                self.plc.on_datagram(sent, (str(DEVICE_IP.address), ACYCLIC_PORT), now)
        due = self.plc.next_deadline()
        longest = now + _LONGEST_TURN_NS
        self.loop.call_at(longest if due is None else min(longest, max(now + _TURN_NS, due)), self._turn)

    def _keep(
        self,
        data: bytes | bytearray,
        source: tuple[str, int],
        address: tuple[str, int] | None,
        from_mac: bytes,
        to_mac: bytes,
    ) -> None:
        frame = bytes(data) if address is None else datagram(bytes(data), source, address, from_mac, to_mac)
        self.frames.append((self.loop.now(), frame))

    def until(self, condition: Callable[[], object], what: str, patience: int = _PATIENCE) -> None:
        until(self.daemon, condition, what, patience)

    def run(self, ns: int) -> None:
        self.loop.run_for(ns)

    def connect(self) -> None:
        self.plc.start(self.loop.now())
        self.until(lambda: self.link.connected and self.plc.phase is Phase.DATA, "data exchange")

    def set(self, slot: int, *values: int) -> None:
        """Setpoints of a drive object; what is not given is 0."""
        half = telegram(self.daemon.objects[slot - 1].telegram.number).setpoints
        given = (*values, *([0] * (len(half.signals) - len(values))))
        self.plc.set_output((slot, 2), half.encode(given))

    def word(self, slot: int = 1) -> int:
        """ZSW1; -1 while the input data is BAD."""
        data = self.plc.input((slot, 2))
        return -1 if data is None else int.from_bytes(data[:2], "big")

    def enable(self, slot: int = 1, *values: int) -> None:
        """OFF, then ON, with further setpoints."""
        self.set(slot, OFF, *values)
        self.until(lambda: drive_state(self.word(slot)) == 0x01, "ready")
        self.set(slot, ON, *values)
        self.until(lambda: drive_state(self.word(slot)) == 0x07, "operation")

    def write(self, folder: Path) -> list[str]:
        """plc.pcap and can.log."""
        begin = captures.BEGIN_NS
        packets = [(begin + now, captures.ETHERNET, frame) for now, frame in self.frames]
        (folder / "plc.pcap").write_bytes(captures.pcap(packets, nanoseconds=True))
        lines = []
        for now, can_id, data in self.can:
            seconds, rest = divmod(begin + now, 10**9)
            lines.append(f"({seconds}.{rest // 1000:06d}) can0 {can_id:03X}#{data.hex().upper()}\n")
        (folder / "can.log").write_text("".join(lines))
        return [str(folder / "plc.pcap"), str(folder / "can.log")]


@contextmanager
def plant(
    config: GatewayConfig,
    *,
    data_hold: int = 100,
    before: Callable[[Daemon], object] = lambda daemon: None,
    online: bool = True,
) -> Iterator[Plant]:
    """A daemon whose nodes are online (or, not ``online``, have not answered yet), not connected yet."""
    world = World()
    world.simulate(config)
    port = FakeEthernet(world.loop)
    daemon = build_gateway(config, world, port)
    made = Plant(daemon, port, world, data_hold=data_hold)
    before(daemon)
    daemon.start()
    try:
        if online:
            nodes_online(daemon, _PATIENCE)
        yield made
    finally:
        daemon.stop()
        until(daemon, daemon.stopped.is_set, "the end of the daemon")
    assert world.loop.task_errors == 0
    world.loop.close()


class ControllerPlc(Plc):
    """As ``Plc`` over PROFINET: the controller of a plant. It connects again when its relationship has ended."""

    def __init__(self, site: Plant) -> None:
        super().__init__(site.daemon, [item.telegram.number for item in site.daemon.objects])
        self.site = site
        self.retry = 0
        self._exchange = ControllerExchange(self.endpoint, site.plc)

    def send(self) -> None:
        controller, now = self.site.plc, self.loop.now()
        controller.silent = self.silent
        if controller.phase in {Phase.IDLE, Phase.ENDED} and now >= self.retry and not self.silent:
            self.retry = now + SECOND
            controller.start(now)
        if not self.silent:
            self._exchange.send()

    def cycle(self) -> None:
        super().cycle()
        self._exchange.take(self.loop.now())


def parameterise_again(site: Plant) -> None:
    """The controller keeps sending, but its data does not count until it has finished."""
    plc = site.plc
    block = PrmBeginReq(ar_uuid=plc.ar_uuid, session_key=plc.session, command=ControlCommand.PRM_BEGIN)
    plc._send_call(Operation.CONTROL, block.encode(), lambda *_: None, site.loop.now())


def try_to_connect(site: Plant, host: str = OTHER_IP, mac: bytes = OTHER_MAC, **project: object) -> None:
    """One Connect of a controller, which the device refuses."""
    before = site.link.device.cm.refusals
    other = IoController(
        Station(Identity(mac, 1, 1, "plc", "PLC"), "plc-2"), replace(site.plc.project, **project), DEVICE_IP, seed=9
    )
    other.learned.mac, other.learned.ip = DEVICE_MAC, DEVICE_IP
    other._services.device = site.link.device.cm._object
    other._connect(site.loop.now())
    site.others[host, ACYCLIC_PORT] = deque()
    for _, data in other.outgoing():
        site.port.datagrams.append((bytes(data), (host, ACYCLIC_PORT)))
        site.port.on_other()
    site.run(20 * MS)
    del site.others[host, ACYCLIC_PORT]
    assert site.link.device.cm.refusals == before + 1


def abort(code: int) -> Callable[[Plant], None]:
    """The controller ends with an alarm ERR of this code."""

    def act(site: Plant) -> None:
        relation = site.link.device.relation
        assert relation is not None
        content = bytes((0xCF, 0x81, 0xFD, code))
        reference = site.plc.project.alarm().reference
        pdu = apmx.encode(Priority.LOW, relation.reference, reference, PduType.ERR, 0xFFFE, 0xFFFF, content)
        site.port.arrive(None, ethernet.frame(DEVICE_MAC, PLC_MAC, pdu, tag=0xA000))
        site.killed = True

    return act


class PlantChannel:
    """An engineer's datagrams to the station, from an address of his own."""

    local_address = ("192.168.0.9", 50_000)

    def __init__(self, site: Plant) -> None:
        self._site = site
        self._received = site.others.setdefault(self.local_address, deque())

    def send(self, data: bytes) -> None:
        self._site.port.datagrams.append((data, self.local_address))
        self._site.port.on_other()

    def receive(self, timeout_s: float) -> bytes | None:
        end = self._site.loop.now() + int(timeout_s * SECOND)
        while not self._received and self._site.loop.now() < end:
            self._site.run(MS)
        return self._received.popleft() if self._received else None

    def now(self) -> float:
        return self._site.loop.now() / SECOND

    def sleep(self, seconds: float) -> None:
        self._site.run(int(seconds * SECOND))

    def close(self) -> None:
        del self._site.others[self.local_address]
