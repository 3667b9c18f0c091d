"""``python -m pdgw.workshop.walk``: run all walks, print states, transitions and violations; exit status 1 with violations."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from pdgw.workshop.walk.cases import every, full, selected, short


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="walk", description="Walk every state of an axis.")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--short", action="store_true", help="what the tests walk")
    which.add_argument("--all", action="store_true", help="every telegram, in minutes")
    which.add_argument(
        "--full", action="store_true", help="all choices with all telegrams in the full alphabet, in hours"
    )
    parser.add_argument("--only", default="", help="walk only cases whose name contains this text")
    parser.add_argument("--figures", type=Path, help="write what was walked to this file")
    options = parser.parse_args()
    broken = False
    figures = []
    chosen = {options.short: short, options.all: every, options.full: full}.get(True, selected)
    for case in chosen():
        if options.only not in case.name:
            continue
        began = time.process_time()
        result = case.run()
        for violation in result.violations.values():
            print(violation)
        if result.stuck is not None:
            print(f"does not come to {result.stuck.wanted}: {result.stuck.drive}, {result.stuck.output}")
        broken = broken or bool(result.violations) or result.stuck is not None
        figures.append(f"{case.name}: {result}\n")
        print(figures[-1].strip() + f", {time.process_time() - began:.0f} s of CPU", flush=True)
    if options.figures is not None:
        options.figures.write_text("".join(figures), encoding="utf-8")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
