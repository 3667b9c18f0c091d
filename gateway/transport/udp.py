"""The UDP edge of the cyclic exchange: one socket, never blocking but in ``wait``."""

from __future__ import annotations

import select
import socket

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.transport.cyclic import Address

_MAXIMUM_DATAGRAM = 2048


class UdpSocket:
    """A bound UDP socket; GatewayError names address and port when it cannot be had."""

    def __init__(self, listen: str, port: int, purpose: str) -> None:
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
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self.errors = 0
        """ICMP and send errors: the peer is not there just now."""

    @property
    def address(self) -> Address:
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def wait(self, timeout_ns: int) -> bool:
        """Until a datagram is there (True) or the time is over; 0 only looks."""
        return bool(self._poll.poll(timeout_ns / 1_000_000 if timeout_ns > 0 else 0))

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
        self._socket.close()
