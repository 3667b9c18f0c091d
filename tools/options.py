"""Options that commands share, and what they need of terminal and signals.

Addresses typed by the user, single keys from a terminal (POSIX and Windows) or characters from a pipe, the end of a command on
signals. Simulations do not log, because their results show what happened."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from pdgw.gateway.base.errors import GatewayError


def parse_address(text: str, default_port: int) -> tuple[str, int]:
    """Split ``HOST`` or ``HOST:PORT``; raises GatewayError for any other text."""
    host, _, port = text.partition(":")
    if not host or (port and not (port.isdecimal() and len(port) < 6 and 0 < int(port) < 65536)):
        raise GatewayError(f"address {text!r}: expected HOST or HOST:PORT")
    try:
        return socket.gethostbyname(host), int(port) if port else default_port
    except OSError as error:
        raise GatewayError(f"address {text!r}: {error.strerror}") from error
    except UnicodeError as error:
        raise GatewayError(f"address {text!r}: not a host name: {error}") from error


_AT_ONCE = 64


@contextlib.contextmanager
def single_keys() -> Iterator[None]:
    """Set the terminal to deliver each key at once and without echo; restore it afterwards. No effect without a terminal."""
    if not sys.stdin.isatty() or sys.platform == "win32":
        yield
        return
    import termios  # noqa: PLC0415 (not there on Windows)
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def read_keys() -> str:
    """Wait for the next keys and return them; empty at the end of the input."""
    if sys.platform == "win32" and sys.stdin.isatty():
        import msvcrt  # noqa: PLC0415 (there on Windows only)

        return msvcrt.getwch()
    # Read past Python's buffer, which waits for a whole block.
    return os.read(sys.stdin.fileno(), _AT_ONCE).decode("utf-8", "replace")


@contextmanager
def quiet(*names: str) -> Iterator[None]:
    """Suppress everything below CRITICAL from these loggers."""
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show a progress bar for long work, on a terminal only: call with what is done, and all."""
    from rich.console import Console  # noqa: PLC0415 (slow to load)
    from rich.progress import Progress  # noqa: PLC0415

    if not sys.stderr.isatty():
        yield None
        return
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, as used by shells."""


def end_as_by_ctrl_c() -> None:
    """Handle SIGTERM and SIGHUP like Ctrl-C, so that open files are completed. A SIGHUP ignored by nohup stays ignored."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has only one of them
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)


Files = Annotated[list[str], typer.Argument(help="Captures of both buses, like plc.pcap can.log.", metavar="FILE...")]
Config = Annotated[Path | None, typer.Option(help="The gateway's configuration: axes, nodes, choices.")]
Telegrams = Annotated[list[int] | None, typer.Option(help="Telegram; repeat for each axis (default: inferred).")]
Nodes = Annotated[
    list[str] | None,
    typer.Option(help="CANopen node of each axis in turn, or AXIS=NODE (default: number of the axis)."),
]
Offset = Annotated[
    float | None,
    typer.Option(
        help="Clock of the CAN capture minus the clock of the PLC's capture, in seconds (default: correlated)."
    ),
]
Station = Annotated[
    str, typer.Option(metavar="NAME", help="PROFINET station, where several in the capture have telegrams.")
]


ConfigFile = Annotated[Path, typer.Argument(help="Configuration file (TOML).")]
DriveObject = Annotated[int, typer.Argument(metavar="DO", min=1, max=254, help="Drive object of the device.")]
ControlPort = Annotated[
    int, typer.Option(min=0, max=65535, help="Loopback TCP port for `pdgw sim inject`, 0 for none.")
]


def telegrams_of_axes(telegrams: Sequence[int] | None, axes: int | None) -> list[int]:
    """The telegram of each axis, from one number for all axes or one for each. GatewayError when the counts differ."""
    given = list(telegrams or [1])
    if len(given) == 1:
        return given * (axes or 1)
    if axes not in {None, len(given)}:
        raise GatewayError(f"--axes {axes}: --telegram is given {len(given)} times, once for each axis")
    return given


def only_with(what: str, given: Mapping[str, object]) -> None:
    """Reject options that would have no effect. GatewayError names the first one and ``what`` it needs."""
    for option, value in given.items():
        if value is not None:
            raise GatewayError(f"{option}: only with {what}")


def send_command(port: int, command: str) -> str:
    """Send a line to the control port of simulated devices. Return the answer; GatewayError for a rejected command."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
            connection.sendall(command.encode() + b"\n")
            answer = connection.makefile().readline().strip()
    except OSError as error:
        raise GatewayError(f"no simulator answers on 127.0.0.1 port {port} ({error.strerror or error})") from error
    if answer.startswith("error: "):
        raise GatewayError(answer.removeprefix("error: "))
    return answer
