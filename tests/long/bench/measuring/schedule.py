"""A client with a fixed schedule: it sends each cycle's datagram when it is due, whatever the result of the last one.

An answer counts if it arrives before the next datagram is sent; later the cycle is missed. So a slow gateway cannot hide its
delay by slowing the client (coordinated omission). Cycles that the client itself missed are counted separately.

An answer has two latencies: until the kernel time stamps it at the client's socket, and until the client reads it. The
second includes the time until the client runs again.
"""

from __future__ import annotations

import gc
import select
import socket
import struct
import time
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from pdgw.durations import SECOND
from tests.long.bench.measuring.measure import Latency, latency

_STAMPS = 35
"""SO_TIMESTAMPNS and SCM_TIMESTAMPNS of Linux, for which Python has no names."""
_TIMESPEC = struct.Struct("@ll")


class Arrival(NamedTuple):
    """A datagram, and when it reached the kernel and the client: monotonic nanoseconds."""

    at_socket: int
    at_client: int
    data: bytes


def _real_time_offset() -> int:
    """Difference of the kernel's time stamps to the monotonic clock. The fastest of several readings counts."""
    looks = []
    for _ in range(8):
        before, real, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        looks.append((after - before, real - (before + after) // 2))
    return min(looks)[1]


class Dialogue(Protocol):
    """The datagrams to one peer, and the meaning of its answers."""

    def datagram(self, cycle: int, newest: bytes = b"") -> bytes | bytearray:
        """``newest``: the last datagram of the peer."""

    def answers(self, data: bytes, cycle: int) -> bool:
        """Whether ``data`` can only be an answer to this cycle or a later one."""


class Peer:
    """A peer on loopback: its dialogue, and the latencies of its answers."""

    def __init__(self, port: int, dialogue: Dialogue) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
        self.dialogue = dialogue
        self._next = 0
        self.newest = b""
        """The newest datagram."""
        self.sent: dict[int, int] = {}
        """Send time of each cycle's datagram, monotonic nanoseconds."""
        self.begin()

    def begin(self) -> None:
        """Start a new measurement; the cycle numbers continue."""
        self.samples: list[int] = []
        """Latencies at the client."""
        self.socket_samples: list[int] = []
        """Latencies at the client's socket."""
        self._offset = _real_time_offset()
        self.missed = 0
        self.slept = 0
        """Cycles without a datagram, because the client was not running."""
        self.sent.clear()
        self._arrived: list[Arrival] = []
        self._cycle: int | None = None
        self._owed = False

    def send(self) -> None:
        """Send the datagram of the next cycle. An answer received before this counts for the previous cycle."""
        datagram = self.dialogue.datagram(self._next, self.newest)
        self.settle()
        self._cycle = self._next
        self._next += 1
        self.sent[self._cycle] = time.monotonic_ns()
        try:
            self.socket.send(datagram)
        except ConnectionRefusedError:
            return  # ICMP error of an earlier datagram: the peer has no socket at the moment

    def take(self) -> None:
        """Read the received datagrams."""
        try:
            while True:
                data, stamps, _, _ = self.socket.recvmsg(2048, 64)
                seconds, nanoseconds = _TIMESPEC.unpack(stamps[0][2])
                stamp = seconds * SECOND + nanoseconds - self._offset
                self._arrived.append(Arrival(stamp, time.monotonic_ns(), data))
                self.newest = data
        except (BlockingIOError, ConnectionRefusedError):
            return

    def sleep_through(self) -> None:
        """Count the next cycle as passed without its datagram."""
        self.settle()
        self.slept += 1
        self._next += 1

    def settle(self) -> None:
        """End the period of the last datagram: store its latency, or count it as missed."""
        self.take()
        if self._cycle is not None:
            answer = self._answer(self._cycle)
            if answer is None:
                self.missed += 1
            else:
                self.samples.append(answer.at_client - self.sent[self._cycle])
                self.socket_samples.append(answer.at_socket - self.sent[self._cycle])
            self._owed = answer is None
        self._cycle = None
        self._arrived.clear()

    def _answer(self, cycle: int) -> Arrival | None:
        """The answer to this cycle, if it arrived."""
        if not self._arrived:
            return None
        if not self._owed:
            return self._arrived[0]
        # A late answer to an earlier cycle may arrive first. Only an answer that is certainly newer counts, or one after it.
        newer = [item for item in self._arrived if self.dialogue.answers(item.data, cycle)]
        if newer:
            return newer[0]
        return self._arrived[-1] if len(self._arrived) > 1 else None

    def latency(self, period_ns: int) -> Latency:
        """Latencies at the client in this measurement."""
        return latency(self.samples, self.missed, period_ns)

    def socket_latency(self, period_ns: int) -> Latency:
        """Latencies at the client's socket in this measurement."""
        return latency(self.socket_samples, self.missed, period_ns)

    def close(self) -> None:
        self.socket.close()


def run(peers: Sequence[Peer], cycles: int, period_ns: int) -> None:
    """Run this number of cycles with each peer, spread over the period so that they do not disturb each other."""
    step = period_ns // len(peers)
    sockets = [peer.socket for peer in peers]
    by_socket = {peer.socket: peer for peer in peers}

    def wait_until(due: int) -> None:
        while (remaining := due - time.monotonic_ns()) > 0:
            for ready in select.select(sockets, [], [], remaining / SECOND)[0]:
                by_socket[ready].take()

    enabled = gc.isenabled()
    gc.disable()
    try:
        start = time.monotonic_ns() + period_ns
        for number in range(cycles):
            for index, peer in enumerate(peers):
                due = start + number * period_ns + index * step
                wait_until(due)
                if time.monotonic_ns() - due >= period_ns:  # the client's own delay, not the peer's
                    peer.sleep_through()
                else:
                    peer.send()
        wait_until(start + cycles * period_ns + step)
        for peer in peers:
            peer.settle()
    finally:
        if enabled:
            gc.enable()


class FlatOut(NamedTuple):
    """The answers of a peer when each datagram waits for the previous answer."""

    cycles: int
    per_s: float


def flat_out(peer: Peer, seconds: float) -> FlatOut:
    """Run cycles for about ``seconds``, each after the answer to the one before. A missing answer costs 0.2 s."""
    count = 0
    start = time.monotonic_ns()
    end = start + int(seconds * SECOND)
    while time.monotonic_ns() < end:
        peer.send()
        if select.select([peer.socket], [], [], 0.2)[0]:
            peer.take()
        count += 1
    peer.settle()
    return FlatOut(count, count * SECOND / (time.monotonic_ns() - start))
