"""The numbers of axes and cycle times that each build was measured with, and whether a configuration is beyond them.

The figures are in ``measured.toml``, from the measurements of ``docs/measured``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from pdgw.gateway.service.build import kind
from pdgw.phrases import counted

PATH: Final = Path(__file__).with_name("measured.toml")
Row = tuple[int, float]
"""Number of axes and cycle time in milliseconds that were measured with at most 0.1 % of the cycles missed."""


def beyond_measured(axes: int, cycle_ms: float, build: str | None = None) -> str:
    """Empty, or one line: no measurement of this build (``build``: another one) had as many axes in as short a cycle."""
    document = tomllib.loads(PATH.read_text(encoding="utf-8"))
    build = kind() if build is None else build
    rows: Sequence[Row] = [(row["axes"], row["cycle_ms"]) for row in document[build]]
    if any(axes <= most and cycle_ms >= shortest for most, shortest in rows):
        return ""
    best = ", ".join(f"{most} at {shortest:g} ms" for most, shortest in rows)
    return (
        f"{counted(axes, 'axis', 'axes')} at {cycle_ms:g} ms: beyond what this build ({build}) was measured for; "
        f"measured axes: {best}. Watch the missed cycles with pdgw status"
    )
