"""The library as a foreign project sees it: code of the documents passes strict type checkers against the installed package."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from tests.support.documents.sources import ROOMS, ROOT

TUTORIAL = ROOT / "docs" / "tutorials" / "python-developer.md"
KEPT = ROOT / ".mypy_cache" / "typed"
"""What mypy found in the files of the package and of the libraries: a file is read again only where it differs."""
FOREIGN = '''\
"""A test bench with types of its own."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pdgw

Fault = tuple[int, int | str]


class Bench:
    """A machine and its expected speeds."""

    def __init__(self, file: str | Path, world: Callable[[pdgw.World], None] | None = None) -> None:
        self.gateway: pdgw.Gateway = pdgw.Gateway(file, seed=7)
        if world is not None:
            world(self.gateway.world)

    def speed(self, do_id: int) -> float:
        return self.gateway.plc.actual("NIST_A", do_id) / 0x4000

    def faults(self, faults: list[Fault]) -> Iterator[str]:
        for do_id, fault in faults:
            device: pdgw.SimulatedDevice = self.gateway.device(do_id)
            device.inject(fault)
            yield self.gateway.sentence(do_id)
            device.clear()


def describe(number: int) -> list[str]:
    telegram: pdgw.Telegram = pdgw.telegram(number)
    return [f"{item.name}: {item.description}" for item in telegram.setpoints.signals]


def families(folder: Path) -> None:
    for file in folder.glob("*.toml"):
        pdgw.add_family(file)


def main(path: str) -> int:
    try:
        config: pdgw.GatewayConfig = pdgw.load_config(path)
        daemon: pdgw.Daemon = pdgw.build_gateway(config, pdgw.World(3))
    except pdgw.PdgwError as error:
        print(error)
        return 1
    daemon.release()
    return 0
'''


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project, and in ``v`` an environment with the package in the layout of its wheel."""
    folder = tmp_path_factory.mktemp("typed")
    venv.create(folder / "v", symlinks=True)
    site = next((folder / "v").glob("lib/python*/site-packages"))
    for room in ("pdgw", *ROOMS):
        place = site / "pdgw" / ("" if room == "pdgw" else room)
        shutil.copytree(ROOT / room, place, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    sources = folder / "sources"
    sources.mkdir()
    for code in re.findall(r"```python\n(# (\S+)\n.*?)```", TUTORIAL.read_text(encoding="utf-8"), re.DOTALL):
        (sources / code[1]).write_text(code[0])
    for file in (ROOT / "docs" / "examples").glob("[!ao]*.py"):  # archive and open_controller need extras
        (sources / file.name).write_text(file.read_text())
    (sources / "foreign.py").write_text(FOREIGN)
    (sources / "pyrightconfig.json").write_text('{"typeCheckingMode": "standard"}')
    assert len(list(sources.iterdir())) >= 10
    return folder


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("checker", "options"),
    [
        ("mypy", ["--strict", "--python-executable", "../v/bin/python", "--cache-dir", str(KEPT)]),
        ("basedpyright", ["--pythonpath", "../v/bin/python"]),
    ],
)
def test_code_of_documents_and_a_foreign_project_is_typed(project: Path, checker: str, options: list[str]) -> None:
    """basedpyright is pyright with its program in the package, so that it needs no download."""
    pytest.importorskip(checker, reason=f"no {checker} (pip install 'profidrive-gateway[dev]')")
    result = subprocess.run(
        [sys.executable, "-m", checker, *options, "."],
        cwd=project / "sources",
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
