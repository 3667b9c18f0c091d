"""``pdgw sim``: the command group of the simulators."""

from __future__ import annotations

import typer

from pdgw.tools.command_table import SIM_COMMANDS, lazy_group

app = typer.Typer(
    cls=lazy_group(SIM_COMMANDS), help="Simulate a PLC, drives, encoders or a bus of devices.", no_args_is_help=True
)


@app.callback()
def sim() -> None:
    """Simulate a PLC, drives, encoders or a bus of devices."""
