"""What the PLC sees, for a terminal: control and status words by bit, values, the present step."""

from __future__ import annotations

from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive.signals import Signal, signal
from pdgw.profidrive.telegrams import ApplicationMode
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text


def _value(item: Signal, raw: int, positioning: bool) -> str:
    if item.bits and item.name not in {"Modes of Operation", "Modes of Operation Display"}:
        names = [bit.name for bit in item.fields(positioning=positioning) if bit.width == 1 and bit.of(raw)]
        return f"{raw:04X}h  {' '.join(names)}"
    percent = item.percent(raw)
    return f"{raw}" if percent is None else f"{raw}  ({percent:.2f} %)"


def table(endpoint: PlcEndpoint, title: str) -> RenderableType:
    """All axes as tables."""
    parts: list[RenderableType] = [Text(title, style="bold")]
    for index, telegram in enumerate(endpoint.telegrams):
        positioning = telegram.mode is ApplicationMode.POSITIONING
        grid = Table("setpoint", "", "actual value", "", title=f"axis {index + 1}, telegram {telegram.number}")
        actuals = endpoint.actuals[index]
        sent = [(n, _value(signal(n), v, positioning)) for n, v in endpoint.setpoints[index].items()]
        got = [(n, _value(signal(n), v, positioning)) for n, v in actuals.items()] if actuals else [("IOPS BAD", "")]
        for row in range(max(len(sent), len(got))):
            left = sent[row] if row < len(sent) else ("", "")
            right = got[row] if row < len(got) else ("", "")
            grid.add_row(*left, *right)
        parts.append(grid)
    return Group(*parts)
