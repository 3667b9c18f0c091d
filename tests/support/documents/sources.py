"""The packages and their sources as syntax trees, for tests of imports and classes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
ROOMS = sorted(file.parent.name for file in ROOT.glob("[!.]*/__init__.py") if file.parent.name != "tests")
"""Folders of the repository that are installed: ``pdgw`` and its sub-packages."""
QUOTED = "|".join(rf"{mark}(?:\\[\s\S]|(?!{mark})[^\\])*{mark}" for mark in ('"""', "'''", '"', "'"))
"""A string of Python without its prefix, as a pattern."""
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


def statements(file: Path) -> Iterator[ast.AST]:
    """Every statement of a file, wherever in it; expressions, most of a tree, are not walked."""
    return within(ast.parse(file.read_text(encoding="utf-8")))


def within(node: ast.AST) -> Iterator[ast.AST]:
    """Every statement of a tree."""
    for block in _BLOCKS:
        for child in getattr(node, block, ()):
            yield child
            yield from within(child)
