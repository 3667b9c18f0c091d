"""The modules of the axis machine stay small; ``tests/test_loading.py`` holds them pure."""

from __future__ import annotations

import pkgutil
from pathlib import Path

import pytest

from pdgw.gateway import axis

MODULES = sorted(module.name for module in pkgutil.walk_packages(axis.__path__, axis.__name__ + "."))
LINES = 500


@pytest.mark.parametrize("module", MODULES)
def test_no_module_of_the_axis_machine_is_long(module: str) -> None:
    path = Path(axis.__path__[0]).joinpath(*module.removeprefix(axis.__name__ + ".").split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    assert len(source.read_text().splitlines()) <= LINES
