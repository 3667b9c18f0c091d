"""The optional part of the build: ``PDGW_COMPILED=1`` compiles the modules of the cyclic path by mypyc.

Everything else is declared in pyproject.toml. The compiled modules are the same typed sources, which stay in the wheel; without
them it is complete too.
"""

from __future__ import annotations

import os
import shutil
import tomllib
from pathlib import Path
from typing import Any

from setuptools import setup

COMPILED = (
    "ds301/can_frame.py",
    "ds301/pdo.py",
    "dsp402/images.py",
    "dsp402/pdo.py",
    "dsp402/states.py",
    "gateway/axis/**/[!_]*.py",
    "gateway/motion/[!_]*.py",
    "gateway/transport/confirmation.py",
    "gateway/transport/cyclic.py",
    "gateway/transport/sequence.py",
    "profidrive/frame.py",
    "profidrive/signals.py",
    "profidrive/telegrams.py",
    "profidrive/words.py",
)
"""Patterns of what every cycle runs through. Traps: an enum with an ``__init__``, a class derived from an untyped library's, an
interpreted class derived from a compiled one, a value of another type than declared."""
TREE = Path("build/mypyc")
WANTED = os.environ.get("PDGW_COMPILED") == "1"


def extensions() -> list[Any]:
    """The extension modules."""
    try:
        from mypyc.build import mypycify  # noqa: PLC0415
    except ImportError:
        return []  # asked for below; then this file runs again
    # mypyc names a module by its path: the rooms, by links, where the package has them.
    shutil.rmtree(TREE, ignore_errors=True)
    package = TREE / "pdgw"
    package.mkdir(parents=True)
    folders = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-dir"]
    for path in [*Path("pdgw").glob("*.py"), *map(Path, set(folders.values()) - {"pdgw"})]:
        (package / path.name).symlink_to(path.resolve())
    options = ["--config-file=", "--strict", "--follow-imports=silent", "--ignore-missing-imports"]
    made: list[Any] = mypycify(
        [*options, *(str(package / file) for pattern in COMPILED for file in sorted(Path().glob(pattern)))],
        group_name="pdgw.compiled",
    )
    return made


setup(
    setup_requires=["mypy>=1.13"] if WANTED else [],
    ext_modules=extensions() if WANTED else [],
)
