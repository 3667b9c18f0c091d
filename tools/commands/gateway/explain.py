"""``pdgw explain``: show what happened around the last fault or stop, in at most ten lines."""

from __future__ import annotations

import json
import zipfile
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from pdgw.gateway.configuration.defaults import STATUS_PORT
from pdgw.gateway.errors import writing


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
            with RingReader(Path(document["trace"])) as reader:
                archive.writestr("capture.pcapng", part_of(reader)[0])
