"""DCP requests whose headers scapy builds: Identify, Get and Set, as an engineering tool or a controller sends them."""

from __future__ import annotations

from scapy.contrib.pnio import ProfinetIO
from scapy.layers.l2 import Dot1Q, Ether

from tests.support.wire.profinet import PLC_MAC

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
