"""``pdgw soak``: days of random faults in virtual time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from pdgw.durations import SECOND
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.errors import GatewayError
from pdgw.tools.soak.life import PART_NS, Life
from pdgw.tools.soak.trace import clock
from pdgw.tools.soak.watch import ViolationError

_HOUR_NS = 3600 * SECOND
_GROWTH_KIB = 64 * 1024
"""More memory than after the first parts is a leak."""
_SETTLED_PARTS = 3


def soak(
    hours: Annotated[float, typer.Option(min=0.001, max=100_000, help="How long, in hours of virtual time.")] = 24,
    seed: Annotated[int, typer.Option(help="Decides everything that is left to chance.")] = 1,
    axes: Annotated[int, typer.Option(min=1, max=8, help="Number of axes.")] = 1,
    telegrams: Annotated[str, typer.Option(help="Telegrams of the axes in turn, for example 1,9.")] = "1",
    until: Annotated[
        float | None, typer.Option(min=0, help="Play only up to this second of the day, from the last power-on before.")
    ] = None,
    trace: Annotated[
        bool, typer.Option("--trace", help="With --until: print what happened before, with all CAN frames.")
    ] = False,
) -> None:
    """Play a day of random PLC words and faults in virtual time; exit status 1 if what must never happen did.

    The same seed is the same day. After a failure: `pdgw soak --seed N --until SECOND --trace` shows the moment.
    """
    numbers = _numbers(telegrams, axes)
    if trace and until is None:
        raise GatewayError("--trace: only with --until: what happened before a moment of the day")
    console = Console()
    if until is not None:
        _play_until(console, seed, int(until * SECOND), numbers, frames=trace)
        return
    end = int(hours * _HOUR_NS)
    starts = 0
    memory = 0
    bar = Progress(
        TextColumn("{task.fields[clock]}"), BarColumn(), TextColumn("{task.fields[starts]} starts"), TimeRemainingColumn(),
        console=console,
    )  # fmt: skip
    with bar:
        task = bar.add_task("", total=end, clock=clock(0), starts=0)
        for part in range(-(-end // PART_NS)):
            life = Life(seed, part, numbers)

            def show(now: int, life: Life = life, before: int = starts) -> None:
                bar.update(task, completed=now, clock=clock(now), starts=before + life.starts)

            try:
                life.play(min(end, (part + 1) * PART_NS), show)
                if part == _SETTLED_PARTS:
                    memory = _memory()
                elif part > _SETTLED_PARTS and _memory() > memory + _GROWTH_KIB:
                    raise ViolationError(f"memory grew by {(_memory() - memory) // 1024} MiB")
            except ViolationError as violation:
                bar.stop()
                _fail(console, life, violation, seed, numbers)
            starts += life.starts
            life.close()
    console.print(f"{clock(end)} h of seed {seed}: {starts} starts, nothing that must not happen")


def _memory() -> int:
    """The most this process has had, KiB; 0 where the system does not tell."""
    try:
        import resource  # noqa: PLC0415 (not there on Windows)
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _numbers(telegrams: str, axes: int) -> list[int]:
    known = list(DRIVE_TELEGRAM_NUMBERS)
    try:
        chosen = [int(text) for text in telegrams.split(",")]
    except ValueError:
        chosen = [-1]
    if not set(chosen) <= set(known):
        raise GatewayError(f"--telegrams {telegrams}: expected numbers with commas between, of {known}")
    return [chosen[number % len(chosen)] for number in range(axes)]


def _play_until(console: Console, seed: int, until: int, numbers: Sequence[int], *, frames: bool) -> None:
    life = Life(seed, max(0, until - 1) // PART_NS, numbers, frames=frames)
    try:
        life.play(until)
    except ViolationError as violation:
        _fail(console, life, violation, seed, numbers)
    if frames:
        _print_lines(console, life)
    console.print(f"{clock(life.loop.now())} of seed {seed}: nothing that must not happen")


def _fail(console: Console, life: Life, violation: ViolationError, seed: int, numbers: Sequence[int]) -> NoReturn:
    _print_lines(console, life)
    now = life.loop.now()
    again = (
        f"--axes {len(numbers)} --telegrams {','.join(map(str, numbers))} --until {now / SECOND + 0.001:.3f} --trace"
    )
    console.print(f"[red]{clock(now)}[/red] {violation}", highlight=False)
    console.print(f"pdgw soak --seed {seed} {again}", highlight=False, soft_wrap=True)
    raise typer.Exit(1)


def _print_lines(console: Console, life: Life) -> None:
    for line in life.trace.lines:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
