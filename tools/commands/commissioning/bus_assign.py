"""``pdgw bus assign``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.gateway.base.errors import GatewayError

if TYPE_CHECKING:
    from pdgw.tools.commissioning.lss import Identity


def assign(
    node_id: Annotated[int, typer.Argument(min=1, max=127, help="The new node-ID.")],
    config: Annotated[
        Path | None, typer.Argument(help="Configuration with one bus, in place of the options.", show_default=False)
    ] = None,
    interface: Annotated[str, typer.Option(help="python-can interface, without a configuration.")] = "socketcan",
    channel: Annotated[str, typer.Option(help="Channel of the interface.")] = "can0",
    bitrate: Annotated[int | None, typer.Option(help="Bit rate of the bus.")] = None,
    old: Annotated[
        int | None,
        typer.Option("--from", min=1, max=127, help="Its present node-ID; without it the device has none."),
    ] = None,
    serial: Annotated[
        str | None, typer.Option(help="Serial number (1018h/4), where several devices have no node-ID.")
    ] = None,
    new_bitrate: Annotated[
        int | None, typer.Option(help="Bit rate that the device has after it was switched off and on.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Give a device its node-ID, and a bit rate if asked, by LSS; store it and read it back."""
    from pdgw.ds301.communication import LSS_BIT_TIMINGS
    from pdgw.gateway.commissioning.node_ids import look_before
    from pdgw.gateway.configuration.environment import CanConfig
    from pdgw.gateway.configuration.file import load_config
    from pdgw.tools.bus_task import blocking, complete, opened
    from pdgw.tools.commissioning.lss import LssBus, identity_text

    if new_bitrate is not None and new_bitrate not in LSS_BIT_TIMINGS:
        raise GatewayError(f"--new-bitrate {new_bitrate}: allowed: {', '.join(map(str, LSS_BIT_TIMINGS))}")
    bus = CanConfig(interface=interface, channel=channel, bitrate=bitrate, name=channel)
    if config is not None:
        bus, *others = load_config(config).can
        if others:
            raise GatewayError(f"{config} has several buses; name one by --interface and --channel")
    with opened(bus) as network:
        known = complete(network.loop, lambda: look_before(network, node_id, old))
    with blocking(bus) as master:
        lss = LssBus(master)
        with lss.opened():
            identity = known or _chosen(lss.non_configured(), serial)
            typer.echo(f"{'no node-ID' if old is None else f'node {old}'}: {identity_text(identity)}")
            rate = "" if new_bitrate is None else f" and {new_bitrate} bit/s"
            if not yes and not typer.confirm(f"give it node-ID {node_id}{rate}?"):
                raise GatewayError("nothing is changed")
            failed = lss.assign(identity, node_id, old, new_bitrate)
    typer.echo(f"node {node_id}: answers with this identity, {failed or 'stored'}")
    if new_bitrate is not None:
        typer.echo(
            f"{new_bitrate} bit/s: after it was switched off and on; then it is alone on that bit rate until the others "
            "and the adapter have it"
        )
    if failed:
        raise typer.Exit(1)


def _chosen(found: list[Identity], serial: str | None) -> Identity:
    """The device without a node-ID that is meant. GatewayError if there is none, or more than one."""
    from pdgw.tools.commissioning.lss import identity_text

    if not found:
        raise GatewayError(
            "no device without a node-ID answers LSS. Connect and power it; it needs the bit rate of the bus. A device that "
            "has a node-ID needs --from; one without LSS has switches or an object of its maker"
        )
    wanted = found if serial is None else [item for item in found if item[3] == _number(serial)]
    if len(wanted) != 1:
        listed = "; ".join(map(identity_text, found))
        raise GatewayError(f"{len(wanted)} devices without a node-ID fit, choose one by --serial: {listed}")
    return wanted[0]


def _number(serial: str) -> int:
    from pdgw.gateway.client.address import parse_integer

    try:
        return parse_integer(serial)
    except ValueError:
        raise GatewayError(f"--serial {serial}: expected a number such as 4711, 0x1267 or 1267h") from None
