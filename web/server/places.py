"""Which connections to the page stay open: few for each unknown sender, and a new one always gets a place.

A connection is unknown until it shows the token or carries a stream. Unknown connections end in favour of newer ones, so a
sender with many connections loses its own first, and /healthz is always answered.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable

CONNECTIONS_MAX = 64
UNKNOWN_MAX = 48
"""The other places are for connections with the token, and for streams."""
UNKNOWN_OF_SENDER_MAX = 16
_IPV6_NETWORK_BITS = 64
"""One sender may use every address of such a network."""
Peer = tuple[str, int]
"""Address and port of the other side, as a socket and ASGI's ``client`` have them."""


def sender(host: str) -> str:
    """The part of an address that counts as one sender: the IPv4 address or the IPv6 network."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.IPv6Network((address, _IPV6_NETWORK_BITS), strict=False))


class Places:
    """The connections that are open, oldest first."""

    def __init__(self) -> None:
        self._unknown: dict[Peer, Callable[[], None]] = {}
        self._known: set[Peer] = set()

    def enter(self, peer: Peer, end: Callable[[], None]) -> bool:
        """Take a place; ``end`` aborts this connection when a newer one needs it. False: known connections have all of them."""
        name = sender(peer[0])
        own = [other for other in self._unknown if sender(other[0]) == name]
        full = len(self._unknown) >= UNKNOWN_MAX or len(self._unknown) + len(self._known) >= CONNECTIONS_MAX
        replaced = own if len(own) >= UNKNOWN_OF_SENDER_MAX else list(self._unknown) if full else None
        if replaced is not None:
            if not replaced:
                return False
            self._unknown.pop(replaced[0])()
        self._unknown[peer] = end
        return True

    def keep(self, peer: Peer) -> None:
        """The connection showed the token, or carries a stream: no other one takes its place."""
        if self._unknown.pop(peer, None) is not None:
            self._known.add(peer)

    def keeps(self, peer: Peer) -> bool:
        return peer in self._known

    def leave(self, peer: Peer) -> None:
        """The connection is closed."""
        self._unknown.pop(peer, None)
        self._known.discard(peer)
