"""``python -m tests.long.counts.write``: count again and write ``golden.toml``, after a change that is worth its cost."""

from __future__ import annotations

import platform
import shutil
from collections.abc import Mapping

from pdgw.gateway.service.build import interpreter
from tests.long.counts import exchange
from tests.long.counts.axis_cycle import TELEGRAMS, bytecodes, peak_bytes
from tests.long.counts.golden import FILE, PYTHON
from tests.long.counts.instructions import TELEGRAMS as COUNTED
from tests.long.counts.instructions import counted


def main() -> None:
    """Write the counts of this Python version. Those of other versions are removed."""
    lines = [
        "# Golden counts of one cycle, written by `python -m tests.long.counts.write`. A count may be 5 % larger.",
        "",
    ]
    for axes in exchange.AXES:
        lines += _table("system_calls", str(axes), exchange.system_calls(axes))
    for axes in exchange.AXES:
        lines += _table(f'exchange."{PYTHON}"', str(axes), exchange.bytecodes(axes))
    for number in TELEGRAMS:
        lines += _table(f'bytecodes."{PYTHON}"', str(number), bytecodes(number))
    lines += _table(f'peak_bytes."{PYTHON}"', "", {str(number): peak_bytes(number) for number in TELEGRAMS})
    if shutil.which("valgrind"):
        about = f"{interpreter()}, {platform.machine()}"
        for number in COUNTED:
            lines += _table(f'instructions."{about}"', str(number), counted(number))
    FILE.write_text("\n".join(lines), encoding="utf-8")


def _table(kind: str, name: str, parts: Mapping[str, float]) -> list[str]:
    """A table of TOML, the largest part first."""
    heading = f"[{kind}.{name}]" if name else f"[{kind}]"
    rows = sorted(parts.items(), key=lambda item: (-item[1], item[0]))
    return [heading, *(f'"{part}" = {round(count, 2):g}' for part, count in rows), ""]


if __name__ == "__main__":
    main()
