"""``pdgw``: the command line, put together from the table of commands in ``tools.command_table``.

Errors the user can act on end as one line and exit status 1; ``--debug`` shows the rest.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from pdgw.ds301.errors import CanopenError
from pdgw.gateway.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.command_table import COMMANDS, lazy_group

app = typer.Typer(
    name="pdgw",
    cls=lazy_group(COMMANDS),
    help="PROFIdrive-to-CANopen gateway: daemon, simulators, decoder and conformance tools.",
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
)


class _Options:
    debug = False


def _print_version(wanted: bool) -> None:
    if wanted:
        from pdgw import __version__  # noqa: PLC0415 (looks into the installed package's metadata)

        typer.echo(f"pdgw {__version__}")
        raise typer.Exit


@app.callback()
def options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """PROFIdrive-to-CANopen gateway."""
    _Options.debug = debug


def main() -> None:
    """Run the command line; errors the user can act on are one line."""
    try:
        app()
    except (GatewayError, CanopenError, ProfidriveError) as error:
        if _Options.debug:
            raise
        from rich.console import Console  # noqa: PLC0415
        from rich.markup import escape  # noqa: PLC0415

        Console(stderr=True).print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(1)
