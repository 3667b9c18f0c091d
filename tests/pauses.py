"""``make test-paused``: a command while, one after the other, a process of it is held up (SIGSTOP) for up to a second.

So does a busy machine, only more seldom: what fails here for another reason than its defect will fail there one day. Arguments: a
seed, then the command. Its exit status is the command's. Linux only. ``tests.thread_pauses`` does it to threads.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path

LONGEST_S = 1.0
SHORTEST_GAP_S = 0.2
"""Between two pauses everything runs for so long, and up to five times that."""


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


def hold_up(root: int, chance: random.Random, ended: threading.Event) -> int:
    """Until ``ended``; how many pauses there were."""
    pauses = 0
    while not ended.wait(SHORTEST_GAP_S * chance.uniform(1, 5)):
        process = chance.choice(family(root))
        if not runs(process):
            continue
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGSTOP)
            try:
                ended.wait(chance.uniform(0, LONGEST_S))
            finally:
                os.kill(process, signal.SIGCONT)
            pauses += 1
    return pauses


def main(seed: int, command: list[str]) -> int:
    ended = threading.Event()
    with subprocess.Popen(command) as process:
        threading.Thread(target=lambda: (process.wait(), ended.set()), name="end", daemon=True).start()
        pauses = hold_up(process.pid, random.Random(seed), ended)
    print(f"seed {seed}: {pauses} pauses of up to {LONGEST_S:g} s")
    return process.returncode


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
