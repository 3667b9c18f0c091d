"""``pdgw sim plc``: simulate a PLC on UDP or PROFINET, controlled by a scenario or the keyboard."""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from ipaddress import IPv4Interface
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.errors import GatewayError, writing
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.tools.options import end_as_by_ctrl_c, only_with, parse_address, read_keys, send_command, telegrams_of_axes
from pdgw.tools.output.reports import HtmlFile, JUnitFile, to_be_written

if TYPE_CHECKING:
    from rich.table import Table

    from pdgw.peers.plc.client import PlcRunner
    from pdgw.peers.plc.engine import Engine, Result
    from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
    from pdgw.tools.output.reports import Report

_SNAPSHOT_NS = 100 * MS
_SILENCE_NS = 2 * SECOND
"""Report the gateway as missing after this time without an answer. A scenario may wait longer for it."""


def results_table(results: list[Result]) -> Table:
    """A table of all expectations with pass or fail."""
    from pdgw.tools.output.reports import plain_table

    grid = plain_table("step", "axis", "expectation", "measured", "after", "")
    for item in results:
        verdict = "[green]pass[/green]" if item.passed else "[red]FAIL[/red]"
        grid.add_row(str(item.step), str(item.axis), item.name, item.measured, f"{item.waited_s:.3f} s", verdict)
    return grid


def _drive(port: int | None, command: str) -> None:
    """Send a command of the scenario to `pdgw sim drive --control-port`."""
    if port is None:
        raise GatewayError(
            f"the scenario sends the drive the command {command!r}: give --drive-port, the --control-port of the simulator"
        )
    send_command(port, command)


def plc(
    scenario: Annotated[Path | None, typer.Argument(help="Scenario file (YAML).", show_default=False)] = None,
    gateway: Annotated[str, typer.Option(help="HOST or HOST:PORT of the gateway.")] = f"127.0.0.1:{CYCLIC_PORT}",
    telegram: Annotated[
        list[int] | None,
        typer.Option(
            help="With --interactive: telegram of the axes; repeat to give one for each (default: 1).",
            show_default=False,
        ),
    ] = None,
    axes: Annotated[
        int | None, typer.Option(min=1, max=32, help="With --interactive: number of axes (default: 1).")
    ] = None,
    cycle_ms: Annotated[float, typer.Option(min=0.25, max=512, help="Cycle time.")] = 4,
    interactive: Annotated[bool, typer.Option("--interactive", help="Control the axes with the keyboard.")] = False,
    pcap: Annotated[
        Path | None, typer.Option(callback=to_be_written, help="Record both directions to this file.")
    ] = None,
    as_json: Annotated[
        Path | None, typer.Option("--json", callback=to_be_written, help="Write the results to this file.")
    ] = None,
    junit: JUnitFile = None,
    html: HtmlFile = None,
    acyclic_port: Annotated[
        int, typer.Option(min=1, max=65535, help="UDP port of the gateway's parameter channel.")
    ] = ACYCLIC_PORT,
    drive_port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="--control-port of the drive simulator.")
    ] = None,
    profinet: Annotated[
        str | None, typer.Option(metavar="IFACE", help="PROFINET on this Ethernet interface instead of UDP.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="STATION", help="With --profinet: name of the station.")] = "pdgw",
    device_ip: Annotated[
        str, typer.Option(metavar="IP/PREFIX", help="With --profinet: IP address to set in the station.")
    ] = "192.168.0.2/24",
    progress: Annotated[
        bool,
        typer.Option(
            "--progress",
            help="Print JSON lines: steps, expectations, and ten times a second the actual values of the PLC.",
        ),
    ] = False,
) -> None:
    """Simulate a PLC with a scenario (exit status 1 if an expectation fails) or the keyboard."""
    from rich.console import Console

    from pdgw.peers.plc.client import PlcClient
    from pdgw.peers.plc.engine import Engine, Result
    from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
    from pdgw.peers.plc.scenario_file import load_scenario
    from pdgw.profidrive.telegrams import telegram as telegram_of
    from pdgw.tools.output.plc_capture import Capture
    from pdgw.tools.plc_window import watch

    address = parse_address(gateway, CYCLIC_PORT)
    if interactive == (scenario is not None):
        raise GatewayError("give either a scenario file or --interactive")
    if scenario is not None:
        only_with("--interactive", {"--telegram": telegram, "--axes": axes})
    else:
        only_with("a scenario", {"--json": as_json, "--junit": junit, "--html": html, "--drive-port": drive_port})
    chosen = load_scenario(scenario) if scenario else None
    if sys.stdout.isatty() and not progress and (chosen is not None or sys.stdin.isatty()):
        # Another process draws, so that a slow terminal cannot delay the PLC's cycle.
        results, status = watch(sys.argv[1:], interactive=chosen is None, local=address[0].startswith("127."))
        if results:
            Console().print(results_table([Result(**item) for item in results]))
        raise typer.Exit(status)
    numbers = chosen.telegrams if chosen else telegrams_of_axes(telegram, axes)
    cycle_ns = int(cycle_ms * MS)
    endpoint = PlcEndpoint([telegram_of(number) for number in numbers], cycle_ns)
    if profinet is not None and pcap is not None:
        raise GatewayError("--pcap: not allowed with --profinet; record the interface instead (dumpcap, tcpdump)")
    engine = Engine(chosen, endpoint) if chosen else None
    output = Output(endpoint, _SILENCE_NS // cycle_ns, as_lines=progress)
    with contextlib.ExitStack() as recording:  # an incomplete capture is reported after the results
        client: PlcRunner
        if profinet is None:
            capture = recording.enter_context(contextlib.closing(Capture(pcap))) if pcap is not None else None
            client = PlcClient(
                address, endpoint, cycle_ns, None if capture is None else capture.conversation, acyclic_port
            )
        else:
            client = _connected(profinet, name, device_ip, endpoint, cycle_ns)
        end_as_by_ctrl_c()  # complete the capture before the end
        begin_s = time.time()
        try:
            if engine is None:
                _run_keys(client, endpoint, output)
            else:
                client.on_cycle = lambda: output.show(engine, engine.current)
                client.run(engine, partial(_drive, drive_port))
                output.show(engine, engine.current)
        except KeyboardInterrupt:
            raise typer.Exit(130) from None
        finally:
            client.close()
        if engine is not None and scenario is not None:
            _report(engine, scenario, gateway if profinet is None else name).write(junit, html)
            _finish(engine, as_json, begin_s, progress=progress)


def _report(engine: Engine, scenario: Path, gateway: str) -> Report:
    """The expectations as checks. A gateway that never answered is a failed check."""
    from pdgw.gateway.configuration.toml_file import read_text
    from pdgw.tools.output.reports import Check, Report

    checks = [
        Check(
            f"axis {item.axis}",
            f"step {item.step}: {item.name}",
            item.measured,
            () if item.passed else (item.measured,),
            item.waited_s,
        )
        for item in engine.results
    ]
    if not engine.endpoint.counters["received"]:
        checks.append(Check("gateway", "reached", failures=(engine.endpoint.why_no_values(0),)))
    counted = {f"frames {name}": str(count) for name, count in engine.endpoint.counters.items()}
    return Report(engine.scenario.name, tuple(checks), read_text(scenario), {"gateway": gateway, **counted})


def _connected(interface: str, name: str, device_ip: str, endpoint: PlcEndpoint, cycle_ns: int) -> PlcRunner:
    """Connect a PLC over PROFINET. Return when data is exchanged, so that the scenario starts then."""
    from pdgw.peers.controller.plc import ProfinetPlc
    from pdgw.profinet.station import check_name

    try:
        address = IPv4Interface(device_ip)
    except ValueError as error:
        raise GatewayError(
            f"--device-ip {device_ip}: expected an address with its prefix, like 192.168.0.2/24"
        ) from error
    try:
        check_name(name)
    except ProfidriveError as error:
        raise GatewayError(f"--name {name}: allowed: {error.allowed}") from error
    client = ProfinetPlc(interface, name, address, endpoint, cycle_ns)
    try:
        client.connect()
    except BaseException:
        client.close()
        raise
    return client


def _finish(engine: Engine, as_json: Path | None, begin_s: float, *, progress: bool) -> None:
    """Print the results. The exit status is 1 when an expectation failed or the gateway never answered.

    ``begin_s``: start of their times, in seconds of the epoch.
    """
    from rich.console import Console

    endpoint = engine.endpoint
    reached = bool(endpoint.counters["received"])
    if as_json is not None:
        document = {
            "name": engine.scenario.name,
            "passed": engine.passed and reached,
            "begin_s": begin_s,
            "results": [asdict(item) for item in engine.results],
            "notes": engine.notes,
            "counters": dict(endpoint.counters),
        }
        with writing(f"--json {as_json}"):
            as_json.write_text(json.dumps(document, indent=2), encoding="utf-8")
    if engine.results and not progress:
        Console().print(results_table(engine.results))
    if not reached:
        raise GatewayError(f"the scenario did not reach a gateway: {endpoint.why_no_values(0)}")
    if not engine.passed:
        raise typer.Exit(1)
    if not engine.results:
        typer.echo("every step is done; the scenario has no expect, so nothing was checked", err=True)


class Output:
    """Output while the PLC runs: JSON lines, or notes and failures as text."""

    def __init__(self, endpoint: PlcEndpoint, patience: int, *, as_lines: bool) -> None:
        """``patience``: frames without an answer before this is reported, once."""
        self._endpoint = endpoint
        self._patience: int | None = patience
        self.as_lines = as_lines
        """The title of the snapshots lists the keys."""
        self._due = 0
        self._notes = self._results = 0

    def show(self, engine: Engine | None, title: str) -> None:
        """Print new notes and results. Called once a cycle."""
        from pdgw.peers.plc.exchange.following import snapshot

        if engine is not None:
            for when, note in engine.notes[self._notes :]:
                self._print({"note": note, "time_s": when})
            for item in engine.results[self._results :]:
                self._print({"result": asdict(item)})
            self._notes, self._results = len(engine.notes), len(engine.results)
        if self._patience is not None and self._endpoint.counters["sent"] >= self._patience:
            self._patience = None
            if not self._endpoint.counters["received"] and not self.as_lines:  # snapshots show it
                self.message(self._endpoint.why_no_values(0))
        if self.as_lines and time.monotonic_ns() >= self._due:
            self._due = time.monotonic_ns() + _SNAPSHOT_NS
            self._print({"snapshot": snapshot(self._endpoint, title)})

    def message(self, text: str) -> None:
        """Print a message for the user."""
        self._print({"message": text})

    def _print(self, document: dict[str, Any]) -> None:
        from pdgw.peers.plc.exchange.following import line_of

        if self.as_lines:
            print(json.dumps(document), flush=True)
        elif line := line_of(document):
            print(line, file=sys.stderr if "message" in document else sys.stdout, flush=True)


def _run_keys(client: PlcRunner, endpoint: PlcEndpoint, output: Output) -> None:
    """Carry out keys from standard input until its end or the exit key."""
    from pdgw.peers.plc.keyboard import Keyboard

    keyboard = Keyboard(endpoint, output.message, client.stop)

    def cycle() -> None:
        keyboard.step(time.monotonic_ns())
        output.show(None, keyboard.help)

    if not output.as_lines:
        output.message(keyboard.help)
    client.on_cycle = cycle
    threading.Thread(target=_read_keys, args=(keyboard.press, client.stop), daemon=True).start()
    client.run(None)


def _read_keys(press: Callable[[str], None], stop: Callable[[], None]) -> None:
    while keys := read_keys():
        for key in keys:
            press(key)
    stop()
