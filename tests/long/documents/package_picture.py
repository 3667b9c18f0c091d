"""The packages as a picture in architecture.md: an arrow to each package that one imports, and that no other arrow leads to."""

from __future__ import annotations

from typing import Final

from tests.test_package_imports import ROWS

PLACE: Final = ("architecture.md", "packages")
_OPEN: Final = ("gateway", "tools")
"""Folders that are drawn with their packages. Their own modules are one box."""


def generate() -> str:
    """A Mermaid diagram of the rows that the test of imports holds."""
    imported = _imported()
    lines = ["```mermaid", "flowchart TD"]
    for folder in _OPEN:
        lines += [f'    subgraph {folder}_folder ["{folder}/"]', f'        {folder}["*.py"]']
        lines += [
            f"        {_node(item)}[{item.partition('.')[2]}]" for item in sorted(imported) if _inside(item, folder)
        ]
        lines.append("    end")
    for package, others in sorted(imported.items()):
        beyond = set().union(*(_below(imported, other) for other in others))
        lines += [f"    {_node(package)} --> {_node(other)}" for other in sorted(others - beyond)]
    return "\n".join([*lines, "```"]) + "\n"


def _imported() -> dict[str, set[str]]:
    """The packages of the picture with those they import. Single modules of an open folder are left out."""
    imported: dict[str, set[str]] = {}
    for package, row in ROWS.items():
        drawn = imported.setdefault(_drawn(package), set())
        drawn |= {_drawn(item) for item in row.split() if item in ROWS or _drawn(item) not in _OPEN}
    for folder in _OPEN:
        imported[folder] |= {package for package in imported if _inside(package, folder)}
    return {package: others - {package} for package, others in imported.items()}


def _drawn(name: str) -> str:
    """The package of the picture that a package or module belongs to."""
    top, _, rest = name.partition(".")
    package = f"{top}.{rest.partition('.')[0]}"
    return package if top in _OPEN and package in ROWS else top


def _inside(package: str, folder: str) -> bool:
    return package.startswith(f"{folder}.")


def _below(imported: dict[str, set[str]], package: str) -> set[str]:
    """Every package that a package imports directly or through others."""
    return imported[package].union(*(_below(imported, other) for other in imported[package]))


def _node(package: str) -> str:
    return package.replace(".", "_")
