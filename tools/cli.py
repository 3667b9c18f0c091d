"""``pdgw``: one file per subcommand in ``tools.commands``, put together here.

Errors the user can act on end as one line and exit status 1; ``--debug`` shows the rest.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from pdgw.ds301.errors import CanopenError
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from rich.console import Console
from rich.markup import escape

app = typer.Typer(
    name="pdgw",
    help="PROFIdrive-to-CANopen gateway: daemon, simulators, decoder and conformance tools.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
sim = typer.Typer(help="Simulators: PLC, drives, encoders, a bus of devices.", no_args_is_help=True)
app.add_typer(sim, name="sim")


def _register(wanted: str = "") -> None:
    """Put the subcommands in; each module has one function per command.

    The decoder stands in pipes and loops: it does not load the gateway for ``decode`` alone.
    """
    if wanted == "decode":
        from pdgw.tools.commands.decode import decode as decode_command  # noqa: PLC0415

        app.command("decode")(decode_command)
        return
    from pdgw.tools.commands import (  # noqa: PLC0415
        bench,
        config,
        conformance,
        decode,
        demo,
        eds,
        param,
        replay,
        run,
        sim_drive,
        sim_encoder,
        sim_plc,
        status,
        timeline,
    )

    app.command("run")(run.run)
    app.add_typer(config.app, name="config")
    app.command("status")(status.status)
    app.add_typer(bench.app, name="bench")
    app.command("decode")(decode.decode)
    app.command("timeline")(timeline.timeline)
    app.command("replay")(replay.replay)
    app.command("demo")(demo.demo)
    app.add_typer(param.app, name="param")
    app.add_typer(eds.app, name="eds")
    app.add_typer(conformance.app, name="conformance")
    sim.command("plc")(sim_plc.plc)
    sim.command("drive")(sim_drive.drive)
    sim.command("encoder")(sim_encoder.encoder)
    sim.command("bus")(sim_drive.bus)
    sim.command("inject")(sim_drive.inject)


class _Options:
    debug = False


@app.callback()
def options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
) -> None:
    """PROFIdrive-to-CANopen gateway."""
    _Options.debug = debug


def main() -> None:
    """Entry point of the console script."""
    _register(sys.argv[1] if len(sys.argv) > 1 else "")
    try:
        app()
    except (GatewayError, CanopenError, ProfidriveError) as error:
        if _Options.debug:
            raise
        Console(stderr=True).print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(1)
