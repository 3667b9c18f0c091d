"""The real gateway on Ethernet frames: a veth pair in network namespaces, found by name, connected, driven, released."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.demo import namespaces
from pdgw.tools.recording.recorder import CAPTURE
from tests.support.cli import pdgw as in_process
from tests.support.processes import PATIENT, pdgw
from tests.support.readers import tshark

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
CONFIG = f"""\
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
{PATIENT}"""


def namespaces_or_skip() -> None:
    """Skips, in CI fails, where network namespaces are not possible."""
    why = namespaces.missing()
    if why:
        if os.environ.get("CI"):
            pytest.fail(why)
        pytest.skip(why)


def capture_without_a_configuration(recording: str) -> None:
    """The capture contains its configuration (Connect)."""
    result = in_process("decode", recording, "--json")
    assert result.returncode == 0, result.stderr
    assert "observed in Connect of press-1: axis 1 telegram 1" in result.stderr
    kinds = {json.loads(line)["kind"] for line in result.stdout.splitlines()}
    assert kinds >= {"dcp", "lldp", "rpc", "alarm", "frame", "parameter-request", "parameter-response", "pdo"}
    timeline = in_process("timeline", recording)
    assert timeline.returncode == 0, timeline.stderr
    assert "relationship of pdgw-plc and press-1 confirmed" in timeline.stdout
    assert "-> executed" in timeline.stdout
    replayed = in_process("replay", recording)
    assert replayed.returncode == 0, replayed.stdout


def dissected(recording: Path) -> None:
    """tshark finds cyclic frames and nothing malformed."""
    rows = tshark.fields(recording, ["pn_rt.frame_id", "_ws.malformed"])
    assert not [row for row in rows if row["_ws.malformed"]]
    assert any(row["pn_rt.frame_id"] for row in rows)


def test_demo_reports_missing_namespaces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(namespaces, "_unshare", lambda: ["sh", "-c", "echo unshare: not permitted >&2; exit 1"])
    monkeypatch.setattr(namespaces.shutil, "which", lambda tool: tool)
    with pytest.raises(GatewayError, match=r"the kernel does not allow network namespaces .unshare: not permitted"):
        namespaces.enter("pdgw")
    monkeypatch.setattr(namespaces.shutil, "which", lambda tool: None)
    with pytest.raises(GatewayError, match="unshare, nsenter, ip not found; install util-linux and iproute2"):
        namespaces.enter("pdgw")


@pytest.mark.e2e
def test_a_controller_finds_the_gateway_on_ethernet_and_moves_a_drive(tmp_path: Path) -> None:
    namespaces_or_skip()
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG, encoding="utf-8")
    script = Path(__file__).with_name("profinet_controller.py")
    command = ["unshare", "-Urn", sys.executable, str(script), str(config), str(Path(sys.executable).with_name("pdgw"))]
    result = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)
    assert result.returncode == 0, result.stderr
    seen = json.loads(result.stdout.splitlines()[-1])
    log = result.stderr
    assert seen["moved"], (seen, log)
    assert seen["P965"] == "0201000106010329"
    assert seen["interface"] == 0
    assert seen["address taken"], (seen, log)
    assert seen["exit status"] == 0
    assert "IP address set to 192.168.0.2 by DCP" in log
    assert "controller pdgw-plc 192.168.0.1 connected, cycle 16 ms" in log
    capture_without_a_configuration(str(tmp_path / CAPTURE))
    if shutil.which("tshark") is None:
        pytest.skip("tshark is not installed; what the others read is there")
    dissected(tmp_path / CAPTURE)


@pytest.mark.e2e
def test_third_party_controller_turns_an_axis_with_the_gsdml_file(tmp_path: Path) -> None:
    """profinet-py knows nothing of this package: modules and lengths are those of the file."""
    namespaces_or_skip()
    if not find_spec("construct"):
        pytest.skip("the extra controller is not installed")
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG.replace('station_name = "press-1"', 'station_name = "press-1"\nip = "192.168.0.2/24"'))
    written = pdgw("map", str(config), "--gsdml", str(tmp_path))
    assert written.returncode == 0, written.stderr
    (gsdml,) = tmp_path.glob("GSDML-*.xml")
    script, example = Path(__file__).with_name("open_controller.py"), EXAMPLES / "open_controller.py"
    command = ["unshare", "-Urn", sys.executable, str(script), str(config), str(gsdml), str(example)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False, cwd=tmp_path)
    assert result.returncode == 0, (result.stdout, result.stderr)
    station, ready, operation, turns, stands = result.stdout.splitlines()
    assert station == "press-1 at 192.168.0.2"
    assert ready.startswith("ready to switch on: ZSW1")
    assert operation.startswith("in operation: ZSW1")
    assert turns.startswith("turns at 25 %: ZSW1")
    assert stands.startswith("stands: ZSW1")
    assert "connected, cycle 16 ms" in result.stderr
    assert "differs from the configuration" not in result.stderr
    return result.stderr
