"""The UDP edge, and the filters in the kernel for sockets."""

from __future__ import annotations

import ctypes
import ipaddress
import socket
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Final

from pdgw.ds301.loop.arrivals import ANCILLARY, SO_TIMESTAMPNS, Arrivals
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.ports import bound

# Filters in the kernel (classic BPF, Linux), so that frames for others cost the exchange nothing.
#
# Source: linux/filter.h. A program is a sequence of instructions; a packet for which it returns 0 is dropped.


Instruction = tuple[int, int, int, int]
"""Code, jump if true, jump if false, operand."""
LOAD_HALF, LOAD_WORD, JUMP_EQUAL, JUMP_GREATER_EQUAL, JUMP_GREATER, RETURN = 0x28, 0x20, 0x15, 0x35, 0x25, 0x06
_JUMP_SET = 0x45
_SO_ATTACH_FILTER, _SO_DETACH_FILTER = 26, 27
_NETWORK_HEADER = 0xFFF0_0000
"""SKF_NET_OFF: offsets from here count from the IP header; other offsets on a UDP socket count from the UDP header."""
_SOURCE_ADDRESS = _NETWORK_HEADER + 12
_SOURCE_PORT = 0
_RANDOM = 0xFFFF_F000 + 56
"""SKF_AD_OFF + SKF_AD_RANDOM: a random number."""
_SAMPLE = 0xFF
"""Of 256 datagrams of other senders, one is received."""
_EVERYTHING = 0xFFFF


def attach(to: socket.socket, program: Sequence[Instruction]) -> None:
    """Have the kernel drop what the program returns 0 for; OSError where it cannot."""
    code = b"".join(struct.pack("HBBI", *instruction) for instruction in program)
    _attach(to, len(program), ctypes.create_string_buffer(code, len(code)))


def _attach(to: socket.socket, length: int, code: ctypes.Array[ctypes.c_char]) -> None:
    # The caller keeps the code until the kernel has it: a compiled function releases a variable after its last use.
    to.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HL", length, ctypes.addressof(code)))


def detach(of: socket.socket) -> None:
    """Let everything through again; OSError where there was no filter."""
    of.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)


def from_sender(host: str, port: int) -> list[Instruction]:
    """UDP datagrams of this sender, and so few of others that they can be named."""
    return [
        (LOAD_WORD, 0, 0, _SOURCE_ADDRESS),
        (JUMP_EQUAL, 0, 3, int(ipaddress.IPv4Address(host))),
        (LOAD_HALF, 0, 0, _SOURCE_PORT),
        (JUMP_EQUAL, 0, 1, port),
        (RETURN, 0, 0, _EVERYTHING),
        (LOAD_WORD, 0, 0, _RANDOM),
        (_JUMP_SET, 1, 0, _SAMPLE),
        (RETURN, 0, 0, _EVERYTHING),
        (RETURN, 0, 0, 0),
    ]


# The UDP edge: a bound socket on the loop, never blocking, with the kernel's receive time stamps where it has them (Linux).


Address = tuple[str, int]
_MAXIMUM_DATAGRAM: Final = 2048


class UdpSocket:
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
