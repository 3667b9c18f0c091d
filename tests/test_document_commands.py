"""Commands of the documents, run in this process on files made for them.

``make tour`` runs those of the tutorials, README and ``tests/tour/other-documents.md``, each in processes of its own.
``test_documents`` checks that the others exist, with their options.
"""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from pdgw.durations import MS
from tests.decoder.frames.profinet.test_profinet import frames as profinet_frames
from tests.support.axis.recorded import speed
from tests.support.axis.rig import NODE
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis, configuration
from tests.support.gateways.recorded_daemon import recorded, recording
from tests.support.readers import captures
from tests.test_documents import DOCUMENTS, ROOT, commands

_ALIKE = re.compile(r"\bpress\.toml\b")

HERE = {
    "pdgw --version": "pdgw ",
    "pdgw config check gateway.toml": "gateway.toml: ok, 1 axis",
    "pdgw config example": "[[axis]]",
    'pdgw decode plant.pcap --filter \'kind == "alarm" or kind == "dcp"\'': "",
    "pdgw timeline plant.pcap --station press-1 --html plant.html": "",
    "pdgw decode plc.pcap --filter 'stw1.on == 0 and axis == 1'": "STW1 047Eh",
    "pdgw drives": "epos4",
    "pdgw drives my.eds": "engel",
    "pdgw drives epos4": "EPOS4",
    "pdgw map gateway.toml": "NSOLL_A",
    "pdgw map gateway.toml --format codesys --out pdgw.xml": "",
    "pdgw map gateway.toml --format csv --out map.csv": "",
    "pdgw map gateway.toml --format plcopen --out pdgw.xml": "",
    "pdgw map gateway.toml --format scl --out pdgw.scl": "",
    "pdgw map gateway.toml --format st --out pdgw.st": "",
    "pdgw map gateway.toml --format udt --out pdgw.udt": "",
    "pdgw replay recording/gateway.pcapng": "all equal",
    "pdgw sim bus --example": "[[device]]",
    "pdgw timeline plc.pcap can.log": "anomalies: none",
    "pdgw timeline plc.pcap can.log --config gateway.toml": "anomalies: none",
}
"""Commands typed here, with something of what they print."""

PROFINET = {
    "pdgw map gateway.toml --format scl --out pdgw.scl --gsdml .": "GSDML-V2.4-pdgw-profidrive-gateway-",
    "pdgw map gateway.toml --gsdml .": "GSDML-V2.4-pdgw-profidrive-gateway-",
}
"""As ``HERE``, with ``type = "profinet"`` in the configuration."""


def test_the_commands_typed_here_are_in_the_documents() -> None:
    found = {_ALIKE.sub("gateway.toml", text) for path in DOCUMENTS for text in commands(path.read_text("utf-8"))}
    assert HERE.keys() | PROFINET.keys() <= found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files with the names the documents use."""
    speed().frames.write(tmp_path)
    with recorded(configuration(axis(1)), tmp_path) as plc:
        plc.enable()
    (tmp_path / "recording").mkdir()
    Path(recording(tmp_path)).rename(tmp_path / "recording" / "gateway.pcapng")
    packets = [(captures.BEGIN_NS + i * MS, captures.ETHERNET, data) for i, data in enumerate(profinet_frames())]
    (tmp_path / "plant.pcap").write_bytes(captures.pcap(packets))
    shutil.copy(ROOT / "dsp402" / "eds" / "engel.eds", tmp_path / "my.eds")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def configure(folder: Path, transport: str) -> None:
    (folder / "gateway.toml").write_text(
        f'[can]\ninterface = "virtual"\n[transport]\ncycle_time_ms = 4\n{transport}\n'
        f"[[axis]]\ndo_id = 1\nnode_id = {NODE}\ntelegram = 1\n"
    )


@pytest.mark.parametrize("command", sorted(HERE.keys() | PROFINET.keys()))
def test_document_command_gives_the_documented_output(command: str, folder: Path) -> None:
    configure(folder, 'type = "profinet"\ninterface = "eth1"' if command in PROFINET else "")
    words = shlex.split(command.replace("press-1", "gateway"))[1:]  # the station in the capture
    done = pdgw(*words)
    assert done.returncode == 0, done.stderr
    assert ({**HERE, **PROFINET})[command] in done.stdout + done.stderr
    for option in ("--out", "--html"):
        if option in words:
            assert (folder / words[words.index(option) + 1]).stat().st_size
