"""A release: source distributions that do not depend on the machine, and a whole bill of materials."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import tarfile
from pathlib import Path
from typing import Any

import pytest

from pdgw.workshop import release
from pdgw.workshop.installation import verify
from pdgw.workshop.release import ReleaseError, source_distribution, sources, unpack
from pdgw.workshop.sbom import PACKAGE, document
from tests.support.documents.written_tables import ROOT

EPOCH = 1_800_000_000


def tree(folder: Path, umask: int, time: int) -> Path:
    before = os.umask(umask)
    try:
        (folder / "sub").mkdir(parents=True)
        for name in ("b.py", "a.py", "sub/c.txt"):
            (folder / name).write_text(name)
            os.utime(folder / name, (time, time))
        (folder / "b.py").chmod(0o777 & ~umask)
    finally:
        os.umask(before)
    return folder


def test_a_source_distribution_depends_on_names_contents_and_execute_bits_alone(tmp_path: Path) -> None:
    first, second = tree(tmp_path / "one", 0o022, 1), tree(tmp_path / "two" / "deeper", 0o077, 99_999)
    made = [source_distribution(sources(folder), "p-1.0", EPOCH) for folder in (first, second)]
    assert made[0] == made[1]
    (first / "a.py").write_text("other")
    assert source_distribution(sources(first), "p-1.0", EPOCH) != made[0]


def test_a_source_distribution_unpacks_to_what_it_was_made_from(tmp_path: Path) -> None:
    folder = tree(tmp_path / "one", 0o077, 1)
    data = source_distribution(sources(folder), "p-1.0", EPOCH)
    unpack(gzip.decompress(data), tmp_path / "back")
    assert sources(tmp_path / "back" / "p-1.0") == sources(folder)
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        assert {(item.uid, item.gid, item.uname, item.mtime) for item in archive} == {(0, 0, "", EPOCH)}


class Builds:
    """Replaces pip: the wheel of each build has the next content."""

    def __init__(self, *contents: bytes) -> None:
        self.contents = list(contents)

    def __call__(self, tree: Path, folder: Path, epoch: int) -> list[Path]:
        folder.mkdir()
        sdist, wheel = folder / "p-1.0.tar.gz", folder / "p-1.0-py3-none-any.whl"
        sdist.write_bytes(source_distribution({"a.py": (b"", 0o644)}, "p-1.0", epoch))
        wheel.write_bytes(self.contents.pop(0))
        return [sdist, wheel]


def test_a_release_whose_builds_differ_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(EPOCH))
    monkeypatch.setattr(release, "_built", Builds(b"one", b"two"))
    with pytest.raises(ReleaseError, match=r"p-1.0-py3-none-any.whl: the second build differs"):
        release.release(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_release_has_checksums_of_all_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", str(EPOCH))
    monkeypatch.setattr(release, "_built", Builds(b"one", b"one"))
    release.release(tmp_path)
    listed = dict(reversed(line.split("  ")) for line in (tmp_path / "SHA256SUMS").read_text().splitlines())
    assert listed.keys() == {path.name for path in tmp_path.iterdir()} - {"SHA256SUMS"}
    assert release.PINS in listed
    verify(tmp_path)
    for name, told in listed.items():
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == told
    with pytest.raises(ReleaseError, match="has files"):
        release.release(tmp_path)


@pytest.fixture(scope="module")
def bill() -> dict[str, Any]:
    return document("0.9.0", EPOCH)


def test_the_bill_of_materials_is_the_same_each_time(bill: dict[str, Any]) -> None:
    assert json.dumps(document("0.9.0", EPOCH)) == json.dumps(bill)
    assert (bill["bomFormat"], bill["specVersion"], bill["version"]) == ("CycloneDX", "1.6", 1)
    assert re.fullmatch(r"urn:uuid:[0-9a-f-]{36}", bill["serialNumber"])
    assert bill["metadata"]["timestamp"] == "2027-01-15T08:00:00+00:00"
    assert bill["metadata"]["component"]["bom-ref"] == f"pkg:pypi/{PACKAGE}@0.9.0"


def test_the_bill_of_materials_has_each_dependency_with_pin_and_licence(bill: dict[str, Any]) -> None:
    pins = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().splitlines())
    pins = {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pins.items()}
    found = {item["name"]: item for item in bill["components"]}
    assert {"canopen", "python-can", "pydantic-core", "starlette", "paho-mqtt", "uplot", "lit-html"} <= found.keys()
    assert not {"pytest", "mypy", "ruff", "scapy"} & found.keys()
    for name, item in found.items():
        assert item["licenses"], name
        if item["purl"].startswith("pkg:pypi/"):
            assert item["version"] == pins[name], name
    assert {found["canopen"]["scope"], found["starlette"]["scope"]} == {"required", "optional"}
    assert found["canopen"]["scope"] == "required"


def test_the_bill_of_materials_refers_to_its_own_components(bill: dict[str, Any]) -> None:
    references = [bill["metadata"]["component"]["bom-ref"], *(item["bom-ref"] for item in bill["components"])]
    assert len(references) == len(set(references))
    for item in bill["dependencies"]:
        assert {item["ref"], *item["dependsOn"]} <= set(references)
