"""The PROFINET controller of the benchmark, a process of its own: connects, exchanges data and prints its phases.

Arguments: cycle in milliseconds, seconds of exchange.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from ipaddress import IPv4Interface

from pdgw.durations import MS
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import project_of
from pdgw.peers.controller.running import RunningController
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.model import TELEGRAM_SUBSLOT
from pdgw.tools.demo.namespaces import ADDRESS_HERE, THERE
from tests.long.bench.profinet import STATION

_AXIS = (1, TELEGRAM_SUBSLOT)
_PATIENCE_S = 60
_HOLD_MS = 200
"""Shortest data hold time: this controller is not a real-time system."""
_CYCLES_HELD = 3


def main(cycle_ms: float, seconds: float) -> None:
    """Exchange data for a time and release the relationship."""
    project = project_of(STATION, [telegram(1)], round(cycle_ms * MS))
    project = replace(project, data_hold=max(_CYCLES_HELD, round(_HOLD_MS / cycle_ms)))
    runner = RunningController(THERE, project, IPv4Interface(ADDRESS_HERE))
    plc = runner.controller
    end = time.monotonic() + _PATIENCE_S
    while plc.input(_AXIS) is None and time.monotonic() < end:
        if plc.phase in {Phase.IDLE, Phase.IDENTIFY, Phase.ENDED}:
            plc.start(time.monotonic_ns())
        runner.run(0.1, lambda: plc.input(_AXIS) is not None)
    print("data", flush=True)
    runner.run(seconds)
    print("measured" if plc.phase is Phase.DATA else plc.learned.ended or plc.phase.value, flush=True)
    plc.release(time.monotonic_ns())
    runner.run(3, lambda: plc.phase is Phase.ENDED)


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
