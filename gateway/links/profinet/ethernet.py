"""The Ethernet edge of the PROFINET device: raw sockets with filters in the kernel, the RPC port, link state, IP address.

Linux (AF_PACKET). Real-time frames and DCP have a socket each, so that a flood of DCP cannot push a controller's frame out of
the buffer. Needs CAP_NET_RAW; CAP_NET_ADMIN to set the address that DCP gives. Speed, duplex mode and autonegotiation are what
the driver says (ETHTOOL). Source: linux/ethtool.h (struct ethtool_cmd), RFC 4836 (dot3MauType, ifMauAutoNegCapAdvertisedBits).
"""

from __future__ import annotations

import ctypes
import logging
import socket
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Protocol, TypeVar

from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.packet_filter import (
    JUMP_EQUAL,
    JUMP_GREATER,
    JUMP_GREATER_EQUAL,
    LOAD_HALF,
    LOAD_WORD,
    RETURN,
    Instruction,
    attach,
)
from pdgw.gateway.base.ports import refusal
from pdgw.gateway.base.udp import Address
from pdgw.profinet import ethernet
from pdgw.profinet.discovery import dcp
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import MAU_100BASE_TX_FULL, MAU_1000BASE_T_FULL, IpSuite, Medium

_SIOCETHTOOL, _ETHTOOL_GSET = 0x8946, 1
_COMMAND: Final = struct.Struct("=IIIHBBBBBBIIHBBIII")
"""cmd, supported, advertising, speed, duplex, port, phy_address, transceiver, autoneg, mdio_support, ... speed_hi, ..."""
_SUPPORTS_AUTONEGOTIATION: Final = 1 << 6
_FULL: Final = 1
MAU_TYPES: Final = {
    (10, False): 10,
    (10, True): 11,
    (100, False): 15,
    (100, True): MAU_100BASE_TX_FULL,
    (1000, False): 29,
    (1000, True): MAU_1000BASE_T_FULL,
    (10_000, True): 54,
}
"""dot3MauType of copper by Mbit/s and full duplex."""
_ADVERTISED: Final = ((0, 1), (1, 2), (2, 4), (3, 5), (4, 14), (5, 15))
"""Bit of ethtool's ADVERTISED_ (10 half, 10 full, 100 half ... 1000 full), bit of RFC 4836 counted from the most significant."""
_UNKNOWN: Final = Medium(0, 0, 0)


def medium_of(command: bytes) -> Medium:
    """Decode a driver's answer to ETHTOOL_GSET. MAU type 0: an unknown speed, or no link."""
    _, supported, advertising, low, duplex, _, _, _, enabled, _, _, _, high, *_ = _COMMAND.unpack(command)
    autonegotiation = bool(supported & _SUPPORTS_AUTONEGOTIATION) | (enabled == 1) << 1
    advertised = sum(0x8000 >> bit for ours, bit in _ADVERTISED if advertising >> ours & 1)
    return Medium(MAU_TYPES.get((high << 16 | low, duplex == _FULL), 0), autonegotiation, advertised)


def read_medium(sock: socket.socket, interface: str) -> Medium:
    """Speed and duplex mode of an interface; unknown if its driver does not report them."""
    import fcntl  # noqa: PLC0415 (not there on Windows)

    command = ctypes.create_string_buffer(_COMMAND.pack(_ETHTOOL_GSET, *[0] * 17), _COMMAND.size)
    request = struct.pack("16sP16x", interface.encode(), ctypes.addressof(command))
    try:
        fcntl.ioctl(sock.fileno(), _SIOCETHTOOL, request)
    except OSError:
        return _UNKNOWN
    return medium_of(command.raw)


log = logging.getLogger("gateway")

T = TypeVar("T")
_FRAME_MAX = 2048
_DATAGRAM_MAX = 65_535
_ARPHRD_ETHER = 1
_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, _MR_MULTICAST = 263, 1, 0
_SO_BINDTODEVICE = 25
_SIOCGIFADDR, _SIOCSIFADDR, _SIOCGIFNETMASK, _SIOCSIFNETMASK = 0x8915, 0x8916, 0x891B, 0x891C
_NETLINK_ROUTE, _GROUP_LINK, _GROUP_ADDRESS = 0, 1, 0x10
_DCP_FIRST, _DCP_LAST = 0xFEFC, dcp.FRAME_ID_IDENTIFY_RESPONSE
_FRAME_ID_AT = 14


def _to(mac: bytes) -> list[Instruction]:
    """Drop unless the destination is this one; followed by what the rest is checked for."""
    high, low = struct.unpack(">IH", mac)
    return [
        (LOAD_WORD, 0, 0, 0),
        (JUMP_EQUAL, 1, 0, high),
        (RETURN, 0, 0, 0),
        (LOAD_HALF, 0, 0, 4),
        (JUMP_EQUAL, 1, 0, low),
        (RETURN, 0, 0, 0),
    ]


def real_time_filter(mac: bytes) -> list[Instruction]:
    """Frames to this station other than DCP."""
    return [
        *_to(mac),
        (LOAD_HALF, 0, 0, _FRAME_ID_AT),
        (JUMP_GREATER_EQUAL, 0, 1, _DCP_FIRST),
        (RETURN, 0, 0, 0),
        (RETURN, 0, 0, _FRAME_MAX),
    ]


def dcp_filter() -> list[Instruction]:
    """DCP frames, to whomever the kernel delivers."""
    return [
        (LOAD_HALF, 0, 0, _FRAME_ID_AT),
        (JUMP_GREATER_EQUAL, 0, 1, _DCP_FIRST),
        (JUMP_GREATER, 0, 1, _DCP_LAST),
        (RETURN, 0, 0, 0),
        (RETURN, 0, 0, _FRAME_MAX),
    ]


class EthernetPort(Protocol):
    """One interface, as the PROFINET link needs it."""

    errors: int
    """Frames and datagrams not sent or not received."""

    @property
    def mac(self) -> bytes:
        """MAC address."""

    @property
    def link_up(self) -> bool:
        """The cable is on."""

    @property
    def medium(self) -> Medium:
        """Speed, duplex mode and autonegotiation."""

    def start(
        self, on_real_time: Callable[[], None], on_other: Callable[[], None], on_link: Callable[[], None]
    ) -> None:
        """Call these in the loop: a real-time frame; DCP, LLDP or a datagram; cable or address may be another."""

    def listen(self, *, on: bool) -> None:
        """Whether a real-time frame calls what ``start`` was given (the beginning), or only waits for ``receive``."""

    def receive(self) -> bytes | None:
        """The next real-time frame."""

    def receive_other(self) -> bytes | None:
        """The next DCP or LLDP frame."""

    def receive_datagram(self) -> tuple[bytes, Address] | None:
        """The next datagram at the RPC port."""

    def send(self, frame: bytes | bytearray) -> None:
        """Send a frame without waiting."""

    def send_datagram(self, data: bytes, address: Address) -> None:
        """Send from the RPC port without waiting."""

    def ip(self) -> IpSuite:
        """The interface's address."""

    def set_ip(self, suite: IpSuite) -> None:
        """Give the interface this address; GatewayError when that is not allowed."""

    def close(self) -> None:
        """Release everything."""


class RawEthernet:
    """An Ethernet interface of the machine; GatewayError if it cannot be opened."""

    def __init__(self, loop: Loop, interface: str) -> None:
        self._loop = loop
        self._interface = interface
        self._sockets: list[socket.socket] = []
        self.errors = 0
        if not hasattr(socket, "AF_PACKET"):
            raise GatewayError(f'interface {interface}: raw Ethernet needs Linux; use type = "udp" on other systems')
        try:
            self._index = socket.if_nametoindex(interface)
        except OSError as error:
            names = ", ".join(name for _, name in socket.if_nameindex())
            raise GatewayError(f"interface {interface}: does not exist, allowed: {names}") from error
        try:
            self._open()
        except PermissionError as error:
            self.close()
            raise GatewayError(
                f"interface {interface}: no permission for raw Ethernet (CAP_NET_RAW is missing); set "
                "AmbientCapabilities=CAP_NET_RAW CAP_NET_ADMIN in the systemd unit, or grant them to the "
                "interpreter: setcap cap_net_raw,cap_net_admin+ep (docs/profinet.md)"
            ) from error
        except OSError as error:
            self.close()
            raise GatewayError(f"interface {interface}: cannot be used ({refusal(error, ACYCLIC_PORT)})") from error

    def _open(self) -> None:
        self._dcp = self._raw(ethernet.ETHERTYPE_PROFINET, dcp_filter(), ethernet.DCP_MULTICAST)
        *_, hardware, mac = self._dcp.getsockname()
        if hardware != _ARPHRD_ETHER:
            self.close()
            raise GatewayError(f"interface {self._interface}: not an Ethernet interface")
        self.mac = bytes(mac)
        self._real_time = self._raw(ethernet.ETHERTYPE_PROFINET, real_time_filter(self.mac))
        self._lldp = self._raw(ethernet.ETHERTYPE_LLDP, None, ethernet.LLDP_MULTICAST)
        self._rpc = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sockets.append(self._rpc)
        self._rpc.setsockopt(socket.SOL_SOCKET, _SO_BINDTODEVICE, self._interface.encode() + b"\0")
        self._rpc.bind(("0.0.0.0", ACYCLIC_PORT))
        self._netlink = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE)
        self._sockets.append(self._netlink)
        self._netlink.bind((0, _GROUP_LINK | _GROUP_ADDRESS))
        for item in self._sockets:
            item.setblocking(False)

    def _raw(self, ethertype: int, program: Sequence[Instruction] | None, group: bytes = b"") -> socket.socket:
        # Bind after the filter is set: frames received before would be queued unfiltered.
        item = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        self._sockets.append(item)
        if program is not None:
            attach(item, program)
        if group:
            membership = struct.pack("iHH8s", self._index, _MR_MULTICAST, len(group), group)
            item.setsockopt(_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, membership)
        item.bind((self._interface, ethertype))
        return item

    @property
    def link_up(self) -> bool:
        try:
            return Path(f"/sys/class/net/{self._interface}/carrier").read_text(encoding="ascii").strip() == "1"
        except OSError:
            return False  # an interface that is down has no readable carrier state

    @property
    def medium(self) -> Medium:
        return read_medium(self._rpc, self._interface)

    def start(
        self, on_real_time: Callable[[], None], on_other: Callable[[], None], on_link: Callable[[], None]
    ) -> None:
        def link_changed() -> None:
            while self._receive(self._netlink.recv, _FRAME_MAX) is not None:
                pass
            on_link()

        self._on_real_time = on_real_time
        self.listen(on=True)
        for item in (self._dcp, self._lldp, self._rpc):
            self._loop.add_reader(item.fileno(), on_other)
        self._loop.add_reader(self._netlink.fileno(), link_changed)

    def listen(self, *, on: bool) -> None:
        if on:
            self._loop.add_reader(self._real_time.fileno(), self._on_real_time, urgent=True)
        else:
            self._loop.remove_reader(self._real_time.fileno())

    @property
    def descriptors(self) -> list[int]:
        """Descriptors of real-time frames, DCP, LLDP and datagrams."""
        return [item.fileno() for item in (self._real_time, self._dcp, self._lldp, self._rpc)]

    def _receive(self, read: Callable[[int], T], size: int) -> T | None:
        try:
            return read(size)
        except BlockingIOError:
            return None
        except OSError:
            self.errors += 1
            return None

    def receive(self) -> bytes | None:
        return self._receive(self._real_time.recv, _FRAME_MAX)

    def receive_other(self) -> bytes | None:
        return self._receive(self._dcp.recv, _FRAME_MAX) or self._receive(self._lldp.recv, _FRAME_MAX)

    def receive_datagram(self) -> tuple[bytes, Address] | None:
        return self._receive(self._rpc.recvfrom, _DATAGRAM_MAX)

    def send(self, frame: bytes | bytearray) -> None:
        try:
            self._real_time.send(frame)
        except OSError:
            self.errors += 1

    def send_datagram(self, data: bytes, address: Address) -> None:
        try:
            self._rpc.sendto(data, address)
        except OSError:
            self.errors += 1

    # -- the IP address -----------------------------------------------------------------------------------------------

    def _request(self, address: bytes = bytes(4)) -> bytes:
        family = struct.pack("=H", socket.AF_INET)
        return struct.pack("16s2s2s4s16x", self._interface.encode(), family, b"\0\0", address)

    def ip(self) -> IpSuite:
        import fcntl  # noqa: PLC0415 (not there on Windows)

        found = []
        for request in (_SIOCGIFADDR, _SIOCGIFNETMASK):
            try:
                found.append(fcntl.ioctl(self._rpc.fileno(), request, self._request())[20:24])
            except OSError:
                return IpSuite()  # no address is set
        return IpSuite.decode(found[0] + found[1] + bytes(4))

    def set_ip(self, suite: IpSuite) -> None:
        import fcntl  # noqa: PLC0415 (not there on Windows)

        requests: Final = [(_SIOCSIFADDR, suite.address.packed)]
        if suite.is_set:
            requests.append((_SIOCSIFNETMASK, suite.mask.packed))
        try:
            for request, value in requests:
                fcntl.ioctl(self._rpc.fileno(), request, self._request(value))
        except OSError as error:
            raise GatewayError(
                f"interface {self._interface}: cannot set the address {suite.address} "
                f"({error.strerror or error}); this needs CAP_NET_ADMIN (docs/profinet.md)"
            ) from error

    def close(self) -> None:
        for item in self._sockets:
            self._loop.remove_reader(item.fileno())
            item.close()
        self._sockets.clear()
