"""``python -m pdgw.workshop loop``: a position loop closed by a simulated PLC, with several gains and cycle times."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from pdgw.tools.log_level import quiet
from pdgw.tools.output.files import to_be_written
from pdgw.workshop.loop_study import CYCLES_MS, GAINS, Point, plot, study


def loop(
    cycle_ms: Annotated[
        list[float] | None, typer.Option(min=0.25, max=32, help="Cycle time in ms; repeat.", show_default=False)
    ] = None,
    gain: Annotated[
        list[float] | None, typer.Option(min=1, max=2000, help="Gain in 1/s; repeat.", show_default=False)
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--plot", callback=to_be_written, help="Draw the result to this file.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the points as JSON.")] = False,
) -> None:
    """Close a position loop in a simulated PLC, with DSC and without: following error and stability, in virtual time."""
    if picture is not None:
        plot([], picture)  # report a picture that cannot be drawn before the work
    with quiet("gateway"):
        points = list(study(cycle_ms or CYCLES_MS, gain or GAINS))
    if picture is not None:
        plot(points, picture)
    if as_json:
        typer.echo(json.dumps([{k: v for k, v in asdict(item).items() if k != "samples"} for item in points], indent=2))
        return
    table = Table("who closes the loop", "cycle", "gain", "overshoot", "settles", "following error")
    for item in points:
        table.add_row(item.form, f"{item.cycle_ms:g} ms", f"{item.gain:g} 1/s", *_figures(item))
    Console().print(table)


def _figures(item: Point) -> tuple[str, str, str]:
    return f"{item.overshoot:.0%}", "yes" if item.stable else "[red]no[/red]", f"{item.following_error:.0f} increments"
