"""``python -m tests.long.bench [counts|exchange|profinet|stops|decode ...]`` (``make bench``): print the tables.

The exit status is 1 if a count is not about that of ``counts.toml``. ``--write`` makes the counts those of the file and of the
documents. ``--realtime``: all processes with real-time priority (Linux; root or CAP_SYS_NICE). ``--seconds``: time for each row.
"""

from __future__ import annotations

import argparse
import logging
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version

from rich.console import Console
from rich.table import Table

from pdgw.gateway.base.identity import interpreter, kind
from pdgw.tools.demo import namespaces
from tests.long.bench import counting, decoding, exchange, profinet, stops

_TABLES = ("counts", "exchange", "profinet", "stops", "decode")
_PRIORITY = 10


def _print(title: str, titles: Sequence[str], rows: Iterable[tuple[str, ...]]) -> None:
    table = Table(*titles, title=title)
    for row in rows:
        table.add_row(*row)
        print(*row, sep="\t", file=sys.stderr, flush=True)
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser("python -m tests.long.bench", description=__doc__)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=", ".join(_TABLES))
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--write", action="store_true", help="counts: write counts.toml and the documents")
    chosen = parser.parse_args()
    if unknown := set(chosen.tables) - set(_TABLES):
        parser.error(f"table {', '.join(sorted(unknown))}, allowed: {', '.join(_TABLES)}")
    names = chosen.tables or _TABLES
    policy, priority = (os.SCHED_FIFO, _PRIORITY) if chosen.realtime else (os.SCHED_BATCH, 0)
    os.sched_setscheduler(0, policy, os.sched_param(priority))  # the gateway keeps it
    if names == ["profinet"] and not namespaces.inside():
        namespaces.enter("tests.long.bench")
    facts = (version("profidrive-gateway"), kind(), interpreter(), platform.release(), platform.machine())
    today = datetime.now(UTC).date().isoformat()
    print(
        today,
        "pdgw",
        *facts,
        f"{os.cpu_count()} cores, {'real-time' if chosen.realtime else 'usual'} priority",
        flush=True,
    )
    found: dict[str, dict[str, float]] = {}
    if "counts" in names:
        _print("counts of a cycle, which no other work on the machine changes", counting.TITLES, counting.rows(found))
        if chosen.write and found:
            counting.write(found)
    if "exchange" in names:
        title = "cyclic exchange over UDP: until the answer is at the client"
        _print(title, exchange.TITLES, exchange.rows(chosen.seconds))
    if names == ["profinet"]:
        _print("PROFINET: period of the frames", profinet.TITLES, profinet.rows(chosen.seconds))
    elif "profinet" in names:
        options = ["--seconds", str(chosen.seconds)]
        subprocess.run([sys.executable, "-m", "tests.long.bench", "profinet", *options], check=False)
    if "stops" in names:
        logging.getLogger("gateway").disabled = True
        _print("stop times, virtual time", stops.TITLES, stops.rows(20))
    if "decode" in names:
        _print("decoder and timeline, start-up included", decoding.TITLES, decoding.rows(decoding.PACKETS))
    limits = counting.known()
    over = {name: more for name in found if name in limits and (more := counting.excess(found[name], limits[name]))}
    if over:
        sys.exit(f"not as {counting.LIMITS.name} says: {over}")


if __name__ == "__main__":
    main()
