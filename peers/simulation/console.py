"""Simulated devices in the foreground, and their text commands.

Text commands of the simulators: one line in, one line out, on standard input or a loopback TCP port. Run simulated devices in
the foreground: console, ports, signals.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import signal
import socketserver
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.interfaces import open_bus
from pdgw.ds301.loop.readiness import NO_DESCRIPTOR
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.ports import refusal
from pdgw.peers.drive.objects import DRIVE_FAULTS
from pdgw.peers.node.behaviour import parse
from pdgw.peers.option_values import CONSOLE_COMMANDS
from pdgw.peers.simulation.config import ControlConfig
from pdgw.peers.simulation.devices import Simulation

_LINE_MAX = 1000
"""Longest command line in characters; the longest command has about 100."""
_TOO_LONG = f"error: a command has at most {_LINE_MAX} characters"
_IDLE_S = 3600.0
_NO_DESCRIPTOR_PAUSE_S = 1.0
_BACKGROUND_PAUSE_S = 0.5
"""Between attempts to read a terminal whose foreground has another process."""
_NUMBER = re.compile("[0-9]{1,3}")


class Console:
    """Commands for all devices, or with the prefix ``@N`` for one."""

    def __init__(self, simulation: Simulation, quit_: threading.Event) -> None:
        self._simulation = simulation
        self._quit = quit_

    def execute(self, line: str) -> str:
        """Run one command line. The answer is one line; errors start with ``error:``."""
        # The text after "=" may be a file name.
        words = ["".join((name.lower(), sign, value)) for name, sign, value in (w.partition("=") for w in line.split())]
        chosen = self._simulation.nodes
        if words and words[0].startswith("@") and _NUMBER.fullmatch(words[0][1:]):
            node = int(words.pop(0)[1:])
            if node not in chosen:
                return f"error: node {node} is not simulated, allowed {chosen}"
            chosen = [node]
        if not words:
            return "ok"
        if words[0] == "quit":
            self._quit.set()
            return "ok"
        try:
            answers = [self._one(node, words) for node in chosen]
        except CanopenError as error:
            return f"error: {error}"
        return "; ".join(answers) if words[0] in {"status", "faults"} else answers[0]

    def _one(self, node: int, words: list[str]) -> str:
        simulation = self._simulation
        match words:
            case ["fault", number] if _NUMBER.fullmatch(number):
                if int(number) not in DRIVE_FAULTS:
                    raise CanopenError("fault number", int(number), f"one of {list(DRIVE_FAULTS)}")
                simulation.start_fault(node, "drive-fault", {"number": int(number)})
                return f"ok: fault {number}, {DRIVE_FAULTS[int(number)].name}"
            case ["fault", name, *_]:
                fault = simulation.start_fault(node, *parse(" ".join(words[1:])))
                chosen = "".join(f" {key}={value}" for key, value in fault.values.items())
                return f"ok: {name}{chosen}"
            case ["clear"]:
                simulation.end_fault(node)
                return "ok"
            case ["clear", name]:
                simulation.end_fault(node, name)
                return "ok"
            case ["probe", "1" | "2" as probe, "on" | "off" as level]:
                simulation.deflect(node, int(probe), level == "on")
                return "ok"
            case ["motion", motion]:
                simulation.move(node, motion)
                return "ok"
            case ["motion", motion, channel] if _NUMBER.fullmatch(channel):
                simulation.move(node, motion, int(channel))
                return "ok"
            case ["faults"]:
                return f"node {node}: {', '.join(simulation.device(node).node.catalogue)}"
            case ["status"]:
                return self._status(node)
        return f"error: {' '.join(words)!r} is not a command, allowed: {CONSOLE_COMMANDS}"

    def _status(self, node: int) -> str:
        status = self._simulation.status(node)
        parts = [f"node {node}: {status.get('state', status['type'])}", f"NMT {status['nmt']}"]
        parts += [f"{key} {status[key]}" for key in status if key not in {"node_id", "type", "state", "nmt", "faults"}]
        if status["faults"]:
            parts.append("misbehaves: " + " ".join(self._simulation.device(node).node.faults))
        return ", ".join(parts)


class PatientServer(socketserver.ThreadingTCPServer):
    """A thread for each connection. If no file descriptor is left for a new one, it pauses, because the port stays readable."""

    allow_reuse_address = True
    daemon_threads = True

    def get_request(self) -> tuple[Any, Any]:
        """The next connection. If accepting it fails, socketserver continues with the next one."""
        try:
            return super().get_request()
        except OSError as error:
            if error.errno in NO_DESCRIPTOR:
                time.sleep(_NO_DESCRIPTOR_PAUSE_S)
            raise


def serve(console: Console, port: int) -> socketserver.ThreadingTCPServer:
    """Serve the console on a loopback TCP port; GatewayError when it cannot be opened. The caller shuts it down."""

    class Handler(socketserver.StreamRequestHandler):
        timeout = _IDLE_S

        def handle(self) -> None:
            # A client that disconnects early or sends nothing for long needs no answer.
            with contextlib.suppress(OSError):
                while line := self.rfile.readline(_LINE_MAX + 1):
                    if len(line) > _LINE_MAX:
                        self.wfile.write(_TOO_LONG.encode() + b"\n")
                        return
                    self.wfile.write(console.execute(line.decode("utf-8", "replace")).encode() + b"\n")

    try:
        server = PatientServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise GatewayError(f"control port: 127.0.0.1 port {port} cannot be used ({refusal(error, port)})") from error
    threading.Thread(target=server.serve_forever, name="control", daemon=True).start()
    return server


def _next_line() -> str:
    while True:
        try:
            return sys.stdin.readline(_LINE_MAX + 1)
        except OSError as error:
            if error.errno != errno.EIO or not os.isatty(sys.stdin.fileno()):
                raise
            time.sleep(_BACKGROUND_PAUSE_S)


def _rest_of(line: str) -> str:
    """Read to the end of a line that is too long."""
    while line and not line.endswith("\n"):
        line = sys.stdin.readline(_LINE_MAX)
    return _TOO_LONG


def read_standard_input(console: Console, at_end: Callable[[], None] | None = None) -> None:
    """Read commands from standard input on a separate thread, on a terminal only in the foreground. ``at_end`` is called at its
    end."""
    if hasattr(signal, "SIGTTIN"):
        signal.signal(
            signal.SIGTTIN, signal.SIG_IGN
        )  # it would stop a process in the background; reading fails instead

    def read() -> None:
        with contextlib.suppress(ValueError, OSError):
            while line := _next_line():
                print(console.execute(line) if len(line) <= _LINE_MAX else _rest_of(line), flush=True)
        if at_end is not None:
            at_end()

    threading.Thread(target=read, name="stdin", daemon=True).start()


_PERIOD_S = 0.2


def run(simulation: Simulation, control: ControlConfig, title: str, *, attached: bool = False) -> None:
    """Run until SIGINT, SIGTERM or `quit`; open the ports before the devices are powered. ``attached``: end with the input.

    GatewayError when the bus is lost.
    """
    quit_ = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: quit_.set())
    console = Console(simulation, quit_)
    with ExitStack() as at_end:
        if control.port:
            server = serve(console, control.port)
            at_end.callback(server.server_close)
            at_end.callback(server.shutdown)
        at_end.callback(simulation.stop)
        simulation.start()
        read_standard_input(console, quit_.set if attached else None)
        print(f"{title}; commands: {CONSOLE_COMMANDS}", flush=True)
        # Sleep instead of waiting for the event: if another thread gets the signal, its handler would not run during the
        # wait.
        while not quit_.is_set():
            if lost := simulation.check_bus():
                raise GatewayError(f"{title}: the bus is lost ({lost})")
            time.sleep(_PERIOD_S)


def run_nodes(
    kind: str,
    place: tuple[str, str, int | None],
    nodes: Sequence[int],
    control: ControlConfig,
    title: str,
    **options: object,
) -> None:
    """Run devices of one type with the same ``options`` on one bus. ``place``: interface, channel and bit rate. ``title``:
    name of one device.
    """
    if len(set(nodes)) != len(nodes):
        raise GatewayError(f"--node-id: {nodes} contains a node twice")
    simulation = Simulation()
    for node in nodes:
        simulation.add(kind, open_bus(*place), node, node, **options)
    interface, channel, _ = place
    names = ", ".join(f"{title} {node}" for node in nodes)
    run(simulation, control, f"{names} on {interface} {channel}")
