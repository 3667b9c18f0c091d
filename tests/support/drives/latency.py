"""Latencies of simulated drives, drawn at random."""

from __future__ import annotations

from random import Random

from pdgw.peers.drive import Latency
from pdgw.peers.drive.model.latency import LATENCY_MAX_MS


def draw_latency(chance: Random) -> Latency:
    """Draw both directions at random: no latency in one of four, else log-uniform up to 100 ms."""

    def direction() -> int:
        return 0 if chance.random() < 0.25 else round(LATENCY_MAX_MS ** chance.random())

    return Latency(direction(), direction())
