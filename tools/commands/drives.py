"""``pdgw drives``: the families of drives the package knows, and which one a data sheet belongs to."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from pdgw.ds301.objects import Access, CanType
from pdgw.dsp402.describe import described_by_sheet
from pdgw.dsp402.drive import load_eds
from pdgw.dsp402.drive_type import DriveType
from pdgw.dsp402.overlay import Overlay, overlay, overlays
from pdgw.gateway.commissioning.telegram_check import lacks_by_telegram, missing_lines, not_available

app = typer.Typer(help="Families of drives.", no_args_is_help=True)


@app.command("list")
def list_families(
    as_json: Annotated[bool, typer.Option("--json", help="A JSON list, one object per family.")] = False,
) -> None:
    """List the families."""
    if as_json:
        typer.echo(json.dumps([_document(item) for item in overlays().values()], indent=2))
        return
    table = Table("family", "drives", "vendor-ID", "names", "velocities")
    for name, item in overlays().items():
        vendor = f"{item.match.vendor_id:X}h" if item.match.vendor_id is not None else ""
        table.add_row(name, item.title, vendor, ", ".join(item.match.names), item.units.velocity)
    Console().print(table)


@app.command()
def show(
    family: Annotated[str, typer.Argument(help="Name of the family.")],
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Show what is known about a family, where that is from and what is unverified."""
    item = overlay(family)
    if as_json:
        typer.echo(json.dumps(_document(item), indent=2))
        return
    typer.echo(f"{item.name}: {item.title}")
    for title, lines in (("hints", item.hints), ("sources", item.sources), ("unverified", item.unverified)):
        if lines:
            typer.echo(f"{title}:")
            for line in lines:
                typer.echo(f"  {line}")
    for title, values in (
        ("units", item.units.model_dump(exclude_defaults=True)),
        ("modes", item.modes),
        ("objects", {name: _address(found.address) for name, found in item.objects.items()}),
        (
            "unit texts",
            {text: ", ".join(map(_address, addresses)) for text, addresses in item.unit_texts.items()},
        ),
        ("faults", {number: f"{fault.name}, {fault.code:04X}h" for number, fault in item.faults.items()}),
        ("quirks", item.quirks.model_dump(exclude_defaults=True)),
    ):
        if values:
            typer.echo(f"{title}:")
            for key, value in values.items():
                typer.echo(f"  {key}: {_text(value)}")
    if item.homing_methods:
        typer.echo(f"homing methods: {', '.join(map(str, item.homing_methods))}")


@app.command()
def match(
    eds: Annotated[Path, typer.Argument(help="EDS or DCF of a drive.")],
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Tell the family of a drive from its data sheet, and what each telegram lacks with the values the data sheet has."""
    drive = described_by_sheet(load_eds(eds, 1))
    missing = lacks_by_telegram(drive)
    without = {number: lines for number in missing if (lines := not_available(drive, number))}
    if as_json:
        document = {
            "file": str(eds),
            "name": drive.name,
            "family": drive.family or None,
            "modes": dict(drive.modes),
            "homing_methods": list(drive.homing_methods),
            "scaling": list(drive.scaling.lines),
            "telegrams": dict(missing),
            "keys": list(missing_lines(drive, *missing)),
            "not_available": without,
        }
        typer.echo(json.dumps(document, indent=2))
        return
    _print_match(drive, missing, without)


def _print_match(drive: DriveType, missing: Mapping[int, str], without: Mapping[int, Sequence[str]]) -> None:
    typer.echo(
        f"{drive.name}: " + (f"family {drive.family}" if drive.family else "no family, CiA 402 as it tells itself")
    )
    typer.echo(f"modes: {', '.join(f'{mode} {name}' for mode, name in drive.modes.items())}")
    rpdos, tpdos = len(drive.pdos.rpdos), len(drive.pdos.tpdos)
    typer.echo(f"PDOs: {rpdos} RPDOs, {tpdos} TPDOs")
    for line in drive.scaling.lines:
        typer.echo(f"  {line}")
    for number, refusal in missing.items():
        if refusal:
            typer.echo(f"telegram {number} needs more: {refusal}")
    for line in dict.fromkeys(line for lines in without.values() for line in lines):
        numbers = [str(number) for number, lines in without.items() if line in lines]
        typer.echo(f"telegram{'s' * (len(numbers) > 1)} {', '.join(numbers)}: {line}")
    lines = missing_lines(drive, *missing)
    if lines:
        typer.echo("to paste into its [[axis]] and fill in, as far as the telegram needs it:")
    for line in lines:
        typer.echo(f"  {line}")
    for line in overlay(drive.family).hints if drive.family else ():
        typer.echo(f"hint: {line}")


def _document(item: Overlay) -> dict[str, Any]:
    document: dict[str, Any] = item.model_dump(exclude_defaults=True)
    return json.loads(json.dumps(document, default=_plain))  # type: ignore[no-any-return]


def _plain(value: object) -> object:
    if isinstance(value, CanType):
        return value.name
    if isinstance(value, Access):
        return value.value
    return sorted(value) if isinstance(value, frozenset) else _text(value)


def _address(address: tuple[int, int]) -> str:
    return f"{address[0]:04X}h/{address[1]}"


def _text(value: object) -> str:
    if isinstance(value, frozenset):
        return ", ".join(f"{index:04X}h" for index in sorted(value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {item}" for name, item in value.items())
    return str(value)
