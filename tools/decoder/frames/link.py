"""Link layers: from a captured packet to the bytes of an RT frame, an RPC packet or a CAN frame.

Source: the tcpdump.org link-layer header types, IEEE 802.1Q, RFC 791, RFC 8200 (fixed header only), RFC 768.
Left out: reassembly of IP fragments, IPv6 extension headers, other encapsulations.
"""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

from pdgw.ds301.bus.can_frame import ERROR, EXTENDED, EXTENDED_ID, REMOTE, STANDARD_ID
from pdgw.profidrive.frame import ETHERTYPE
from pdgw.profinet.ethernet import ETHERTYPE_LLDP
from pdgw.tools.decoder.frames.records import LinkType


class Carried(enum.Enum):
    """Content after the headers."""

    RT = "PROFINET RT"
    LLDP = "LLDP"
    UDP = "UDP"
    CAN = "CAN"
    OTHER = "other"


class Payload(NamedTuple):
    """The bytes after the headers. Ports and addresses only for UDP; ``text`` describes other packets."""

    carried: Carried
    data: bytes
    source: tuple[bytes, int] = (b"", 0)
    destination: tuple[bytes, int] = (b"", 0)
    text: str = ""


_IPV4 = 0x0800
_IPV6 = 0x86DD
_VLAN = (0x8100, 0x88A8, 0x9100)
_SLL_CAN = (0x000C, 0x000D)
UDP_PROTOCOL = 17
_FRAGMENT = 0x3FFF
_PROTOCOLS = {1: "ICMP", 2: "IGMP", 6: "TCP", 58: "ICMPv6"}
_ETHERTYPES = {0x0806: "ARP", 0x88E3: "MRP", 0x8863: "PPPoE"}
_IPV4_HEADER = struct.Struct(">BxHxxHxBxx4s4s")
_UDP_HEADER = struct.Struct(">HHHxx")


def _other(text: str) -> Payload:
    return Payload(Carried.OTHER, b"", text=text)


def _short(what: str, size: int, least: int) -> Payload:
    return _other(f"{what} cut off: {size} bytes, at least {least} expected")


def _udp(data: bytes, source: bytes, destination: bytes) -> Payload:
    if len(data) < _UDP_HEADER.size:
        return _short("UDP header", len(data), _UDP_HEADER.size)
    sport, dport, length = _UDP_HEADER.unpack_from(data)
    if length < _UDP_HEADER.size or length > len(data):
        return _other(f"UDP length {length} does not fit into {len(data)} bytes")
    return Payload(Carried.UDP, data[_UDP_HEADER.size : length], (source, sport), (destination, dport))


def _transport(protocol: int, data: bytes, source: bytes, destination: bytes) -> Payload:
    if protocol == UDP_PROTOCOL:
        return _udp(data, source, destination)
    return _other(_PROTOCOLS.get(protocol, f"IP protocol {protocol}"))


def _ipv4(data: bytes) -> Payload:
    if len(data) < 20:
        return _short("IPv4 header", len(data), 20)
    first, length, fragment, protocol, source, destination = _IPV4_HEADER.unpack_from(data)
    header = 4 * (first & 15)
    if first >> 4 != 4 or header < 20:
        return _other(f"IPv4 header begins with {first:02X}h")
    if length == 0:  # segmentation offload leaves the length to the network card
        length = len(data)
    if not header <= length <= len(data):
        return _other(f"IPv4 length {length} does not fit into {len(data)} bytes")
    if fragment & _FRAGMENT:
        return _other("IPv4 fragment (not reassembled)")
    return _transport(protocol, data[header:length], source, destination)


def _ipv6(data: bytes) -> Payload:
    if len(data) < 40:
        return _short("IPv6 header", len(data), 40)
    length = 40 + int.from_bytes(data[4:6], "big")
    if data[0] >> 4 != 6 or length > len(data):
        return _other(f"IPv6 length {length} does not fit into {len(data)} bytes")
    return _transport(data[6], data[40:length], data[8:24], data[24:40])


def _typed(ethertype: int, data: bytes) -> Payload:
    while ethertype in _VLAN:
        if len(data) < 4:
            return _short("VLAN tag", len(data), 4)
        ethertype, data = int.from_bytes(data[2:4], "big"), data[4:]
    if ethertype == ETHERTYPE:
        return Payload(Carried.RT, data)
    if ethertype == ETHERTYPE_LLDP:
        return Payload(Carried.LLDP, data)
    if ethertype == _IPV4:
        return _ipv4(data)
    if ethertype == _IPV6:
        return _ipv6(data)
    return _other(_ETHERTYPES.get(ethertype, f"EtherType {ethertype:04X}h"))


def _ip(data: bytes) -> Payload:
    return _ipv6(data) if data and data[0] >> 4 == 6 else _ipv4(data)


_LOOPBACK_IPV4 = 2


def unwrap(link: int, data: bytes) -> Payload:
    """Remove the headers of a packet. Damaged and unrelated packets are ``Carried.OTHER`` with a text."""
    if link == LinkType.ETHERNET:
        return (
            _typed(int.from_bytes(data[12:14], "big"), data[14:])
            if len(data) >= 14
            else _short("Ethernet", len(data), 14)
        )
    if link == LinkType.CAN_SOCKETCAN:
        return Payload(Carried.CAN, data)
    if link in (LinkType.LINUX_SLL, LinkType.LINUX_SLL2):
        header, position = (16, 14) if link == LinkType.LINUX_SLL else (20, 0)
        if len(data) < header:
            return _short("Linux cooked header", len(data), header)
        protocol = int.from_bytes(data[position : position + 2], "big")
        if protocol in _SLL_CAN:
            return Payload(Carried.CAN, data[header:])
        return _typed(protocol, data[header:])
    if link in (LinkType.RAW_IP, LinkType.IPV4, LinkType.IPV6):
        return _ip(data)
    if link in (LinkType.NULL, LinkType.LOOP):
        if len(data) < 4:
            return _short("loopback header", len(data), 4)
        family = data[:4]
        known = _LOOPBACK_IPV4.to_bytes(4, "little"), _LOOPBACK_IPV4.to_bytes(4, "big")
        return _ipv4(data[4:]) if family in known else _ip(data[4:])
    return _other(f"link type {link}")


class CanFrame(NamedTuple):
    """A CAN frame taken from a capture; ``cob_id`` without flags."""

    cob_id: int
    data: bytes
    extended: bool = False
    remote: bool = False
    error: bool = False


_SOCKETCAN_HEADER = struct.Struct(">IBxxx")


def socketcan(data: bytes) -> CanFrame | str:
    """The frame of a SocketCAN packet (identifier big-endian); a text when it is damaged."""
    if len(data) < _SOCKETCAN_HEADER.size:
        return f"SocketCAN header cut off: {len(data)} of 8 bytes"
    identifier, length = _SOCKETCAN_HEADER.unpack_from(data)
    extended = bool(identifier & EXTENDED)
    remote = bool(identifier & REMOTE)
    payload = data[8 : 8 + length]
    if len(payload) < length and not remote:
        return f"CAN frame of {length} bytes cut off: {len(payload)} captured"
    return CanFrame(
        identifier & (EXTENDED_ID if extended else STANDARD_ID), payload, extended, remote, bool(identifier & ERROR)
    )
