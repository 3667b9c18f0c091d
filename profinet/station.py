"""Identity and names of a device: identity, name of station, IP suite.

Source: IEC 61158-6-10 (NameOfStation, IPsuite, AnnotationString), IEC 61158-5-10.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from pdgw.profidrive.errors import ProfidriveError

NAME_MAX: Final = 240
_LABEL = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?", re.ASCII)
_ADDRESS = re.compile(r"\d{1,3}(\.\d{1,3}){3}", re.ASCII)
_PORT = re.compile(r"port-\d{3}(-\d{5})?", re.ASCII)


def check_name(name: str) -> None:
    """A name of station; ProfidriveError says why it is invalid."""
    if len(name) > NAME_MAX:
        raise ProfidriveError("station name", f"{len(name)} characters", f"at most {NAME_MAX}")
    labels = name.split(".")
    if not all(_LABEL.fullmatch(label) for label in labels):
        raise ProfidriveError("station name", name, "labels of 1..63 of a-z, 0-9, inner hyphens, with dots between")
    if _ADDRESS.fullmatch(name):
        raise ProfidriveError("station name", name, "no IP address")
    if _PORT.fullmatch(labels[0]):
        raise ProfidriveError("station name", name, "a first label other than a port name (port-001)")


@dataclass(frozen=True, slots=True)
class IpSuite:
    """Address, mask and gateway; all zero is none."""

    address: IPv4Address = IPv4Address(0)
    mask: IPv4Address = IPv4Address(0)
    gateway: IPv4Address = IPv4Address(0)

    @property
    def is_set(self) -> bool:
        return int(self.address) != 0

    def check(self) -> None:
        """ProfidriveError for what no host can have. All zero is allowed: it deletes."""
        address, mask, gateway = int(self.address), int(self.mask), int(self.gateway)
        if (address, mask, gateway) == (0, 0, 0):
            return
        host = ~mask & 0xFFFFFFFF
        if host & (host + 1) or not mask:
            raise ProfidriveError("IP mask", str(self.mask), "leading ones, then zeros")
        first = address >> 24
        if first in {0, 127} or first >= 224 or address & host in {0, host}:
            raise ProfidriveError("IP address", str(self.address), "a host's address below 224.0.0.0")
        if gateway and (gateway ^ address) & mask:
            raise ProfidriveError("gateway", str(self.gateway), "0.0.0.0 or an address of the subnet")

    def encode(self) -> bytes:
        """12 bytes."""
        return self.address.packed + self.mask.packed + self.gateway.packed

    @classmethod
    def decode(cls, data: bytes) -> IpSuite:
        """Decode 12 bytes."""
        return cls(IPv4Address(data[:4]), IPv4Address(data[4:8]), IPv4Address(data[8:12]))


NO_IP: Final = IpSuite()


@dataclass(frozen=True, slots=True)
class Identity:
    """Constant identity of the device. ``software``: prefix letter and three numbers 0..255."""

    mac: bytes
    vendor_id: int
    device_id: int
    product: str
    """TypeOfStation, at most 25 characters are shown."""
    order_id: str
    serial_number: str = ""
    hardware_revision: int = 1
    software: tuple[str, int, int, int] = ("V", 0, 0, 0)
    instance: int = 1

    @property
    def product_text(self) -> str:
        return self.product[:25]

    @property
    def annotation(self) -> str:
        """As the endpoint mapper shows it."""
        prefix, *release = self.software
        numbers = "".join(f"{number:3d}" for number in release)
        return f"{self.product[:25]:<25} {self.order_id[:20]:<20} {self.hardware_revision:5d} {prefix}{numbers}"

    @property
    def chassis(self) -> str:
        """System identification as LLDP shows it."""
        prefix, *release = self.software
        numbers = "".join(f"{number:3d}" for number in release)
        return (
            f"{self.product[:25]:<25} {self.order_id[:20]:<20} {self.serial_number[:16]:<16} "
            f"{self.hardware_revision:5d} {prefix}{numbers}"
        )


MAU_100BASE_TX_FULL: Final = 0x0010
MAU_1000BASE_T_FULL: Final = 0x001E


@dataclass(frozen=True, slots=True)
class Medium:
    """What the port runs at. Source: IEEE 802.3 clause 30, RFC 4836 (dot3MauType, ifMauAutoNegCapAdvertisedBits)."""

    mau_type: int = MAU_100BASE_TX_FULL
    """Speed and duplex mode; 0: unknown."""
    autonegotiation: int = 0x03
    """Bit 0: supported, bit 1: enabled."""
    advertised: int = 0x0400
    """Capabilities that the port advertises."""


_CHASSIS_MAC, _PORT_MAC = 4, 3
"""Subtypes of an ID that is a MAC address."""


@dataclass(slots=True)
class Neighbour:
    """The device at the other end of the cable, from LLDP. ``chassis``, ``port``: its IDs, each after its subtype."""

    chassis: bytes
    port: bytes
    mac: bytes
    seen_ns: int
    lifetime_ns: int
    management: bytes = b""
    """Of the management address if it is IPv4: four bytes, the kind of interface number, the number in four bytes."""

    @property
    def expiry_ns(self) -> int:
        """When it is forgotten (TTL), unless another frame of it comes."""
        return self.seen_ns + self.lifetime_ns

    @property
    def chassis_id(self) -> str:
        """As text."""
        return _id_text(self.chassis, _CHASSIS_MAC)

    @property
    def port_id(self) -> str:
        """As text."""
        return _id_text(self.port, _PORT_MAC)

    @property
    def alias(self) -> str:
        """The alias this neighbour gives us."""
        return self.port_id if "." in self.port_id else f"{self.port_id}.{self.chassis_id}"


def _id_text(content: bytes, mac_subtype: int) -> str:
    if content[0] == mac_subtype:
        return content[1:].hex("-")
    return content[1:].decode("latin-1").rstrip("\0 ")


@dataclass(slots=True)
class Station:
    """Identity and what DCP may change."""

    identity: Identity
    name: str = ""
    ip: IpSuite = NO_IP
    neighbour: Neighbour | None = None
    port: str = "port-001"
    link_up: bool = True
    link_since_ns: int = 0
    """When the cable was plugged or pulled."""
    medium: Medium = Medium()
    interface_index: int = 1
    lldp_legacy: bool = False
    """The controller requests the name of station as chassis ID, as in devices before V2.3."""
    lldp_silent: bool = False
    """The controller requests no LLDP frames."""

    @property
    def lldp_adjusted(self) -> bool:
        """The controller changed how LLDP is sent."""
        return self.lldp_legacy or self.lldp_silent
