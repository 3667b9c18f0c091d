"""``python -m tests.long.counts.instructions``: processor instructions of an axis cycle, counted by callgrind.

Two runs of different length under valgrind; their difference is the cost of the cycles. Prints a line for each telegram. The
exit status is 1, with the functions that grew, if a count is above the golden one. The golden counts are valid for one
interpreter and processor; on others they are only printed.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from pdgw.gateway.service.build import build_text, interpreter
from tests.long.bench.translation import axis_cycle
from tests.long.counts.golden import exceeded, golden

TELEGRAMS = (1,)
_SHORT, _LONG = 256, 1280
_SMALL = 200
"""Functions with fewer instructions are added up."""
_PARTS = 12
_FUNCTION = re.compile(r"c?fn=\((\d+)\)(?: (.*))?")


def main() -> int:
    """Count, print and compare."""
    if sys.argv[1:]:
        cycle = axis_cycle(int(sys.argv[1]))
        for _ in range(int(sys.argv[2])):
            cycle()
        return 0
    if shutil.which("valgrind") is None:
        print("valgrind is not installed: the instructions of an axis cycle are not counted")
        return 0
    about = f"{interpreter()}, {platform.machine()}"
    known = golden()["instructions"].get(about, {})
    print(f"{build_text()}, {platform.machine()}")
    bad = False
    for number in TELEGRAMS:
        found = counted(number)
        wanted = known.get(str(number))
        print(f"telegram {number}: {sum(found.values()):.0f} instructions of an axis cycle")
        if wanted is None:
            print(f"no golden count for {about}; the largest parts:")
        text = exceeded(f"telegram {number}, instructions", found, wanted) if wanted else ""
        bad |= bool(text)
        print(text or "\n".join(f"  {name} = {count:.0f}" for name, count in Counter(found).most_common(_PARTS)))
    return int(bad)


def counted(number: int) -> dict[str, float]:
    """Instructions of one axis cycle by function of the interpreter. Small functions are added up."""
    few, many = (_instructions(number, cycles) for cycles in (_SHORT, _LONG))
    found = {name: (many[name] - few[name]) / (_LONG - _SHORT) for name in many}
    parts = {name: count for name, count in found.items() if count >= _SMALL}
    return parts | {"others": sum(found.values()) - sum(parts.values())}


def _instructions(number: int, cycles: int) -> Counter[str]:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "callgrind.out"
        command = [
            "valgrind",
            "--tool=callgrind",
            "--quiet",
            f"--callgrind-out-file={out}",
            sys.executable,
            "-m",
            __spec__.name,
        ]
        environment = os.environ | {"PYTHONHASHSEED": "0"}
        subprocess.run([*command, str(number), str(cycles)], check=True, env=environment)
        return parse(out.read_text(encoding="utf-8", errors="replace"))


def parse(text: str) -> Counter[str]:
    """Instructions by function from a callgrind file, without those of called functions."""
    names: dict[str, str] = {}
    counts: Counter[str] = Counter()
    current, called = "", False
    for line in text.splitlines():
        match = _FUNCTION.match(line)
        if match is not None:
            names.setdefault(match[1], match[2] or "")
            if line.startswith("fn"):
                current = names[match[1]]
        elif line.startswith("calls="):
            called = True  # the next line has the cost of the called function
        elif line[:1] in "0123456789+-*" and line:
            if not called:
                counts[current] += int(line.split()[1])
            called = False
    return counts


if __name__ == "__main__":
    sys.exit(main())
