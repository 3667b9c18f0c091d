"""``pdgw trace``: read the flight recorder of a gateway, also of a killed one."""

from __future__ import annotations

import logging
import os
import select
import signal
import sys
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.base.durations import SECOND
from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.defaults import Trigger

if TYPE_CHECKING:
    from pdgw.gateway.trace.reader import RingReader

app = typer.Typer(
    help="Save or list recordings of the flight recorder: the last minutes of both buses.", no_args_is_help=True
)

Ring = Annotated[
    str | None,
    typer.Option(
        "--ring", metavar="NAME|PATH", help="Ring of which gateway, see `pdgw trace list`.", show_default=False
    ),
]


@app.callback()
def trace() -> None:
    """Save or list recordings of the flight recorder: the last minutes of both buses."""


@app.command("save")
def save_(
    file: Annotated[Path, typer.Argument(help="The pcapng file to write; ending .gz: compressed by gzip.")],
    ring: Ring = None,
    last: Annotated[float | None, typer.Option(min=0.001, help="Only the last SECONDS.")] = None,
) -> None:
    """Write both buses and the configuration as pcapng, for Wireshark, `pdgw timeline` and `pdgw replay`."""
    from pdgw.gateway.trace.reader import RingReader
    from pdgw.tools.recording.trace_keeper import chosen_ring, save

    reader = RingReader(chosen_ring(ring))
    newest = reader.cycles(at_most=1)
    begin = None if last is None or not newest else newest[0].time_ns - int(last * SECOND)
    count = save(reader, file, begin)
    state = "running" if reader.is_alive else "ended" if reader.ended else "killed"
    typer.echo(f"{file}: {counted(count, 'packet')} of {reader.path.name} ({state})")


@app.command("list")
def list_() -> None:
    """List the ring files of this machine, also of ended and killed gateways."""
    from pdgw.gateway.base.run_directory import rings, run_directory
    from pdgw.gateway.trace.reader import RingReader

    for path in rings():
        try:
            typer.echo(_line(RingReader(path)))
        except GatewayError as error:
            typer.echo(str(error))
    if not rings():
        typer.echo(f"no ring files in {run_directory() or 'a run directory, this machine has none'}")


def _line(reader: RingReader) -> str:
    state = f"process {reader.layout.process}" if reader.is_alive else "ended" if reader.ended else "killed"
    cycles = reader.cycles()
    if not cycles:
        return f"{reader.path}: {state}, nothing recorded yet"
    until = datetime.fromtimestamp(cycles[-1].wall_ns / SECOND).strftime("%Y-%m-%d %H:%M:%S")
    seconds = (cycles[-1].time_ns - cycles[0].time_ns) / SECOND
    return f"{reader.path}: {state}, {seconds:.1f} s until {until}, {len(reader.layout.objects)} drive objects"


@app.command("watch")
def watch(
    ring: Ring = None,
    on: Annotated[
        list[Trigger] | None,
        typer.Option("--on", help="Trigger; repeat for several (default: both).", show_default=False),
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the files (default: the state directory).", show_default=False),
    ] = None,
    before: Annotated[int, typer.Option(min=0, help="Seconds before.")] = 10,
    after: Annotated[int, typer.Option(min=0, help="Seconds after.")] = 5,
    files: Annotated[int, typer.Option(min=1, help="Number of files; the oldest are deleted.")] = 20,
    attached: Annotated[bool, typer.Option("--attached", hidden=True)] = False,
) -> None:
    """Save a file around each fault, or around each stop without an OFF of the PLC."""
    from pdgw.tools.recording.trace_keeper import Choice, chosen_ring, follow, sleeping

    triggers = frozenset(on or Trigger)
    directory = to if to is not None else kept_directory()
    choice = Choice(directory, triggers, before, after, files)
    logging.basicConfig(format="%(message)s", level=logging.INFO)
    if not attached:
        path = chosen_ring(ring)
        typer.echo(f"watching {path}, files are written to {directory}")
        follow(path, choice, sleeping)
        return
    # The gateway sends the path on standard input and closes it at its own end. Only this ends the watch: signals are
    # ignored, because a service manager sends them to all processes at once.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(10)
    follow(Path(sys.stdin.readline().strip()), choice, _until_closed)


def kept_directory() -> Path:
    """Default folder of kept files. GatewayError when there is no home directory."""
    from pdgw.gateway.base.store import state_directory

    state = state_directory()
    if state is None:
        raise GatewayError("--to is missing: this machine has no state directory")
    return state / "traces"


def _until_closed(seconds: float) -> bool:
    return bool(select.select([sys.stdin], [], [], seconds)[0]) and not sys.stdin.readline()
