"""``python -m tests.long.soak``: days of random faults, and calm days, in virtual time; exit status 1 if a rule is broken.

The same seed gives the same day. After a failure the command prints the command that repeats the time before it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence

from pdgw.base.durations import SECOND
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from tests.long.soak.calm import CALM_TELEGRAMS, CalmRun, draw_calm
from tests.long.soak.plan import draw_plan, parts
from tests.long.soak.planted import DEFECTS, search
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.trace import clock
from tests.long.soak.watch import ViolationError

_HOUR_NS = 3600 * SECOND
_GROWTH_KIB = 16 * 1024
"""Growth of the memory after the first hour that counts as a leak."""


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.long.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=24, help="duration in hours of virtual time")
    parser.add_argument("--seed", type=int, default=1, help="decides everything that is left to chance")
    parser.add_argument("--axes", type=int, choices=range(1, 9), default=2, help="number of axes")
    parser.add_argument("--telegrams", default="", help="of the axes in turn: 1,9; without it each axis draws its own")
    parser.add_argument(
        "--until", type=float, help="run only up to this second; print what happened, with all CAN frames"
    )
    parser.add_argument("--calm", action="store_true", help="no faults, one day of each telegram")
    parser.add_argument("--replay", action="store_true", help="record each part, and replay it without a difference")
    parser.add_argument("--planted", action="store_true", help="print when the soak finds each planted defect")
    options = parser.parse_args(arguments)
    known = CALM_TELEGRAMS if options.calm else DRIVE_TELEGRAM_NUMBERS
    chosen = options.telegrams.split(",") if options.telegrams else []
    if not set(chosen) <= set(map(str, known)):
        parser.error(f"--telegrams {options.telegrams}: expected numbers with commas between, of {list(known)}")
    options.telegrams = list(map(int, chosen))
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line. Returns the exit status."""
    options = _options(arguments)
    if options.planted:
        return _search(options.seed, options.axes)
    end = int(options.hours * _HOUR_NS) if options.until is None else max(1, int(options.until * SECOND))
    days = [[number] for number in options.telegrams or CALM_TELEGRAMS] if options.calm else [options.telegrams]
    done = "tasks" if options.calm else "starts"
    print(f"| telegrams | virtual hours | {done} | violations | virtual s per CPU s | MiB |\n{'| --- ' * 6}|")
    for numbers in days:
        begun, count, memory, steps = time.process_time(), 0, 0, 0
        for run, stop in _runs(options, numbers, end):
            try:
                run.run_to(stop)
                steps += run.replayed()
                memory = memory or (_memory() if stop > _HOUR_NS else 0)
                if memory and _memory() > memory + _GROWTH_KIB:
                    raise ViolationError(f"memory grew by {(_memory() - memory) // 1024} MiB after the first hour")
            except ViolationError as violation:
                _report(options, numbers, run, violation)
                return 1
            if options.until is not None:
                print(*run.trace.lines, sep="\n")
            count += run.tasks if isinstance(run, CalmRun) else run.starts
            run.close()
        speed = end / SECOND / (time.process_time() - begun)
        chosen = ",".join(map(str, numbers)) or "all"
        print(f"| {chosen} | {end / _HOUR_NS:g} | {count} | 0 | {speed:.0f} | {_memory() // 1024} |", flush=True)
        if options.replay:
            print(f"{steps} steps replayed without a difference")
    return 0


def _runs(options: argparse.Namespace, numbers: Sequence[int], end: int) -> Iterator[tuple[SoakRun, int]]:
    """The parts of a day up to its end, each with its own end; with ``--until`` only the last."""
    axes, draw = (1, draw_calm) if options.calm else (options.axes, draw_plan)
    for part in parts(options.seed, axes, numbers, draw):
        if options.until is None or part.end >= end:
            frames = options.until is not None
            records = options.replay
            calm = CalmRun(part, frames=frames, records=records) if options.calm else None
            run = calm or SoakRun(part, keep_telegrams=bool(numbers), frames=frames, records=records)
            yield run, min(end, part.end)
        if part.end >= end:
            return


def _report(options: argparse.Namespace, numbers: Sequence[int], run: SoakRun, violation: ViolationError) -> None:
    print(run.plan, *run.trace.lines, sep="\n")
    now = run.loop.now()
    chosen = f" --telegrams {','.join(map(str, numbers))}" if numbers else ""
    day = f"{'--calm' if options.calm else f'--axes {options.axes}'}{chosen}"
    print(f"{clock(now)} {violation}")
    print(f"python -m tests.long.soak --seed {options.seed} {day} --until {now / SECOND + 0.001:.3f}")


def _search(seed: int, axes: int) -> int:
    """Print the table of planted defects. Exit status 1 when one is not found."""
    print("| what is broken | found after (virtual time) | by |\n| --- | --- | --- |")
    missed = 0
    for text in DEFECTS:
        found = search(text, seed, axes)
        missed += found.time_ns is None
        after = "not found" if found.time_ns is None else f"{found.time_ns / SECOND:.0f} s"
        print(f"| {text} | {after} | {found.message} |", flush=True)
    return int(missed > 0)


def _memory() -> int:
    """Peak memory of this process in KiB; 0 where the system has no figure."""
    try:
        import resource  # noqa: PLC0415 (not there on Windows)
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    sys.exit(main())
