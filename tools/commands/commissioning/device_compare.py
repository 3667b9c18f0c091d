"""``pdgw device compare``."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from pdgw.base.phrases import counted
from pdgw.tools.options import ConfigFile, DriveObject


def compare(
    config: ConfigFile,
    axis: DriveObject,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON list, one object per difference.")] = False,
) -> None:
    """Compare a device with its values in dcf and objects; exit status 1 if they differ."""
    from pdgw.tools.bus_task import asked
    from pdgw.tools.output.device_values import document, print_differences

    with asked(config, axis) as (device, run):
        found = run(device.differences)
    values = device.values
    if as_json:
        typer.echo(json.dumps([document(item) for item in found], indent=2))
    elif found:
        print_differences(found)
    if not as_json:
        typer.echo(f"{values.source}: {counted(len(values.items), 'value')}, {len(found)} of them differ")
    if found:
        raise typer.Exit(1)
