"""The compiled wheels: which are built, what each must contain, and which of them a release takes. `make wheels` builds them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import ClassVar

import pytest

from pdgw.workshop import installation, wheels
from pdgw.workshop.release import SUMS, ReleaseError, same_sources
from tests.test_forge import PYTHONS, workflow
from tests.test_package import PROJECT, ROOT

SETTINGS = PROJECT["tool"]["cibuildwheel"]
NAME = "profidrive_gateway-0.9.0-cp311-cp311-manylinux_2_28_x86_64.whl"
PURE = {"pdgw/a.py": b"a = 1\n", "pdgw/b.py": b"b = 1\n", "pdgw-0.9.0.dist-info/WHEEL": b"Tag: py3-none-any\n"}
COMPILED = PURE | {
    "pdgw/a.cpython-311-x86_64-linux-gnu.so": b"machine code",
    "pdgw/gateway/links/profinet/engine.abi3.so": b"machine code",
    "pdgw-0.9.0.dist-info/WHEEL": b"Tag: cp311\n",
}


def written(path: Path, files: Mapping[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return path


def test_each_supported_python_has_a_compiled_wheel_for_linux_on_both_processors() -> None:
    known = [
        f"cp{python.replace('.', '')}-{system}_{machine}"
        for python in ("3.10", *PYTHONS, "3.14t", "3.15")
        for system in ("manylinux", "musllinux", "macosx")
        for machine in ("x86_64", "aarch64")
    ]
    built = {name for name in known if any(fnmatch(name, pattern) for pattern in SETTINGS["build"])}
    assert built == {
        f"cp{python.replace('.', '')}-manylinux_{machine}" for python in PYTHONS for machine in ("x86_64", "aarch64")
    }
    assert wheels.versions() == PYTHONS
    assert SETTINGS["environment"]["PDGW_COMPILED"] == "1"
    assert workflow()["jobs"]["wheels"]["strategy"]["matrix"]["machine"] == ["ubuntu-24.04", "ubuntu-24.04-arm"]


def test_every_pattern_of_compiled_modules_names_a_module(tmp_path: Path) -> None:
    found = wheels.compiled_modules()
    assert "gateway/links/cyclic.py" in found
    assert len(found) == len(set(found))
    assert all((ROOT / path).is_file() for path in found)
    (tmp_path / "setup.py").write_text('COMPILED = ("a.py", "gone/*.py")\n')
    (tmp_path / "a.py").touch()
    with pytest.raises(ReleaseError, match=r"COMPILED names gone/\*\.py: no such module"):
        wheels.compiled_modules(tmp_path)


def test_the_soak_compiles_modules_that_no_wheel_compiles(tmp_path: Path) -> None:
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    setup = setup.replace("\nCOMPILED =", "\nRELEASED =").replace("\nSOAK =", "\nCOMPILED =")
    (tmp_path / "setup.py").write_text(setup, encoding="utf-8")
    for package in ("gateway", "peers", "profidrive", "workshop"):
        (tmp_path / package).symlink_to(ROOT / package)
    found = wheels.compiled_modules(tmp_path)
    assert {"peers/drive/model/model.py", "workshop/soak/watch.py"} <= set(found)
    assert not set(found) & set(wheels.compiled_modules())


@pytest.mark.parametrize(
    ("name", "files", "message"),
    [
        (NAME.replace("manylinux_2_28", "linux"), COMPILED, "expected a tag manylinux"),
        (NAME, PURE, "pdgw/a is not compiled"),
        (NAME, {path: data for path, data in COMPILED.items() if path != "pdgw/a.py"}, "or has no source"),
        (
            NAME,
            {path: data for path, data in COMPILED.items() if "engine" not in path},
            "engine.abi3.so, which is left",
        ),
        (NAME, COMPILED | {"pdgw/c.so": bytes(ROOT)}, "pdgw/c.so contains the path"),
    ],
)
def test_a_wheel_that_is_not_portable_or_not_compiled_is_rejected(
    name: str, files: Mapping[str, bytes], message: str
) -> None:
    wheels.check(NAME, COMPILED, ["a.py"])
    with pytest.raises(ReleaseError, match=message):
        wheels.check(name, files, ["a.py"])


@pytest.mark.parametrize("other", [{"pdgw/b.py": b"b = 2\n"}, {}])
def test_a_release_takes_no_wheel_with_other_sources(tmp_path: Path, other: Mapping[str, bytes]) -> None:
    pure = written(tmp_path / "pure.whl", PURE)
    same_sources(written(tmp_path / NAME, COMPILED), pure)
    stale = {path: data for path, data in COMPILED.items() if path != "pdgw/b.py"} | other
    with pytest.raises(ReleaseError, match=r"pdgw/b.py is not that of the commit, build the wheels again"):
        same_sources(written(tmp_path / NAME, stale), pure)


class _Environment:
    """Takes note of what is installed, as the programs of an environment do that work in its folder."""

    installed: ClassVar[list[str]] = []

    def __init__(self, place: Path, python: Path | None = None) -> None:
        pass

    def install(self, *arguments: str) -> None:
        self.installed.extend(item for item in arguments if "/" in item)

    def run(self, program: str, *arguments: str) -> str:
        return "pdgw 0.9.0, compiled, CPython 3.11"


def test_files_are_found_from_the_folder_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`make wheels` and `make release` name them from the folder of the project."""
    monkeypatch.setattr(_Environment, "installed", [])
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / SUMS).write_text("")
    (tmp_path / "out" / "profidrive_gateway-0.9.0.tar.gz").write_text("")
    for module in (wheels, installation):
        monkeypatch.setattr(module, "Environment", _Environment)
    wheels.tried(Path("python"), Path("out") / NAME)
    installation.installed(Path("out"))
    assert len(_Environment.installed) == 4
    assert all(Path(item).is_absolute() for item in _Environment.installed)
