"""``pdgw status``: what a running gateway does, and why an axis does not move."""

from __future__ import annotations

import json
import shutil
import socket
from typing import Annotated, Any

import typer

from pdgw.gateway.errors import GatewayError
from pdgw.gateway.ports import STATUS_PORT
from pdgw.tools.status_text import status_lines


def fetch(port: int) -> dict[str, Any]:
    """The snapshot of the daemon on a loopback port; GatewayError when none answers."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
            text = b"".join(iter(lambda: connection.recv(65536), b""))
    except OSError as error:
        raise GatewayError(f"no gateway answers on 127.0.0.1 port {port} ({error.strerror or error})") from error
    try:
        document: dict[str, Any] = json.loads(text)
        document["plc"], document["axes"], document["encoders"]
    except (ValueError, TypeError, KeyError) as error:
        raise GatewayError(f"127.0.0.1 port {port}: what answers there is no gateway") from error
    return document


def status(
    port: Annotated[int, typer.Option(min=1, max=65535, help="The daemon's status port.")] = STATUS_PORT,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole snapshot as JSON.")] = False,
    counters: Annotated[bool, typer.Option("--counters", help="All counters, with their meanings.")] = False,
) -> None:
    """Show axes, reasons, faults and counters of a running gateway."""
    document = fetch(port)
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    for line in status_lines(document, shutil.get_terminal_size().columns, counters=counters):
        typer.echo(line)
