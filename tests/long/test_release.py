"""What a release checks: the compiled wheels, and the bill of materials. `make release` and `make wheels` build them."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.long.release import ReleaseError, check, main, modules, patterns
from tests.support.documents.sources import ROOMS
from tests.test_forge import PYTHONS, workflow
from tests.test_package import PROJECT, ROOT

SETTINGS = PROJECT["tool"]["cibuildwheel"]
NAME = "profidrive_gateway-0.9.0-cp311-cp311-manylinux_2_28_x86_64.whl"
MODULE = "pdgw/a.cpython-311-x86_64-linux-gnu.so"
PURE = {"pdgw/a.py": b"a = 1\n", "pdgw/b.py": b"b = 1\n", "pdgw-0.9.0.dist-info/WHEEL": b"Tag: py3-none-any\n"}
COMPILED = PURE | {
    MODULE: b"machine code",
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
    assert SETTINGS["environment"]["PDGW_COMPILED"] == "1"
    assert workflow()["jobs"]["wheels"]["strategy"]["matrix"]["machine"] == ["ubuntu-24.04", "ubuntu-24.04-arm"]


def test_every_pattern_of_compiled_modules_names_a_module_once() -> None:
    found = [*modules(), *modules("SOAK")]
    assert "gateway/links/cyclic.py" in modules()
    assert {"peers/drive/model/model.py"} <= set(modules("SOAK"))
    assert len(found) == len(set(found))
    assert [pattern for name in ("COMPILED", "SOAK") for pattern in patterns(name) if not any(ROOT.glob(pattern))] == []


@pytest.mark.parametrize(
    ("name", "files", "message"),
    [
        (NAME.replace("manylinux_2_28", "linux"), COMPILED, "expected a tag manylinux"),
        (NAME, PURE, "pdgw/a is not compiled"),
        (NAME, COMPILED | {MODULE: bytes(ROOT)}, "pdgw/a contains a path of this machine"),
        (NAME, COMPILED | {"pdgw/b.py": b"b = 2\n"}, "pdgw/b.py is not that of the commit, build the wheels again"),
        (NAME, {path: data for path, data in COMPILED.items() if path != "pdgw/b.py"}, "pdgw/b.py is not that of"),
    ],
)
def test_a_stale_or_incomplete_or_not_portable_wheel_is_rejected(
    name: str, files: Mapping[str, bytes], message: str, tmp_path: Path
) -> None:
    pure = written(tmp_path / "pure.whl", PURE)
    check(written(tmp_path / NAME, COMPILED), pure, ["a.py"])
    with pytest.raises(ReleaseError, match=message):
        check(written(tmp_path / name, files), pure, ["a.py"])


def test_the_bill_of_materials_gets_the_files_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "p-1.0-py3-none-any.whl", PURE)
    bill = tmp_path / "p.cdx.json"
    bill.write_text('{"components": [{"name": "canopen"}]}')
    monkeypatch.setattr(sys, "argv", ["release", str(tmp_path)])
    assert main() == 0
    assert {item["name"] for item in json.loads(bill.read_text())["components"]} == {"canopen", "lit-html", "uplot"}


def test_a_bad_wheel_is_one_error_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written(tmp_path / "p-1.0-py3-none-any.whl", PURE)
    written(tmp_path / NAME, PURE)
    (tmp_path / "p.cdx.json").write_text('{"components": []}')
    monkeypatch.setattr(sys, "argv", ["release", str(tmp_path)])
    assert main() == 1
    assert capsys.readouterr().err == f"error: {NAME}: pdgw/{modules()[0].removesuffix('.py')} is not compiled\n"


def test_the_source_distribution_has_every_folder_and_file_of_a_commit() -> None:
    lines = [line.split() for line in (ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()]
    grafted = {name for word, *names in lines if word == "graft" for name in names}
    included = {name for word, *names in lines if word == "include" for name in names}
    by_setuptools = {"LICENSE", "MANIFEST.in", "README.md", "pyproject.toml"}
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert {path.partition("/")[0] for path in listed.split()} == {*grafted, *included, *by_setuptools, *ROOMS}
