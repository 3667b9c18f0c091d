"""Link layer discovery: who we are on this port, and who the neighbour is.

Source: IEEE 802.1AB with the PROFINET extensions of IEC 61158-6-10, as tshark reads them. Left out: measured line delays.
"""

from __future__ import annotations

import enum
import struct
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profinet import ethernet
from pdgw.profinet.station import Neighbour, Station

INTERVAL_NS: Final = 5 * SECOND
LIFETIME_S: Final = 20
_HEADER = struct.Struct(">H")
_LENGTH_MASK = 0x1FF
_TYPE_SHIFT = 9
_PNO = bytes.fromhex("000ecf")
_IEEE_802_3 = bytes.fromhex("00120f")


class Tlv(enum.IntEnum):
    """TLV types."""

    END = 0
    CHASSIS_ID = 1
    PORT_ID = 2
    TTL = 3
    MANAGEMENT_ADDRESS = 8
    ORGANISATION = 127


_LOCALLY_ASSIGNED = 7
_PORT_STATUS, _CHASSIS_MAC = 2, 5
_MAU_SUBTYPE = 1
_AUTONEGOTIATION = struct.Struct(">BHH")
_MANAGEMENT = struct.Struct(">BB4sBIB")
_IPV4, _IF_INDEX = 1, 2


def _tlv(kind: Tlv, content: bytes) -> bytes:
    return _HEADER.pack(kind << _TYPE_SHIFT | len(content)) + content


def port_id(station: Station) -> str:
    """Name of the port: with the name of station, unless the controller requests that in the chassis ID."""
    return f"{station.port}.{station.name}" if station.name and not station.lldp_legacy else station.port


def chassis_id(station: Station) -> str:
    """Chassis ID: the name of the device."""
    return station.name if station.name and station.lldp_legacy else station.identity.chassis


def encode(station: Station) -> bytes:
    """The LLDP frame of this station."""
    identity = station.identity
    local = bytes((_LOCALLY_ASSIGNED,))
    medium = station.medium
    mau = _AUTONEGOTIATION.pack(medium.autonegotiation, medium.advertised, medium.mau_type)
    management = _MANAGEMENT.pack(5, _IPV4, station.ip.address.packed, _IF_INDEX, station.interface_index, 0)
    payload = b"".join(
        (
            _tlv(Tlv.CHASSIS_ID, local + chassis_id(station).encode("latin-1")),
            _tlv(Tlv.PORT_ID, local + port_id(station).encode("latin-1")),
            _tlv(Tlv.TTL, LIFETIME_S.to_bytes(2, "big")),
            _tlv(Tlv.ORGANISATION, _PNO + bytes((_PORT_STATUS,)) + bytes(4)),
            _tlv(Tlv.ORGANISATION, _PNO + bytes((_CHASSIS_MAC,)) + identity.mac),
            _tlv(Tlv.ORGANISATION, _IEEE_802_3 + bytes((_MAU_SUBTYPE,)) + mau),
            _tlv(Tlv.MANAGEMENT_ADDRESS, management),
            _tlv(Tlv.END, b""),
        )
    )
    return ethernet.frame(ethernet.LLDP_MULTICAST, identity.mac, payload, ethertype=ethernet.ETHERTYPE_LLDP)


def decode(data: bytes, start: int, now: int) -> Neighbour:
    """Content of a neighbour's frame; ProfidriveError if it lacks or damages a mandatory TLV."""
    found: dict[int, bytes] = {}
    at = start
    while at + _HEADER.size <= len(data):
        (head,) = _HEADER.unpack_from(data, at)
        kind, length = head >> _TYPE_SHIFT, head & _LENGTH_MASK
        at += _HEADER.size
        if kind == Tlv.END:
            break
        if at + length > len(data):
            raise ProfidriveError("LLDP TLV length", length, f"at most {len(data) - at}")
        found.setdefault(kind, data[at : at + length])
        at += length
    for kind, least in ((Tlv.CHASSIS_ID, 2), (Tlv.PORT_ID, 2), (Tlv.TTL, 2)):
        if len(found.get(kind, b"")) < least:
            raise ProfidriveError("LLDP frame", kind.name, "this TLV, which is mandatory")
    lifetime = int.from_bytes(found[Tlv.TTL][:2], "big")
    management = found.get(Tlv.MANAGEMENT_ADDRESS, b"")
    ipv4 = management[2:11] if management[:2] == bytes((5, _IPV4)) and len(management) >= _MANAGEMENT.size - 1 else b""
    return Neighbour(found[Tlv.CHASSIS_ID], found[Tlv.PORT_ID], data[6:12], now, lifetime * SECOND, ipv4)
