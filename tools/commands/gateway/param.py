"""``pdgw param``: read, write, describe, save and restore parameters over the record channel."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.tools.options import parse_address, progress_bar

if TYPE_CHECKING:
    from rich.console import RenderableType

    from pdgw.gateway.client.session import Element, Session
    from pdgw.profidrive.parameters.description import Description

app = typer.Typer(help="Read and write parameters of a gateway or of another PROFIdrive device.", no_args_is_help=True)

_DEFAULT = f"127.0.0.1:{ACYCLIC_PORT}"
Parameters = Annotated[list[str], typer.Argument(help="Parameters.", show_default=False)]
Gateway = Annotated[str, typer.Option("--gateway", help="HOST:PORT of the record channel.")]
DoId = Annotated[int, typer.Option("--do", min=0, max=254, help="DO-ID; 0 is the device.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
_place: dict[str, Any] = {}
"""The access point, from the options of the group."""


@app.callback()
def options(
    slot: Annotated[
        int | None,
        typer.Option(
            min=0, max=0x7FFF, help="Slot of the parameter access point (1), or of I&M (0).", show_default=False
        ),
    ] = None,
    subslot: Annotated[int, typer.Option(min=1, max=0xFFFF, help="Its subslot.")] = 1,
    local: Annotated[bool, typer.Option("--local", help="Use record B02Eh instead of B02Fh.")] = False,
    profinet: Annotated[
        bool, typer.Option("--profinet", help="A PROFINET station: connect for device access, beside its controller.")
    ] = False,
) -> None:
    """Parameters are written P922, 965, 6041h, 0x1018.3, 1018h.1-4 or P947[0..7]."""
    _place.update(slot=slot, subslot=subslot, local=local, profinet=profinet)


@contextmanager
def _session(gateway: str, do_id: int, slot: int = 1) -> Iterator[Session]:
    """``slot``: of the access point, if no option names one."""
    from pdgw.gateway.client.session import Session
    from pdgw.gateway.client.udp import ParameterClient

    place = dict(_place)
    profinet = place.pop("profinet", False)
    if place.get("slot") is None:
        place["slot"] = slot
    with ParameterClient(parse_address(gateway, ACYCLIC_PORT), do_id, **place) as client:
        if profinet:
            client.connect()
        yield Session(client)


def _print_table(titles: Sequence[str], rows: Iterable[Sequence[RenderableType | None]]) -> None:
    from rich.console import Console

    from pdgw.tools.output.reports import plain_table

    table = plain_table(*titles)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _show(session: Session, elements: list[Element], *, as_json: bool) -> None:
    """Print values. The exit status is 1 when a parameter could not be read."""
    from pdgw.gateway.client.session import address_text, meaning

    if as_json:
        typer.echo(json.dumps([element.document() for element in elements], indent=2))
    else:
        rows = []
        for element in elements:
            name, unit = session.name_and_unit(element.pnu, element.subindex)
            text = meaning(element, encoder=session.is_encoder)
            rows.append(
                (
                    address_text(element.pnu, element.subindex),
                    name,
                    element.format.name if element.format else "",
                    "" if element.value is None else str(element.value),
                    unit,
                    f"[red]{text}[/red]" if element.failed else text,
                )
            )
        _print_table(("parameter", "name", "format", "value", "unit", ""), rows)
    if any(element.failed for element in elements):
        raise typer.Exit(1)


@app.command()
def read(parameters: Parameters, gateway: Gateway = _DEFAULT, do_id: DoId = 1, as_json: AsJson = False) -> None:
    """Read parameters; without a subindex, all elements of an array."""
    from pdgw.gateway.client.address import parse_target

    targets = [parse_target(text) for text in parameters]
    with _session(gateway, do_id) as session:
        with progress_bar("reading") as progress:
            elements = session.read(targets, progress)
        _show(session, elements, as_json=as_json)


@app.command(context_settings={"ignore_unknown_options": True})
def write(
    assignments: Annotated[
        list[str],
        typer.Argument(help="PARAMETER VALUE pairs; several values of an array: 1,2,3", show_default=False),
    ],
    gateway: Gateway = _DEFAULT,
    do_id: DoId = 1,
    type_name: Annotated[
        str | None, typer.Option("--type", help="Data type (default: the type that the device reports).")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write parameters; as many as possible in one request."""
    from pdgw.gateway.client.address import parse_target, parse_type

    if len(assignments) % 2:
        raise GatewayError(f"{assignments[-1]!r}: a value is missing; expected PARAMETER VALUE pairs")
    pairs = [(parse_target(name), value) for name, value in zip(assignments[::2], assignments[1::2], strict=True)]
    given = parse_type(type_name) if type_name is not None else None
    with _session(gateway, do_id) as session:
        _show(session, session.write_texts(pairs, given), as_json=as_json)


def _described(pnu: int, item: Description | None) -> dict[str, Any]:
    from pdgw.gateway.client.session import full_name

    return {
        "pnu": pnu,
        "name": full_name(pnu, item.name) if item else None,
        "format": item.type.name if item else None,
        "elements": item.count if item and item.array else None,
        "writable": item.writable if item else None,
    }


@app.command("list")
def list_(gateway: Gateway = _DEFAULT, do_id: DoId = 1, as_json: AsJson = False) -> None:
    """List all parameters of the device (P980 ff)."""
    from pdgw.gateway.client.session import address_text

    with _session(gateway, do_id) as session, progress_bar("reading descriptions") as progress:
        pnus = session.pnus()
        descriptions = session.describe(pnus, progress)
    rows = [_described(pnu, descriptions[pnu]) for pnu in pnus]
    if as_json:
        typer.echo(json.dumps(rows, indent=2))
        return
    access = {None: "", True: "rw", False: "r"}
    _print_table(
        ("parameter", "name", "format", "elements", "access"),
        (
            (address_text(row["pnu"]), row["name"], row["format"], str(row["elements"] or ""), access[row["writable"]])
            for row in rows
        ),
    )


@app.command()
def describe(parameters: Parameters, gateway: Gateway = _DEFAULT, do_id: DoId = 1, as_json: AsJson = False) -> None:
    """Show description, limits and texts of parameters."""
    from pdgw.gateway.client.address import parse_target
    from pdgw.gateway.client.session import address_text

    pnus = [parse_target(text).pnu for text in parameters]
    documents: list[dict[str, Any]] = []
    with _session(gateway, do_id) as session:
        descriptions = session.describe(pnus)
        for pnu in pnus:
            item = descriptions[pnu]
            if item is None:
                documents.append({"pnu": pnu, "name": None})
                continue
            limited = item.low or item.high
            documents.append(
                {
                    **_described(pnu, item),
                    "low": item.low if limited else None,
                    "high": item.high if limited else None,
                    "texts": session.texts(pnu) if item.has_texts else [],
                }
            )
    if as_json:
        typer.echo(json.dumps(documents, indent=2))
    else:
        for document in documents:
            typer.secho(address_text(document["pnu"]), bold=True)
            for key, value in list(document.items())[1:]:
                if value is not None and value != []:
                    typer.echo(f"  {key}: {value}")
    missing = [address_text(document["pnu"]) for document in documents if document["name"] is None]
    if missing:
        raise GatewayError(f"no description of {', '.join(missing)}")


@app.command()
def identify(gateway: Gateway = _DEFAULT, as_json: AsJson = False) -> None:
    """Show vendor, order number, serial number, revisions and tags (I&M0 to I&M4) of the device, or of --slot."""
    from rich.text import Text

    from pdgw.gateway.client.udp import read_identification

    with _session(gateway, 0, slot=0) as session:
        fields = read_identification(session.client)
    if as_json:
        typer.echo(json.dumps(fields, indent=2))
        return
    # Text from a device has no markup.
    _print_table(("field", "value"), ((name, Text(value)) for name, value in fields.items()))


@app.command()
def dump(
    file: Annotated[Path, typer.Argument(help="Where to.", show_default=False)],
    gateway: Gateway = _DEFAULT,
    do_id: DoId = 1,
) -> None:
    """Save all parameters of a drive object."""
    from pdgw.gateway.client.dump import read_all
    from pdgw.gateway.client.session import address_text

    with _session(gateway, do_id) as session, progress_bar("reading") as progress:
        saved, failed = read_all(session, progress)
    saved.save(file)
    settings = sum(element.setting for element in saved.parameters)
    typer.echo(f"{file}: {counted(len(saved.parameters), 'element')}, {settings} of them settings")
    by_error: dict[str, list[str]] = {}
    for element in failed:
        by_error.setdefault(element.error_text, []).append(address_text(element.pnu, element.subindex))
    for text, addresses in by_error.items():
        more = f" and {len(addresses) - 1} more" if len(addresses) > 1 else ""
        typer.echo(f"not read: {addresses[0]}{more}: {text}", err=True)


@app.command("restore")
def restore_(
    file: Annotated[Path, typer.Argument(help="A file of `pdgw param dump`.", show_default=False)],
    gateway: Gateway = _DEFAULT,
    do_id: DoId = 1,
    yes: Annotated[bool, typer.Option("--yes", help="Write without asking.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only show the differences.")] = False,
    change_telegram: Annotated[
        bool,
        typer.Option(
            "--change-telegram", help="Restore even if the file was saved with another telegram; P922 is written last."
        ),
    ] = False,
    other: Annotated[
        bool, typer.Option("--other", help="Restore even if the file was saved from another drive object or device.")
    ] = False,
    partial: Annotated[
        bool, typer.Option("--partial", help="Keep the settings that were written when the device rejects another one.")
    ] = False,
) -> None:
    """Show the differences between a file and the device, then write all differing settings or none."""
    from pdgw.gateway.client.dump import Dump, difference, other_origin, other_telegram, restore
    from pdgw.gateway.client.session import address_text

    saved = Dump.load(file)
    with _session(gateway, do_id) as session:
        origin = "" if other else other_origin(session, saved)
        if origin:
            raise GatewayError(
                f"{file} was saved from {origin}, not from DO {do_id}: nothing was written; --other writes it anyway"
            )
        with progress_bar("comparing") as progress:
            pairs = difference(session, saved, progress)
        if not pairs:
            typer.echo("nothing differs")
            return
        _print_table(
            ("parameter", "name", "device", "file"),
            (
                (
                    address_text(item.pnu, item.subindex),
                    session.name_and_unit(item.pnu, item.subindex)[0],
                    found.error_text if found.failed else str(found.value),
                    str(item.value),
                )
                for item, found in pairs
            ),
        )
        if dry_run:
            return
        telegrams = other_telegram(pairs)
        if telegrams is not None and not change_telegram:
            raise GatewayError(
                f"DO {do_id} has telegram {telegrams[0]}, but {file} was saved with telegram {telegrams[1]}: "
                "nothing was written; check that it is the file of this axis; --change-telegram writes it "
                "anyway"
            )
        if not yes and not typer.confirm(f"write {counted(len(pairs), 'setting')} to DO {do_id}?"):
            raise typer.Exit(1)
        with progress_bar("writing") as progress:
            outcome = restore(session, pairs, progress, partial=partial)
        kept = 0 if outcome.taken_back else len(outcome.written)
        typer.echo(f"{kept} of {len(pairs)} settings written")
        if outcome.taken_back and outcome.written:
            typer.echo(f"{len(outcome.written) - len(outcome.stuck)} of {len(outcome.written)} old values written back")
        if outcome.failed or outcome.stuck:
            _show(session, [*outcome.failed, *outcome.stuck], as_json=False)
