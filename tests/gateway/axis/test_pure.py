"""The axis machine is pure: it can be imported where no bus, socket, clock, thread or log exists, and its modules stay small."""

from __future__ import annotations

import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

from pdgw.gateway import axis

IMPURE = ("can", "canopen", "threading", "time", "socket", "selectors", "logging", "asyncio", "queue", "subprocess")
MODULES = sorted(module.name for module in pkgutil.walk_packages(axis.__path__, axis.__name__ + "."))
LINES = 500


@pytest.mark.e2e
def test_no_module_of_the_axis_machine_brings_the_outside_along() -> None:
    code = f"import sys; sys.modules.update(dict.fromkeys({IMPURE!r})); import {', '.join(MODULES)}"
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("module", MODULES)
def test_no_module_of_the_axis_machine_is_long(module: str) -> None:
    path = Path(axis.__path__[0]).joinpath(*module.removeprefix(axis.__name__ + ".").split("."))
    source = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    assert len(source.read_text().splitlines()) <= LINES
