"""``pdgw demo``."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from pdgw.peers.plc.engine import Result
from pdgw.tools import namespaces
from pdgw.tools.commands.sim_plc import results_table
from pdgw.tools.demo.links import OnEthernet, OnLoopback
from pdgw.tools.demo.run import SCENARIO, Demo


class _Story:
    """The story as it unfolds: live on a terminal, one line per step otherwise."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.lines: list[tuple[str, int, int]] = []
        self.live: Live | None = None

    def show(self, document: dict[str, Any]) -> None:
        if "note" in document:
            self.lines.append((document["note"], 0, 0))
        else:
            text, passed, failed = self.lines[-1] if self.lines else ("", 0, 0)
            good = document["result"]["passed"]
            self.lines[-1:] = [(text, passed + good, failed + (not good))]
        if self.live is not None:
            self.live.update(self.table())
        elif "note" in document:
            self.console.print(f"{document['time_s']:7.2f} s  {document['note']}", highlight=False)
        elif not document["result"]["passed"]:
            self.console.print(f"           FAILED {document['result']['name']}: {document['result']['measured']}")

    def table(self) -> Table:
        grid = Table("story", "passed", "failed", title="pdgw demo")
        for text, passed, failed in self.lines[-20:]:
            grid.add_row(text, f"[green]{passed}[/green]", f"[red]{failed}[/red]" if failed else "")
        return grid


def demo(
    out: Annotated[
        Path, typer.Option(help="Where report.json, plc.pcap, can.log, trace.png and trace.html go.")
    ] = Path("demo-out"),
    profinet: Annotated[
        bool,
        typer.Option("--profinet", help="PLC and gateway over Ethernet frames, between network namespaces (Linux)."),
    ] = False,
    scenario: Annotated[
        Path, typer.Option(help="Another story for these drives (telegrams 1, 9, 100, 83).", show_default=False)
    ] = SCENARIO,
) -> None:
    """PLC, gateway and the bus of three drives and an encoder as processes; every expectation with pass or fail."""
    if profinet and not namespaces.inside():
        namespaces.enter()
    console = Console()
    story = _Story(console)
    run = Demo(out, story.show, OnEthernet() if profinet else OnLoopback(), scenario)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a stopped demo stops its processes
    try:
        if sys.stdout.isatty():
            with Live(story.table(), console=console, refresh_per_second=8) as story.live:
                outcome = run.run()
        else:
            outcome = run.run()
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    console.print(results_table([Result(**item) for item in outcome.report["results"]]))
    results = outcome.report["results"]
    good = sum(item["passed"] for item in results)
    console.print(
        f"{good} of {len(results)} expectations passed in {outcome.report['duration_s']} s; evidence in {out}/"
    )
    if not outcome.passed:
        raise typer.Exit(1)
