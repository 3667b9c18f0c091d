"""``pdgw status``: what a running gateway does, and why an axis does not move."""

from __future__ import annotations

import json
import shutil
import time
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from pdgw.gateway.configuration.ports import STATUS_PORT
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.service.status_client import fetch, fetch_faults
from pdgw.tools.output.status_check import Health, check_line
from pdgw.tools.output.status_text import status_lines

_PERIOD_S = 1.0


def status(
    port: Annotated[int, typer.Option(min=1, max=65535, help="The daemon's status port.")] = STATUS_PORT,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole snapshot as JSON.")] = False,
    counters: Annotated[bool, typer.Option("--counters", help="All counters, with their meanings.")] = False,
    faults: Annotated[bool, typer.Option("--faults", help="All faults that are kept, not only the newest.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Again every second, until Ctrl-C.")] = False,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="One line for monitoring; exit status 0 well, 1 warning, 2 critical, 3 no answer."
        ),
    ] = False,
) -> None:
    """Show axes, reasons, faults and counters of a running gateway."""
    if check:
        others = {"--json": as_json, "--counters": counters, "--faults": faults, "--watch": watch}
        if given := [option for option, value in others.items() if value]:
            raise typer.BadParameter(f"prints one line, not with {', '.join(given)}", param_hint="--check")
        _check(port)
    elif watch:
        _watch(port, as_json=as_json, counters=counters, faults=faults)
    else:
        document = _document(port, faults=faults)
        if as_json:
            typer.echo(json.dumps(document, indent=2))
            return
        for line in status_lines(document, shutil.get_terminal_size().columns, counters=counters):
            typer.echo(line)


def _document(port: int, *, faults: bool) -> dict[str, Any]:
    document = fetch(port)
    if faults:
        for item in (*document["axes"], *document["encoders"]):
            item["faults"] = fetch_faults(port, item["do_id"])
    return document


def _check(port: int) -> None:
    try:
        health, line = check_line(fetch(port))
    except GatewayError as error:
        health, line = Health.UNKNOWN, f"{Health.UNKNOWN.name} - {error}"
    typer.echo(line)
    raise typer.Exit(health)


def _watch(port: int, *, as_json: bool, counters: bool, faults: bool) -> None:
    """A gateway that does not answer is asked again; on a terminal the picture stays in its place, elsewhere each is printed."""
    console = Console()
    with Live(console=console, auto_refresh=False, screen=console.is_terminal and not as_json) as live:
        while True:
            try:
                document = _document(port, faults=faults)
                text = "\n".join(status_lines(document, console.width, counters=counters))
            except GatewayError as error:
                document, text = {"error": str(error)}, f"{error}; asked again every second"
            if as_json:
                typer.echo(json.dumps(document))
            elif console.is_terminal:
                live.update(Text(text), refresh=True)
            else:
                typer.echo(f"{text}\n")
            time.sleep(_PERIOD_S)
