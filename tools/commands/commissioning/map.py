"""``pdgw map``: print the place of every value in the frames, for the PLC programmer."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.profidrive.frame import FRAME_ID_TO_CONTROLLER, FRAME_ID_TO_DEVICE
from pdgw.profidrive.telegrams import TELEGRAMS, Direction, Telegram

if TYPE_CHECKING:
    from pdgw.gateway.configuration.byte_map import FrameMap, Place
    from pdgw.gateway.configuration.environment import TransportConfig

    Maps = tuple[FrameMap, FrameMap]

_TITLES = {
    Direction.SETPOINT: f"PLC -> gateway, FrameID {FRAME_ID_TO_DEVICE:04X}h",
    Direction.ACTUAL: f"gateway -> PLC, FrameID {FRAME_ID_TO_CONTROLLER:04X}h",
}
_SUBMODULE = {
    Direction.SETPOINT: "PLC -> gateway, output data",
    Direction.ACTUAL: "gateway -> PLC, input data",
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
    UDT = "udt"
    PLCOPEN = "plcopen"
    CODESYS = "codesys"


def map_(
    config: Annotated[
        Path | None,
        typer.Argument(help="Configuration file (TOML); only --gsdml works without it.", show_default=False),
    ] = None,
    format_: Annotated[
        Format,
        typer.Option(
            "--format",
            help="text, csv, st (IEC 61131-3 Structured Text), plcopen (XML of it), codesys (XML with sockets), scl (Siemens) or "
            "udt (its data types).",
        ),
    ] = Format.TEXT,
    out: Annotated[Path | None, typer.Option(help="Output file (default: standard output).")] = None,
    gsdml: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="PROFINET: also write the device description (GSDML) to this folder."),
    ] = None,
) -> None:
    """Print the byte map of a configuration, with unit and 100 % of every value, or code for the PLC."""
    from pdgw.gateway.base.store import stored_parameters
    from pdgw.gateway.configuration.byte_map import frame_maps
    from pdgw.gateway.configuration.environment import TransportConfig
    from pdgw.gateway.configuration.file import load_config
    from pdgw.tools.plc.code import siemens_scl, siemens_types, structured_text
    from pdgw.tools.plc.plcopen import plcopen_xml
    from pdgw.tools.plc.sockets import Sockets

    if config is None:
        if gsdml is None:
            raise GatewayError("CONFIG is missing: give a configuration file; only --gsdml works without it")
        typer.echo(str(_write_gsdml(TransportConfig(), gsdml)))
        return
    loaded = load_config(config)
    stored = stored_parameters(loaded.store, loaded.file).telegrams
    for line in loaded.replaced_telegrams(stored):
        typer.echo(line, err=True)
    loaded = loaded.with_telegrams(stored)
    maps = frame_maps(loaded)
    profinet = loaded.transport.type == "profinet"
    if gsdml is not None:
        if not profinet:
            raise GatewayError(f'--gsdml: {config} has type = "{loaded.transport.type}", expected "profinet"')
        typer.echo(f"device description: {_write_gsdml(loaded.transport, gsdml, loaded.telegrams)}", err=True)
    formats: dict[Format, Callable[[], str]] = {
        Format.TEXT: lambda: (_profinet_text if profinet else _udp_text)(maps, None if out is None else 120),
        Format.CSV: lambda: _csv(maps, profinet=profinet),
        Format.ST: lambda: structured_text(loaded),
        Format.SCL: lambda: siemens_scl(loaded),
        Format.UDT: lambda: siemens_types(loaded),
        Format.PLCOPEN: lambda: plcopen_xml(structured_text(loaded)),
        Format.CODESYS: lambda: plcopen_xml(structured_text(loaded, Sockets.CODESYS)),
    }
    text = formats[format_]()
    if out is None:
        sys.stdout.write(text)
        return
    with writing(f"--out {out}"):
        out.write_text(text, encoding="utf-8")


def _write_gsdml(transport: TransportConfig, folder: Path, known: Mapping[int, Telegram] = TELEGRAMS) -> Path:
    """Write the device description to a folder. ``known``: the telegrams, the user's own among them."""
    from pdgw.tools.output.data_sheets import write_gsdml

    return write_gsdml(transport, folder, "--gsdml", known)


def _udp_text(maps: Maps, width: int | None) -> str:
    tables = [
        (
            f"{_TITLES[found.direction]}: {found.size} bytes of UDP payload, numbers big-endian",
            [(str(place.axis or ""), place.in_frame, place) for place in found.places],
        )
        for found in maps
    ]
    return _tables(
        tables,
        width,
        "All other bytes are 0. On UDP beyond this machine and without direct = true, the PLC copies the tick (docs/plc.md).",
    )


def _profinet_text(maps: Maps, width: int | None) -> str:
    """Describe the data of each submodule. Offsets in the frame are agreed at each connect and are not known here."""
    tables = [
        (
            f"{_SUBMODULE[found.direction]}, subslot 2 of each axis' slot, numbers big-endian",
            [
                (f"{axis.do_id} in slot {slot}", place.in_object, place)
                for slot, axis in enumerate(found.axes, 1)
                for place in axis.places
                if place.in_object is not None
            ],
        )
        for found in maps
    ]
    return _tables(tables, width, "The PROFINET driver of the PLC handles IOPS, IOCS and the position in the frame.")


def _tables(tables: Sequence[tuple[str, Sequence[tuple[str, int, Place]]]], width: int | None, remark: str) -> str:
    """Format tables with a title. A row has the owner of a value, its byte offset and its name."""
    from rich.console import Console

    from pdgw.tools.output.reports import plain_table

    console = Console(file=io.StringIO(), width=width or Console().width)
    for title, rows in tables:
        table = plain_table(
            "axis",
            "offset",
            "bytes",
            "name",
            "type",
            "100 %, values",
            "description",
            title=title,
            narrow=("axis", "offset", "bytes", "name", "type"),
        )
        for whose, offset, place in rows:
            scale = place.full or place.unit
            table.add_row(whose, str(offset), str(place.length), place.name, place.type, scale, place.description)
        console.print(table)
    console.print(remark)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def _csv(maps: Maps, *, profinet: bool) -> str:
    """One row for each value. On PROFINET the column ``offset`` and the rows of the frame's own fields are missing."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for found in maps:
        for place in found.places:
            if profinet and place.in_object is None:
                continue
            in_submodule = "" if place.in_object is None else place.in_object
            writer.writerow(
                (
                    "plc-to-gateway" if found.direction is Direction.SETPOINT else "gateway-to-plc",
                    place.axis or "",
                    "" if profinet else place.in_frame,
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
