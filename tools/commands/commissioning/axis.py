"""``pdgw axis``: commission one axis without a PLC."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.options import INTERRUPTED

if TYPE_CHECKING:
    from pdgw.ds301.loop.loop import Loop

app = typer.Typer(help="Turn an axis for the first time, without a PLC.", no_args_is_help=True)

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


@app.callback()
def group() -> None:
    """Turn an axis for the first time, without a PLC."""


@app.command("test")
def try_out(
    do_id: Annotated[int, typer.Argument(metavar="DO", min=1, max=254, help="Drive object of the axis.")],
    config: Annotated[Path, typer.Argument(help="Configuration file (TOML).")] = Path("gateway.toml"),
    percent: Annotated[
        float,
        typer.Option(min=0.1, max=20, help="Speed in percent of 100 % NSOLL; the test starts with a quarter of it."),
    ] = 2.0,
    turns: Annotated[float, typer.Option(min=0.1, max=100, help="Turns of the motor at that speed.")] = 2.0,
    backward: Annotated[bool, typer.Option("--backward", help="With a negative speed.")] = False,
) -> None:
    """Turn an axis slowly without a PLC, after a typed confirmation, and compare commanded and measured values."""
    from pdgw.gateway.base.platform import SystemPlatform
    from pdgw.gateway.base.store import ParameterStore, confirmation
    from pdgw.gateway.configuration.file import load_config
    from pdgw.tools.bus_task import complete
    from pdgw.tools.commissioning.axis_test import AxisTest, Choices
    from pdgw.tools.service.child_processes import device_processes

    choices = Choices(Fraction(str(percent)) * (-1 if backward else 1), Fraction(str(turns)))
    loaded = load_config(config)
    with ExitStack() as at_end:
        reached = at_end.enter_context(device_processes(loaded))
        platform = SystemPlatform()
        at_end.callback(platform.loop.close)
        axis_test = AxisTest(reached, do_id, platform, typer.echo, _asking(platform.loop), choices)
        for name in _SIGNALS:
            if hasattr(signal, name):  # Windows lacks most of these signals
                number = getattr(signal, name)
                before = signal.signal(number, lambda *_: platform.loop.call_threadsafe(axis_test.interrupt))
                at_end.callback(signal.signal, number, before)
        outcome = complete(platform.loop, axis_test.run)
    if outcome.interrupted:
        raise typer.Exit(INTERRUPTED)
    if not outcome.passed:
        raise GatewayError(f"DO {do_id}: {outcome.abort_reason or 'the axis does not do what is commanded'}")
    if not outcome.confirmed or outcome.scaling is None:
        raise GatewayError(
            f"DO {do_id}: not verified: drive and gateway agree, but no person has confirmed the turns of the shaft"
        )
    today = date.today().isoformat()
    kept = confirmation(today, outcome.serial_number, outcome.scaling)
    store = ParameterStore(loaded.store, typer.echo, loaded.file)
    with store.held():
        store.update(lambda parameters: setattr(parameters.drive_object(do_id), "units_witnessed", kept))
    typer.echo("the axis follows its commands")
    if loaded.store is not None:
        typer.echo(
            f"units verified on {today}, drive with serial number {outcome.serial_number}: kept in {loaded.store}"
        )


def _asking(loop: Loop) -> Callable[[str, Callable[[str], None]], None]:
    """Return a function that asks on the terminal while the gateway keeps running. The end of the input confirms nothing."""
    from pdgw.tools.commissioning.axis_test import TURNS

    def ask(expected: str, answer: Callable[[str], None]) -> None:
        typer.echo("Turns: " if expected == TURNS else f"Type '{expected}' to continue: ", nl=False)

        def read() -> None:
            line = sys.stdin.readline()
            loop.call_threadsafe(lambda: answer(line))

        threading.Thread(target=read, name="terminal", daemon=True).start()

    return ask
