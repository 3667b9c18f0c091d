"""The UDP edge: a bound socket on the loop, never blocking."""

from __future__ import annotations

import socket
from collections.abc import Callable

from pdgw.ds301.loop import Loop
from pdgw.gateway.errors import GatewayError

Address = tuple[str, int]
_MAXIMUM_DATAGRAM = 2048


class UdpSocket:
    """A bound UDP socket; GatewayError names address and port when it cannot be had."""

    def __init__(self, loop: Loop, listen: str, port: int, purpose: str) -> None:
        self._loop = loop
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((listen, port))
        except OSError as error:
            self._socket.close()
            raise GatewayError(
                f"{purpose}: {listen} port {port} cannot be used ({error.strerror or error}); "
                "choose another --listen address or port"
            ) from error
        self._socket.setblocking(False)
        self._closed = False
        self.errors = 0
        """ICMP and send errors: the peer is not there just now."""

    @property
    def address(self) -> Address:
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        """Call ``action`` whenever datagrams wait."""
        self._loop.add_reader(self._socket.fileno(), action, urgent=urgent)

    def receive(self) -> tuple[bytes, Address] | None:
        """The next waiting datagram, or None."""
        try:
            return self._socket.recvfrom(_MAXIMUM_DATAGRAM)
        except BlockingIOError:
            return None
        except OSError:
            self.errors += 1
            return None

    def send(self, data: bytes | bytearray, address: Address) -> None:
        """Send without waiting; a failure is counted, the next cycle sends anew."""
        try:
            self._socket.sendto(data, address)
        except OSError:
            self.errors += 1

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()
