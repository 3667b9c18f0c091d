"""A client that keeps its schedule: each cycle's datagram leaves when it is due, whatever became of the one before.

An answer counts when it came before the next datagram left; later it is missed, so that a gateway that falls behind cannot hide
it by slowing its client down (coordinated omission). Cycles that the client itself slept through are counted apart.

An answer has two latencies: until the kernel has it for the client's socket, which stamps it, and until the client has it. The
second one contains the client's own way back into the processor.
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
from pdgw.workshop.bench.measuring.measure import Latency, latency

_STAMPS = 35
"""SO_TIMESTAMPNS and SCM_TIMESTAMPNS of Linux, which Python does not name."""
_TIMESPEC = struct.Struct("@ll")


class Arrival(NamedTuple):
    """A datagram, when the kernel had it and when the client had it: monotonic nanoseconds."""

    at_socket: int
    at_client: int
    data: bytes


def _real_time_offset() -> int:
    """What the clock of the kernel's stamps is ahead of the monotonic one: of several looks, the one that took least."""
    looks = []
    for _ in range(8):
        before, real, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        looks.append((after - before, real - (before + after) // 2))
    return min(looks)[1]


class Dialogue(Protocol):
    """What is sent to one peer, and what its answers tell."""

    def datagram(self, cycle: int) -> bytes | bytearray: ...

    def answers(self, data: bytes, cycle: int) -> bool:
        """Whether ``data`` is certainly no answer to an earlier cycle than this one."""


class Peer:
    """One peer on loopback: its dialogue, and the latencies of its answers."""

    def __init__(self, port: int, dialogue: Dialogue) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
        self.dialogue = dialogue
        self._next = 0
        self.newest = b""
        """The last datagram that came."""
        self.sent: dict[int, int] = {}
        """When the datagram of each cycle left, monotonic nanoseconds."""
        self.begin()

    def begin(self) -> None:
        """A new measurement; cycles are numbered on."""
        self.samples: list[int] = []
        """Latencies at the client."""
        self.socket_samples: list[int] = []
        """Latencies at its socket."""
        self._offset = _real_time_offset()
        self.missed = 0
        self.slept = 0
        """Cycles without a datagram, because the client was not awake."""
        self.sent.clear()
        self._arrived: list[Arrival] = []
        self._cycle: int | None = None
        self._owed = False

    def send(self) -> None:
        """The datagram of the next cycle; what the one before got by now is its answer."""
        datagram = self.dialogue.datagram(self._next)
        self.settle()
        self._cycle = self._next
        self._next += 1
        self.sent[self._cycle] = time.monotonic_ns()
        try:
            self.socket.send(datagram)
        except ConnectionRefusedError:
            return  # tells of an earlier datagram: nobody listens yet or any more

    def take(self) -> None:
        """Read what is there."""
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
        """The next cycle passed without its datagram."""
        self.settle()
        self.slept += 1
        self._next += 1

    def settle(self) -> None:
        """The period of the last datagram is over: its latency, or missed."""
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
        """The answer to this cycle, if it came."""
        if not self._arrived:
            return None
        if not self._owed:
            return self._arrived[0]
        # The answer to an earlier cycle may still come: only what is newer for certain counts, or what comes behind it.
        newer = [item for item in self._arrived if self.dialogue.answers(item.data, cycle)]
        if newer:
            return newer[0]
        return self._arrived[-1] if len(self._arrived) > 1 else None

    def latency(self, period_ns: int) -> Latency:
        """Of the measurement so far, at the client."""
        return latency(self.samples, self.missed, period_ns)

    def socket_latency(self, period_ns: int) -> Latency:
        """Of the measurement so far, at its socket."""
        return latency(self.socket_samples, self.missed, period_ns)

    def close(self) -> None:
        self.socket.close()


def run(peers: Sequence[Peer], cycles: int, period_ns: int) -> None:
    """So many cycles with each peer, spread over the period so that each has the machine for itself."""
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
                if time.monotonic_ns() - due >= period_ns:  # its own fault, not the peer's
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
    """What a peer answers when each datagram waits for the answer to the one before."""

    cycles: int
    per_s: float


def flat_out(peer: Peer, seconds: float) -> FlatOut:
    """Cycles with an answer awaited each time, for about so long; an answer that does not come costs 0.2 s."""
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
