"""Read the counts of ``golden.toml`` and compare with them."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("golden.toml")
TOLERANCE = 0.05
"""Tolerated share above the golden count."""
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"


def golden() -> dict[str, Any]:
    """The golden counts by kind. Those that depend on the interpreter have its version below the kind."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


def exceeded(name: str, found: Mapping[str, float], wanted: Mapping[str, float]) -> str:
    """Empty, or a text if the sum of the parts is too large: the parts that grew, the largest growth first."""
    now, before = sum(found.values()), sum(wanted.values())
    if now <= before * (1 + TOLERANCE):
        return ""
    growth = {part: found.get(part, 0) - wanted.get(part, 0) for part in {**wanted, **found}}
    parts = sorted((part for part, more in growth.items() if more > 0), key=lambda part: -growth[part])
    lines = [f"  {part}: {wanted.get(part, 0):g} -> {found[part]:g}" for part in parts]
    return "\n".join([f"{name}: {now:g}, allowed: {before:g} + {TOLERANCE:.0%}; what grew:", *lines])
