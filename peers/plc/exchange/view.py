"""The PLC's view as plain data and as tables for a terminal: words by bit, values, and why values are missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.signals import Signal
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf, telegram


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


def _rows(half: TelegramHalf, values: Mapping[str, int]) -> list[tuple[str, str]]:
    positioning = half.mode is ApplicationMode.POSITIONING
    return [(name, _value(half.signal(name), value, positioning)) for name, value in values.items()]


def _value(item: Signal, raw: int, positioning: bool) -> str:
    if item.bits and item.name not in {"Modes of Operation", "Modes of Operation Display"}:
        names = [
            bit.name if bit.width == 1 else f"{bit.name}={bit.of(raw)}"
            for bit in item.fields(positioning=positioning)
            if bit.of(raw)
        ]
        return f"{raw:04X}h  {' '.join(names)}"
    percent = item.percent(raw)
    if percent is None:
        return f"{item.value_of(raw):g} {item.unit}".rstrip() if item.is_float else f"{raw} {item.unit}".rstrip()
    return f"{raw}  ({percent:.2f} %)"


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
        sent = _rows(chosen.setpoints, axis["setpoints"])
        got = _rows(chosen.actuals, axis["actuals"] or {})
        for row in range(max(len(sent), len(got))):
            left = sent[row] if row < len(sent) else ("", "")
            right = got[row] if row < len(got) else ("", "")
            grid.add_row(*left, *right)
        parts.append(grid)
    return Group(*parts)
