"""``pdgw config``: an example, and the check of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from pdgw.gateway.config import example as example_text
from pdgw.gateway.config import load_config

app = typer.Typer(help="Configuration files.", no_args_is_help=True)


@app.command()
def example() -> None:
    """Print a commented configuration."""
    typer.echo(example_text(), nl=False)


@app.command()
def check(file: Annotated[Path, typer.Argument(help="Configuration file (TOML).")]) -> None:
    """Validate a file; exit status 1 and one line for each thing that is wrong."""
    config = load_config(file)
    buses = ", ".join(f"{bus.name} ({bus.interface} {bus.channel or ''})".replace(" )", ")") for bus in config.can)
    objects = f"{len(config.axis)} axes" + (f" and {len(config.encoder)} encoders" if config.encoder else "")
    typer.echo(f"{file}: ok, {objects} on {buses}, cycle {config.transport.cycle_time_ms:g} ms")
