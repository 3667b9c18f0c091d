"""``pdgw sim drive``: simulated CiA 402 drives on any python-can bus, with faults injected at run time."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
import socketserver
import sys
import threading
from typing import Annotated

import can
import typer

from ds301.bus import open_bus
from ds301.errors import CanopenError
from dsp402.faults import DRIVE_FAULTS
from dsp402.simulator import SimulatedDrive
from dsp402.states import state_of
from gateway.errors import GatewayError

_NUMBER = re.compile("[0-9]{1,3}")
COMMANDS = "fault N (1-12), clear, di1 on|off, status, quit"


class Console:
    """The text commands of the drive simulator."""

    def __init__(self, drives: dict[int, SimulatedDrive], quit_: threading.Event) -> None:
        self._drives = drives
        self._quit = quit_

    def execute(self, line: str) -> str:
        """Run one command line; the answer is one line, errors begin with ``error:``."""
        words = line.lower().split()
        chosen = list(self._drives)
        if words and words[0].startswith("@") and _NUMBER.fullmatch(words[0][1:]):
            chosen = [int(words.pop(0)[1:])]
            if chosen[0] not in self._drives:
                return f"error: node {chosen[0]} is not simulated, allowed {list(self._drives)}"
        if not words:
            return "ok"
        if words[0] == "quit":
            self._quit.set()
            return "ok"
        answers = [self._one(self._drives[node], words) for node in chosen]
        return "; ".join(answers) if words[0] == "status" else answers[0]

    def _one(self, drive: SimulatedDrive, words: list[str]) -> str:
        match words:
            case ["fault", number] | [number] if _NUMBER.fullmatch(number):
                try:
                    drive.inject(int(number))
                except CanopenError as error:
                    return f"error: {error}"
                return f"ok: fault {number}, {DRIVE_FAULTS[int(number)].name}"
            case ["clear"]:
                drive.clear()
                return "ok"
            case ["di1", "on" | "off" as state]:
                drive.set_enable_input(state == "on")
                return "ok"
            case ["status"]:
                model = drive.model
                state_name = state_of(model.statusword)
                return (
                    f"node {drive.node.node_id}: {state_name.value if state_name else 'unknown'}, NMT {drive.node.state.name}, "
                    f"mode {int(model.mode)}, position {model.position_actual}, velocity {model.velocity_actual}, "
                    f"fault {model.error_code}"
                )
        return f"error: {' '.join(words)!r} is no command, allowed: {COMMANDS}"


def _serve(console: Console, port: int) -> socketserver.ThreadingTCPServer:
    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                self.wfile.write(console.execute(line.decode("utf-8", "replace")).encode() + b"\n")

    socketserver.ThreadingTCPServer.allow_reuse_address = True
    try:
        server = socketserver.ThreadingTCPServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise GatewayError(f"control port: 127.0.0.1 port {port} cannot be used ({error.strerror})") from error
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="control", daemon=True).start()
    return server


def _read_standard_input(console: Console) -> None:
    with contextlib.suppress(ValueError, OSError):
        for line in sys.stdin:
            print(console.execute(line), flush=True)


def drive(
    interface: Annotated[str, typer.Option(help="python-can interface.")] = "virtual",
    channel: Annotated[str, typer.Option(help="Channel of the interface.")] = "pdgw",
    bitrate: Annotated[int | None, typer.Option(help="Bit rate.")] = None,
    node_id: Annotated[
        list[int] | None, typer.Option(min=1, max=126, help="Node-ID; repeat for several drives.")
    ] = None,
    control_port: Annotated[int, typer.Option(help="Loopback TCP port for `pdgw sim inject`, 0 for none.")] = 0,
) -> None:
    """Run simulated drives until SIGINT, SIGTERM or `quit`. Commands on standard input: see `pdgw sim inject`."""
    nodes = node_id or [1]
    if len(set(nodes)) != len(nodes):
        raise GatewayError(f"--node-id: {nodes} names a node twice")
    quit_ = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: quit_.set())
    buses: list[can.BusABC] = [open_bus(interface, channel, bitrate) for _ in nodes]
    drives = {node: SimulatedDrive(bus, node, serial_number=node) for node, bus in zip(nodes, buses, strict=True)}
    console = Console(drives, quit_)
    server = _serve(console, control_port) if control_port else None
    for item in drives.values():
        item.start()
    threading.Thread(target=_read_standard_input, args=(console,), name="stdin", daemon=True).start()
    print(f"drives {nodes} on {interface} {channel}; commands: {COMMANDS}", flush=True)
    quit_.wait()
    if server is not None:
        server.shutdown()
        server.server_close()
    for item in drives.values():
        item.stop()


def inject(
    command: Annotated[list[str], typer.Argument(help=COMMANDS + " (@N: only node N).")],
    port: Annotated[int, typer.Option(help="The simulator's --control-port.")],
) -> None:
    """Give a running drive simulator a command: `pdgw sim inject --port 5000 fault 7`."""
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
            connection.sendall(" ".join(command).encode() + b"\n")
            answer = connection.makefile().readline().strip()
    except OSError as error:
        raise GatewayError(
            f"no drive simulator answers on 127.0.0.1 port {port} ({error.strerror or error})"
        ) from error
    if answer.startswith("error: "):
        raise GatewayError(answer.removeprefix("error: "))
    typer.echo(answer)
