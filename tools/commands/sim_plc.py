"""``pdgw sim plc``: a PLC on UDP that plays a scenario or obeys the keyboard."""

from __future__ import annotations

import contextlib
import json
import os
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
from rich.console import Console
from rich.live import Live
from rich.table import Table

from gateway.errors import GatewayError
from profidrive.frame import UDP_PORT
from profidrive.telegrams import telegram as telegram_of
from tools.plc.client import PlcClient
from tools.plc.endpoint import PlcEndpoint
from tools.plc.scenario import Engine, Result, Scenario, load_scenario
from tools.plc.view import table

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


def parse_address(text: str, default_port: int) -> tuple[str, int]:
    """``HOST`` or ``HOST:PORT``; GatewayError otherwise."""
    host, _, port = text.partition(":")
    if port and not (port.isdigit() and int(port) < 65536):
        raise GatewayError(f"address {text!r}: expected HOST or HOST:PORT")
    try:
        return socket.gethostbyname(host), int(port) if port else default_port
    except OSError as error:
        raise GatewayError(f"address {text!r}: {error.strerror}") from error


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
    client = PlcClient(address, endpoint, cycle_ns, pcap)
    engine = Engine(chosen, endpoint) if chosen else None
    try:
        if engine is None:
            _interactive(client, endpoint, numbers)
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
        as_json.write_text(json.dumps(document, indent=2), encoding="utf-8")
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


def _interactive(client: PlcClient, endpoint: PlcEndpoint, numbers: list[int]) -> None:
    """Keys on a terminal, the same letters as lines otherwise."""
    speed = 0
    stopped = False
    pending: list[Engine] = []

    def do(key: str) -> None:
        nonlocal speed, stopped
        if key == "x":
            client.stop()
            return
        if key not in KEYS:
            return
        action = KEYS[key][1]
        if key in "+-":
            speed = max(-100, min(100, speed + (_SPEED_STEP if key == "+" else -_SPEED_STEP)))
            action = {"speed": f"{speed} %"}
        elif key == " ":
            stopped = not stopped
            action = {"intermediate_stop": True} if stopped else {"resume": True}
        steps = [{"axis": axis, **(action or {})} for axis in range(1, len(numbers) + 1)]
        try:
            pending.append(Engine(Scenario.model_validate({"telegrams": numbers, "steps": steps}), endpoint))
        except GatewayError as error:
            print(error, file=sys.stderr)

    def play() -> None:
        if pending:
            pending[0].step(time.monotonic_ns())
            if pending[0].finished:
                pending.pop(0)

    help_text = "  ".join(f"{key or ' '}={text}" for key, (text, _) in KEYS.items()).replace(" =", "space=", 1)
    reader = threading.Thread(target=_read_keys, args=(do, client), daemon=True)
    if sys.stdout.isatty():
        with _raw_terminal(), Live(refresh_per_second=10) as live:

            def refresh() -> None:
                play()
                live.update(table(endpoint, help_text))

            client.on_cycle = refresh
            reader.start()
            client.run(None)
        return
    print(help_text, flush=True)
    client.on_cycle = play
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
