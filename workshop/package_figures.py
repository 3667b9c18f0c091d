"""``python -m pdgw.workshop.package_figures [ROOT]``: files, lines, public names and imports of each package in ROOT.

A row does not include sub-packages, unless its name ends with ``/``. An import is a pair of modules: both in the packages of
the row, or the second one outside.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True, slots=True)
class Module:
    """One source file."""

    package: str
    lines: int
    public: int
    imports: frozenset[str]
    """Each imported module as ``package:module``."""


def modules(root: Path) -> Iterator[Module]:
    """The modules of the top-level folders that pyproject.toml maps to packages."""
    mapping = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]
    files = {
        ".".join([name, *file.relative_to(root / folder).with_suffix("").parts]).removesuffix(".__init__"): file
        for name, folder in mapping.items()
        for file in (root / folder).rglob("*.py")
    }
    for name, file in files.items():
        text = file.read_text(encoding="utf-8")
        tree = ast.parse(text)
        imported = {target for target in _targets(tree, files) if target != name}
        pairs = frozenset(f"{_package(target, files)}:{target}" for target in imported)
        yield Module(_package(name, files), len(text.splitlines()), len(set(_public(tree))), pairs)


def _package(name: str, files: dict[str, Path]) -> str:
    return name if files[name].name == "__init__.py" else name.rpartition(".")[0]


def _targets(tree: ast.Module, files: dict[str, Path]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in files)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                target = f"{node.module}.{alias.name}"
                yield from [target] if target in files else [node.module] if node.module in files else []


def _public(tree: ast.Module) -> Iterator[str]:
    """Names without underscore that a module defines at its top level."""
    for node in tree.body:
        found: list[str] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found = [node.name]
        elif isinstance(node, ast.Assign):
            found = [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found = [node.target.id]
        yield from (name for name in found if not name.startswith("_"))


def table(root: Path) -> Table:
    """A row for each package."""
    found = list(modules(root))
    made = Table(*("package", "files", "lines", "public names", "inside", "outside"), box=box.SIMPLE_HEAD)
    tops = sorted({".".join(module.package.split(".")[:2]) for module in found} - {"pdgw"})
    for top in tops:
        below = sorted({module.package for module in found if f"{module.package}.".startswith(f"{top}.")})
        if len(below) > 1:
            made.add_row(*_row(f"{top}.", found, f"{top.removeprefix('pdgw.')}/"))
        for package in below:
            made.add_row(*_row(package, found, package.removeprefix("pdgw.")))
    made.add_row(*_row("pdgw", found, "pdgw"))
    made.add_row(*_row("", found, "all"))
    return made


def _row(package: str, found: list[Module], title: str) -> tuple[str, ...]:
    """``package`` with a dot at its end includes its sub-packages; an empty name includes everything."""

    def within(name: str) -> bool:
        return not package or name == package or package.endswith(".") and f"{name}.".startswith(package)

    own = [module for module in found if within(module.package)]
    pairs = [within(target.partition(":")[0]) for module in own for target in module.imports]
    figures = len(own), sum(m.lines for m in own), sum(m.public for m in own), sum(pairs), len(pairs) - sum(pairs)
    return title, *map(str, figures)


if __name__ == "__main__":
    Console().print(table(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1]))
