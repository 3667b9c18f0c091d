"""The controller of ``pdgw bench profinet``: a process of its own that tells its phases and ends without a word.

Arguments: cycle and data hold time in milliseconds, seconds of exchange, ``realtime`` or nothing.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import replace
from ipaddress import IPv4Interface

from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import project_of
from pdgw.peers.controller.running import RunningController
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.model import DAP_SUBSLOT, TELEGRAM_SUBSLOT
from pdgw.profinet.rpc.client import RecordResult
from pdgw.profinet.rpc.identification import INDEX
from pdgw.tools.bench.build import use_real_time_priority
from pdgw.tools.bench.profinet import STATION
from pdgw.tools.namespaces import ADDRESS_HERE, THERE

_AXIS = (1, TELEGRAM_SUBSLOT)
_ASK_S = 0.02
"""How often it asks for the station while that starts."""
_PATIENCE_S = 60
_READS = 20


def _tell(phase: str) -> None:
    print(json.dumps({"phase": phase}), flush=True)


def main(cycle_ms: int, hold_ms: int, seconds: float) -> None:
    made = project_of(STATION, [telegram(1)], cycle_ms * 1_000_000)
    project = replace(made, data_hold=hold_ms // cycle_ms)
    runner = RunningController(THERE, project, IPv4Interface(ADDRESS_HERE))
    plc = runner.controller
    found = False
    _tell("ready")

    def connect() -> None:
        """Until the drive's data is valid; anew where a busy machine ends the relationship."""
        nonlocal found
        end = time.monotonic() + _PATIENCE_S
        while plc.input(_AXIS) is None and time.monotonic() < end:
            if plc.phase in {Phase.IDLE, Phase.IDENTIFY, Phase.ENDED}:
                plc.start(time.monotonic_ns())
            runner.run(_ASK_S, lambda: plc.input(_AXIS) is not None)
            if not found and plc.learned.mac:
                found = True
                _tell("found")

    connect()
    runner.run(0.5)
    plc.release(time.monotonic_ns())
    runner.run(3, lambda: plc.phase is Phase.ENDED)
    connect()
    _tell("data")
    runner.run(seconds)
    results: list[RecordResult] = []
    for _ in range(_READS):
        before = len(results)
        plc.read((0, 0, DAP_SUBSLOT), INDEX, results.append)
        runner.run(2, lambda before=before: len(results) > before)  # type: ignore[misc]
    _tell("done" if plc.phase is Phase.DATA else plc.learned.ended or plc.phase.value)
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    if sys.argv[4]:
        use_real_time_priority()
    main(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
