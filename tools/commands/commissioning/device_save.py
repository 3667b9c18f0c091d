"""``pdgw device save``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.tools.options import ConfigFile, DriveObject


def save(
    config: ConfigFile,
    axis: DriveObject,
    output: Annotated[Path, typer.Option("--output", "-o", help="The new DCF.")],
) -> None:
    """Save what a device has into a DCF, which replaces it at night (key dcf); read-only on the bus."""
    from datetime import datetime

    from pdgw.tools.bus_task import asked
    from pdgw.tools.options import progress_bar

    if output.exists():
        raise GatewayError(f"-o {output}: the file exists; name a new one")
    with asked(config, axis) as (device, run), progress_bar("reading") as report:
        text, count = run(lambda: device.save(datetime.now(), report))
    with writing(f"-o {output}"), output.open("x", encoding="utf-8") as file:
        file.write(text)
    typer.echo(f"{output}: {counted(count, 'value')} of node {device.item.node_id}")
    typer.echo(f'next: dcf = "{output}" in the table of DO {axis}, pdgw device compare {config} {axis}', err=True)
