"""What every package may import: optional packages with the names of their extras, and files that a user names."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from pdgw.base.extras import EXTRA_OF, missing
from pdgw.base.files import read_file
from tests.test_package import PROJECT, ROOMS, ROOT

CORE = {"can", "canopen", "greenlet", "pydantic", "pydantic_core", "typer", "click", "rich", "yaml", "pdgw"}
"""What every installation can import beside the standard library."""
WITH_ANOTHER = {"h11", "pytest"}
"""What a package of an extra always brings along, as uvicorn h11, and what loads the module: pytest its plugin."""
NOT_OPTIONAL = CORE | WITH_ANOTHER | sys.stdlib_module_names
BY_WEB_COMMAND = "tools/web"
"""The package that ``pdgw web`` imports in a ``try``, and nothing else does."""
EXTRAS = PROJECT["project"]["optional-dependencies"]


def imports(path: Path) -> Iterator[tuple[str, bool]]:
    """The top-level packages that a module imports, and whether it does so in a ``try``."""
    text = path.read_text(encoding="utf-8")
    words = set(re.findall(r"^ *(?:from|import) (\w+)", text, re.MULTILINE))
    if not words - NOT_OPTIONAL:
        return
    tree = ast.parse(text)
    guarded = [item for item in ast.walk(tree) if isinstance(item, ast.Try) or _is_for_types(item)]
    tried = {id(below) for item in guarded for below in ast.walk(item)}
    for item in ast.walk(tree):
        names = [alias.name for alias in item.names] if isinstance(item, ast.Import) else []
        if isinstance(item, ast.ImportFrom) and item.module:
            names = [item.module]
        for name in names:
            yield name.partition(".")[0], id(item) in tried


def _is_for_types(item: ast.AST) -> bool:
    return isinstance(item, ast.If) and isinstance(item.test, ast.Name) and item.test.id == "TYPE_CHECKING"


def optional() -> set[tuple[str, str, bool]]:
    """Each import of a package that a plain installation does not have: file, package, whether in a ``try``."""
    return {
        (path.relative_to(ROOT).as_posix(), package, tried)
        for room in ROOMS
        for path in (ROOT / room).rglob("*.py")
        for package, tried in imports(path)
        if package not in NOT_OPTIONAL
    }


def test_each_optional_import_is_in_the_table_and_can_name_its_extra() -> None:
    found = optional()
    assert {package for _, package, _ in found} == EXTRA_OF.keys() - {"playwright"}
    assert [item for item in found if not item[2] and not item[0].startswith(f"{BY_WEB_COMMAND}/")] == []


def test_each_extra_of_the_table_installs_its_package() -> None:
    for package, extra in EXTRA_OF.items():
        names = {Requirement(text).name.partition("-")[0] for text in EXTRAS[extra]}
        assert package in names, (package, extra)
        assert missing(package).endswith(f"pip install 'profidrive-gateway[{extra}]'")


def test_scapy_layers_without_scapy_name_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    name = "pdgw.profidrive.scapy_layers"
    monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "scapy.contrib.pnio", None)
    with pytest.raises(ImportError, match=re.escape("this needs scapy: pip install 'profidrive-gateway[scapy]'")):
        __import__(name)


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_file(path, 5) == b"12345"
    with pytest.raises(OSError, match="longer than 4 bytes; check that it is the right file"):
        read_file(path, 4)


@pytest.mark.parametrize(("path", "reason"), [("/dev/zero", "a pipe or a device"), ("/", "a directory")])
def test_other_things_with_a_path_are_rejected(path: str, reason: str) -> None:
    with pytest.raises(OSError, match=f"{reason}, expected a file"):
        read_file(Path(path), 5)
