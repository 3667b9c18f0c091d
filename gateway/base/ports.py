"""Ports of this machine: bind one, and name the process that has it already."""

from __future__ import annotations

import errno
import os
import re
import socket
from contextlib import suppress
from pathlib import Path

from pdgw.gateway.base.errors import GatewayError

_SHOWN = 120
"""Characters of a command line."""


def bound(what: str, host: str, port: int, remedy: str, backlog: int = 0) -> socket.socket:
    """A UDP socket on a port, or one of TCP that listens with this ``backlog``.

    GatewayError with ``what`` it is for, the address, the process that has it if it is known, and the remedy.
    """
    kind = socket.SOCK_STREAM if backlog else socket.SOCK_DGRAM
    made = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind)
    try:
        if backlog:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        if backlog:
            made.listen(backlog)
    except OSError as error:
        made.close()
        raise GatewayError(f"{what}: {host} port {port} cannot be used ({refusal(error, port)}); {remedy}") from error
    return made


def refusal(error: OSError, port: int) -> str:
    """Why the system refuses a port, with the process that has it, if this user may see it (Linux)."""
    return (error.strerror or str(error)) + (_holder(port) if error.errno == errno.EADDRINUSE else "")


def _holder(port: int) -> str:
    row = re.compile(rf"^ *\d+: \w+:{port:04X} (?:\S+ +){{7}}(\d+)", re.MULTILINE)
    with suppress(OSError):  # a process has ended meanwhile
        files = Path("/proc/net").glob("[tu][cd]p*")
        sockets = {f"socket:[{inode}]" for file in files for inode in row.findall(file.read_text("ascii"))}
        for link in Path("/proc").glob("[0-9]*/fd/*"):
            with suppress(OSError):  # it is another user's
                if os.readlink(link) in sockets:
                    command = link.parents[1].joinpath("cmdline").read_text("utf-8", "replace").replace("\0", " ")
                    return f" by process {link.parts[2]}, {command[:_SHOWN].strip()}"
    return ""
