"""``pdgw status``: what a running gateway does, and why an axis does not move."""

from __future__ import annotations

import json
import shutil
from typing import Annotated

import typer

from pdgw.gateway.ports import STATUS_PORT
from pdgw.gateway.status_client import fetch, fetch_faults
from pdgw.tools.status_text import status_lines


def status(
    port: Annotated[int, typer.Option(min=1, max=65535, help="The daemon's status port.")] = STATUS_PORT,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole snapshot as JSON.")] = False,
    counters: Annotated[bool, typer.Option("--counters", help="All counters, with their meanings.")] = False,
    faults: Annotated[bool, typer.Option("--faults", help="All faults that are kept, not only the newest.")] = False,
) -> None:
    """Show axes, reasons, faults and counters of a running gateway."""
    document = fetch(port)
    if faults:
        for item in (*document["axes"], *document["encoders"]):
            item["faults"] = fetch_faults(port, item["do_id"])
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    for line in status_lines(document, shutil.get_terminal_size().columns, counters=counters):
        typer.echo(line)
