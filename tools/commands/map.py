"""``pdgw map``: where every value lies in the frames, for who programs the PLC."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pdgw.gateway.bytemap import FrameMap, Place, counter_step, frame_maps
from pdgw.gateway.config_file import load_config
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.frame import FRAME_ID_TO_CONTROLLER, FRAME_ID_TO_DEVICE
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.plc_code import Dialect, code
from pdgw.tools.tables import plain_table

_TITLES = {
    Direction.SETPOINT: f"PLC -> gateway, FrameID {FRAME_ID_TO_DEVICE:04X}h",
    Direction.ACTUAL: f"gateway -> PLC, FrameID {FRAME_ID_TO_CONTROLLER:04X}h",
}
_COLUMNS = (
    "direction",
    "axis",
    "offset",
    "in_submodule",
    "length",
    "name",
    "type",
    "unit",
    "full_scale",
    "description",
)


class Format(StrEnum):
    """Values of ``--format``."""

    TEXT = "text"
    CSV = "csv"
    ST = "st"
    SCL = "scl"


Maps = tuple[FrameMap, FrameMap]


def map_(
    config: Annotated[Path, typer.Argument(help="Configuration file (TOML).")],
    format_: Annotated[
        Format, typer.Option("--format", help="text, csv, st (IEC 61131-3 Structured Text) or scl (Siemens).")
    ] = Format.TEXT,
    out: Annotated[Path | None, typer.Option(help="Write here instead of standard output.")] = None,
) -> None:
    """Print the byte map of a configuration: offset, length, signal, unit and 100 % of every value; or code for the PLC."""
    loaded = load_config(config)
    maps = frame_maps(loaded)
    step = counter_step(loaded)
    formats: dict[Format, Callable[[], str]] = {
        Format.TEXT: lambda: _text(maps, None if out is None else 120),
        Format.CSV: lambda: _csv(maps),
        Format.ST: lambda: "\n".join(code(maps, step, Dialect(siemens=False))) + "\n",
        Format.SCL: lambda: "\n".join(code(maps, step, Dialect(siemens=True))) + "\n",
    }
    text = formats[format_]()
    if out is None:
        sys.stdout.write(text)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise GatewayError(f"--out {out}: cannot be written ({error.strerror or error})") from error


def _text(maps: Maps, width: int | None) -> str:
    console = Console(file=io.StringIO(), width=width or Console().width)
    for found in maps:
        table = plain_table(
            "axis",
            "offset",
            "bytes",
            "name",
            "type",
            "100 %, values",
            "description",
            title=f"{_TITLES[found.direction]}: {found.size} bytes of UDP payload, numbers big-endian",
            narrow=("axis", "offset", "bytes", "name", "type"),
        )
        for place in found.places:
            table.add_row(
                *(_cell(place)[name] for name in ("axis", "offset", "length", "name", "type", "scale", "description"))
            )
        console.print(table)
    console.print(
        "Bytes behind the last IOCS up to the CycleCounter are 0. On PROFINET each axis is a submodule of its own."
    )
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def _cell(place: Place) -> dict[str, str]:
    return {
        "axis": str(place.axis) if place.axis else "",
        "offset": str(place.in_frame),
        "length": str(place.length),
        "name": place.name,
        "type": place.type,
        "scale": place.full or place.unit,
        "description": place.description,
    }


def _csv(maps: Maps) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for found in maps:
        for place in found.places:
            in_submodule = "" if place.in_object is None else place.in_object
            writer.writerow(
                (
                    "plc-to-gateway" if found.direction is Direction.SETPOINT else "gateway-to-plc",
                    place.axis or "",
                    place.in_frame,
                    in_submodule,
                    place.length,
                    place.name,
                    place.type,
                    place.unit,
                    place.full,
                    place.description,
                )
            )
    return out.getvalue()
