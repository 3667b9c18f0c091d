"""``pdgw device write``."""

from __future__ import annotations

from typing import Annotated

import typer

from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.options import ConfigFile, DriveObject


def write(
    config: ConfigFile,
    axis: DriveObject,
    store: Annotated[bool, typer.Option("--store", help="The device keeps them without power (1010h).")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Write the values of dcf and objects that a device does not have, while it has no power, and read them back."""
    from pdgw.tools.bus_task import asked
    from pdgw.tools.output.device_values import print_differences

    with asked(config, axis) as (device, run):
        found, is_stored = run(lambda: (device.differences(), device.is_stored))
    if found:
        print_differences(found)
    else:
        typer.echo(f"{device.values.source}: the device has all of its {counted(len(device.values.items), 'value')}")
    if not found and not (store and not is_stored):
        return
    what = f"write {counted(len(found), 'value')}{' and store all' if store else ''}" if found else "store all values"
    if not yes and not typer.confirm(f"DO {axis}, node {device.item.node_id}: {what}?"):
        raise GatewayError("nothing is written")
    with asked(config, axis) as (device, run):
        late, shown = run(lambda: (device.write(), store and device.store()))
    typer.echo(f"{counted(len(found), 'value')} written and read back")
    if store:
        typer.echo(f"stored{', 1020h shows the date of the file' if shown else ''}")
    if late:
        names = ", ".join(item.name for item in late)
        then = "switch the device off and on" if store else "store them (--store), then switch the device off and on"
        typer.echo(f"{names}: may act after a restart only; {then}")
