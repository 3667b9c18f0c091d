"""``pdgw device``: the values of one device, without a running gateway."""

from __future__ import annotations

import typer

from pdgw.tools.command_table import DEVICE_COMMANDS, lazy_group

app = typer.Typer(
    cls=lazy_group(DEVICE_COMMANDS),
    help="Save, compare or write the values of one device, without a running gateway.",
    no_args_is_help=True,
)


@app.callback()
def group() -> None:
    """Save, compare or write the values of one device, without a running gateway."""
