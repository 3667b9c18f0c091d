"""``make long LONG=paused``: run a command and repeatedly pause (SIGSTOP) one or several of its processes.

A busy machine does the same, only more seldom: a test that fails here without a defect will fail there one day. The exit
status is the command's. Linux only. ``tests.thread_pauses`` pauses threads.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path

SHORTEST_GAP_S = 0.2
"""Shortest time between two pauses; the longest is five times that."""


def family(process: int) -> list[int]:
    """The process and all it has started, those of its children too."""
    found = [process]
    for member in found:
        with contextlib.suppress(OSError):  # ended meanwhile
            for task in Path(f"/proc/{member}/task").iterdir():
                found += [int(child) for child in (task / "children").read_text().split()]
    return found


def runs(process: int) -> bool:
    """Not ended, and not held up by the test itself."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "TtZX"


def send(processes: list[int], number: signal.Signals) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, number)


def hold_up(root: int, chance: random.Random, ended: threading.Event, longest_s: float) -> int:
    """Until ``ended``; how many pauses there were. Two of three are of one process, the others of any number of them at once."""
    pauses = 0
    while not ended.wait(SHORTEST_GAP_S * chance.uniform(1, 5)):
        members = family(root)
        number = 1 if chance.random() < 2 / 3 else chance.randint(1, len(members))
        held = [process for process in chance.sample(members, number) if runs(process)]
        if not held:
            continue
        try:
            send(held, signal.SIGSTOP)
            ended.wait(chance.uniform(0, longest_s))
        finally:
            send(held, signal.SIGCONT)
        pauses += 1
    return pauses


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.pauses")
    parser.add_argument("--longest", type=float, default=1.0, metavar="S", help="the longest pause, in seconds (1)")
    parser.add_argument("seed", type=int)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    ended = threading.Event()
    with subprocess.Popen(given.command) as process:
        threading.Thread(target=lambda: (process.wait(), ended.set()), name="end", daemon=True).start()
        pauses = hold_up(process.pid, random.Random(given.seed), ended, given.longest)
    print(f"seed {given.seed}: {pauses} pauses of up to {given.longest:g} s")
    return process.returncode


if __name__ == "__main__":
    sys.exit(main())
