"""``pdgw drives``: list the known drive families; check data sheets (EDS, DCF) and show what they lack."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdgw.base.phrases import did_you_mean
from pdgw.ds301.communication import NODE_IDS
from pdgw.gateway.base.errors import GatewayError

if TYPE_CHECKING:
    from pdgw.ds301.eds.importer import EdsImport
    from pdgw.ds301.eds.text import EdsError
    from pdgw.dsp402.drive_type import DriveType
    from pdgw.dsp402.identification.overlay import Overlay


def drives(
    items: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FAMILY | FILE]...",
            help="Families by name or TOML file, or EDS and DCF files.",
            show_default=False,
        ),
    ] = None,
    node_id: Annotated[
        int, typer.Option(min=NODE_IDS[0], max=NODE_IDS[-1], help="Node-ID for values of a file that depend on it.")
    ] = 1,
    write: Annotated[
        Path | None,
        typer.Option(metavar="OUT", help="Write the repaired file; only with one FILE.", show_default=False),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """List the known drive families, show one, or check EDS and DCF files and list their repairs.

    The exit status is 1 if a file cannot be used.
    """
    from pdgw.dsp402.identification.overlay import add_family, overlay, overlays

    items = [add_family(name).name if name.endswith(".toml") else name for name in items or ()]
    families = [name for name in items if name in overlays()]
    files = [Path(name) for name in items if name not in overlays()]
    if families and files:
        raise GatewayError(f"{files[0]}: give either families or files")
    if write is not None and len(files) != 1:
        raise GatewayError(f"--write: allowed with one file, {len(files)} are given")
    for file in files:
        if not file.suffix and not file.exists():
            raise GatewayError(f"{file}: neither a file nor a family{did_you_mean(str(file), overlays())}")
    if files:
        _check(files, node_id, write, as_json=as_json)
    elif families:
        _show([overlay(name) for name in families], as_json=as_json)
    else:
        _list(as_json=as_json)


def _list(*, as_json: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from pdgw.dsp402.identification.overlay import overlays

    if as_json:
        typer.echo(json.dumps([_document(item) for item in overlays().values()], indent=2))
        return
    table = Table("family", "drives", "vendor-ID", "names", "velocities")
    for name, item in overlays().items():
        vendor = f"{item.match.vendor_id:X}h" if item.match.vendor_id is not None else ""
        table.add_row(name, item.title, vendor, ", ".join(item.match.names), item.units.velocity)
    Console().print(table)


def _show(families: Sequence[Overlay], *, as_json: bool) -> None:
    """Show the facts about families with their sources and what is unverified."""
    if as_json:
        typer.echo(json.dumps([_document(item) for item in families], indent=2))
        return
    for item in families:
        _print_family(item)


def _print_family(item: Overlay) -> None:
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


def _check(files: Sequence[Path], node_id: int, write: Path | None, *, as_json: bool) -> None:
    """Import each file, name its family, and list what each telegram lacks with the values of the file."""
    from rich.console import Console

    from pdgw.ds301.eds.importer import EdsImport
    from pdgw.ds301.eds.text import EdsError
    from pdgw.tools.output.data_sheets import import_document, imported, print_import, write_repaired

    results = [(file, imported(file, node_id)) for file in files]
    if as_json:
        documents = [
            import_document(file, result) | {"notes": _notes(result)} | _match_document(result)
            for file, result in results
        ]
        typer.echo(json.dumps(documents, indent=2))
    else:
        console = Console()
        for file, result in results:
            print_import(console, file, result)
            for note in _notes(result):
                typer.echo(note)
            drive = _drive_of(result)
            if drive is not None:
                _print_match(drive)
    if any(isinstance(result, EdsError) for _, result in results):
        raise typer.Exit(1)
    for _, result in results:
        if write is not None and isinstance(result, EdsImport):
            write_repaired(write, result.text)


def _drive_of(result: EdsImport | EdsError) -> DriveType | None:
    """The drive that a file describes. None for an unusable file or another type of device."""
    from pdgw.ds301.eds.text import EdsError
    from pdgw.dsp402.identification.describe import described_by_sheet
    from pdgw.dsp402.objects import CONTROLWORD, STATUSWORD

    if isinstance(result, EdsError) or not {CONTROLWORD[0], STATUSWORD[0]} <= set(result.dictionary):
        return None
    return described_by_sheet(result.dictionary)


def _notes(result: EdsImport | EdsError) -> list[str]:
    """What a usable file describes instead of a drive, and where it contradicts itself."""
    from pdgw.ds301.communication import DEVICE_TYPE, IDENTITY, profile_of
    from pdgw.ds301.eds.pdos import variable
    from pdgw.ds301.eds.text import EdsError
    from pdgw.dsp402.objects import CONTROLWORD, STATUSWORD

    if isinstance(result, EdsError):
        return []
    dictionary = result.dictionary
    missing = [f"{index:04X}h" for index, _ in (CONTROLWORD, STATUSWORD) if index not in dictionary]
    notes = []
    if missing:
        device_type = variable(dictionary, DEVICE_TYPE)
        profile = profile_of(device_type.default) if device_type and isinstance(device_type.default, int) else 0
        notes.append(
            f"no CiA 402 drive: {' and '.join(missing)} missing" + (f", device profile {profile}" if profile else "")
        )
    info = dictionary.device_information
    stated = {"VendorNumber": info.vendor_number, "ProductNumber": info.product_number}
    for subindex, (key, number) in enumerate(stated.items(), 1):
        entry = variable(dictionary, IDENTITY, subindex)
        if number and entry is not None and entry.default and entry.default != number:
            notes.append(
                f"[DeviceInfo] {key} is {number:X}h, but 1018h/{subindex} is {entry.default:X}h: correct the wrong one; "
                "the gateway compares the device with [DeviceInfo]"
            )
    return notes


def _not_available(drive: DriveType, numbers: Iterable[int]) -> dict[int, Sequence[str]]:
    """The optional objects that the drive lacks, for each telegram."""
    from pdgw.gateway.commissioning.telegram_check import not_available
    from pdgw.profidrive.telegrams import TELEGRAMS

    return {number: lines for number in numbers if (lines := not_available(drive, TELEGRAMS[number]))}


def _match_document(result: EdsImport | EdsError) -> dict[str, Any]:
    from pdgw.gateway.commissioning.telegram_check import lacks_by_telegram, missing_lines
    from pdgw.profidrive.telegrams import telegram

    drive = _drive_of(result)
    if drive is None:
        return {}
    missing = lacks_by_telegram(drive)
    return {
        "name": drive.name,
        "family": drive.family or None,
        "modes": dict(drive.modes),
        "homing_methods": list(drive.homing_methods),
        "scaling": list(drive.scaling.lines),
        "telegrams": dict(missing),
        "keys": list(missing_lines(drive, *map(telegram, missing))),
        "not_available": _not_available(drive, missing),
    }


def _print_match(drive: DriveType) -> None:
    from pdgw.dsp402.identification.overlay import overlay
    from pdgw.gateway.commissioning.telegram_check import lacks_by_telegram, missing_lines
    from pdgw.profidrive.telegrams import telegram

    missing = lacks_by_telegram(drive)
    without = _not_available(drive, missing)
    typer.echo(
        f"{drive.name}: "
        + (f"family {drive.family}" if drive.family else "no family: a CiA 402 drive as its own objects describe it")
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
    lines = missing_lines(drive, *map(telegram, missing))
    if lines:
        typer.echo("paste into its [[axis]] and fill in the keys that the telegram needs:")
    for line in lines:
        typer.echo(f"  {line}")
    for line in overlay(drive.family).hints if drive.family else ():
        typer.echo(f"hint: {line}")


def _document(item: Overlay) -> dict[str, Any]:
    document: dict[str, Any] = item.model_dump(exclude_defaults=True)
    return json.loads(json.dumps(document, default=_plain))  # type: ignore[no-any-return]


def _plain(value: object) -> object:
    from pdgw.ds301.objects import Access, CanType

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
