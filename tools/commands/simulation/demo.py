"""``pdgw demo``."""

from __future__ import annotations

import sys
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdgw.base.extras import missing
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.demo.chapters import CHAPTERS
from pdgw.tools.options import end_as_by_ctrl_c

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live
    from rich.table import Table

    from pdgw.tools.demo.chapters import Chapter
    from pdgw.tools.demo.sequence import Outcome

ChapterName = StrEnum("ChapterName", {name: name for name in CHAPTERS})  # type: ignore[misc]  # made of the chapters
CHAPTERS_HELP = "; ".join(f"{item.name}: {item.about}" for item in CHAPTERS.values())


class _StepPrinter:
    """Prints the steps as they happen: redrawn on a terminal, else one line for each step."""

    def __init__(self, console: Console, chapter: str) -> None:
        self.console = console
        self.chapter = chapter
        self.lines: list[tuple[str, int, int]] = []
        self.live: Live | None = None

    def show(self, document: dict[str, Any]) -> None:
        from pdgw.peers.plc.exchange.following import line_of

        if "note" in document:
            self.lines.append((document["note"], 0, 0))
        elif "result" in document:
            text, passed, failed = self.lines[-1] if self.lines else ("", 0, 0)
            good = document["result"]["passed"]
            self.lines[-1:] = [(text, passed + good, failed + (not good))]
        if self.live is not None and "message" not in document:  # a message, for example: no gateway answers yet
            self.live.update(self.table())
        elif line := line_of(document):
            self.console.print(line, highlight=False)

    def table(self) -> Table:
        from rich.table import Table

        grid = Table("step", "passed", "failed", title=f"pdgw demo, chapter {self.chapter}")
        for text, passed, failed in self.lines[-20:]:
            grid.add_row(text, f"[green]{passed}[/green]", f"[red]{failed}[/red]" if failed else "")
        return grid


def demo(
    chapter: Annotated[
        list[ChapterName] | None,
        typer.Option(help=f"Only this chapter; repeat for several. {CHAPTERS_HELP}", show_default=False),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            help="Each chapter's report.json, recording (gateway), trace.png and trace.html go into its folder here."
        ),
    ] = Path("demo-out"),
    profinet: Annotated[
        bool,
        typer.Option("--profinet", help="PLC and gateway over Ethernet frames, between network namespaces (Linux)."),
    ] = False,
    scenario: Annotated[
        Path | None, typer.Option(help="Another scenario for the devices of one chapter.", show_default=False)
    ] = None,
) -> None:
    """Run a PLC, the gateway and simulated drives in chapters; report every expectation as pass or fail."""
    from rich.console import Console

    from pdgw.tools.demo import namespaces

    chosen = [CHAPTERS[item.value] for item in dict.fromkeys(chapter or ChapterName)]
    if scenario is not None and len(chosen) > 1:
        raise GatewayError(f"--scenario: needs one --chapter too ({', '.join(CHAPTERS)})")
    if profinet and not namespaces.inside():
        namespaces.enter("pdgw")
    console = Console()
    if find_spec("matplotlib") is None:
        console.print(f"without trace.png: {missing('matplotlib', 'it')}", highlight=False)
    end_as_by_ctrl_c()  # stop the processes when the demo is stopped
    try:
        outcomes = [_run_chapter(item, out / item.name, console, scenario, profinet=profinet) for item in chosen]
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    if len(outcomes) > 1:
        _print_results(console, f"{len(outcomes)} chapters", outcomes, out)
    if not all(outcome.passed for outcome in outcomes):
        raise typer.Exit(1)


def _run_chapter(chapter: Chapter, out: Path, console: Console, scenario: Path | None, *, profinet: bool) -> Outcome:
    """Run one chapter and print its results."""
    from rich.live import Live

    from pdgw.peers.plc.engine import Result
    from pdgw.tools.commands.simulation.plc import results_table
    from pdgw.tools.demo.links import OnEthernet, OnLoopback
    from pdgw.tools.demo.sequence import Demo

    console.print(f"Chapter {chapter.name}: {chapter.about}", style="bold", highlight=False)
    printer = _StepPrinter(console, chapter.name)
    run = Demo(chapter, out, printer.show, OnEthernet() if profinet else OnLoopback(), scenario)
    if sys.stdout.isatty():
        with Live(printer.table(), console=console, refresh_per_second=8) as printer.live:
            outcome = run.run()
    else:
        outcome = run.run()
    console.print(results_table([Result(**item) for item in outcome.report["results"]]))
    _print_results(console, chapter.name, [outcome], out)
    for name, status in outcome.report["exit_codes"].items():
        if status and name != "plc":  # for the PLC this only means failed expectations
            console.print(f"the {name} process ended with status {status}; see {out / name}.log", highlight=False)
    return outcome


def _print_results(console: Console, what: str, outcomes: list[Outcome], out: Path) -> None:
    results = [item for outcome in outcomes for item in outcome.report["results"]]
    good = sum(item["passed"] for item in results)
    seconds = sum(outcome.report["duration_s"] for outcome in outcomes)
    console.print(
        f"{what}: {good} of {len(results)} expectations passed in {seconds:.0f} s; results in {out}/", highlight=False
    )
