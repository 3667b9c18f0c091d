"""``pdgw sim drive``, ``encoder`` and ``bus``: simulate devices on any python-can bus. Their faults are chosen at run time.

``pdgw sim inject`` sends commands to running ones. The group ``sim`` is here too.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.ds301.communication import NODE_IDS
from pdgw.dsp406.kinds import DEVICES, ROTARY
from pdgw.gateway.base.errors import GatewayError
from pdgw.peers.option_values import BUS_PORT, CONSOLE_COMMANDS, ENGEL, MOTIONS, SHAPES
from pdgw.tools.command_table import SIM_COMMANDS, lazy_group
from pdgw.tools.options import ControlPort, send_command

if TYPE_CHECKING:
    from pdgw.peers.bus import ServedBus

app = typer.Typer(
    cls=lazy_group(SIM_COMMANDS), help="Simulate a PLC, drives, encoders or a bus of devices.", no_args_is_help=True
)

Interface = Annotated[str, typer.Option(help="python-can interface.")]
Channel = Annotated[str, typer.Option(help="Channel of the interface.")]
BitRate = Annotated[int | None, typer.Option(help="Bit rate.")]


@app.callback()
def sim() -> None:
    """Simulate a PLC, drives, encoders or a bus of devices."""


def drive(
    interface: Interface = "virtual",
    channel: Channel = "pdgw",
    bitrate: BitRate = None,
    node_id: Annotated[
        list[int] | None, typer.Option(min=NODE_IDS[0], max=NODE_IDS[-1], help="Node-ID; repeat for several drives.")
    ] = None,
    like: Annotated[str, typer.Option(help=f"Shape of the drive: {', '.join(SHAPES)}.")] = ENGEL,
    axis: Annotated[
        str, typer.Option(help="Axis: rotary (a shaft) or linear (a slide with limit switches).")
    ] = "rotary",
    control_port: ControlPort = 0,
) -> None:
    """Run simulated drives until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`."""
    from pdgw.peers.simulation.config import ControlConfig
    from pdgw.peers.simulation.console import run_nodes

    control = ControlConfig(port=control_port)
    run_nodes("drive", (interface, channel, bitrate), node_id or [1], control, "drive", like=like, axis=axis)


def encoder(
    interface: Interface = "virtual",
    channel: Channel = "pdgw",
    bitrate: BitRate = None,
    node_id: Annotated[
        list[int] | None, typer.Option(min=NODE_IDS[0], max=NODE_IDS[-1], help="Node-ID; repeat for several encoders.")
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


def bus(
    file: Annotated[Path | None, typer.Argument(help="Description of the bus (TOML).", show_default=False)] = None,
    serve: Annotated[
        bool,
        typer.Option("--serve", help="Open a bus for other processes, with the devices of FILE or without devices."),
    ] = False,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Loopback UDP port of --serve, 0 for a free one.")
    ] = BUS_PORT,
    attached: Annotated[bool, typer.Option("--attached", hidden=True, help="End when standard input closes.")] = False,
    example_: Annotated[bool, typer.Option("--example", help="Print a commented example of the file.")] = False,
) -> None:
    """Run the simulated devices of FILE with their faults until SIGINT, SIGTERM or `quit`; --serve opens the bus too."""
    from pdgw.gateway.base.platform import open_configured_bus
    from pdgw.gateway.configuration.environment import CanConfig
    from pdgw.peers.bus import INTERFACE, ServedBus
    from pdgw.peers.simulation.config import ControlConfig, add_device, example, load_bus
    from pdgw.peers.simulation.console import run
    from pdgw.peers.simulation.devices import Simulation

    if example_:
        typer.echo(example(), nl=False)
        return
    if file is None and not serve:
        raise GatewayError("give a file, --serve for a bus without devices, or --example for a file to start from")
    config = load_bus(file) if file is not None else None
    with ExitStack() as at_end:
        place = config.can if config is not None else None
        served: ServedBus | None = None
        if serve:
            served = at_end.enter_context(ServedBus(port))
            place = CanConfig(interface=INTERFACE, channel=served.channel)
            typer.echo(f'[can]\ninterface = "{INTERFACE}"\nchannel = "{served.channel}"\n')
        if place is None:
            raise GatewayError(f"{file}: [can] is missing: it names the bus of the devices; --serve opens one for them")
        simulation = Simulation()
        devices = config.device if config is not None else ()
        for device in devices:
            add_device(simulation, device, open_configured_bus(place) if served is None else served.connect())
        names = ", ".join(f"{device.type} {device.node_id}" for device in devices)
        control = config.control if config is not None else ControlConfig()
        run(simulation, control, f"{names or 'no devices'} on {place.interface} {place.channel}", attached=attached)


def inject(
    command: Annotated[list[str], typer.Argument(help=CONSOLE_COMMANDS + " (@N: only node N).")],
    port: Annotated[int, typer.Option(min=1, max=65535, help="The simulator's --control-port.")],
) -> None:
    """Send a command to running simulated devices, for example a fault."""
    typer.echo(send_command(port, " ".join(command)))
