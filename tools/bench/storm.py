"""The cyclic exchange under a storm of parameter requests: p99 with and without it, in turn in the same run.

``python -m tools.bench.storm PORT AXES`` is the storm: one client for each axis, asking as fast as answers come; it prints the
number of requests it got answered when its standard input ends.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from dataclasses import dataclass

from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.parameters.codec import Address
from pdgw.tools.bench.measure import Latency, Peer, latency, paced
from pdgw.tools.bench.roundtrip import PERIOD_NS, Plc, background, process
from pdgw.tools.parameters.client import ParameterClient

GOAL_RATIO = 1.5
AXES = 4
_PHASES = 4
_MIX = [Address(0x6041), Address(0x606C), Address(965), Address(947, 0, 8), Address(0x1018, 1, 4)]
"""Statusword, velocity, profile, faults, identity: some answered by the gateway, most by the drive."""


@dataclass(frozen=True, slots=True)
class Storm:
    """One comparison."""

    quiet: Latency
    storm: Latency
    requests_per_s: float

    @property
    def ratio(self) -> float:
        """p99 with the storm over p99 without."""
        return self.storm.p99 / self.quiet.p99


def run(cycles: int) -> Storm:
    """Quiet and stormy phases in turn, at 1 kHz with four axes."""
    quiet: list[int] = []
    stormy: list[int] = []
    requests = 0
    elapsed = 0.0
    lost = [0, 0]
    with process("pdgw.tools.bench.instant", str(AXES)) as ports:
        plc = Plc(AXES)
        gateway = Peer(ports[0], plc.frame)
        try:
            plc.enable(gateway)
            for _ in range(_PHASES):
                lost[0] += _phase(gateway, cycles // _PHASES, quiet)
                with background("pdgw.tools.bench.storm", str(ports[2]), str(AXES)) as (child, _):
                    start = time.perf_counter()
                    lost[1] += _phase(gateway, cycles // _PHASES, stormy)
                    elapsed += time.perf_counter() - start
                    if child.stdin is None or child.stdout is None:
                        raise GatewayError("benchmark: the storm has no pipes")
                    child.stdin.close()
                    requests += int(child.stdout.read() or 0)
        finally:
            gateway.close()
    return Storm(latency(quiet, lost[0]), latency(stormy, lost[1]), requests / elapsed)


def _phase(gateway: Peer, cycles: int, samples: list[int]) -> int:
    gateway.samples.clear()
    before = gateway.lost
    paced([gateway], max(1, cycles), PERIOD_NS)
    samples += gateway.samples
    return gateway.lost - before


def _ask(port: int, do_id: int, stopping: threading.Event, counts: list[int]) -> None:
    with ParameterClient(("127.0.0.1", port), do_id, slot=do_id) as client:
        while not stopping.is_set():
            client.request(_MIX)
            counts.append(1)


def main() -> None:
    """The storm."""
    os.nice(19)  # in the field the storm comes from another machine
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
