"""``pdgw config``: print an example configuration, check a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError

if TYPE_CHECKING:
    from pdgw.ds301.node.plan import PdoPlan
    from pdgw.dsp402.drive_type import DriveType
    from pdgw.gateway.configuration.axis_config import AxisConfig
    from pdgw.gateway.configuration.config import GatewayConfig
    from pdgw.gateway.configuration.environment import CanConfig

app = typer.Typer(help="Print an example configuration, or check a file.", no_args_is_help=True)


@app.command()
def example() -> None:
    """Print a commented configuration."""
    from pdgw.gateway.configuration.defaults import example as example_text

    typer.echo(example_text(), nl=False)


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="Configuration file (TOML).")],
    bus: Annotated[
        bool,
        typer.Option("--bus", help="Also read units and PDOs from the drives on the bus; read-only."),
    ] = False,
    run: Annotated[
        bool,
        typer.Option("--run", help="Also open the ports and interfaces of `pdgw run`; sends nothing."),
    ] = False,
) -> None:
    """Validate a file; print one line for each error (exit status 1)."""
    from pdgw.gateway.base.store import stored_parameters
    from pdgw.gateway.configuration.check import references_wrong
    from pdgw.gateway.configuration.file import load_config
    from pdgw.gateway.service.operating_system import NEEDED_BELOW_MS
    from pdgw.peers.simulation.config import simulated_devices

    config = load_config(file)
    for can in config.can:
        simulated_devices(config, can)
    wrong = references_wrong(config, file)
    if wrong:
        raise GatewayError("\n".join(wrong))
    protected = _start(config)
    stored = stored_parameters(config.store, config.file).telegrams
    if replaced := config.replaced_telegrams(stored):
        config = config.with_telegrams(stored)
        protected = _start(config)
    buses = ", ".join(f"{bus.name} ({bus.interface} {bus.channel or ''})".replace(" )", ")") for bus in config.can)
    objects = counted(len(config.axis), "axis", "axes") + (
        f" and {counted(len(config.encoder), 'encoder')}" if config.encoder else ""
    )
    typer.echo(f"{file}: ok, {objects} on {buses}, cycle {config.transport.cycle_time_ms:g} ms")
    for line in (*replaced, *protected):
        typer.echo(line)
    refused = False
    if bus:
        refused = _check_buses(config)
    else:
        for axis in config.axis:
            refused |= _refuses(config, axis)
        for item in config.can:
            if item.interface != "virtual" or item.bitrate is not None:
                _print_bus_load(config, item, {})
    for item in config.can:
        _print_encoders(config, item)
    if run:
        _open(config)
    elif config.transport.cycle_time_ms < NEEDED_BELOW_MS:
        typer.echo(_scheduling(config))
    if refused:
        raise typer.Exit(1)


def _check_buses(config: GatewayConfig) -> bool:
    """Read units and PDOs from the drives and print the bus load. True when a drive does not answer or cannot run its
    telegram.
    """
    refused = False
    for item in config.can:
        plans = {axis.node_id: _ask(config, axis) for axis in config.axes_of(item)}
        known = {node_id: plan for node_id, plan in plans.items() if plan is not None}
        refused |= len(known) < len(plans)
        _print_bus_load(config, item, known)
    return refused


def _scheduling(config: GatewayConfig) -> str:
    """What a short cycle requires from the operating system, as text."""
    from pdgw.gateway.service.operating_system import NEEDED_BELOW_MS

    return (
        f"a cycle below {NEEDED_BELOW_MS} ms needs real-time priority on a busy machine (docs/operation.md); "
        "the log shows whether it is granted"
    )


def _print_bus_load(config: GatewayConfig, bus: CanConfig, plans: Mapping[int, PdoPlan]) -> None:
    """Print the load of a bus and the longest delay of its frames. CanopenError when the cycle is too short for them.

    ``plans``: PDOs of the drives that answered.
    """
    from pdgw.ds301.bus.load import DEFAULT_BITRATE, check_load
    from pdgw.gateway.configuration.bus_load import check_cycle, latest

    cycle_ms, bitrate = config.transport.cycle_time_ms, bus.bitrate or DEFAULT_BITRATE
    frames = config.frames_of(bus, plans)
    load = check_load(bus.name, frames, bitrate)
    asked = " with these PDOs" if plans else ""
    typer.echo(f"bus {bus.name}: worst-case load {load:.0%} of {bitrate} bit/s{asked}; longest delay of each frame:")
    found = latest(frames, bitrate, cycle_ms)
    for item in found:
        typer.echo(f"  {item}")
    check_cycle(bus.name, found)


def _start(config: GatewayConfig) -> list[str]:
    """Find all other errors of a start: build the gateway in a simulated world, without interfaces, ports or files.

    The result is a line for each protection, as far as it is known before the start.
    """
    from pdgw.gateway.configuration.environment import TransportConfig
    from pdgw.gateway.daemon.assembly import build_gateway
    from pdgw.gateway.objects.axis import Axis
    from pdgw.gateway.objects.protections import protections
    from pdgw.gateway.service.causes import who
    from pdgw.peers.world import World

    # A PROFINET link needs a real network interface, so UDP replaces it.
    transport = config.transport if config.transport.type == "udp" else TransportConfig()
    daemon = build_gateway(config.model_copy(update={"transport": transport, "store": None}), World())
    found: dict[str, list[Axis]] = {}
    for axis in daemon.axes:
        for item in protections(axis):
            found.setdefault(f"{item.name}: {item.text}", []).append(axis)
    daemon.release()
    return [f"{who(axes)}: {line}" for line, axes in found.items()]


def _open(config: GatewayConfig) -> None:
    """Open what a start needs of this machine, and close it: GatewayError or CanopenError with the first that is missing.

    A gateway that runs has its ports, and its recording must stay.
    """
    from pdgw.gateway.daemon.assembly import build_gateway
    from pdgw.gateway.service.operating_system import request

    unrecorded = config.trace.model_copy(update={"enabled": False})
    daemon = build_gateway(config.model_copy(update={"trace": unrecorded}))
    for service in daemon.services:
        service.stop()
    daemon.release()
    typer.echo(f"this machine: ports and CAN interfaces can be opened, {request(config.transport.cycle_time_ms)[1]}")


def _refuses(config: GatewayConfig, axis: AxisConfig) -> bool:
    """Print the PDOs that the data sheet of a drive leads to. True when its telegram is impossible with them, or with a value
    of its files."""
    from pdgw.ds301.aborts import CanopenError
    from pdgw.dsp402.drive.client import load_eds
    from pdgw.dsp402.identification.describe import described_by_sheet

    if axis.eds is None:
        return False
    drive = described_by_sheet(load_eds(axis.eds, axis.node_id), axis.units, axis.families)
    if forbidden := _forbidden_value(config, axis, drive):
        typer.echo(f"DO {axis.do_id}: telegram {axis.telegram} is rejected: {forbidden}")
        return True
    try:
        _, lines = _plan(config, axis, drive)
    except CanopenError as error:
        typer.echo(f"DO {axis.do_id}: telegram {axis.telegram} is rejected: {error}")
        return True
    for line in lines:
        typer.echo(f"DO {axis.do_id}: {line}")
    return False


def _forbidden_value(config: GatewayConfig, axis: AxisConfig, drive: DriveType) -> str:
    """The value of the files that the telegram does not allow; empty if there is none."""
    from dataclasses import replace

    from pdgw.gateway.commissioning.telegram_check import lacks

    values, cycle_ms = axis.device_values("axis"), config.transport.cycle_time_ms
    for row in axis.drive_settings(axis.telegram, cycle_ms).corrected(drive):
        value = values.numbers.get(row.address)
        if value is not None and not row.fits(value):
            return f"{row.entry} = {value} of {values.source}: {row.why}; allowed: {row.corrected(value)}"
    settings = axis.settings_at(cycle_ms)
    without, with_values = (
        lacks(item, axis.chosen, settings) for item in (drive, replace(drive, acting=values.numbers))
    )
    return "" if with_values == without else f"{values.source}: {with_values}"


def _plan(config: GatewayConfig, axis: AxisConfig, drive: DriveType) -> tuple[PdoPlan, tuple[str, ...]]:
    """The PDOs of a drive, and lines about them for the user."""
    from pdgw.gateway.commissioning.supervisions import speed_by_sdo
    from pdgw.gateway.commissioning.telegram_check import planned

    cycle_ms = config.transport.cycle_time_ms
    node, settings = axis.drive_settings(axis.telegram, cycle_ms), axis.settings_at(cycle_ms)
    plan = planned(drive, axis.chosen, axis.node_id, sync=node.sync, settings=settings)
    return plan, (*plan.lines, *speed_by_sdo(plan, node, axis.reaction_ns(axis.telegram, cycle_ms)))


def _print_encoders(config: GatewayConfig, bus: CanConfig) -> None:
    """Print the PDOs that the data sheets of encoders lead to."""
    from pdgw.dsp406.encoder import EncoderSheet

    for channels in config.encoders_of(bus).values():
        first, numbers = channels[0], tuple(item.channel for item in channels)
        if first.eds is not None:
            sheet = EncoderSheet(first.settings(numbers, config.transport.cycle_time_ms))
            for line in sheet.plan().lines:
                typer.echo(f"DO {', '.join(str(item.do_id) for item in channels)}: {line}")


def _ask(config: GatewayConfig, axis: AxisConfig) -> PdoPlan | None:
    """Read an axis' drive and print its 100 % values and PDOs. None when the drive cannot run the telegram."""
    from pdgw.ds301.aborts import CanopenError
    from pdgw.ds301.node.sdo import Inquiry
    from pdgw.dsp402.acting import left_to_the_drive
    from pdgw.dsp402.drive.client import load_eds
    from pdgw.dsp402.identification.generic import probe
    from pdgw.gateway.commissioning.telegram_check import lacks, missing_lines
    from pdgw.tools.bus_task import complete, opened

    try:
        dictionary = load_eds(axis.eds, axis.node_id) if axis.eds else None
        with opened(config.bus_of(axis)) as network, Inquiry(network, axis.node_id, axis.sdo_timeout_ms / 1000) as node:
            drive = complete(network.loop, lambda: probe(node, dictionary, axis.units, axis.families))
    except CanopenError as error:
        typer.echo(f"DO {axis.do_id}: {error}")  # the text names what is wrong with the node, its bus or its data sheet
        return None
    typer.echo(
        f"DO {axis.do_id}, node {axis.node_id}: {drive.name}" + (f", family {drive.family}" if drive.family else "")
    )
    for line in drive.scaling.lines:
        typer.echo(f"  {line}")
    settings = axis.settings_at(config.transport.cycle_time_ms)
    refusal = lacks(drive, axis.chosen, settings)
    if refusal:
        typer.echo(f"  telegram {axis.telegram} is rejected: {refusal}")
        for line in missing_lines(drive, axis.chosen, settings=settings):
            typer.echo(f"    {line}")
        return None
    plan, lines = _plan(config, axis, drive)
    modes = axis.drive_settings(axis.telegram, config.transport.cycle_time_ms).modes(drive)
    left = left_to_the_drive(drive.acting, modes, {entry.address for entry in plan.commanded})
    for line in (*lines, *left):
        typer.echo(f"  {line}")
    return plan
