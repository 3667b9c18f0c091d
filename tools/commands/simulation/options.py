"""Options shared by the simulators."""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from pdgw.gateway.errors import GatewayError

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
