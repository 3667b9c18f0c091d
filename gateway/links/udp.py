"""The UDP edge: a bound socket on the loop, never blocking, with the kernel's receive time stamps where it has them (Linux)."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Final

from pdgw.ds301.loop.loop import Loop
from pdgw.durations import SECOND
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links import packet_filter

Address = tuple[str, int]
_MAXIMUM_DATAGRAM: Final = 2048
SO_TIMESTAMPNS: Final = 35
"""Option of Linux; Python has no name for it before 3.14."""
_TIMESPEC: Final = struct.Struct("@ll")
_ANCILLARY: Final = socket.CMSG_SPACE(_TIMESPEC.size) if hasattr(socket, "CMSG_SPACE") else 0


def arrival(stamp: int, wall: int, now: int, earliest: int) -> int:
    """Monotonic arrival time of a datagram that the kernel stamped with the wall clock; all in nanoseconds.

    ``wall`` and ``now`` were read together. A change of the wall clock cannot move a datagram after ``now``, or before
    ``earliest``, when nothing waited or when the datagram before it arrived.
    """
    return max(earliest, min(now, now - (wall - stamp)))


class UdpSocket:
    """A bound UDP socket; GatewayError names address and port if it cannot be opened."""

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
        self._only: Address | None = None
        self._earliest = loop.now()
        """No datagram that waits has arrived before."""
        self._stamped = False
        if sys.platform == "linux":
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                self._stamped = True
            except OSError:
                pass  # the kernel does not support it
        self.received_at: int | None = None
        """Monotonic time of the datagram received last, None without time stamps."""
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
                packet_filter.attach(self._socket, packet_filter.from_sender(*sender))
            else:
                packet_filter.detach(self._socket)
        except OSError:
            return  # the kernel has no filters: the caller checks the sender of each datagram
        self._only = sender

    def receive(self) -> tuple[bytes, Address] | None:
        """The next waiting datagram, or None."""
        try:
            if not self._stamped:
                return self._socket.recvfrom(_MAXIMUM_DATAGRAM)
            data, ancillary, _, source = self._socket.recvmsg(_MAXIMUM_DATAGRAM, _ANCILLARY)
            self.received_at = self._arrival(*ancillary[0]) if ancillary else None
            return data, source
        except BlockingIOError:
            self._earliest = self._loop.now()
            return None
        except OSError:
            self.errors += 1
            return None

    def _arrival(self, _level: int, kind: int, data: bytes) -> int | None:
        """The time in the first ancillary message; no other one is requested."""
        if kind != SO_TIMESTAMPNS or len(data) != _TIMESPEC.size:
            return None
        seconds, nanoseconds = _TIMESPEC.unpack(data)
        stamp = seconds * SECOND + nanoseconds
        self._earliest = arrival(stamp, time.time_ns(), self._loop.now(), self._earliest)
        return self._earliest

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
