"""The cyclic exchange during a storm of parameter requests, alternating with quiet phases of the same run.

``python -m pdgw.workshop.bench.storm PORT AXES`` is the storm: a client for each axis sends a request after each answer. It
prints the number of answered requests when its standard input ends.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import closing
from dataclasses import dataclass

from pdgw.client.udp import ParameterClient
from pdgw.durations import MS, SECOND
from pdgw.profidrive.parameters.codec import ParameterAddress
from pdgw.workshop.bench.measuring.dialogues import PlcDialogue
from pdgw.workshop.bench.measuring.measure import Latency
from pdgw.workshop.bench.measuring.phases import Phases
from pdgw.workshop.bench.measuring.schedule import Peer
from pdgw.workshop.bench.processes.processes import module, running

AXES = 4
PERIOD_NS = MS
_MIX = [
    ParameterAddress(0x6041),
    ParameterAddress(0x606C),
    ParameterAddress(965),
    ParameterAddress(947, 0, 8),
    ParameterAddress(0x1018, 1, 4),
]
"""Statusword, velocity, profile, faults, identity. The gateway answers some, the drive most."""


@dataclass(frozen=True, slots=True)
class Storm:
    """The figures of one comparison."""

    quiet: Latency
    storm: Latency
    requests_per_s: float

    @property
    def ratio_p99(self) -> float:
        """p99 with the storm divided by p99 without."""
        return self.storm.p99 / self.quiet.p99


def measure(seconds: float, phases: int = 4) -> Storm:
    """Run this number of quiet and stormy phases in turn. ``seconds``: total of each kind."""
    cycles = max(1, int(seconds * SECOND) // PERIOD_NS // phases)
    plc = PlcDialogue(AXES, PERIOD_NS)
    requests = 0
    elapsed = 0.0
    with running(AXES, PERIOD_NS) as (_, daemon):
        daemon.wait_online(AXES)
        with closing(Peer(daemon.cyclic_port, plc)) as peer:
            parts = Phases(plc, peer, PERIOD_NS, cycles)
            for _ in range(phases):
                parts.play("quiet")
                storm = module("pdgw.workshop.bench.storm", str(daemon.acyclic_port), str(AXES))
                start = time.monotonic()
                try:
                    parts.play("storm")
                finally:
                    elapsed += time.monotonic() - start
                    requests += int(storm.end())
    quiet, stormy = (parts.latency(name) for name in ("quiet", "storm"))
    return Storm(quiet, stormy, requests / elapsed)


def _ask(port: int, do_id: int, stopping: threading.Event, counts: list[int]) -> None:
    with ParameterClient(("127.0.0.1", port), do_id, slot=do_id) as client:
        while not stopping.is_set():
            client.request(_MIX)
            counts.append(1)


def main() -> None:
    """The storm."""
    # In the field the storm comes from another machine. Here it gets the lowest priority.
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(19)
    port, axes = int(sys.argv[1]), int(sys.argv[2])
    stopping = threading.Event()
    counts: list[int] = []
    clients = [
        threading.Thread(target=_ask, args=(port, do_id, stopping, counts), daemon=True) for do_id in range(1, axes + 1)
    ]
    for client in clients:
        client.start()
    while not counts:
        time.sleep(0.001)
    print("ready", flush=True)
    sys.stdin.read()
    print(len(counts), flush=True)


if __name__ == "__main__":
    main()
