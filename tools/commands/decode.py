"""``pdgw decode``: bytes to names, values and bits."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from typing import Annotated

import typer

from decoder.recognise import parse_hex, recognise
from decoder.render import one_line, tree
from profidrive.telegrams import Direction
from profidrive.telegrams import telegram as telegram_of


class DirectionOption(StrEnum):
    """Values of ``--direction``."""

    SETPOINT = "setpoint"
    ACTUAL = "actual"


def decode(
    hex_text: Annotated[
        str,
        typer.Option("--hex", help="Telegram words, C_SDU, whole frame, parameter request or response; - reads stdin."),
    ],
    telegram: Annotated[int | None, typer.Option(help="Telegram of the data; without it inferred.")] = None,
    direction: Annotated[
        DirectionOption | None, typer.Option(help="Setpoints or actual values; default by FrameID, else setpoint.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="The full tree with every bit.")] = False,
) -> None:
    """Decode a piece of data and tell what it was recognised as."""
    chosen = telegram_of(telegram) if telegram is not None else None
    data = parse_hex(sys.stdin.read() if hex_text == "-" else hex_text)
    document = recognise(data, chosen, Direction(direction.value) if direction else None)
    if as_json:
        typer.echo(json.dumps(document))
    elif verbose:
        for line in tree(document):
            typer.echo(line)
    else:
        typer.echo(one_line(document))
