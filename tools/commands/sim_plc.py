"""``pdgw sim plc``: a PLC on UDP that plays a scenario or obeys the keyboard."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import socket
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.client import PlcClient
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario import Engine, Result, Scenario, load_scenario
from pdgw.peers.plc.view import table
from pdgw.profidrive.frame import UDP_PORT
from pdgw.profidrive.signals import signal as signal_of
from pdgw.profidrive.telegrams import telegram as telegram_of
from pdgw.profinet.rpc.dcerpc import UDP_PORT as ACYCLIC_PORT
from pdgw.tools.address import parse_address
from rich.console import Console
from rich.live import Live
from rich.table import Table

KEYS: dict[str, tuple[str, dict[str, object] | None]] = {
    "o": ("OFF1", {"off1": True}),
    "e": ("enable", {"enable": True}),
    "+": ("faster", None),
    "-": ("slower", None),
    "q": ("quick stop", {"quick_stop": True}),
    "c": ("coast stop", {"coast": True}),
    "a": ("acknowledge", {"ack": True}),
    "h": ("home (method 35)", {"home": {"method": 35}}),
    "m": ("move +10 %", {"move": {"to": "10 %", "relative": True}}),
    " ": ("intermediate stop / resume", None),
    "x": ("exit", None),
}
_SPEED_STEP = 10
_NO_INTERMEDIATE_STOP = signal_of("STW1").bit("NO_INTERMEDIATE_STOP", positioning=True).mask


def results_table(results: list[Result]) -> Table:
    """Every expectation with pass or fail."""
    grid = Table("step", "axis", "expectation", "measured", "after", "")
    for item in results:
        verdict = "[green]pass[/green]" if item.passed else "[red]FAIL[/red]"
        grid.add_row(str(item.step), str(item.axis), item.name, item.measured, f"{item.waited_s:.3f} s", verdict)
    return grid


class _DriveLink:
    """Scenario commands to `pdgw sim drive --control-port`."""

    def __init__(self, port: int | None) -> None:
        self._port = port

    def __call__(self, command: str) -> None:
        if self._port is None:
            raise GatewayError(f"the scenario tells the drive {command!r}: give --drive-port, its --control-port")
        try:
            with socket.create_connection(("127.0.0.1", self._port), timeout=5) as connection:
                connection.sendall(command.encode() + b"\n")
                answer = connection.makefile().readline().strip()
        except OSError as error:
            raise GatewayError(
                f"no drive simulator on 127.0.0.1 port {self._port} ({error.strerror or error})"
            ) from error
        if answer.startswith("error"):
            raise GatewayError(f"drive simulator: {answer}")


def plc(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario file (YAML).", show_default=False)] = None,
    gateway: Annotated[str, typer.Option(help="HOST or HOST:PORT of the gateway.")] = f"127.0.0.1:{UDP_PORT}",
    telegram: Annotated[list[int] | None, typer.Option(help="Telegram of each axis, without a scenario.")] = None,
    axes: Annotated[int, typer.Option(min=1, max=32, help="Axes with the same telegram.")] = 1,
    cycle_ms: Annotated[float, typer.Option(min=0.5, max=512, help="Cycle time.")] = 4,
    interactive: Annotated[bool, typer.Option("--interactive", help="Obey the keyboard.")] = False,
    pcap: Annotated[Path | None, typer.Option(help="Record both directions here.")] = None,
    trace: Annotated[Path | None, typer.Option(help="Write sampled values here (CSV).")] = None,
    as_json: Annotated[Path | None, typer.Option("--json", help="Write the results here.")] = None,
    acyclic_port: Annotated[int, typer.Option(help="UDP port of the gateway's parameter channel.")] = ACYCLIC_PORT,
    drive_port: Annotated[int | None, typer.Option(help="--control-port of the drive simulator.")] = None,
    progress: Annotated[bool, typer.Option("--progress", help="Print one JSON line per step and expectation.")] = False,
) -> None:
    """Play a scenario (exit status 1 when an expectation fails), or obey the keyboard."""
    address = parse_address(gateway, UDP_PORT)
    if scenario is None and not interactive:
        raise GatewayError("give a scenario file or --interactive")
    chosen = load_scenario(scenario) if scenario else None
    numbers = chosen.telegrams if chosen else (telegram or [1]) * axes
    cycle_ns = int(cycle_ms * 1_000_000)
    endpoint = PlcEndpoint([telegram_of(number) for number in numbers], cycle_ns)
    client = PlcClient(address, endpoint, cycle_ns, pcap, acyclic_port)
    engine = Engine(chosen, endpoint) if chosen else None
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the capture is to be complete
    try:
        if engine is None:
            _interactive(client, endpoint)
            return
        with _view(client, engine, progress):
            client.run(engine, _DriveLink(drive_port))
    except KeyboardInterrupt:
        raise typer.Exit(130) from None
    finally:
        client.close()
        if trace is not None:
            client.write_trace(trace)
    if as_json is not None:
        document = {
            "name": engine.scenario.name,
            "passed": engine.passed,
            "results": [asdict(item) for item in engine.results],
            "notes": engine.notes,
            "counters": dict(endpoint.counters),
        }
        try:
            as_json.write_text(json.dumps(document, indent=2), encoding="utf-8")
        except OSError as error:
            raise GatewayError(f"results {as_json}: cannot be written: {error.strerror}") from error
    if not progress:
        Console().print(results_table(engine.results))
    if not engine.passed:
        raise typer.Exit(1)


@contextlib.contextmanager
def _view(client: PlcClient, engine: Engine, progress: bool) -> Iterator[None]:
    """Live tables on a terminal, JSON lines with ``--progress``, else one line per step."""
    if not progress and sys.stdout.isatty():
        with Live(refresh_per_second=10) as live:
            client.on_cycle = lambda: live.update(table(client.endpoint, engine.current))
            yield
        return
    shown = {"notes": 0, "results": 0}

    def show() -> None:
        for when, note in engine.notes[shown["notes"] :]:
            shown["notes"] += 1
            print(json.dumps({"note": note, "time_s": when}) if progress else f"{when:7.3f} s  {note}", flush=True)
        for item in engine.results[shown["results"] :]:
            shown["results"] += 1
            if progress:
                print(json.dumps({"result": asdict(item)}), flush=True)
            elif not item.passed:
                print(f"{item.time_s:7.3f} s  FAILED {item.name}: {item.measured}", flush=True)

    client.on_cycle = show
    yield
    show()


class Keyboard:
    """Keys to setpoints of all axes, sans-I/O: ``press`` from any thread, ``step`` once per cycle.

    Each axis works off its keys by itself. A stop key acts at once: what has not begun is dropped, an enable that waits for
    the drive is given up, and only a handshake that has begun is completed. ``tell`` gets what the user must know.
    """

    def __init__(self, endpoint: PlcEndpoint, tell: Callable[[str], None]) -> None:
        self.endpoint = endpoint
        self.tell = tell
        self._numbers = [item.number for item in endpoint.telegrams]
        self._keys: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._pending: list[list[tuple[str, Engine]]] = [[] for _ in self._numbers]
        self._speed = 0

    def press(self, key: str) -> None:
        """Take a key; an unknown one does nothing."""
        if key in KEYS:
            self._keys.put(key)

    def step(self, now: int) -> None:
        """Obey the keys pressed since the last cycle and go on with what is under way."""
        while not self._keys.empty():
            self._obey(self._keys.get(), now)
        for pending in self._pending:
            if pending:
                key, engine = pending[0]
                engine.step(now)
                if engine.finished:
                    pending.pop(0)
                    self._tell_failures(key, engine)

    def _tell_failures(self, key: str, engine: Engine) -> None:
        for result in engine.results:
            if not result.passed:
                self.tell(f"{KEYS[key][0]}, axis {result.axis}: {result.name} not met: {result.measured}")

    def _obey(self, key: str, now: int) -> None:
        action = KEYS[key][1] or {}
        if key in "+-":
            self._speed = max(-100, min(100, self._speed + (_SPEED_STEP if key == "+" else -_SPEED_STEP)))
            action = {"speed": f"{self._speed} %"}
        elif key == " ":
            running = any(values.get("STW1", 0) & _NO_INTERMEDIATE_STOP for values in self.endpoint.setpoints)
            action = {"intermediate_stop": True} if running else {"resume": True}
        stop = key in "oqc" or "intermediate_stop" in action
        for axis, pending in enumerate(self._pending, 1):
            document = {"telegrams": self._numbers, "steps": [{"axis": axis, **action}]}
            try:
                engine = Engine(Scenario.model_validate(document), self.endpoint)
            except GatewayError as error:
                self.tell(f"{KEYS[key][0]}, axis {axis}: {error}")
                continue
            if stop:
                pending[:] = [item for item in pending[:1] if item[0] != "e" and item[1].current]
                engine.step(now)
            else:
                pending.append((key, engine))


def _interactive(client: PlcClient, endpoint: PlcEndpoint) -> None:
    """Keys on a terminal, the same letters as lines otherwise."""
    keyboard = Keyboard(endpoint, lambda text: print(text, file=sys.stderr))

    def do(key: str) -> None:
        if key == "x":
            client.stop()
        else:
            keyboard.press(key)

    help_text = "  ".join(f"{key or ' '}={text}" for key, (text, _) in KEYS.items()).replace(" =", "space=", 1)
    reader = threading.Thread(target=_read_keys, args=(do, client), daemon=True)
    if sys.stdout.isatty():
        with _raw_terminal(), Live(refresh_per_second=10) as live:

            def refresh() -> None:
                keyboard.step(time.monotonic_ns())
                live.update(table(endpoint, help_text))

            client.on_cycle = refresh
            reader.start()
            client.run(None)
        return
    print(help_text, flush=True)
    client.on_cycle = lambda: keyboard.step(time.monotonic_ns())
    reader.start()
    client.run(None)


def _read_keys(do: Callable[[str], None], client: PlcClient) -> None:
    descriptor = sys.stdin.fileno()
    while True:
        # Read past Python's own buffer: a key that waits in it would not wake select.
        text = os.read(descriptor, 64).decode("utf-8", "replace")
        if not text:
            client.stop()
            return
        for key in text:
            do(key)


@contextlib.contextmanager
def _raw_terminal() -> Iterator[None]:
    if not sys.stdin.isatty():
        yield
        return
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
