"""Phases of one exchange in turn, quiet and disturbed: what is measured in each, gathered by name."""

from __future__ import annotations

from collections import Counter, defaultdict

from pdgw.workshop.bench.measuring.dialogues import PlcDialogue
from pdgw.workshop.bench.measuring.measure import Latency, latency
from pdgw.workshop.bench.measuring.schedule import Peer, run


class Phases:
    """Of ``cycles`` cycles each."""

    def __init__(self, plc: PlcDialogue, peer: Peer, period_ns: int, cycles: int) -> None:
        self._plc = plc
        self._peer = peer
        self._period_ns = period_ns
        self._cycles = cycles
        self._samples: defaultdict[str, list[int]] = defaultdict(list)
        self._missed: Counter[str] = Counter()

    def play(self, name: str) -> None:
        """One phase. The axes are enabled first: starting what disturbs took longer than the watchdog waits."""
        self._plc.enable(self._peer, self._period_ns)
        self._peer.begin()
        run([self._peer], self._cycles, self._period_ns)
        self._samples[name] += self._peer.samples
        self._missed[name] += self._peer.missed

    def latency(self, name: str) -> Latency:
        """All phases of that name together."""
        return latency(self._samples[name], self._missed[name], self._period_ns)
