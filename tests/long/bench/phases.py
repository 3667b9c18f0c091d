"""Quiet and disturbed phases of one exchange in turn, with the latencies of each kind."""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass

from pdgw.durations import SECOND
from tests.long.bench.measuring.dialogues import PlcDialogue
from tests.long.bench.measuring.measure import Latency, latency
from tests.long.bench.measuring.schedule import Peer, run
from tests.long.bench.processes.processes import Background, Gateway, running

QUIET = "quiet"
Disturb = Callable[[Gateway], AbstractContextManager[Background]]
"""Starts the process that disturbs a gateway. The process prints a count when it ends."""


@dataclass(frozen=True, slots=True)
class Phase:
    """All phases of one name together."""

    latency: Latency
    slept: int
    """Cycles that the client itself missed."""
    per_s: float
    """Rate of the disturbance by its own count; 0 for quiet phases."""


def in_turn(
    axes: int, period_ns: int, seconds: float, phases: int, disturbed: Mapping[str, Disturb]
) -> dict[str, Phase]:
    """Run this number of phases of each kind, quiet and disturbed in turn. ``seconds``: total of each kind."""
    cycles = max(1, int(seconds * SECOND) // period_ns // phases)
    plc = PlcDialogue(axes, period_ns)
    samples: defaultdict[str, list[int]] = defaultdict(list)
    missed, slept, counted = Counter[str](), Counter[str](), Counter[str]()
    elapsed = dict.fromkeys(disturbed, 0.0)
    with running(axes, period_ns) as (_, gateway):
        gateway.wait_online(axes)
        with closing(Peer(gateway.cyclic_port, plc)) as peer:

            def play(name: str) -> None:
                # Starting the disturbance takes longer than the watchdog time.
                plc.enable(peer, period_ns)
                peer.begin()
                run([peer], cycles, period_ns)
                samples[name] += peer.samples
                missed[name] += peer.missed
                slept[name] += peer.slept

            for _ in range(phases):
                play(QUIET)
                for name, disturb in disturbed.items():
                    with disturb(gateway) as others:
                        start = time.monotonic()
                        try:
                            play(name)
                        finally:
                            elapsed[name] += time.monotonic() - start
                            counted[name] += int(others.end())
    return {
        name: Phase(
            latency(samples[name], missed[name], period_ns),
            slept[name],
            counted[name] / elapsed[name] if name in elapsed else 0.0,
        )
        for name in (QUIET, *disturbed)
    }


def lower_priority() -> None:
    """Give this process the lowest priority: in the field it is another machine."""
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(19)
