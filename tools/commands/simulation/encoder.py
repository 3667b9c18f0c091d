"""``pdgw sim encoder``: simulate CiA 406 encoders on any python-can bus, with motions and faults chosen at run time."""

from __future__ import annotations

from typing import Annotated

import typer

from pdgw.dsp406.kinds import DEVICES, ROTARY
from pdgw.peers.option_values import MOTIONS
from pdgw.tools.options import ControlPort


def encoder(
    interface: Annotated[str, typer.Option(help="python-can interface.")] = "virtual",
    channel: Annotated[str, typer.Option(help="Channel of the interface.")] = "pdgw",
    bitrate: Annotated[int | None, typer.Option(help="Bit rate.")] = None,
    node_id: Annotated[
        list[int] | None, typer.Option(min=1, max=126, help="Node-ID; repeat for several encoders.")
    ] = None,
    model: Annotated[str, typer.Option(help=f"One of {', '.join(DEVICES)}.")] = ROTARY.name,
    channels: Annotated[
        int | None, typer.Option(help="Channels of a multi-sensor encoder, 1..254.", show_default=False)
    ] = None,
    motion: Annotated[
        list[str] | None,
        typer.Option(help=f"{MOTIONS}; repeat for further channels. In revolutions, for linear encoders in mm."),
    ] = None,
    control_port: ControlPort = 0,
) -> None:
    """Run simulated encoders until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`."""
    from pdgw.peers.simulation.config import ControlConfig
    from pdgw.peers.simulation.console import run_nodes

    control = ControlConfig(port=control_port)
    options = {"model": model, "channels": channels, "motion": motion or ()}
    run_nodes("encoder", (interface, channel, bitrate), node_id or [1], control, f"{model} encoder", **options)
