"""``pdgw status``: show what a running gateway does and why an axis does not move. ``pdgw explain``.

``pdgw explain``: show what happened around the last fault or stop, in at most ten lines.
"""

from __future__ import annotations

import json
import shutil
import time
import zipfile
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.gateway.configuration.defaults import STATUS_PORT

_PERIOD_S = 1.0


def status(
    do_id: Annotated[
        int | None, typer.Argument(metavar="[AXIS]", min=1, max=254, help="Show all details of this axis or encoder.")
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="The daemon's status port.")] = STATUS_PORT,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole snapshot as JSON.")] = False,
    counters: Annotated[bool, typer.Option("--counters", help="Show all counters with their meanings.")] = False,
    faults: Annotated[bool, typer.Option("--faults", help="Show all stored faults, not only the newest.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Repeat every second until Ctrl-C.")] = False,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="One line for monitoring; exit status 0 well, 1 warning, 2 critical, 3 no answer."
        ),
    ] = False,
) -> None:
    """Show why axes are not in operation and one line for each axis; with an axis number, all details of that axis."""
    if check:
        others = {
            "AXIS": do_id is not None,
            "--json": as_json,
            "--counters": counters,
            "--faults": faults,
            "--watch": watch,
        }
        if given := [option for option, value in others.items() if value]:
            raise typer.BadParameter(f"prints one line, not allowed with {', '.join(given)}", param_hint="--check")
        _check(port)
    elif watch:
        _watch(port, do_id, as_json=as_json, counters=counters, faults=faults)
    else:
        document = _document(port, faults=faults)
        if as_json:
            typer.echo(json.dumps(document, indent=2))
            return
        for line in _lines(document, do_id, shutil.get_terminal_size().columns, counters=counters, faults=faults):
            typer.echo(line)


def _lines(document: dict[str, Any], do_id: int | None, width: int, *, counters: bool, faults: bool) -> Iterator[str]:
    from pdgw.tools.output.status_text import fault_lines, object_lines, status_lines

    if do_id is not None:
        yield from object_lines(document, do_id, width)
        return
    yield from status_lines(document, width, counters=counters)
    if faults:
        for item in (*document["axes"], *document["encoders"]):
            yield from fault_lines(item, width)


def _document(port: int, *, faults: bool) -> dict[str, Any]:
    from pdgw.gateway.service.status_client import fetch, fetch_faults

    document = fetch(port)
    if faults:
        for item in (*document["axes"], *document["encoders"]):
            item["faults"] = fetch_faults(port, item["do_id"])
    return document


def _check(port: int) -> None:
    from pdgw.gateway.service.status_client import fetch
    from pdgw.tools.output.status_text import Health, check_line

    try:
        health, line = check_line(fetch(port))
    except GatewayError as error:
        health, line = Health.UNKNOWN, f"{Health.UNKNOWN.name} - {error}"
    typer.echo(line)
    raise typer.Exit(health)


def _watch(port: int, do_id: int | None, *, as_json: bool, counters: bool, faults: bool) -> None:
    """Print the status repeatedly, also while the gateway does not answer. A terminal is redrawn in place."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console()
    with Live(console=console, auto_refresh=False, screen=console.is_terminal and not as_json) as live:
        while True:
            try:
                document = _document(port, faults=faults)
                text = "\n".join(_lines(document, do_id, console.width, counters=counters, faults=faults))
            except GatewayError as error:
                document, text = {"error": str(error)}, f"{error}; retry every second"
            if as_json:
                typer.echo(json.dumps(document))
            elif console.is_terminal:
                live.update(Text(text), refresh=True)
            else:
                typer.echo(f"{text}\n")
            time.sleep(_PERIOD_S)


def explain(
    do_id: Annotated[
        int | None, typer.Argument(metavar="[AXIS]", min=1, max=254, help="Only this axis or encoder.")
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="The daemon's status port.")] = STATUS_PORT,
    support: Annotated[
        Path | None,
        typer.Option(help="Write these lines, the status and both buses to this ZIP file.", show_default=False),
    ] = None,
) -> None:
    """Show what happened around the last fault or stop, in at most ten lines."""
    from pdgw.gateway.service.status_client import fetch, fetch_explanation

    lines = [explained_line(line) for line in fetch_explanation(port, do_id)]
    lines = lines or ["no fault or stop since the gateway started"]
    for line in lines:
        typer.echo(line)
    if support is not None:
        _write(support, lines, fetch(port))
        typer.echo(f"{support}: written; send it to the person who helps you")
    else:
        typer.echo(
            "pdgw explain --support FILE.zip writes these lines and both buses to one file for the person who helps you"
        )


def explained_line(line: dict[str, Any]) -> str:
    """Format one line: time, subject, event."""
    at = datetime.fromisoformat(line["time"])
    return f"{at:%H:%M:%S}.{at.microsecond // 1000:03d}  {line['who']}: {line['text']}"


def _write(path: Path, lines: list[str], document: dict[str, Any]) -> None:
    from pdgw.gateway.trace.reader import RingReader
    from pdgw.tools.recording.trace_keeper import part_of

    with writing(path), zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("explain.txt", "\n".join(lines) + "\n")
        archive.writestr("status.json", json.dumps(document, indent=1))
        if document["trace"]:
            archive.writestr("capture.pcapng", part_of(RingReader(Path(document["trace"])))[0])
