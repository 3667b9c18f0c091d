"""Options shared by `pdgw timeline` and `pdgw replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Files = Annotated[list[str], typer.Argument(help="Captures of both buses, like plc.pcap can.log.", metavar="FILE...")]
Config = Annotated[Path | None, typer.Option(help="The gateway's configuration: axes, nodes, choices.")]
Telegrams = Annotated[list[int] | None, typer.Option(help="Telegram; repeat for each axis (default: inferred).")]
Nodes = Annotated[
    list[str] | None,
    typer.Option(help="CANopen node of each axis in turn, or AXIS=NODE (default: number of the axis)."),
]
Offset = Annotated[
    float | None,
    typer.Option(
        help="Clock of the CAN capture minus the clock of the PLC's capture, in seconds (default: correlated)."
    ),
]
Station = Annotated[
    str, typer.Option(metavar="NAME", help="PROFINET station, where several in the capture have telegrams.")
]
