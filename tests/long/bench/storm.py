"""The cyclic exchange during a storm of parameter requests, alternating with quiet phases of the same run.

``python -m tests.long.bench.storm PORT AXES`` is the storm: a client for each axis sends a request after each answer. It
prints the number of answered requests when its standard input ends.
"""

from __future__ import annotations

import sys
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass

from pdgw.client.udp import ParameterClient
from pdgw.durations import MS
from pdgw.profidrive.parameters.codec import ParameterAddress
from tests.long.bench.measuring.measure import Latency
from tests.long.bench.phases import QUIET, in_turn, lower_priority
from tests.long.bench.processes.processes import module

AXES = 4
PERIOD_NS = MS
_STORM = "tests.long.bench.storm"
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
    found = in_turn(
        AXES,
        PERIOD_NS,
        seconds,
        phases,
        {"storm": lambda gateway: nullcontext(module(_STORM, str(gateway.acyclic_port), str(AXES)))},
    )
    return Storm(found[QUIET].latency, found["storm"].latency, found["storm"].per_s)


def _ask(port: int, do_id: int, stopping: threading.Event, counts: list[int]) -> None:
    with ParameterClient(("127.0.0.1", port), do_id, slot=do_id) as client:
        while not stopping.is_set():
            client.request(_MIX)
            counts.append(1)


def main() -> None:
    """The storm."""
    lower_priority()
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
