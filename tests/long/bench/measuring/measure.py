"""Time per call, and percentiles."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from pdgw.durations import US
from pdgw.gateway.errors import GatewayError


@dataclass(frozen=True, slots=True)
class Latency:
    """Percentiles of latencies in microseconds, and the number of cycles without an answer within their period.

    In the percentiles a missed cycle counts with the whole period, the least it can have taken.
    """

    p50: float
    p99: float
    p999: float
    samples: int
    missed: int

    @property
    def missed_share(self) -> float:
        """Missed cycles as a share of all, 0 to 1."""
        return self.missed / (self.samples + self.missed)


def document(result: Any) -> Any:
    """A result as plain data: its fields, and what its properties make of them."""
    if isinstance(result, list | tuple):
        return [document(item) for item in result]
    if not is_dataclass(result):
        return result
    names = [field.name for field in fields(result)]
    names += [name for name, value in vars(type(result)).items() if isinstance(value, property)]
    return {name: document(getattr(result, name)) for name in names}


def percentile(ordered: Sequence[int], share: float) -> int:
    """The value that this share of the sorted samples does not exceed."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def latency(samples_ns: Sequence[int], missed: int, period_ns: int) -> Latency:
    """Compute the percentiles; GatewayError when all cycles were missed."""
    if not samples_ns:
        raise GatewayError(f"benchmark: no answer in {missed} cycles")
    ordered = sorted([*samples_ns, *[period_ns] * missed])
    p50, p99, p999 = (percentile(ordered, share) / US for share in (0.5, 0.99, 0.999))
    return Latency(p50, p99, p999, len(samples_ns), missed)


_FINE_S = 1e-6
_CLOCK = time.thread_time_ns if time.get_clock_info("thread_time").resolution <= _FINE_S else time.perf_counter_ns
"""CPU time of this thread if the system's clock is fine enough, so that other processes do not count."""


def nanoseconds_per_call(call: Callable[[], object], rounds: int = 40, calls: int = 1_000) -> float:
    """The best of many short rounds, which excludes the other work of the machine."""
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
