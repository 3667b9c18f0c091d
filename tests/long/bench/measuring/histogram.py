"""Latencies of hours: counts of microseconds instead of samples."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

from pdgw.durations import US

SHARES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "p99.99": 0.9999, "max": 1.0}
"""Percentiles of a histogram, with the share of the cycles that each contains."""
_BITS = 9


@dataclass(slots=True)
class Histogram:
    """Cycles by latency. A missed cycle counts with the whole period, the least it can have taken."""

    counts: Counter[int] = field(default_factory=Counter)
    """Cycles by microseconds, from 512 us on rounded down by less than 0.4 %."""
    missed: int = 0

    @property
    def cycles(self) -> int:
        """All cycles."""
        return self.counts.total()

    def add(self, samples_ns: Iterable[int], missed: int, period_ns: int) -> None:
        """Add the cycles of a measurement."""
        self.counts.update(_rounded(sample // US) for sample in samples_ns)
        self.missed += missed
        if missed:
            self.counts[_rounded(period_ns // US)] += missed

    def percentiles(self) -> list[int]:
        """The latency in microseconds for each of ``SHARES``."""
        return [self._percentile(share) for share in SHARES.values()]

    def _percentile(self, share: float) -> int:
        ordered = sorted(self.counts)
        upto = list(accumulate(self.counts[value] for value in ordered))
        return ordered[bisect_right(upto, min(self.cycles - 1, int(share * self.cycles)))]


def _rounded(value: int) -> int:
    dropped = max(0, value.bit_length() - _BITS)
    return value >> dropped << dropped


def octaves(histograms: Sequence[Histogram]) -> Iterator[tuple[int, list[int]]]:
    """Lower end of each doubling of the latency in microseconds, with the cycles of each histogram in it."""
    logarithms = [_by_logarithm(histogram) for histogram in histograms]
    used = set().union(*logarithms)
    for bits in range(min(used), max(used) + 1):
        yield 1 << bits >> 1, [counts[bits] for counts in logarithms]


def _by_logarithm(histogram: Histogram) -> Counter[int]:
    counts: Counter[int] = Counter()
    for value, count in histogram.counts.items():
        counts[value.bit_length()] += count
    return counts
