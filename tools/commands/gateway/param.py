"""``pdgw param``: read, write, describe, save and restore parameters over the record channel."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from uuid import UUID

import typer

from pdgw.gateway.errors import GatewayError
from pdgw.phrases import counted
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.rpc.identification import PROFILE_ID
from pdgw.profinet.rpc.records import NIL
from pdgw.tools.address import parse_address

if TYPE_CHECKING:
    from pdgw.client.session import Element, Progress, Session
    from pdgw.client.udp import ParameterClient

app = typer.Typer(help="Parameters of a gateway or of another PROFIdrive device.", no_args_is_help=True)

GATEWAY = typer.Option("--gateway", help="HOST:PORT of the record channel.")
DO = typer.Option("--do", min=0, max=254, help="DO-ID; 0 is the device.")
JSON = typer.Option("--json", help="Print JSON.")


@dataclass
class _Place:
    """Options shared by the commands of the group."""

    slot: int = 1
    subslot: int = 1
    api: int = PROFILE_ID
    local: bool = False
    ar_uuid: UUID = NIL
    station: bool = False


_place = _Place()
_DEFAULT = f"127.0.0.1:{ACYCLIC_PORT}"


@app.callback()
def options(
    slot: Annotated[int, typer.Option(min=0, max=0x7FFF, help="Slot of the parameter access point.")] = 1,
    subslot: Annotated[int, typer.Option(min=1, max=0xFFFF, help="Its subslot.")] = 1,
    api: Annotated[int, typer.Option(min=0, help="Its API.")] = PROFILE_ID,
    local: Annotated[bool, typer.Option("--local", help="Use record B02Eh instead of B02Fh.")] = False,
    ar_uuid: Annotated[UUID, typer.Option(help="AR UUID of the application relationship.")] = NIL,
    profinet: Annotated[
        bool, typer.Option("--profinet", help="A PROFINET station: connect for device access, beside its controller.")
    ] = False,
) -> None:
    """Parameters are written P922, 965, 6041h, 0x1018.3, 1018h.1-4 or P947[0..7]."""
    global _place  # noqa: PLW0603 (typer hands the options of a group over no other way that is shorter)
    _place = _Place(slot, subslot, api, local, ar_uuid, profinet)


@contextmanager
def _client(gateway: str, do_id: int) -> Iterator[ParameterClient]:
    from pdgw.client.udp import ParameterClient

    place = _place
    with ParameterClient(
        parse_address(gateway, ACYCLIC_PORT),
        do_id,
        slot=place.slot,
        subslot=place.subslot,
        api=place.api,
        local=place.local,
        ar_uuid=place.ar_uuid,
    ) as client:
        if place.station:
            client.connect()
        yield client


@contextmanager
def _session(gateway: str, do_id: int) -> Iterator[Session]:
    from pdgw.client.session import Session

    with _client(gateway, do_id) as client:
        yield Session(client)


@contextmanager
def _progress(what: str) -> Iterator[Progress | None]:
    """Show a progress bar for long work, on a terminal only."""
    from rich.console import Console
    from rich.progress import Progress as ProgressBar

    if not sys.stderr.isatty():
        yield None
        return
    with ProgressBar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _show(session: Session, elements: list[Element], *, as_json: bool) -> None:
    """Print values. The exit status is 1 when a parameter could not be read."""
    from rich.console import Console

    from pdgw.client.session import address_text, meaning
    from pdgw.tools.output.tables import plain_table

    if as_json:
        typer.echo(json.dumps([element.document() for element in elements], indent=2))
    else:
        table = plain_table("parameter", "name", "format", "value", "unit", "")
        for element in elements:
            name, unit = session.name_and_unit(element.pnu, element.subindex)
            text = meaning(element, encoder=session.is_encoder)
            table.add_row(
                address_text(element.pnu, element.subindex),
                name,
                element.format.name if element.format else "",
                "" if element.value is None else str(element.value),
                unit,
                f"[red]{text}[/red]" if element.failed else text,
            )
        Console().print(table)
    if any(element.failed for element in elements):
        raise typer.Exit(1)


@app.command()
def read(
    parameters: Annotated[list[str], typer.Argument(help="Parameters to read.", show_default=False)],
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Read parameters; without a subindex, all elements of an array."""
    from pdgw.client.address import parse_target

    targets = [parse_target(text) for text in parameters]
    with _session(gateway, do_id) as session:
        with _progress("reading") as progress:
            elements = session.read(targets, progress)
        _show(session, elements, as_json=as_json)


@app.command(context_settings={"ignore_unknown_options": True})
def write(
    assignments: Annotated[
        list[str],
        typer.Argument(help="PARAMETER VALUE pairs; several values of an array: 1,2,3", show_default=False),
    ],
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
    type_name: Annotated[
        str | None, typer.Option("--type", help="Data type (default: the type that the device reports).")
    ] = None,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Write parameters; as many as possible in one request."""
    from pdgw.client.address import parse_target, parse_type, parse_value

    if len(assignments) % 2:
        raise GatewayError(f"{assignments[-1]!r}: a value is missing; expected PARAMETER VALUE pairs")
    pairs = [(parse_target(name), value) for name, value in zip(assignments[::2], assignments[1::2], strict=True)]
    given = parse_type(type_name) if type_name is not None else None
    with _session(gateway, do_id) as session:
        writes = [
            (target, parse_value(value, given if given is not None else session.type_of(target)))
            for target, value in pairs
        ]
        elements = session.write(writes)
        _show(session, elements, as_json=as_json)


@app.command("list")
def list_(
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """List all parameters of the device (P980 ff)."""
    from rich.console import Console

    from pdgw.client.names import full_name
    from pdgw.client.session import address_text
    from pdgw.tools.output.tables import plain_table

    with _session(gateway, do_id) as session, _progress("reading descriptions") as progress:
        pnus = session.pnus()
        descriptions = session.describe(pnus, progress)
    if as_json:
        rows = []
        for pnu in pnus:
            item = descriptions[pnu]
            details = {
                "name": full_name(pnu, item.name) if item else None,
                "format": item.type.name if item else None,
                "elements": item.count if item and item.array else None,
                "writable": item.writable if item else None,
            }
            rows.append({"pnu": pnu, **details})
        typer.echo(json.dumps(rows, indent=2))
        return
    table = plain_table("parameter", "name", "format", "elements", "access")
    for pnu in pnus:
        item = descriptions[pnu]
        table.add_row(
            address_text(pnu),
            full_name(pnu, item.name) if item else "",
            item.type.name if item else "",
            str(item.count) if item and item.array else "",
            ("rw" if item.writable else "r") if item else "",
        )
    Console().print(table)


@app.command()
def describe(
    parameters: Annotated[list[str], typer.Argument(help="Parameters.", show_default=False)],
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
    as_json: Annotated[bool, JSON] = False,
) -> None:
    """Show description, limits and texts of parameters."""
    from rich.console import Console

    from pdgw.client.address import parse_target
    from pdgw.client.names import full_name
    from pdgw.client.session import address_text

    targets = [parse_target(text) for text in parameters]
    documents: list[dict[str, object]] = []
    with _session(gateway, do_id) as session:
        descriptions = session.describe([target.pnu for target in targets])
        for target in targets:
            item = descriptions[target.pnu]
            if item is None:
                documents.append({"pnu": target.pnu, "name": None})
                continue
            documents.append(
                {
                    "pnu": target.pnu,
                    "name": full_name(target.pnu, item.name),
                    "format": item.type.name,
                    "elements": item.count if item.array else None,
                    "writable": item.writable,
                    "low": item.low if item.low or item.high else None,
                    "high": item.high if item.low or item.high else None,
                    "texts": session.texts(target.pnu) if item.has_texts else [],
                }
            )
    if as_json:
        typer.echo(json.dumps(documents, indent=2))
    else:
        console = Console()
        for document in documents:
            console.print(f"[bold]{address_text(int(str(document['pnu'])))}[/bold]")
            for key, value in list(document.items())[1:]:
                if value is not None and value != []:
                    console.print(f"  {key}: {value}", highlight=False, markup=False)
    if any(document["name"] is None for document in documents):
        raise GatewayError(
            "no description of "
            + ", ".join(address_text(int(str(item["pnu"]))) for item in documents if item["name"] is None)
        )


@app.command()
def identify(gateway: Annotated[str, GATEWAY] = _DEFAULT, as_json: Annotated[bool, JSON] = False) -> None:
    """Show vendor, order number, serial number, revisions and tags of the device (I&M0 to I&M4)."""
    from rich.console import Console
    from rich.text import Text

    from pdgw.client.identify import read_identification
    from pdgw.tools.output.tables import plain_table

    with _client(gateway, 0) as client:
        fields = read_identification(client)
    if as_json:
        typer.echo(json.dumps(fields, indent=2))
        return
    table = plain_table("field", "value")
    for name, value in fields.items():
        table.add_row(name, Text(value))  # text from a device: no markup
    Console().print(table)


@app.command()
def dump(
    file: Annotated[Path, typer.Argument(help="Where to.", show_default=False)],
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
) -> None:
    """Save all parameters of a drive object."""
    from rich.console import Console

    from pdgw.client.dump import read_all
    from pdgw.client.session import address_text

    with _session(gateway, do_id) as session, _progress("reading") as progress:
        saved, failed = read_all(session, progress)
    saved.save(file)
    settings = sum(element.setting for element in saved.parameters)
    Console().print(f"{file}: {counted(len(saved.parameters), 'element')}, {settings} of them settings")
    by_error: dict[str, list[str]] = {}
    for element in failed:
        by_error.setdefault(element.error_text, []).append(address_text(element.pnu, element.subindex))
    for text, addresses in by_error.items():
        more = f" and {len(addresses) - 1} more" if len(addresses) > 1 else ""
        Console(stderr=True).print(f"not read: {addresses[0]}{more}: {text}", highlight=False)


@app.command("restore")
def restore_(
    file: Annotated[Path, typer.Argument(help="A file of `pdgw param dump`.", show_default=False)],
    gateway: Annotated[str, GATEWAY] = _DEFAULT,
    do_id: Annotated[int, DO] = 1,
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
    from rich.console import Console

    from pdgw.client.dump import Dump, difference, other_origin, other_telegram, restore
    from pdgw.client.session import address_text
    from pdgw.tools.output.tables import plain_table

    saved = Dump.load(file)
    console = Console()
    with _session(gateway, do_id) as session:
        origin = "" if other else other_origin(session, saved)
        if origin:
            raise GatewayError(
                f"{file} was saved from {origin}, not from DO {do_id}: nothing was written; --other writes it anyway"
            )
        with _progress("comparing") as progress:
            pairs = difference(session, saved, progress)
        if not pairs:
            console.print("nothing differs")
            return
        differences = plain_table("parameter", "name", "device", "file")
        for wanted, found in pairs:
            name, _ = session.name_and_unit(wanted.pnu, wanted.subindex)
            shown = found.error_text if found.failed else str(found.value)
            differences.add_row(address_text(wanted.pnu, wanted.subindex), name, shown, str(wanted.value))
        console.print(differences)
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
        with _progress("writing") as progress:
            outcome = restore(session, pairs, progress, partial=partial)
        kept = 0 if outcome.taken_back else len(outcome.written)
        console.print(f"{kept} of {len(pairs)} settings written")
        if outcome.taken_back and outcome.written:
            console.print(
                f"{len(outcome.written) - len(outcome.stuck)} of {len(outcome.written)} old values written back"
            )
        if outcome.failed or outcome.stuck:
            _show(session, [*outcome.failed, *outcome.stuck], as_json=False)
