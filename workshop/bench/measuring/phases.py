"""Quiet and disturbed phases of one exchange in turn, with the latencies of each kind."""

from __future__ import annotations

from collections import Counter, defaultdict

from pdgw.workshop.bench.measuring.dialogues import PlcDialogue
from pdgw.workshop.bench.measuring.measure import Latency, latency
from pdgw.workshop.bench.measuring.schedule import Peer, run


class Phases:
    """Phases of ``cycles`` cycles each."""

    def __init__(self, plc: PlcDialogue, peer: Peer, period_ns: int, cycles: int) -> None:
        self._plc = plc
        self._peer = peer
        self._period_ns = period_ns
        self._cycles = cycles
        self._samples: defaultdict[str, list[int]] = defaultdict(list)
        self._missed: Counter[str] = Counter()

    def play(self, name: str) -> None:
        """Run one phase. The axes are enabled first, because starting the disturbance takes longer than the watchdog time."""
        self._plc.enable(self._peer, self._period_ns)
        self._peer.begin()
        run([self._peer], self._cycles, self._period_ns)
        self._samples[name] += self._peer.samples
        self._missed[name] += self._peer.missed

    def latency(self, name: str) -> Latency:
        """Latencies of all phases with this name."""
        return latency(self._samples[name], self._missed[name], self._period_ns)
