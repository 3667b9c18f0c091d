"""The UDP edge: a bound socket on the loop, never blocking, with the kernel's receive time stamps where it has them (Linux)."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from typing import Final, Protocol

from pdgw.ds301.loop.arrivals import ANCILLARY, SO_TIMESTAMPNS, Arrivals
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.packet_filter import attach, detach, from_sender
from pdgw.gateway.base.ports import bound

Address = tuple[str, int]
_MAXIMUM_DATAGRAM: Final = 2048


class DatagramPort(Protocol):
    """A bound UDP port."""

    errors: int
    """Datagrams that could not be sent or received."""

    received_at: int | None
    """Arrival time of the last datagram of ``receive``, by the loop's clock; None if unknown."""

    @property
    def address(self) -> Address:
        """The address that it listens on."""

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        """Call ``action`` in the loop whenever datagrams wait."""

    def pause(self) -> None:
        """Do not call it until the next ``start``; data waits in the buffer until then."""

    def only_from(self, sender: Address | None) -> None:
        """Drop nearly all datagrams of other senders if possible; None: accept all again."""

    def receive(self) -> tuple[bytes, Address] | None:
        """The next datagram that waits, or None."""

    def send(self, data: bytes | bytearray, address: Address) -> None:
        """Send without waiting; data that is not accepted is counted and lost."""

    def close(self) -> None:
        """Release the port."""


class UdpSocket(DatagramPort):
    """A bound UDP socket; GatewayError names address and port if it cannot be opened."""

    def __init__(self, loop: Loop, listen: str, port: int, purpose: str) -> None:
        self._loop = loop
        self._socket = bound(purpose, listen, port, "choose another --listen address or port")
        self._socket.setblocking(False)
        self._closed = False
        self._only: Address | None = None
        self._arrivals = Arrivals(loop)
        self._stamped = False
        if sys.platform == "linux":
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                self._stamped = True
            except OSError:
                pass  # the kernel does not support it
        self.received_at: int | None = None
        self.errors = 0
        """ICMP and send errors: the peer is not there just now."""

    @property
    def address(self) -> Address:
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        """Call ``action`` whenever datagrams wait."""
        self._loop.add_reader(self._socket.fileno(), action, urgent=urgent)

    def pause(self) -> None:
        """Receive nothing until ``start``; the kernel drops what exceeds its buffer."""
        self._loop.remove_reader(self._socket.fileno())

    def only_from(self, sender: Address | None) -> None:
        """Let the kernel drop nearly all datagrams of other senders; None: accept all. Linux only. The caller still checks."""
        if sys.platform != "linux" or sender == self._only:
            return
        try:
            if sender is not None:
                attach(self._socket, from_sender(*sender))
            else:
                detach(self._socket)
        except OSError:
            return  # the kernel has no filters: the caller checks the sender of each datagram
        self._only = sender

    def receive(self) -> tuple[bytes, Address] | None:
        """The next waiting datagram, or None."""
        try:
            if not self._stamped:
                return self._socket.recvfrom(_MAXIMUM_DATAGRAM)
            data, ancillary, _, source = self._socket.recvmsg(_MAXIMUM_DATAGRAM, ANCILLARY)
            self.received_at = self._arrivals.time(ancillary, self._loop.now())
            return data, source
        except BlockingIOError:
            self._arrivals.end(self._loop.now())
            return None
        except OSError:
            self.errors += 1
            return None

    def send(self, data: bytes | bytearray, address: Address) -> None:
        """Send without waiting; a failure is counted, and the next cycle sends again."""
        try:
            self._socket.sendto(data, address)
        except OSError:
            self.errors += 1

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._socket.fileno())
            self._socket.close()
