"""Speed of ``pdgw timeline`` on a recording, its time to the first line, and its memory."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.long.bench.decoding.captures import AXES, write_recording

GOAL_FACTOR = 20.0
"""Goal: seconds of recording per second of CPU."""
_COMMAND = """
import sys
from pdgw.tools.cli import main
sys.argv = ["pdgw", "timeline", *sys.argv[1:]]
try:
    main()
finally:
    import resource
    usage = resource.getrusage(resource.RUSAGE_SELF)
    print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss, file=sys.stderr)
"""


@dataclass(frozen=True, slots=True)
class FollowSpeed:
    """Figures of one run of the command, including its start."""

    recorded_s: int
    cpu_s: float
    first_line_s: float
    """Wall clock time to the first line."""
    peak_mib: float

    @property
    def factor(self) -> float:
        """Seconds of recording per second of CPU."""
        return self.recorded_s / self.cpu_s


def run(seconds: int) -> FollowSpeed:
    """Run the timeline on a recording of four axes at 4 ms with this length."""
    with tempfile.TemporaryDirectory() as folder:
        files = write_recording(Path(folder), seconds)
        telegrams = ["--telegram", "1"] * AXES
        begin = time.perf_counter()
        with subprocess.Popen(
            [sys.executable, "-c", _COMMAND, *files, *telegrams],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            process.stdout.readline()
            first = time.perf_counter() - begin
            process.stdout.read()
            cpu, peak = process.stderr.read().split()[-2:]
    return FollowSpeed(seconds, float(cpu), first, int(peak) / 1024)
