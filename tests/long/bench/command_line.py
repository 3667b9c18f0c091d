"""CPU time of the short commands, from process start to end. The best of a few runs counts."""

from __future__ import annotations

import os
import subprocess
import sys

from pdgw.durations import MS
from tests.long.bench.processes.processes import environment, running

_TRIES = 3
_AXES, _PERIOD_NS = 4, 4 * MS


def measure() -> dict[str, float]:
    """CPU seconds of ``pdgw --help``, and of ``pdgw status`` for a gateway with four axes."""
    with running(_AXES, _PERIOD_NS) as (_, daemon):
        daemon.wait_online(_AXES)
        return {
            "--help": min(cpu_s("--help") for _ in range(_TRIES)),
            "status": min(cpu_s("status", "--port", str(daemon.status_port)) for _ in range(_TRIES)),
        }


def cpu_s(*arguments: str) -> float:
    """CPU seconds of one call of ``pdgw``, user and system. CalledProcessError when it fails."""
    before = os.times()
    command = [sys.executable, "-m", "pdgw", *arguments]
    subprocess.run(command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system
