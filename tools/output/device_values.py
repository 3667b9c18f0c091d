"""Differences between a device and its files, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console

from pdgw.gateway.commissioning.device import Difference
from pdgw.tools.output.reports import plain_table


def document(item: Difference) -> dict[str, str]:
    """For JSON."""
    return {"object": item.item.name, "name": item.name, "file": item.item.text(), "device": item.held}


def print_differences(found: Iterable[Difference]) -> None:
    """Print one line for each."""
    table = plain_table("object", "name", "in the file", "in the device")
    for item in found:
        table.add_row(*document(item).values())
    Console().print(table)
