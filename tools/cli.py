"""``pdgw``: the command line, built from the table in ``tools.command_table``.

Errors that the user can correct are one line with exit status 1. ``--debug`` adds the traceback.
"""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from typing import Annotated, Final, NoReturn

import typer

from pdgw.base.phrases import printable
from pdgw.ds301.aborts import CanopenError
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.command_table import COMMANDS, lazy_group
from pdgw.tools.options import INTERRUPTED

_NO_MORE_OUTPUT: Final = (errno.ENOSPC, errno.EIO, errno.EPIPE)
"""Errors of standard output: the disk is full, or the reader has closed the pipe."""

_OWN_SEQUENCES = re.compile(r"(\x1b\[(?:[0-9;]*[A-HJKm]|\?(?:25|1049)[hl]))")
"""Colours and the cursor movements of tables that are drawn again."""

app = typer.Typer(
    name="pdgw",
    cls=lazy_group(COMMANDS),
    help="PROFIdrive-to-CANopen gateway: daemon, simulators, decoder and tools.",
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class _Options:
    debug = False


def _print_version(requested: bool) -> None:
    if requested:
        from pdgw.gateway.base.identity import build_text  # noqa: PLC0415 (looks into the installed package's metadata)

        typer.echo(f"pdgw {build_text()}")
        raise typer.Exit


@app.callback()
def options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Options before the command."""
    _Options.debug = debug


def main() -> None:
    """Run the command line. An error that the user can correct is printed as one line."""
    _open_missing_streams()
    _replace_unknown_characters()
    _guard_terminal()
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except (GatewayError, CanopenError, ProfidriveError) as error:
        if _Options.debug:
            raise
        _fail(str(error))
    except OSError as error:
        if _Options.debug:
            raise
        what = f"{error.filename}: " if error.filename else ""
        if not what and error.errno in _NO_MORE_OUTPUT:
            what = "output: "
            _discard_output()
        _fail(f"{what}{error.strerror or error}")
    except KeyboardInterrupt:  # pressed while typer still loads, when typer does not handle it
        sys.exit(INTERRUPTED)


def _open_missing_streams() -> None:
    """Replace closed standard streams, so that no file or socket of the program gets their descriptor."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 (until the end)


def _replace_unknown_characters() -> None:
    """Print ? for a character that the code page of the output does not have, such as a line of a table on cp1252."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and not stream.encoding.lower().startswith("utf"):
            stream.reconfigure(errors="replace")


class _Terminal(io.TextIOWrapper):
    """A terminal that shows control characters as escapes, except those of colours and tables."""

    def write(self, text: str, /) -> int:
        parts = _OWN_SEQUENCES.split(text)
        return super().write("".join(part if place % 2 else printable(part) for place, part in enumerate(parts)))


def _guard_terminal() -> None:
    """Keep texts of files, devices and networks from controlling the terminal."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and stream.isatty():
            guarded = _Terminal(stream.buffer, stream.encoding, stream.errors, line_buffering=stream.line_buffering)
            setattr(sys, name, guarded)


def _discard_output() -> None:
    """Discard what is left in the buffer, so that the interpreter does not try to write it again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(text: str) -> NoReturn:
    from rich.console import Console  # noqa: PLC0415
    from rich.markup import escape  # noqa: PLC0415

    Console(stderr=True).print(f"[red]error:[/red] {escape(text)}", highlight=False, soft_wrap=True)
    sys.exit(1)
