"""A device and a controller on one virtual wire, in virtual time; what went over it is kept as Ethernet frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import IPv4Address
from typing import Any
from uuid import UUID

from scapy.contrib.pnio import ProfinetIO
from scapy.layers.l2 import Dot1Q, Ether

from pdgw.base.durations import MS
from pdgw.peers.controller.controller import IoController, Phase
from pdgw.peers.controller.project import Project
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.device import DeviceEvent, ProfinetDevice
from pdgw.profinet.model import DeviceModel, Module, ObjectKind, drive_model
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.rpc.records import AccessError, RecordBlock, RecordRefused, encode_block
from pdgw.profinet.station import Identity, IpSuite, Station
from tests.support.readers.tshark_frames import datagram

DEVICE_MAC = bytes.fromhex("020000000002")
PLC_MAC = bytes.fromhex("020000000001")
DEVICE_IP = IpSuite(IPv4Address("192.168.0.2"), IPv4Address("255.255.255.0"))
PLC_IP = "192.168.0.1"
OBJECTS = [(ObjectKind.AXIS, telegram(1)), (ObjectKind.AXIS, telegram(9)), (ObjectKind.ENCODER, telegram(83))]
IDENTITY = Identity(DEVICE_MAC, 0xFFFF, 0x0402, "profidrive-gateway", "PDGW", "4711")


PORT_CHECK = bytes.fromhex("0200 001e 0100 0000 0000 8001 020a 0012 0100 01 08") + b"port-001" + b"\x05plc-1"
"""PDPortDataCheck: the neighbour is port 1 of plc-1."""
PORT_ADJUST = bytes.fromhex("0202 0018 0100 0000 0000 8001 0224 000c 0100 0000 00000001 0000 0000")
"""PDPortDataAdjust: no LLDP frames."""
INTERFACE_ADJUST = bytes.fromhex("0250 0008 0100 0000 00000000")
"""PDInterfaceAdjust: the chassis ID of LLDP is the name of station."""


def join_multiple(writes: Sequence[tuple[RecordBlock, bytes]]) -> bytes:
    """The data of a RECORD_MULTIPLE, which controllers write."""
    out = bytearray()
    for block, record in writes:
        out += bytes(-len(out) % 4) + encode_block(block) + record
    return bytes(out)


@dataclass
class Application:
    """Records of the application: what was written is read back."""

    records: dict[tuple[int, int, int], bytes] = field(default_factory=dict)
    writes: int = 0

    def read(self, block: RecordBlock, *, implicit: bool) -> bytes:
        try:
            return self.records[block.slot, block.subslot, block.index]
        except KeyError:
            raise RecordRefused(AccessError.STATE_CONFLICT) from None

    def write(self, block: RecordBlock, data: bytes) -> None:
        self.writes += 1
        self.records[block.slot, block.subslot, block.index] = data


def model() -> DeviceModel:
    return drive_model(IDENTITY, OBJECTS)


def project(modules: Mapping[int, Module] | None = None, **settings: Any) -> Project:
    return Project("gateway", modules or model().modules, **settings)


class Wire:
    """Carries everything at once; ``to_device`` and ``to_plc`` may be cut. Time only passes in ``run``."""

    def __init__(self, *, of_project: Project | None = None, seed: int = 1) -> None:
        self.now = 0
        self.application = Application()
        self.station = Station(IDENTITY, "gateway", DEVICE_IP)
        self.device = ProfinetDevice(model(), self.station, lambda host: self.application, seed=UUID(int=99), now=0)
        self.plc = IoController(
            Station(Identity(PLC_MAC, 1, 1, "plc", "PLC"), "plc-1"), of_project or project(), DEVICE_IP, seed=seed
        )
        self.to_device = True
        self.to_plc = True
        self.frames: list[bytes] = []
        self.times: list[tuple[int, bytes]] = []
        self.events: list[DeviceEvent] = []
        self.fresh = 0
        self.on_cycle: Callable[[], None] = lambda: None

    @property
    def consumer(self) -> Consumer:
        """What takes the controller's frames, as the gateway's link reads it."""
        relation = self.device.relation
        assert relation is not None
        assert relation.consumer is not None
        return relation.consumer

    @property
    def silent_ns(self) -> int:
        """Since the last frame of the controller that counted."""
        assert self.consumer.last_ns is not None
        return self.now - self.consumer.last_ns

    def carry(self) -> None:
        """Until nothing is under way."""
        while True:
            down, up = self.plc.outgoing(), self.device.outgoing()
            if not down and not up:
                break
            for address, data in down:
                self._keep(data, (PLC_IP, ACYCLIC_PORT), address, PLC_MAC, DEVICE_MAC)
                if not self.to_device:
                    continue
                if address is None:
                    self.fresh += self.device.on_frame(bytes(data), self.now)
                else:
                    self.device.on_datagram(bytes(data), (PLC_IP, ACYCLIC_PORT), self.now)
            for address, data in up:
                self._keep(data, (str(DEVICE_IP.address), ACYCLIC_PORT), address, DEVICE_MAC, PLC_MAC)
                if not self.to_plc:
                    continue
                if address is None:
                    self.plc.on_frame(bytes(data), self.now)
                else:
                    self.plc.on_datagram(bytes(data), (str(DEVICE_IP.address), ACYCLIC_PORT), self.now)
        self.events += self.device.events()

    def _keep(
        self,
        data: bytes | bytearray,
        source: tuple[str, int],
        address: tuple[str, int] | None,
        from_mac: bytes,
        to_mac: bytes,
    ) -> None:
        frame = bytes(data) if address is None else datagram(bytes(data), source, address, from_mac, to_mac)
        self.frames.append(frame)
        self.times.append((self.now, frame))

    def run(self, ns: int, until: Callable[[], object] = lambda: False) -> None:
        """Let time pass."""
        end = self.now + ns
        self.carry()
        while not until():
            due = self.device.next_deadline()
            other = self.plc.next_deadline()
            when = max(self.now, due if other is None else min(due, other))
            if when > end:
                self.now = end
                break
            self.now = when
            self.plc.poll(self.now)
            self.device.poll(self.now)
            self.on_cycle()
            self.carry()

    def connect(self) -> None:
        """Until data is exchanged."""
        self.plc.start(self.now)
        self.run(20_000 * MS, lambda: self.device.connected and self.plc.phase is Phase.DATA)
        assert self.device.connected, (self.plc.phase, self.plc.learned)

    def reported(self, kind: type[DeviceEvent]) -> list[Any]:
        """Events of this kind until now."""
        return [event for event in self.events if isinstance(event, kind)]


# DCP requests whose headers scapy builds: Identify, Get and Set, as an engineering tool or a controller sends them.


MULTICAST = "01:0e:cf:00:00:00"
GET, SET, IDENTIFY = (0xFEFD, 3), (0xFEFD, 4), (0xFEFE, 5)
"""FrameID and ServiceID of a request."""
NAME, ALIAS = (2, 2), (2, 6)
PERMANENT, TEMPORARY = 1, 0


def dcp_frame(
    frame_id: int, service: int, blocks: bytes, destination: str, delay: int = 0, vlan: bool = False
) -> bytes:
    """A request of the controller, padded to the shortest Ethernet frame. ``delay``: ResponseDelayFactor."""
    head = Ether(src=PLC_MAC.hex(":"), dst=destination)
    head = head / Dot1Q(prio=0, vlan=0, type=0x8892) if vlan else Ether(head.build()[:12] + b"\x88\x92")
    fixed = bytes((service, 0)) + (7).to_bytes(4, "big") + delay.to_bytes(2, "big") + len(blocks).to_bytes(2, "big")
    return bytes(head / ProfinetIO(frameID=frame_id) / (fixed + blocks)).ljust(60, b"\0")


def encoded(option: tuple[int, int], content: bytes) -> bytes:
    """A block: option, suboption, length, content, padded to an even length."""
    return bytes(option) + len(content).to_bytes(2, "big") + content + bytes(len(content) & 1)
