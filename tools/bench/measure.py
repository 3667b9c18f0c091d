"""Measuring: time per call, percentiles, and the paced exchange that compares a gateway with a plain echo."""

from __future__ import annotations

import gc
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Latency:
    """Percentiles of round trips in microseconds, and how many datagrams got no answer."""

    p50: float
    p99: float
    p999: float
    samples: int
    lost: int


def percentile(ordered: Sequence[int], share: float) -> int:
    """The value below which ``share`` of the sorted samples lie."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def latency(samples_ns: Sequence[int], lost: int) -> Latency:
    """Summarise round trips; at least one sample is needed."""
    ordered = sorted(samples_ns)
    p50, p99, p999 = (percentile(ordered, share) / 1000 for share in (0.5, 0.99, 0.999))
    return Latency(p50, p99, p999, len(ordered), lost)


def nanoseconds_per_call(call: Callable[[], object], rounds: int = 5, calls: int = 5_000) -> float:
    """The best of several rounds, which is the cost without the machine's other work."""
    for _ in range(calls // 5):
        call()
    best = float("inf")
    enabled = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            start = time.perf_counter_ns()
            for _ in range(calls):
                call()
            best = min(best, (time.perf_counter_ns() - start) / calls)
    finally:
        if enabled:
            gc.enable()
    return best


class Peer:
    """One UDP peer of the paced exchange: what to send next and how long the answers took."""

    def __init__(self, port: int, next_datagram: Callable[[], bytes | bytearray]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(0.2)
        self.next_datagram = next_datagram
        self.samples: list[int] = []
        self.lost = 0

    def exchange(self) -> bytes | None:
        """Send one datagram and wait for the next answer; the time is kept."""
        datagram = self.next_datagram()
        self._drain()
        start = time.perf_counter_ns()
        try:
            self.socket.send(datagram)
            answer = self.socket.recv(2048)
        except (TimeoutError, ConnectionRefusedError):
            self.lost += 1
            return None
        self.samples.append(time.perf_counter_ns() - start)
        return answer

    def _drain(self) -> None:
        """Frames a gateway sent by itself must not count as the answer."""
        self.socket.setblocking(False)
        try:
            while True:
                self.socket.recv(2048)
        except (BlockingIOError, ConnectionRefusedError):
            pass
        finally:
            self.socket.settimeout(0.2)

    def latency(self) -> Latency:
        return latency(self.samples, self.lost)

    def close(self) -> None:
        self.socket.close()


def paced(peers: Sequence[Peer], cycles: int, period_ns: int) -> None:
    """Exchange with every peer in turn once a period, so that all see the same machine."""
    due = time.perf_counter_ns()
    for _ in range(cycles):
        due += period_ns
        for peer in peers:
            peer.exchange()
        remaining = due - time.perf_counter_ns()
        if remaining > 0:
            time.sleep(remaining / 1e9)
        else:
            due = time.perf_counter_ns()
