"""The physical device (PDEV): interface and port as records, and what a controller has the device check and adjust there.

Source: IEC 61158-6-10 (PDPortDataReal, PDInterfaceDataReal, PDPortDataCheck, PDPortDataAdjust, PDInterfaceAdjust). What a
controller wrote is in force as long as its relationship lasts.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

from pdgw.profinet.blocks.port import (
    NO_LLDP,
    STANDARD_LLDP,
    AdjustPeerToPeerBoundary,
    CheckMauType,
    CheckPeers,
    FastStartUpAdjust,
    InterfaceAdjust,
    NetworkComponentCheck,
    PortData,
    PortDataAdjust,
    PortDataCheck,
)
from pdgw.profinet.blocks.record_blocks import InterfaceDataReal, MultipleBlock, Peer, PortDataReal, PortStatistic
from pdgw.profinet.discovery import lldp
from pdgw.profinet.model import API_DEFAULT, DAP_SLOT, INTERFACE_SUBSLOT, PORT_SUBSLOT, Subslot
from pdgw.profinet.wire import Block

if TYPE_CHECKING:
    from pdgw.profinet.station import Neighbour, Station

PORT: Final = (DAP_SLOT, PORT_SUBSLOT)
INTERFACE: Final = (DAP_SLOT, INTERFACE_SUBSLOT)
_MEDIA_COPPER = 1
_LINK_UP, _LINK_DOWN = 1, 2
_SILENCE_NS: Final = 2 * lldp.INTERVAL_NS
"""A neighbour sends LLDP every 5 s: within this time after the link came up its absence is not a fault."""


class PortIndex(enum.IntEnum):
    """Records of interface and port that a controller writes."""

    PORT_DATA_CHECK = 0x802B
    PORT_DATA_ADJUST = 0x802F
    NETWORK_COMPONENT_CHECK = 0x8070
    INTERFACE_ADJUST = 0x8071
    FAST_STARTUP_ADJUST = 0x8090


WRITABLE: Final[dict[tuple[Subslot, int], type[Block]]] = {
    (PORT, PortIndex.PORT_DATA_CHECK): PortDataCheck,
    (PORT, PortIndex.PORT_DATA_ADJUST): PortDataAdjust,
    (INTERFACE, PortIndex.NETWORK_COMPONENT_CHECK): NetworkComponentCheck,
    (INTERFACE, PortIndex.INTERFACE_ADJUST): InterfaceAdjust,
    (INTERFACE, PortIndex.FAST_STARTUP_ADJUST): FastStartUpAdjust,
}
"""The block of each record."""


class PortFault(enum.Enum):
    """Diagnoses of the port: ChannelErrorType and ExtChannelErrorType."""

    MAU_TYPE = (0x8000, 0x8001)
    STATION_NAME = (0x8001, 0x8000)
    PORT_NAME = (0x8001, 0x8001)
    NO_PEER = (0x8001, 0x8005)


Written = Mapping[tuple[Subslot, int], bytes]
"""Records of interface and port that a controller wrote."""


def check(place: Subslot, index: int, data: bytes) -> None:
    """Raise WireError for a record that does not fit its index."""
    block = WRITABLE[place, index].decode(data)
    if isinstance(block, PortData):
        for _ in block.parts():
            pass


def _parts(written: Written, index: PortIndex, kind: type[PortData]) -> Iterable[Block]:
    data = written.get((PORT, index))
    return kind.decode(data).parts() if data is not None else ()


def adjust(written: Written, station: Station) -> None:
    """Set LLDP as the controller requests it; the default without its records."""
    adjusted = written.get((INTERFACE, PortIndex.INTERFACE_ADJUST))
    station.lldp_legacy = adjusted is not None and not InterfaceAdjust.decode(adjusted).mode & STANDARD_LLDP
    boundaries = _parts(written, PortIndex.PORT_DATA_ADJUST, PortDataAdjust)
    station.lldp_silent = any(
        isinstance(part, AdjustPeerToPeerBoundary) and bool(part.boundary & NO_LLDP) for part in boundaries
    )


def faults(written: Written, station: Station, now: int) -> set[PortFault]:
    """Differences between the port and the controller's project."""
    found: set[PortFault] = set()
    for part in _parts(written, PortIndex.PORT_DATA_CHECK, PortDataCheck):
        match part:
            case CheckPeers(peers=(peer,)) if station.neighbour is not None:
                found |= _compare(peer.port_id, peer.chassis_id, station.neighbour)
            case CheckPeers() if now >= station.link_since_ns + _SILENCE_NS:
                found.add(PortFault.NO_PEER)
            case CheckMauType(mau_type=expected) if station.link_up and station.medium.mau_type not in {0, expected}:
                found.add(PortFault.MAU_TYPE)
    return found


def _compare(port: str, name: str, neighbour: Neighbour) -> set[PortFault]:
    seen_port, _, seen_name = neighbour.alias.partition(".")
    found = set()
    if port and port != seen_port:
        found.add(PortFault.PORT_NAME)
    if name and name != seen_name:
        found.add(PortFault.STATION_NAME)
    return found


# -- records that are read --------------------------------------------------------------------------------------------


def port_data(station: Station) -> bytes:
    """PDPortDataReal."""
    neighbour = station.neighbour
    peers: tuple[Peer, ...] = ()
    if neighbour is not None:
        peers = (Peer(port_id=neighbour.port_id, chassis_id=neighbour.chassis_id, mac=neighbour.mac),)
    return PortDataReal(
        slot=DAP_SLOT,
        subslot=PORT_SUBSLOT,
        port_id=station.port,
        number_of_peers=len(peers),
        peers=peers,
        mau_type=station.medium.mau_type if station.link_up else 0,
        link_state=_LINK_UP if station.link_up else _LINK_DOWN,
        media_type=_MEDIA_COPPER,
    ).encode()


def interface_data(station: Station) -> bytes:
    """PDInterfaceDataReal."""
    ip = station.ip
    return InterfaceDataReal(
        chassis_id=station.identity.chassis,
        mac=station.identity.mac,
        ip=ip.address.packed,
        mask=ip.mask.packed,
        gateway=ip.gateway.packed,
    ).encode()


def statistic(octets: tuple[int, int]) -> bytes:
    """PDPortStatistic of the octets received and sent."""
    received, sent = (count & 0xFFFFFFFF for count in octets)
    return PortStatistic(in_octets=received, out_octets=sent).encode()


def _together(parts: Iterable[tuple[Subslot, bytes]]) -> bytes:
    out = b""
    for (slot, subslot), block in parts:
        out += bytes(-len(out) % 4)
        out += MultipleBlock(api=API_DEFAULT, slot=slot, subslot=subslot, blocks=block).encode()
    return out


def real_data(station: Station) -> bytes:
    """PDRealData: interface and port together."""
    return _together(((INTERFACE, interface_data(station)), (PORT, port_data(station))))


def expected_data(written: Written) -> bytes:
    """PDExpectedData: what the controller wrote; empty where it wrote nothing."""
    return _together((place, written[place, index]) for place, index in WRITABLE if (place, index) in written)
