"""Speed, duplex mode and autonegotiation of a network interface, as its driver says (Linux, ETHTOOL).

Source: linux/ethtool.h (struct ethtool_cmd), RFC 4836 (dot3MauType, ifMauAutoNegCapAdvertisedBits).
"""

from __future__ import annotations

import ctypes
import socket
import struct
from typing import Final

from pdgw.profinet.station import MAU_100BASE_TX_FULL, MAU_1000BASE_T_FULL, Medium

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
