"""The controller of ``bench profinet``: a separate process that prints its phases, and in the last one ends without a
release.

Arguments: cycle in milliseconds; data hold times of the measured relationship and of the one that is not released; seconds
of exchange; a real-time priority or nothing.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from dataclasses import replace
from ipaddress import IPv4Interface

from pdgw.durations import MS
from pdgw.peers.controller.controller import Phase
from pdgw.peers.controller.plc import project_of
from pdgw.peers.controller.running import RunningController
from pdgw.profidrive.telegrams import telegram
from pdgw.profinet.model import DAP_SUBSLOT, TELEGRAM_SUBSLOT
from pdgw.profinet.rpc.client import RecordResult
from pdgw.profinet.rpc.identification import INDEX
from pdgw.tools.demo.namespaces import ADDRESS_HERE, THERE
from tests.long.bench.measuring.build import use_real_time_priority
from tests.long.bench.profinet.profinet import ECHO_BYTES, ECHO_PORT, STATION

_AXIS = (1, TELEGRAM_SUBSLOT)
_ASK_S = 0.02
"""Interval of the requests while the station starts, in seconds."""
_PATIENCE_S = 60
_READS = 20
_ECHO_S = 0.01
_SHORT_S = 0.2
_TRIES = 5


def _print_phase(phase: str) -> None:
    print(json.dumps({"phase": phase}), flush=True)


def main(cycle_ms: float, hold_ms: float, killed_hold_ms: float, seconds: float) -> None:
    made = project_of(STATION, [telegram(1)], round(cycle_ms * MS))
    project = replace(made, data_hold=round(hold_ms / cycle_ms))
    echo = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    device = str(IPv4Interface(ADDRESS_HERE).ip)
    runner = RunningController(THERE, project, IPv4Interface(ADDRESS_HERE))
    plc = runner.controller
    found = False
    _print_phase("ready")

    def connect() -> None:
        """Connect and wait for valid data of the drive. Connect again if a busy machine ends the relationship."""
        nonlocal found
        end = time.monotonic() + _PATIENCE_S
        while plc.input(_AXIS) is None and time.monotonic() < end:
            if plc.phase in {Phase.IDLE, Phase.IDENTIFY, Phase.ENDED}:
                plc.start(time.monotonic_ns())
            runner.run(_ASK_S, lambda: plc.input(_AXIS) is not None)
            if not found and plc.learned.mac:
                found = True
                _print_phase("found")

    def release() -> None:
        plc.release(time.monotonic_ns())
        runner.run(3, lambda: plc.phase is Phase.ENDED)

    connect()
    runner.run(0.5)
    release()
    connect()
    _print_phase("data")
    runner.run(seconds)
    results: list[RecordResult] = []
    for number in range(_READS):
        before = len(results)
        plc.read((0, 0, DAP_SUBSLOT), INDEX, results.append)
        runner.run(2, lambda before=before: len(results) > before)  # type: ignore[misc]
        echo.sendto(number.to_bytes(2, "big") * (ECHO_BYTES // 2), (device, ECHO_PORT))
        runner.run(_ECHO_S)
    _print_phase("measured" if plc.phase is Phase.DATA else plc.learned.ended or plc.phase.value)
    release()
    plc.project = replace(made, data_hold=round(killed_hold_ms / cycle_ms))
    for _ in range(_TRIES):  # on a busy machine the short hold time can expire before the intended end
        connect()
        runner.run(_SHORT_S)
        if plc.phase is Phase.DATA:
            break
    _print_phase("done" if plc.phase is Phase.DATA else plc.learned.ended or plc.phase.value)
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    if len(sys.argv) > 5:
        use_real_time_priority()
    main(*map(float, sys.argv[1:5]))
