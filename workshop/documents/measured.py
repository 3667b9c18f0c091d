"""``python -m pdgw.workshop.documents.measured``: write ``gateway/service/measured.toml`` from ``docs/measured``."""

from __future__ import annotations

import re
from pathlib import Path

from pdgw.gateway.service.build import COMPILED, PURE
from pdgw.gateway.service.measured import PATH, Row

_FOLDER = Path(__file__).parents[2] / "docs" / "measured"
SOURCES = {PURE: "exchange-realtime.txt", COMPILED: "exchange-compiled-realtime.txt"}
MISSED_PERCENT = 0.1
"""Rows of the benchmark with a higher share of missed cycles are ignored."""
_FIRST = re.compile(r"│ (\d+) +│ ([\d.]+) ms +│")
_GATEWAY = re.compile(r"│ +│ +│ gateway +│.*│ ([\d.]+) % │")


def rows(text: str) -> list[Row]:
    """The axes and cycle times that a measured gateway has reached, without rows included in a better one."""
    found: list[Row] = []
    place: Row | None = None
    for printed in text.splitlines():
        line = " ".join(printed.split())  # columns of a fixed width are padded with blanks
        if match := _FIRST.match(line):
            place = int(match[1]), float(match[2])
        elif place is not None and (match := _GATEWAY.match(line)):
            if float(match[1]) <= MISSED_PERCENT:
                found.append(place)
            place = None
    return sorted(
        {(n, ms) for n, ms in found if not any((n, ms) != (m, c) and n <= m and ms >= c for m, c in found)},
        key=lambda row: row[1],
    )


def generate() -> str:
    """Generate the file."""
    lines = [
        "# Axes and cycle times with at most 0.1 % of the cycles missed, at real-time priority on the machine of docs/measured.",
        "# Written by `make docs`.",
    ]
    for build, name in SOURCES.items():
        for axes, cycle_ms in rows((_FOLDER / name).read_text(encoding="utf-8")):
            lines += ["", f'[["{build}"]]', f"axes = {axes}", f"cycle_ms = {cycle_ms:g}"]
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    PATH.write_text(generate(), encoding="utf-8")
