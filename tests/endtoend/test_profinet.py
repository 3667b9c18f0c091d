"""The real gateway on Ethernet frames: a veth pair in network namespaces, found by name, connected, driven, released."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CONFIG = """\
store = "store.json"

[can]
interface = "virtual"
channel = "pdgw"

[transport]
type = "profinet"
interface = "eth1"
station_name = "press-1"
status_port = 0
watchdog_factor = 100        # a busy machine is no loss of the PLC

[[axis]]
do_id = 1
node_id = 1
telegram = 1
simulate = true
"""
TOOLS = ("unshare", "nsenter", "ip")


def namespaces_allowed() -> bool:
    """A user may make network namespaces here."""
    if any(shutil.which(tool) is None for tool in TOOLS):
        return False
    probe = ["unshare", "-Urn", "ip", "link", "add", "plc", "type", "veth", "peer", "name", "eth1"]
    return subprocess.run(probe, capture_output=True, check=False).returncode == 0


SCENARIO = """\
name: speed over PROFINET
telegrams: [1]
steps:
  - {note: "enable", enable: true, within: 20 s}
  - {read: {P965: 0x0329}}
  - {speed: 1500 rpm}
  - {expect: {NIST_A: "1500 rpm +- 10 rpm"}, note: "speed reached", within: 20 s}
  - {off1: true}
  - {expect: {ZSW1.READY_TO_OPERATE: 0, NIST_A: "0 +- 30 rpm"}, note: "standstill, power off", within: 20 s}
"""


def in_namespace(tmp_path: Path, *further: str) -> subprocess.CompletedProcess[str]:
    """The script with a gateway of its own; skips, in CI fails, where that is not possible."""
    if not namespaces_allowed():
        if os.environ.get("CI"):
            pytest.fail(f"network namespaces are not allowed, or one of {TOOLS} is missing")
        pytest.skip(f"network namespaces are not allowed here, or one of {TOOLS} is missing")
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG, encoding="utf-8")
    script = Path(__file__).with_name("profinet_controller.py")
    pdgw = Path(sys.executable).with_name("pdgw")
    command = ["unshare", "-Urn", sys.executable, str(script), str(config), str(pdgw), *further]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_a_scenario_of_the_plc_simulator_plays_over_ethernet(tmp_path: Path) -> None:
    scenario = tmp_path / "speed.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    result = in_namespace(tmp_path, str(scenario))
    assert result.returncode == 0, (result.stdout, result.stderr)
    assert "FAIL" not in result.stdout


def test_a_controller_finds_the_gateway_on_ethernet_and_moves_a_drive(tmp_path: Path) -> None:
    result = in_namespace(tmp_path)
    assert result.returncode == 0, result.stderr
    seen = json.loads(result.stdout.splitlines()[-1])
    log = result.stderr
    assert seen["connected"], (seen, log)
    assert seen["drive ready"], (seen, log)
    assert seen["drive runs"], (seen, log)
    assert seen["P965"] == "0201000106010329"
    assert seen["interface"] == 0
    assert seen["frames in 0.5 s"] > 20
    assert seen["released"] == "released"
    assert seen["exit status"] == 0
    assert "IP address set to 192.168.0.2 by DCP" in log
    assert "controller pdgw-plc 192.168.0.1 connected, cycle 4 ms" in log
