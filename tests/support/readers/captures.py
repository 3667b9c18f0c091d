"""Small captures of both buses, as packets with a link layer and as CAN messages."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from uuid import UUID

import can
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import RawPcapNgReader

from pdgw.base.durations import MS
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profidrive.scapy_layers import cyclic_frame
from pdgw.profidrive.telegrams import Direction
from pdgw.profinet.rpc.client import RecordCaller
from pdgw.profinet.rpc.dcerpc import object_uuid
from pdgw.profinet.rpc.records import RECORD_GLOBAL
from pdgw.profinet.rpc.server import RecordServer
from tests.support.readers.both_buses import block

BEGIN_NS = 1_700_000_000_123_456_000
ETHERNET, SOCKETCAN = 1, 227
ETHER = Ether(src="02:00:00:00:00:01", dst="02:00:00:00:00:02")
"""With both addresses: scapy would ask this machine's network for one it does not have."""
LinkPacket = tuple[int, int, bytes]
"""Time in nanoseconds, link type, bytes."""


def cyclic_packets(cycles: int = 4) -> list[bytes]:
    """Ethernet frames of telegram 1 in both directions, built by scapy."""
    packets = []
    for cycle in range(cycles):
        for direction, signals in (
            (Direction.SETPOINT, {"STW1": 0x047F, "NSOLL_A": 100 * cycle}),
            (Direction.ACTUAL, {"ZSW1": 0x0637, "NIST_A": 100 * cycle - 50}),
        ):
            frame = cyclic_frame([1], direction, [signals], counter=(65500 + 32 * cycle) & 0xFFFF)
            ports = (
                UDP(sport=40000, dport=CYCLIC_PORT)
                if direction is Direction.SETPOINT
                else UDP(sport=CYCLIC_PORT, dport=40000)
            )
            packets.append(bytes(ETHER / IP(src="10.0.0.1", dst="10.0.0.2") / ports / frame))
    return packets


class _Answer:
    """A device that answers every read with these records in turn."""

    def __init__(self, answers: Sequence[bytes]) -> None:
        self.answers = list(answers)

    def read(self, _block: object, *, implicit: bool) -> bytes:
        return self.answers.pop(0)

    def write(self, _block: object, _data: bytes) -> None:
        pass


def parameter_packets(exchanges: Sequence[tuple[bytes, bytes]]) -> list[bytes]:
    """Ethernet frames that write each parameter request and read its response."""
    server = RecordServer[object](_Answer([answer for _, answer in exchanges]), 4096)
    # With the nil UUID tshark 4.0 expects a target AR in the write block too and calls the packet malformed.
    caller = RecordCaller(UUID(int=7), object_uuid(1, 1, 0x400), UUID(int=1))
    packets = []
    for request, _ in exchanges:
        for call in (caller.write(0, 1, 1, RECORD_GLOBAL, request), caller.read(0, 1, 1, RECORD_GLOBAL)):
            for packet in call.packets:
                packets.append(bytes(Ether() / IP() / UDP(sport=50000, dport=34964) / packet))
                packets += [
                    bytes(Ether() / IP() / UDP(sport=34964, dport=50000) / answer)
                    for answer in server.receive(packet, "plc")
                ]
    return packets


CANOPEN: tuple[tuple[int, bytes], ...] = tuple(
    (cob_id, bytes.fromhex(data))
    for cob_id, data in (
        (0x000, "0101"),
        (0x701, "00"),
        (0x701, "7F"),
        (0x080, ""),
        (0x601, "4000100000000000"),
        (0x581, "4300100092010200"),
        (0x601, "2B17100064000000"),
        (0x581, "6017100000000000"),
        (0x602, "4041600000000000"),
        (0x582, "4B41600037020000"),
        (0x601, "4000200500000000"),
        (0x581, "8000200500000206"),
        (0x081, "1043090A00000000"),
        (0x181, "3702B80B0000"),
        (0x201, "F40100000F00"),
    )
)
"""One of each service: NMT, boot-up, heartbeat, SYNC, SDO upload and download, abort, EMCY, PDOs."""


def can_frames(path: Path) -> list[tuple[int, bytes]]:
    """COB-ID and data of the CAN frames in a pcapng file, as scapy reads it."""
    packets = (data for data, about in RawPcapNgReader(str(path)) if about.linktype == SOCKETCAN)
    return [(int.from_bytes(data[:4], "big"), data[8 : 8 + data[4]]) for data in packets]


def socketcan_packet(cob_id: int, data: bytes) -> bytes:
    return struct.pack(">IBxxx", cob_id, len(data)) + data


def messages(channel: str = "can0") -> list[can.Message]:
    """``CANOPEN`` as python-can messages, a millisecond apart."""
    return [
        can.Message(
            timestamp=(BEGIN_NS + number * MS) / 1e9,
            arbitration_id=cob_id,
            data=data,
            is_extended_id=False,
            channel=channel,
            is_rx=True,
        )
        for number, (cob_id, data) in enumerate(CANOPEN)
    ]


def both_buses() -> list[LinkPacket]:
    """Cyclic frames and CAN frames, a millisecond apart."""
    links = [(ETHERNET, data) for data in cyclic_packets()]
    links += [(SOCKETCAN, socketcan_packet(cob_id, data)) for cob_id, data in CANOPEN]
    return [(BEGIN_NS + number * MS, link, data) for number, (link, data) in enumerate(links)]


def pcap(packets: Sequence[LinkPacket], *, order: str = "<", nanoseconds: bool = False) -> bytes:
    """A pcap file; all packets have the first one's link type."""
    magic, unit = (0xA1B23C4D, 1) if nanoseconds else (0xA1B2C3D4, 1000)
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, packets[0][1])]
    for time_ns, _, data in packets:
        seconds, rest = divmod(time_ns, 10**9)
        parts.append(struct.pack(order + "IIII", seconds, rest // unit, len(data), len(data)) + data)
    return b"".join(parts)


def pcapng(packets: Sequence[LinkPacket], *, order: str = "<", resolution: int = 9) -> bytes:
    """A pcapng file with one interface for each link type; ``resolution`` as if_tsresol."""
    links = sorted({link for _, link, _ in packets})
    parts = [block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)]
    for link in links:
        name = f"if{link}".encode()
        options = struct.pack(order + "HHB3x", 9, 1, resolution)
        options += struct.pack(order + "HH", 2, len(name)) + name + bytes(-len(name) % 4) + bytes(4)
        parts.append(block(1, struct.pack(order + "HHI", link, 0, 0) + options, order))
    ticks = 2 ** (resolution & 0x7F) if resolution & 0x80 else 10**resolution
    for time_ns, link, data in packets:
        time = time_ns * ticks // 10**9
        head = struct.pack(order + "IIIII", links.index(link), time >> 32, time & 0xFFFFFFFF, len(data), len(data))
        parts.append(block(6, head + data, order))
    return b"".join(parts)


def candump(found: Sequence[tuple[int, bytes]] = CANOPEN) -> bytes:
    """A log as ``candump -l`` writes it."""
    lines = []
    for number, (cob_id, data) in enumerate(found):
        seconds, rest = divmod(BEGIN_NS + number * MS, 10**9)
        lines.append(f"({seconds}.{rest // 1000:06d}) can0 {cob_id:03X}#{data.hex().upper()}\n")
    return "".join(lines).encode()
