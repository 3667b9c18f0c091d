"""``python -m tests.long soak``: days of random faults, and calm days, in virtual time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import takewhile
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pdgw.durations import SECOND
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.errors import GatewayError
from tests.long.documents.markdown import table
from tests.long.soak.calm import CALM_TELEGRAMS, CalmRun, draw_calm
from tests.long.soak.plan import Part, parts
from tests.long.soak.planted import DEFECTS, search
from tests.long.soak.soak_run import SoakRun
from tests.long.soak.trace import clock
from tests.long.soak.watch import ViolationError

_HOUR_NS = 3600 * SECOND
_GROWTH_KIB = 16 * 1024
"""Growth of the memory after the first hour that counts as a leak."""


def soak(
    hours: Annotated[float, typer.Option(min=0.001, max=100_000, help="Duration in hours of virtual time.")] = 24,
    seed: Annotated[int, typer.Option(help="Decides everything that is left to chance.")] = 1,
    axes: Annotated[int, typer.Option(min=1, max=8, help="Number of axes.")] = 2,
    telegrams: Annotated[
        str, typer.Option(help="Telegrams of the axes in turn, for example 1,9. Without it each axis draws its own.")
    ] = "",
    until: Annotated[
        float | None, typer.Option(min=0, help="Run only up to this second of the day, from the last power-on before.")
    ] = None,
    trace: Annotated[
        bool, typer.Option("--trace", help="With --until: print what happened before, with all CAN frames.")
    ] = False,
    calm: Annotated[
        bool,
        typer.Option("--calm", help="No faults, and a PLC that asks for nothing wrong; each telegram has its own day."),
    ] = False,
    planted: Annotated[
        bool, typer.Option("--planted", help="Plant defects in the gateway and print when the soak finds each.")
    ] = False,
) -> None:
    """Run a day of random PLC words and faults in virtual time; exit status 1 if a rule is violated.

    The same seed gives the same day. After a failure, `soak --seed N --until SECOND --trace` shows the time before it.
    """
    numbers = _numbers(telegrams, CALM_TELEGRAMS if calm else DRIVE_TELEGRAM_NUMBERS)
    if trace and until is None:
        raise GatewayError("--trace: only with --until: what happened before a moment of the day")
    console = Console()
    if planted:
        _search(seed, axes)
    elif until is not None:
        _play_until(console, seed, int(until * SECOND), axes, numbers, frames=trace, calm=calm)
    elif calm:
        _run_calm(console, seed, int(hours * _HOUR_NS), numbers or CALM_TELEGRAMS)
    else:
        _play(console, seed, int(hours * _HOUR_NS), axes, numbers)


def _play(console: Console, seed: int, end: int, axes: int, numbers: Sequence[int]) -> None:
    starts = memory = 0
    begun, used = time.monotonic(), time.process_time()
    bar = Progress(
        TextColumn("{task.fields[clock]}"), BarColumn(), TextColumn("{task.fields[starts]} starts"), TimeRemainingColumn(),
        console=console,
    )  # fmt: skip
    with bar:
        task = bar.add_task("", total=end, clock=clock(0), starts=0)
        for part in _parts(seed, axes, numbers, end):
            soak_run = SoakRun(part, keep_telegrams=bool(numbers))

            def show(now: int, soak_run: SoakRun = soak_run, before: int = starts) -> None:
                bar.update(task, completed=now, clock=clock(now), starts=before + soak_run.starts)

            try:
                soak_run.play(min(end, part.end), show)
                if not memory and part.end > _HOUR_NS:
                    memory = _memory()
                elif memory and _memory() > memory + _GROWTH_KIB:
                    raise ViolationError(f"memory grew by {(_memory() - memory) // 1024} MiB")
            except ViolationError as violation:
                bar.stop()
                _fail(console, soak_run, violation, seed, axes, numbers)
            starts += soak_run.starts
            soak_run.close()
    console.print(f"{clock(end)} h of seed {seed}: {starts} starts, nothing that must not happen")
    used, passed = time.process_time() - used, time.monotonic() - begun
    console.print(
        f"{end / SECOND / used:.0f} virtual seconds in a second of CPU ({used:.0f} s of CPU in {passed:.0f} s); "
        f"memory {_memory() // 1024} MiB, after the first hour {memory // 1024} MiB",
        highlight=False,
    )


def _run_calm(console: Console, seed: int, end: int, numbers: Sequence[int]) -> None:
    """Print the table of calm days; exit status 1 at the first violation."""
    typer.echo(table(("telegram", "virtual hours", "tasks", "violations", "virtual s per CPU s"), ()), nl=False)
    for number in numbers:
        tasks, used = 0, time.process_time()
        for part in takewhile(lambda part: part.begin < end, parts(seed, 1, [number], draw_calm)):
            run = CalmRun(part)
            try:
                run.play(min(end, part.end))
            except ViolationError as violation:
                _fail(console, run, violation, seed, 1, [number])
            tasks += run.tasks
            run.close()
        speed = end / SECOND / (time.process_time() - used)
        typer.echo(f"| {number} | {end / _HOUR_NS:g} | {tasks} | 0 | {speed:.0f} |")


def _search(seed: int, axes: int) -> None:
    """Print the table of planted defects; exit status 1 when one is not found."""
    typer.echo(table(("what is broken", "found after (virtual time)", "by"), ()), nl=False)
    missed = 0
    for name, defect in DEFECTS.items():
        found = search(name, seed, axes)
        missed += found.time_ns is None
        after = "not found" if found.time_ns is None else f"{found.time_ns / SECOND:.0f} s"
        typer.echo(f"| {defect.text} | {after} | {found.message} |")
    if missed:
        raise typer.Exit(1)


def _memory() -> int:
    """Peak memory of this process in KiB; 0 where the system has no figure."""
    try:
        import resource  # noqa: PLC0415 (not there on Windows)
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _numbers(telegrams: str, known: Sequence[int]) -> list[int]:
    if not telegrams:
        return []
    try:
        chosen = [int(text) for text in telegrams.split(",")]
    except ValueError:
        chosen = [-1]
    if not set(chosen) <= set(known):
        raise GatewayError(f"--telegrams {telegrams}: expected numbers with commas between, of {list(known)}")
    return chosen


def _parts(seed: int, axes: int, numbers: Sequence[int], end: int) -> Iterator[Part]:
    """The parts of the day up to this time."""
    return takewhile(lambda part: part.begin < max(end, 1), parts(seed, axes, numbers))


def _play_until(
    console: Console, seed: int, until: int, axes: int, numbers: Sequence[int], *, frames: bool, calm: bool
) -> None:
    if calm:
        *_, part = takewhile(lambda part: part.begin < max(until, 1), parts(seed, 1, numbers, draw_calm))
        soak_run: SoakRun = CalmRun(part, frames=frames)
    else:
        *_, part = _parts(seed, axes, numbers, until)
        soak_run = SoakRun(part, keep_telegrams=bool(numbers), frames=frames)
    try:
        soak_run.play(until)
    except ViolationError as violation:
        _fail(console, soak_run, violation, seed, axes, numbers)
    if frames:
        _print_lines(console, soak_run)
    console.print(f"{clock(soak_run.loop.now())} of seed {seed}: nothing that must not happen")


def _fail(
    console: Console, soak_run: SoakRun, violation: ViolationError, seed: int, axes: int, numbers: Sequence[int]
) -> NoReturn:
    _print_lines(console, soak_run)
    now = soak_run.loop.now()
    chosen = f" --telegrams {','.join(map(str, numbers))}" if numbers else ""
    life = "--calm" if isinstance(soak_run, CalmRun) else f"--axes {axes}"
    again = f"{life}{chosen} --until {now / SECOND + 0.001:.3f} --trace"
    console.print(f"[red]{clock(now)}[/red] {violation}", highlight=False)
    console.print(f"python -m tests.long soak --seed {seed} {again}", highlight=False, soft_wrap=True)
    raise typer.Exit(1)


def _print_lines(console: Console, soak_run: SoakRun) -> None:
    console.print(f"cycle {soak_run.plan.cycle_ms} ms", highlight=False)
    for number, axis in enumerate(soak_run.plan.axes, 1):
        console.print(f"axis {number}: {axis}", highlight=False, soft_wrap=True)
    for line in soak_run.trace.lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
