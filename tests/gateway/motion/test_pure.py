"""The rules of motion are pure."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys
before = set(sys.modules)
import pdgw.gateway.motion.positioner, pdgw.gateway.motion.dsc, pdgw.gateway.motion.messages
bad = {"can", "canopen", "socket", "threading", "logging", "scapy"} & (set(sys.modules) - before)
sys.exit(", ".join(sorted(bad)) or 0)
"""


@pytest.mark.e2e
def test_nothing_of_motion_brings_a_bus_a_socket_a_thread_or_a_log_along() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
