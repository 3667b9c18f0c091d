"""``python -m tests.long.walk``: run all walks, print states, transitions and violations; exit status 1 with violations."""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from tests.long.walk import cases, handshakes
from tests.long.walk.search import Result


def _run(case: cases.Case | handshakes.Handshakes) -> tuple[Result, float]:
    """The result of a walk and the CPU time in seconds."""
    began = time.process_time()
    return case.run(), time.process_time() - began


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="walk", description="Walk every state of an axis, one walk on each processor."
    )
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--short", action="store_true", help="what the tests walk")
    which.add_argument("--all", action="store_true", help="all settings with all telegrams, homing and jog: in hours")
    parser.add_argument("--only", default="", help="walk only cases whose name contains this text")
    parser.add_argument("--figures", type=Path, help="write what was walked to this file")
    options = parser.parse_args()
    extent = {options.short: "short", options.all: "every"}.get(True, "selected")
    walks = [case for part in (cases, handshakes) for case in getattr(part, extent)() if options.only in case.name]
    broken = False
    figures = []
    with ProcessPoolExecutor() as pool:
        for case, (result, seconds) in zip(walks, pool.map(_run, walks), strict=True):
            print(*result.traces(), sep="\n", end="")
            broken = broken or bool(result.violations)
            figures.append(f"{case.name}: {result}\n")
            print(f"{figures[-1].strip()}, {seconds:.0f} s of CPU", flush=True)
    if options.figures is not None:
        options.figures.write_text("".join(figures), encoding="utf-8")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
