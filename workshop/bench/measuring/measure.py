"""Measuring: time per call, and percentiles."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pdgw.durations import US
from pdgw.gateway.errors import GatewayError


@dataclass(frozen=True, slots=True)
class Latency:
    """Percentiles of latencies in microseconds, and how many cycles had no answer within their period.

    A missed cycle counts in the percentiles as one that took the whole period: it took at least that long.
    """

    p50: float
    p99: float
    p999: float
    samples: int
    missed: int

    @property
    def missed_share(self) -> float:
        """Missed cycles of all, 0..1."""
        return self.missed / (self.samples + self.missed)


def percentile(ordered: Sequence[int], share: float) -> int:
    """The value below which ``share`` of the sorted samples lie."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def latency(samples_ns: Sequence[int], missed: int, period_ns: int) -> Latency:
    """Summarise latencies; GatewayError when every cycle missed."""
    if not samples_ns:
        raise GatewayError(f"benchmark: no answer in {missed} cycles")
    ordered = sorted([*samples_ns, *[period_ns] * missed])
    p50, p99, p999 = (percentile(ordered, share) / US for share in (0.5, 0.99, 0.999))
    return Latency(p50, p99, p999, len(samples_ns), missed)


_FINE_S = 1e-6
_CLOCK = time.thread_time_ns if time.get_clock_info("thread_time").resolution <= _FINE_S else time.perf_counter_ns
"""CPU of this thread where the system tells it finely: what else runs on the machine is not in it."""


def nanoseconds_per_call(call: Callable[[], object], rounds: int = 40, calls: int = 1_000) -> float:
    """The best of many short rounds, which is the cost without the machine's other work."""
    for _ in range(calls):
        call()
    best = float("inf")
    enabled = gc.isenabled()
    gc.disable()
    try:
        for _ in range(rounds):
            start = _CLOCK()
            for _ in range(calls):
                call()
            best = min(best, (_CLOCK() - start) / calls)
    finally:
        if enabled:
            gc.enable()
    return best
