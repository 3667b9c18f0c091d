"""Blocks that a controller writes to port and interface before PrmEnd: checks and adjustments.

Source: IEC 61158-6-10 (PDPortDataCheck, PDPortDataAdjust, PDInterfaceAdjust), as tshark reads them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Final

from pdgw.profinet import wire


@dataclass(frozen=True, kw_only=True)
class CheckedPeer(wire.Structure):
    """The port that the project has at the other end of the cable. An empty name is not checked."""

    port_id: str = wire.text(size="B")
    chassis_id: str = wire.text(size="B")


@dataclass(frozen=True, kw_only=True)
class CheckPeers(wire.Block):
    """Which neighbour the project has; a port has one."""

    TYPE: ClassVar[int] = 0x020A
    number_of_peers: int = wire.u8(wire.one_of(1))
    peers: tuple[CheckedPeer, ...] = wire.array(CheckedPeer, count=lambda before: int(before["number_of_peers"]))
    pad: None = wire.align()


@dataclass(frozen=True, kw_only=True)
class CheckLineDelay(wire.Block):
    """Longest line delay in ns. The gateway measures none."""

    TYPE: ClassVar[int] = 0x020B
    reserved: None = wire.padding(2)
    line_delay: int = wire.u32()


@dataclass(frozen=True, kw_only=True)
class CheckMauType(wire.Block):
    """Which speed and duplex mode the port must have."""

    TYPE: ClassVar[int] = 0x020C
    mau_type: int = wire.u16()


@dataclass(frozen=True, kw_only=True)
class CheckLinkState(wire.Block):
    """A link that must be up; a link that is down ends the relationship."""

    TYPE: ClassVar[int] = 0x021C
    link_state: int = wire.u16()


@dataclass(frozen=True, kw_only=True)
class AdjustDomainBoundary(wire.Block):
    """End of a synchronisation domain. A device with one port forwards nothing anyway."""

    TYPE: ClassVar[int] = 0x0209
    reserved: None = wire.padding(2)
    ingress: int = wire.u32()
    egress: int = wire.u32()
    properties: int = wire.u16()
    pad: None = wire.align()


@dataclass(frozen=True, kw_only=True)
class Boundary(wire.Block):
    """Frames that the port does not forward or send."""

    reserved: None = wire.padding(2)
    boundary: int = wire.u32()
    properties: int = wire.u16()
    pad: None = wire.align()


@dataclass(frozen=True, kw_only=True)
class AdjustMulticastBoundary(Boundary):
    """End of a multicast domain. A device with one port forwards nothing anyway."""

    TYPE: ClassVar[int] = 0x0210


NO_LLDP: Final = 1 << 0
"""AdjustPeerToPeerBoundary: the port sends no LLDP frames."""


@dataclass(frozen=True, kw_only=True)
class AdjustPeerToPeerBoundary(Boundary):
    """Whether the port sends LLDP frames (``NO_LLDP``)."""

    TYPE: ClassVar[int] = 0x0224


@dataclass(frozen=True, kw_only=True)
class AdjustPreambleLength(wire.Block):
    """Preamble of sent frames: 0 for 7 octets, which controllers also write. 1 octet is an option of IRT devices."""

    TYPE: ClassVar[int] = 0x0226
    reserved: None = wire.padding(2)
    length: int = wire.u16(wire.between(0, 0))
    pad: None = wire.align()


@dataclass(frozen=True, kw_only=True)
class AdjustDcpBoundary(Boundary):
    """Which DCP frames are not forwarded: nothing passes through a device with one port."""

    TYPE: ClassVar[int] = 0x0225


@dataclass(frozen=True, kw_only=True)
class PortData(wire.Block):
    """Checks or adjustments of one port. The standard has slot and subslot ignored."""

    PARTS: ClassVar[dict[int, type[wire.Block]]]
    reserved: None = wire.padding(2)
    slot: int = wire.u16()
    subslot: int = wire.u16()
    blocks: bytes = wire.rest()

    def parts(self) -> Iterator[wire.Block]:
        """Yield the inner blocks; WireError for a damaged or unsupported block."""
        content = self.blocks
        # Some controllers pad a block with zeros; no inner type starts with a zero.
        while content := content.lstrip(b"\0"):
            kind, data = next(wire.split(content))
            part = self.PARTS.get(kind)
            if part is None:
                allowed = ", ".join(f"{known:04X}h" for known in self.PARTS)
                raise wire.WireError(f"block in {type(self).__name__}", f"{kind:04X}h", allowed, wire.FIRST_FIELD)
            yield part.decode(data)
            content = content[len(data) :]


@dataclass(frozen=True, kw_only=True)
class PortDataCheck(PortData):
    """Checks at the port."""

    TYPE: ClassVar[int] = 0x0200
    PARTS: ClassVar[dict[int, type[wire.Block]]] = {
        part.TYPE: part for part in (CheckPeers, CheckLineDelay, CheckMauType, CheckLinkState)
    }


@dataclass(frozen=True, kw_only=True)
class PortDataAdjust(PortData):
    """Adjustments of the port. The operating system controls speed and link state."""

    TYPE: ClassVar[int] = 0x0202
    PARTS: ClassVar[dict[int, type[wire.Block]]] = {
        part.TYPE: part
        for part in (
            AdjustDomainBoundary,
            AdjustMulticastBoundary,
            AdjustPeerToPeerBoundary,
            AdjustDcpBoundary,
            AdjustPreambleLength,
        )
    }


STANDARD_LLDP: Final = 1 << 0
"""MultipleInterfaceMode.NameOfDevice: the port ID of LLDP has the name of station (port-001.name); 0: the chassis ID has it."""


@dataclass(frozen=True, kw_only=True)
class InterfaceAdjust(wire.Block):
    """Name of the station in LLDP frames."""

    TYPE: ClassVar[int] = 0x0250
    reserved: None = wire.padding(2)
    mode: int = wire.u32(wire.between(0, 1))


@dataclass(frozen=True, kw_only=True)
class NetworkComponentCheck(wire.Block):
    """Limits of dropped frames, which this device does not count."""

    TYPE: ClassVar[int] = 0x0230
    reserved: None = wire.padding(2)
    required: int = wire.u32()
    demanded: int = wire.u32()
    fault: int = wire.u32()


@dataclass(frozen=True, kw_only=True)
class FastStartUpAdjust(wire.Block):
    """Times of a fast start-up, which this device does not have."""

    TYPE: ClassVar[int] = 0x0608
    content: bytes = wire.rest()
