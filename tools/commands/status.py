"""``pdgw status``: what a running gateway does, and why an axis does not move."""

from __future__ import annotations

import json
import socket
from typing import Annotated, Any

import typer
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.ports import STATUS_PORT
from rich.console import Console
from rich.table import Table


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
) -> None:
    """Show axes, reasons, faults and counters of a running gateway."""
    document = fetch(port)
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    console = Console()
    plc = document["plc"]
    peer = f"{plc['peer'][0]}:{plc['peer'][1]}" if plc["peer"] else "none"
    dropped = {name: count for name, count in plc["frames"].items() if count and name != "accepted"}
    console.print(
        f"PLC {'connected' if plc['connected'] else 'not connected'} ({peer}), {plc['frames']['accepted']} frames"
    )
    if dropped:
        console.print("dropped: " + ", ".join(f"{count} {name}" for name, count in dropped.items()))
    table = Table("DO", "node", "telegram", "device", "state", "status word", "why it does not do what is asked")
    objects = [*document["axes"], *document["encoders"]]
    for axis in objects:
        word = next(iter(axis["actuals"].values()))
        table.add_row(
            str(axis["do_id"]),
            str(axis["node_id"]),
            str(axis["telegram"]),
            axis["drive"],
            axis["state"],
            f"{word:04X}h",
            axis["reason"] or axis["drive_text"],
        )
    console.print(table)
    for axis in document["axes"]:
        for line in axis["scaling"]:
            console.print(f"DO {axis['do_id']} {line}", highlight=False)
    for axis in objects:
        for fault in axis["faults"][-3:]:
            console.print(f"DO {axis['do_id']} fault {fault['number']}: {fault['text']}")
