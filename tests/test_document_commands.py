"""Every command of a document is run by a test, or is listed below with the reason why it cannot be run.

``make tour`` runs those of the tutorials, README and ``tests/tour/other-documents.md``, each in processes of its own. This module
runs the commands of ``HERE`` in this process, on files made for them. Names of commands in a sentence and synopses
(`pdgw map CONFIG`) are not run; ``test_documents`` checks that they exist, with their options.
"""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from pdgw.durations import MS
from tests.decoder.frames.profinet.test_profinet import frames as profinet_frames
from tests.decoder.replay.test_replay import speed
from tests.support.axis.rig import NODE
from tests.support.cli import pdgw
from tests.support.readers import captures
from tests.test_documents import BLOCK, DOCUMENTS, INLINE, ROOT, command_in
from tests.tour.console import Command, steps

REST = ROOT / "tests" / "tour" / "other-documents.md"
_PLACEHOLDER = re.compile(r"\[|\.\.\.|(?<![\w,.])(?!NSOLL)[A-Z]+(?![\w.])|YOUR")
_NAMES = re.compile(r"(python -m pdgw\.workshop|pdgw)( [a-z][a-z-]*)+")
_ALIKE = re.compile(r"\bpress\.toml\b")

HERE = {
    "pdgw --help": "PROFIdrive-to-CANopen gateway",
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
    "pdgw map gateway.toml --format csv --out map.csv": "",
    "pdgw map gateway.toml --format plcopen --out pdgw.xml": "",
    "pdgw map gateway.toml --format scl --out pdgw.scl": "",
    "pdgw map gateway.toml --format st --out pdgw.st": "",
    "pdgw map gateway.toml --format udt --out pdgw.udt": "",
    "pdgw replay plc.pcap can.log": "all equal",
    "pdgw replay plc.pcap can.log --config gateway.toml": "all equal",
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

_TERMINAL = "asks at a terminal"
_CAN = "a CAN interface of this machine"
_ETHERNET = "a PROFINET device on Ethernet, root"
_MINUTES = "minutes of CPU"
_PART = "a part of a command: needs a configuration or a file"
_SOURCES = "a folder of the sources"
NOT_TYPED = {
    "pdgw --install-completion": ("changes the start-up file of a user's shell", "tests/tools/test_command_line.py"),
    "pdgw axis test 1": (_TERMINAL, "tests/tools/test_axis_test.py"),
    "pdgw axis test 1 gateway.toml": (_TERMINAL, "tests/tools/test_axis_test.py"),
    "pdgw axis test 1 plant.toml --percent 1 --turns 1 --backward": (_TERMINAL, "tests/tools/test_axis_test.py"),
    "python -m pdgw.workshop bench cycle --axes 8 --cycle-time-ms 1": (_MINUTES, "tests/workshop/test_bench.py"),
    "pdgw bus scan": (_CAN, "tests/can/test_commissioning.py"),
    "pdgw bus scan --channel can1 --eds sheets/": (_CAN, "tests/can/test_commissioning.py"),
    "pdgw config check --bus": (_PART, "tests/tour/other-documents.md"),
    "pdgw decode --json": (_PART, "tests/tools/test_decode_command.py"),
    "pdgw decode /plant/captures --parquet /plant/data --signal NSOLL_A,NIST_A,ZSW1.FAULT -j 8": (
        "a folder of captures, an extra",
        "tests/tools/test_archive.py",
    ),
    "pdgw demo --chapter positioner": ("three processes for half a minute", "tests/endtoend/test_demo.py"),
    "pdgw demo --profinet": ("network namespaces", "tests/endtoend/test_profinet.py"),
    "pdgw param --profinet identify --gateway 192.168.0.2": (_ETHERNET, "tests/tools/test_param_profinet.py"),
    "pdgw param --profinet read P965 P922 6041h --gateway 192.168.0.2 --do 1": (
        _ETHERNET,
        "tests/tools/test_param_profinet.py",
    ),
    "pdgw run --record": (_PART, "tests/tour/other-documents.md"),
    "pdgw run --web": (_PART, "tests/tour/other-documents.md"),
    "python -m pdgw.workshop loop --plot docs/loop.png": (_MINUTES, "tests/workshop/test_loop_study.py"),
    "pdgw sim plc --interactive": (_TERMINAL, "tests/tools/test_plc_keyboard.py"),
    "pdgw sim plc --interactive --telegram 1": (_TERMINAL, "tests/tools/test_plc_keyboard.py"),
    "pdgw sim plc --interactive --telegram 111": (_TERMINAL, "tests/tools/test_plc_keyboard.py"),
    "pdgw sim plc scenario.yaml --profinet eth0 --name press-1 --device-ip 192.168.0.2/24": (
        _ETHERNET,
        "tests/endtoend/test_profinet.py",
    ),
    "pdgw sim plc tools/scenarios/positioner.yaml": (_SOURCES, "tests/peers/test_plc_positioner.py"),
    "pdgw map examples/axis_sequence.toml --format st --out pdgw.st": (_SOURCES, "tests/tools/test_plc_motion.py"),
    "pdgw run examples/axis_sequence.toml": (_SOURCES, "tests/tools/test_plc_motion.py"),
    "python -m pdgw.workshop soak --hours 24 --seed 7": (_MINUTES, "tests/workshop/test_soak.py"),
    "python -m pdgw.workshop soak --calm --hours 24 --telegrams 111 --seed 7": (
        _MINUTES,
        "tests/workshop/test_soak_calm.py",
    ),
    "python -m pdgw.workshop soak --planted --seed 1": (_MINUTES, "tests/workshop/test_soak_planted.py"),
    "python -m pdgw.workshop soak --seed 7 --axes 2 --until 49.001 --trace": (_MINUTES, "tests/workshop/test_soak.py"),
}
"""Why a command is not typed, and where what it does is tested."""


def to_be_typed() -> set[str]:
    """The commands of the documents; that a tutorial's configuration is called like its machine makes no difference."""
    found = set()
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        for pattern in (BLOCK, INLINE):
            for match in pattern.finditer(text):
                command = _ALIKE.sub("gateway.toml", command_in(match))
                name = pattern is INLINE and _NAMES.fullmatch(command)
                if not name and not _PLACEHOLDER.search(re.sub(r"'[^']*'|\"[^\"]*\"", "", command)):
                    found.add(command)
    return found


def typed() -> set[str]:
    """What ``make tour`` types."""
    played = [step.text for path in (*DOCUMENTS, REST) for step in steps(path.read_text()) if isinstance(step, Command)]
    parts = [part.strip() for text in played for part in re.split(r"[;&|>]+", text)]
    return {_ALIKE.sub("gateway.toml", part) for part in parts}


def test_every_document_command_is_run_or_has_a_reason() -> None:
    unaccounted = to_be_typed() - typed() - HERE.keys() - PROFINET.keys() - NOT_TYPED.keys()
    assert not unaccounted, f"neither in {REST.name} nor in this file: {sorted(unaccounted)}"


def test_every_reason_belongs_to_a_document_command_that_is_not_run() -> None:
    assert not NOT_TYPED.keys() & (typed() | HERE.keys() | PROFINET.keys())
    assert not (NOT_TYPED.keys() | HERE.keys() | PROFINET.keys()) - to_be_typed()
    assert [where for _, where in NOT_TYPED.values() if not (ROOT / where).exists()] == []


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Files with the names the documents use."""
    speed().frames.write(tmp_path)
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
