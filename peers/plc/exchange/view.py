"""The PLC's view as plain data and as tables for a terminal: words by bit, values, and why values are missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.signal_text import texts
from pdgw.profidrive.telegrams import telegram


def snapshot(endpoint: PlcEndpoint, title: str) -> dict[str, Any]:
    """All axes as plain data."""
    return {
        "title": title,
        "axes": [
            {
                "telegram": item.number,
                "setpoints": endpoint.setpoints[axis],
                "actuals": endpoint.actuals[axis],
                "why": endpoint.why_no_values(axis) if endpoint.actuals[axis] is None else "",
            }
            for axis, item in enumerate(endpoint.telegrams)
        ],
    }


def line_of(document: Mapping[str, Any]) -> str:
    """A document of the progress as a line for a person; empty if it needs none."""
    if "told" in document:
        return str(document["told"])
    if "note" in document:
        return f"{document['time_s']:7.3f} s  {document['note']}"
    result = document.get("result", {"passed": True})
    return "" if result["passed"] else f"{result['time_s']:7.3f} s  FAILED {result['name']}: {result['measured']}"


def tables(found: dict[str, Any], reasons: Sequence[str] = ()) -> RenderableType:
    """A snapshot as tables. ``reasons``: why the gateway does not execute an axis' command, if known."""
    parts: list[RenderableType] = [Text(found["title"], style="bold")]
    for index, axis in enumerate(found["axes"]):
        chosen = telegram(axis["telegram"])
        reason = axis["why"] or (reasons[index] if index < len(reasons) else "")
        if reason:
            parts.append(Text(f"axis {index + 1}: {reason}", style="yellow"))
        title = f"axis {index + 1}, telegram {axis['telegram']}"
        grid = Table(
            "setpoint", "", "actual value", "", title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False
        )
        sent, received = texts(chosen.setpoints, axis["setpoints"]), texts(chosen.actuals, axis["actuals"] or {})
        for left, right in zip_longest(sent.items(), received.items(), fillvalue=("", "")):
            grid.add_row(*left, *right)
        parts.append(grid)
    return Group(*parts)
