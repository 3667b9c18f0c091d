"""``pdgw bus``: scan a CAN bus before a gateway uses it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdgw.base.durations import SECOND
from pdgw.dsp402.objects import DRIVE_PROFILE
from pdgw.dsp406.kinds import ENCODER_PROFILE
from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.tools.command_table import BUS_COMMANDS, lazy_group

if TYPE_CHECKING:
    from pdgw.gateway.commissioning.scan import Expected, FoundNode
    from pdgw.gateway.configuration.environment import CanConfig
    from pdgw.tools.commissioning.lss import Identity

app = typer.Typer(
    cls=lazy_group(BUS_COMMANDS),
    help="List the nodes of a CAN bus, or give one its node-ID, without a running gateway.",
    no_args_is_help=True,
)

_PROFILES = {DRIVE_PROFILE: "drive", ENCODER_PROFILE: "encoder"}


@app.callback()
def group() -> None:
    """List the nodes of a CAN bus, or give one its node-ID, without a running gateway."""


def scan(
    config: Annotated[
        Path | None,
        typer.Argument(help="Configuration; its buses are scanned and compared with its nodes.", show_default=False),
    ] = None,
    interface: Annotated[str, typer.Option(help="python-can interface, without a configuration.")] = "socketcan",
    channel: Annotated[str, typer.Option(help="Channel of the interface.")] = "can0",
    bitrate: Annotated[int | None, typer.Option(help="Bit rate.")] = None,
    eds: Annotated[list[Path] | None, typer.Option(help="Data sheet, or a folder of them; repeat for several.")] = None,
    listen_s: Annotated[float, typer.Option(min=0.0, max=60, help="Listen for this time first.")] = 1.0,
    timeout_ms: Annotated[int, typer.Option(min=10, max=60_000, help="Timeout for the answer of a drive.")] = 1000,
    write: Annotated[
        Path | None,
        typer.Option(help="Write a first configuration of what is found to this new file.", show_default=False),
    ] = None,
    bitrates: Annotated[
        bool, typer.Option("--bitrates", help="Also listen at the other usual bit rates; sends nothing there.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON list, one object per bus.")] = False,
) -> None:
    """List the nodes on a bus, their types and what they lack for each telegram; read-only."""
    from pdgw.gateway.commissioning.draft import draft
    from pdgw.gateway.commissioning.scan import Scan, expected_on, load_sheets
    from pdgw.gateway.configuration.environment import CanConfig
    from pdgw.gateway.configuration.file import load_config
    from pdgw.tools.bus_task import blocking, complete, opened
    from pdgw.tools.commissioning.bit_rates import hints, listen
    from pdgw.tools.commissioning.lss import LssBus

    if write is not None and (config is not None or write.exists()):
        raise GatewayError(
            f"--write {write}: the file exists; name a new one"
            if config is None
            else f"--write {write}: {config} describes the buses already; scan without a configuration"
        )
    places: list[tuple[CanConfig, dict[int, Expected]]]
    if config is None:
        places = [(CanConfig(interface=interface, channel=channel, bitrate=bitrate, name=channel), {})]
    else:
        loaded = load_config(config)
        places = [(bus, expected_on(loaded, bus)) for bus in loaded.can]
    sheets = load_sheets(eds or ())
    documents = []
    for bus, expected in places:
        with opened(bus) as network:
            scan_ = Scan(
                network,
                sheets,
                expected,
                listen_ns=int(listen_s * SECOND),
                answer_ns=timeout_ms * SECOND // 1000,
                timeout_s=timeout_ms / 1000,
            )
            found = complete(network.loop, scan_.run)
            tries = list(hints(network, bus.bitrate))
        with blocking(bus) as master:
            lss = LssBus(master)
            with lss.opened():
                new = lss.non_configured()
        if as_json:
            nodes = [_document(node) for node in found]
            documents.append({"bus": bus.name, "nodes": nodes, "non_configured": [_new_document(item) for item in new]})
        else:
            for line in _lines(bus, found, new):
                typer.echo(line)
            for line in () if found or new else tries:
                typer.echo(f"  -> {line}")
            for line in listen(bus) if bitrates else ():
                typer.echo(line)
        if write is not None:
            text = draft(bus, found)
            with writing(f"--write {write}"), write.open("x", encoding="utf-8") as file:
                file.write(text)
            typer.echo(f"{write}: written; next: pdgw config check {write}", err=True)
    if as_json:
        typer.echo(json.dumps(documents, indent=2))


def _lines(bus: CanConfig, found: list[FoundNode], new: list[Identity]) -> Iterator[str]:
    from pdgw.tools.commissioning.lss import identity_text

    count = (
        f"{len(found)} node{'' if len(found) == 1 else 's'}" if found else "no node found: no heartbeat and no answer"
    )
    yield f"{bus.name} ({bus.interface} {bus.channel}): {count}"
    for node in found:
        yield ""
        yield from _node_lines(node)
    for identity in new:
        yield ""
        yield f"no node-ID: {identity_text(identity)}"
        yield "  -> give it one: pdgw bus assign NODE-ID"


def _new_document(identity: Identity) -> dict[str, int]:
    keys = ("vendor_id", "product_code", "revision", "serial_number")
    return dict(zip(keys, identity, strict=True))


def _node_lines(node: FoundNode) -> Iterator[str]:
    state = f", {node.nmt_state}" if node.nmt_state else ""
    if node.device_type is None:
        yield f"node {node.node_id}{state}"
    else:
        assert node.profile is not None
        kind = _PROFILES.get(node.profile, f"profile {node.profile}")
        yield f"node {node.node_id}: {kind} {node.name!r}{state}"
        numbers = (
            ("vendor-ID", node.vendor_id),
            ("product code", node.product_code),
            ("revision", node.revision),
            ("serial number", node.serial_number),
        )
        yield "  1018h: " + ", ".join(f"{what} {value:08X}h" for what, value in numbers if value is not None)
        drive = node.drive
        if drive is not None:
            yield f"  family: {drive.family or 'none, CiA 402 as it tells itself'}"
        yield f"  data sheet: {node.eds or 'none given that fits'}"
        if drive is not None:
            yield f"  modes: {', '.join(f'{mode} {name}' for mode, name in drive.modes.items())}"
            yield f"  PDOs: {len(drive.pdos.rpdos)} RPDOs, {len(drive.pdos.tpdos)} TPDOs"
            for line in drive.scaling.lines:
                yield f"  {line}"
    fit = [str(number) for number, missing in node.lacks.items() if not missing]
    if node.lacks:
        yield f"  usable with telegrams: {', '.join(fit) or 'none'}"
    by_reason: dict[str, list[str]] = {}
    for number, missing in node.lacks.items():
        if missing:
            by_reason.setdefault(missing, []).append(str(number))
    for missing, numbers_ in by_reason.items():
        yield f"  telegram{'s' if len(numbers_) > 1 else ''} {', '.join(numbers_)}: {missing}"
    for note in node.notes:
        yield f"  -> {note}"


def _document(node: FoundNode) -> dict[str, Any]:
    drive = node.drive
    return {
        "node_id": node.node_id,
        "nmt_state": node.nmt_state or None,
        "profile": node.profile,
        "device_type": node.device_type,
        "vendor_id": node.vendor_id,
        "product_code": node.product_code,
        "revision": node.revision,
        "serial_number": node.serial_number,
        "name": node.name,
        "eds": None if node.eds is None else str(node.eds),
        "family": None if drive is None else drive.family or None,
        "modes": {} if drive is None else {str(mode): name for mode, name in drive.modes.items()},
        "scaling": [] if drive is None else list(drive.scaling.lines),
        "telegrams": {str(number): missing for number, missing in node.lacks.items()},
        "notes": node.notes,
    }
