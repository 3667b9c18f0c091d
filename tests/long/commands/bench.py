"""``python -m tests.long bench``: cost of the gateway, compared with a floor that is measured in the same run."""

from __future__ import annotations

import json
import logging
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, product
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.status import Status
from rich.table import Table

from pdgw.durations import MS, US
from pdgw.gateway.errors import GatewayError
from pdgw.tools.demo import namespaces
from pdgw.tools.output.reports import HtmlFile, JUnitFile, Report, figures
from tests.long.bench import command_line, flood, killed, recording, settings, stops, storm, translation, watching
from tests.long.bench.decoding import decoding, following
from tests.long.bench.measuring.build import machine, use_real_time_priority
from tests.long.bench.measuring.histogram import SHARES, octaves
from tests.long.bench.measuring.measure import Latency, document
from tests.long.bench.processes.drives import buses
from tests.long.bench.profinet import profinet
from tests.long.bench.recording import RecordingCost
from tests.long.bench.rows import ROWS, Refused, Row, endure, idle, measure
from tests.long.bench.translation import TranslationCost

app = typer.Typer(help="Benchmarks.", invoke_without_command=True)

Seconds = Annotated[float, typer.Option(min=0.01, max=600, help="Duration of each row.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
RealTime = Annotated[
    bool, typer.Option("--realtime", help="All processes with real-time priority (Linux; root or CAP_SYS_NICE).")
]
MINUTES_PER_HOUR = 60
_STOP_SHARES = (0.5, 0.99, 1.0)
_IDLE_AXES, _IDLE_PERIOD_NS = 4, 10 * MS


@app.callback()
def bench(
    context: typer.Context,
    seconds: Seconds = 3,
    as_json: AsJson = False,
    realtime: RealTime = False,
    junit: JUnitFile = None,
    html: HtmlFile = None,
) -> None:
    """Translation cost; the exchange of 1 to 64 axes against a UDP echo; a storm of parameter requests; an idle gateway."""
    if sys.platform != "linux":
        raise GatewayError("bench: runs on Linux only, whose /proc has the CPU and memory of each process")
    if context.invoked_subcommand is not None:
        return
    console = Console(quiet=as_json)
    with _progress() as status:
        status.update("translation")
        costs = translation.run()
        recorder = recording.run()
        if realtime:
            use_real_time_priority()
        _print_machine(console, realtime)
        _print_translation(console, costs, recorder)
        rows = _rows(console, status, seconds)
        status.update(f"{storm.AXES} axes under a storm of parameter requests")
        parameters = storm.measure(seconds)
        floods = _floods(status, seconds)
        status.update("idle")
        idle_share = idle(_IDLE_AXES, _IDLE_PERIOD_NS, seconds)
        status.update("commands")
        commands = command_line.measure()
    told = _document(
        realtime,
        translation=costs,
        flight_recorder=recorder,
        rows=rows,
        parameter_storm=parameters,
        floods=floods,
        idle_cpu_share=idle_share,
        command_cpu_s=commands,
    )
    Report("python -m tests.long bench", measured=figures(told)).write(junit, html)
    if as_json:
        typer.echo(json.dumps(told, indent=2))
        return
    table = _latencies(f"{storm.AXES} axes at 1 ms under parameter requests")
    for name, row in (("quiet", parameters.quiet), (f"{parameters.requests_per_s:.0f} requests/s", parameters.storm)):
        table.add_row(name, *_cells(row))
    table.add_row("storm / quiet", "", f"{parameters.ratio_p99:.2f}", "", "")
    console.print(table)
    _print_floods(console, floods)
    console.print(f"idle, {_IDLE_AXES} axes at 10 ms without a PLC: {_share(idle_share)} of a core")
    console.print(", ".join(f"pdgw {name}: {seconds:.2f} s of CPU" for name, seconds in commands.items()))


@app.command("cycle")
def cycle(
    axes: Annotated[int, typer.Option(min=1, max=64, help="Axes, three on a bus.")] = 1,
    cycle_time_ms: Annotated[float, typer.Option(min=0.25, max=512, help="Cycle time in milliseconds.")] = 1,
    seconds: Seconds = 3,
    interface: Annotated[
        list[str] | None,
        typer.Option(
            help="CAN interface of the kernel (vcan, up) instead of a simulated bus; repeat for each three axes."
        ),
    ] = None,
    as_json: AsJson = False,
    realtime: RealTime = False,
) -> None:
    """Measure one row: a number of axes at one cycle time, compared with the echo."""
    interfaces = interface or []
    missing = [name for name in interfaces if name not in (known for _, known in socket.if_nameindex())]
    if missing or (interfaces and len(interfaces) != len(buses(axes))):
        raise GatewayError(
            f"--interface: {', '.join(interfaces)}, allowed: {len(buses(axes))} CAN interfaces of this machine"
            + (f"; {', '.join(missing)} does not exist" if missing else "")
        )
    if realtime:
        use_real_time_priority()
    with _progress() as status:
        status.update(f"{axes} axes at {cycle_time_ms:g} ms")
        row = measure(axes, round(cycle_time_ms * MS), seconds, interfaces=interfaces)
    if as_json:
        typer.echo(json.dumps(_document(realtime, rows=[row]), indent=2))
        return
    console = Console()
    _print_machine(console, realtime)
    _print_row(console, row, first=True)
    _print_costs(console, [row])


@app.command("hours")
def hours_command(
    hours: Annotated[float, typer.Option(min=1 / MINUTES_PER_HOUR, max=1000, help="Duration in hours.")] = 12,
    axes: Annotated[int, typer.Option(min=1, max=64, help="Axes, three on a bus.")] = 8,
    cycle_time_ms: Annotated[float, typer.Option(min=1, max=512, help="Cycle time in milliseconds.")] = 1,
    as_json: AsJson = False,
    realtime: RealTime = False,
) -> None:
    """Measure the exchange for hours, up to the 99.99th percentile, with a histogram of the latencies."""
    if realtime:
        use_real_time_priority()
    with _progress() as status:
        found = endure(axes, round(cycle_time_ms * MS), round(hours * MINUTES_PER_HOUR), status.update)
    if as_json:
        typer.echo(json.dumps(_document(realtime, hours=found), indent=2))
        return
    _print_machine(console := Console(), realtime)
    both = {"echo": found.echo, "gateway": found.gateway}
    table = Table("", *SHARES, "missed", title=f"{axes} axes at {cycle_time_ms:g} ms for {hours:g} h, latency in us")
    for name, histogram in both.items():
        missed = f"{histogram.missed} of {histogram.cycles}"
        table.add_row(name, *map(str, histogram.percentiles()), missed)
    console.print(table)
    table = Table("from us", *both, title="cycles by latency")
    for low, counts in octaves(list(both.values())):
        table.add_row(str(low), *map(str, counts))
    console.print(table)
    first, last = ("?" if value is None else f"{value / 2**20:.0f} MiB" for value in found.resident_bytes)
    console.print(
        f"memory {first} after the first minute, {last} at the end; {found.stops} minutes with a stopped axis; "
        f"{found.slept} cycles in which the client itself slept"
    )


@app.command("profinet")
def over_profinet(
    cycle_time_ms: Annotated[
        list[float] | None, typer.Option(min=0.25, max=512, help="Cycle time in milliseconds; repeat for more rows.")
    ] = None,
    seconds: Seconds = 5,
    as_json: AsJson = False,
    realtime: RealTime = False,
) -> None:
    """The PROFINET device at 0.25 to 32 ms over virtual Ethernet interfaces, against a process that only sends (Linux)."""
    if not namespaces.inside():
        namespaces.enter("tests.long")
    if realtime:
        use_real_time_priority()  # rejects a missing permission before anything is measured without it
    rows, refused = [], []
    with _progress() as status:
        for cycle_ms, native in product(cycle_time_ms or profinet.CYCLES_MS, profinet.exchanges()):
            status.update(f"PROFINET, {cycle_ms:g} ms{', native' if native else ''}")
            try:
                rows.append(profinet.measure(cycle_ms, seconds, realtime=realtime, native=native))
            except GatewayError as error:
                refused.append({"cycle_ms": cycle_ms, "native": native, "refused": str(error)})
    if as_json:
        told = _document(realtime, rows=rows)
        told["rows"] += refused
        typer.echo(json.dumps(told, indent=2))
        return
    console = Console()
    _print_machine(console, realtime)
    periods = Table(
        "cycle", "", "p50", "p99", "max", "missed", "p99 beyond the cycle", title="period of the input frames"
    )
    for row in rows:
        for name, item in ((row.name, row.gateway), ("only sends", row.floor)):
            own = item is row.gateway
            periods.add_row(
                f"{row.cycle_ms:g} ms" if own else "",
                name,
                *(f"{value:.3f} ms" for value in (item.p50_ms, item.p99_ms, item.max_ms)),
                f"{row.missed} of {item.frames}" if own else "",
                f"{row.ratio_p99:.1f} times" if own else "",
            )
    console.print(periods)
    costs = Table("cycle", "", "CPU", "memory", "start to first answer", title="what the processes take")
    times = Table(
        *("cycle", "Identify to data", "Connect", "record", "UDP echo", "record over echo", "controller killed"),
        title="answer times",
    )
    for row in rows:
        for name, cost in ((row.name, row.cost), ("only sends", row.floor_cost)):
            costs.add_row(
                f"{row.cycle_ms:g} ms" if cost is row.cost else "",
                name,
                _share(cost.cpu_share),
                f"{cost.resident_bytes / 2**20:.0f} MiB",
                f"{cost.start_s:.2f} s",
            )
        times.add_row(
            f"{row.cycle_ms:g} ms{', native' if row.native else ''}",
            *(f"{value:.2f} ms" for value in (row.data_ms, row.connect_ms, row.record_ms, row.echo_ms)),
            f"{row.ratio_record:.1f} times",
            f"{row.killed_ms:.1f} ms (hold {row.hold_ms:g})",
        )
    console.print(costs)
    console.print(times)
    for refusal in refused:
        name = "native" if refusal["native"] else "Python"
        text = f"refused: {refusal['cycle_ms']:g} ms, {name}: {refusal['refused']}"
        console.print(text, markup=False, highlight=False)


@app.command("settings")
def settings_command(
    axes: Annotated[int, typer.Option(min=1, max=64, help="Axes, three on a bus.")] = 8,
    cycle_time_ms: Annotated[float, typer.Option(min=1, max=512, help="Cycle time in milliseconds.")] = 1,
    seconds: Seconds = 5,
    as_json: AsJson = False,
) -> None:
    """The same exchange as by default, without the flight recorder, and with real-time priority; best of three turns."""
    with _progress() as status:
        choices = settings.run(axes, round(cycle_time_ms * MS), seconds, status.update)
    if as_json:
        rows = [
            {"name": item.name, "ratio_p50": item.p50, "ratio_p99": item.p99, "cpu_ns_per_cycle": item.cpu_ns_per_cycle}
            for item in choices
        ]
        typer.echo(json.dumps({"machine": machine(), "settings": rows}, indent=2))
        return
    _print_machine(console := Console())
    title = f"{axes} axes at {cycle_time_ms:g} ms against a UDP echo of the same turn"
    table = Table("", "p50", "p99", "CPU a cycle", title=title)
    for item in choices:
        cost = "?" if item.cpu_ns_per_cycle is None else f"{item.cpu_ns_per_cycle / US:.0f} us"
        table.add_row(escape(item.name), f"{item.p50:.2f}", f"{item.p99:.2f}", cost)
    console.print(table)
    if len(choices) < len(settings.SETTINGS):
        console.print("[realtime] is not granted here: root or CAP_SYS_NICE is needed", markup=False)


@app.command("decode")
def decode(
    packets: Annotated[int, typer.Option(min=4, help="Packets of the capture.")] = 200_000,
    as_json: AsJson = False,
) -> None:
    """The decoder against scapy and tshark on the same capture of both buses."""
    with _progress() as status:
        speeds = decoding.run(packets, progress=status.update)
    ours = speeds[0]
    if as_json:
        ratios = {f"ratio_{speed.name.split()[0]}": ours.packets_per_s / speed.packets_per_s for speed in speeds[1:]}
        typer.echo(json.dumps({"decode": document(speeds), **ratios}, indent=2))
        return
    table = Table("", "seconds", "packets/s", "decoder is", title=f"{packets} packets of both buses, start-up included")
    for speed in speeds:
        ratio = "" if speed is ours else f"{ours.packets_per_s / speed.packets_per_s:.1f} x as fast"
        table.add_row(speed.name, f"{speed.seconds:.2f}", f"{speed.packets_per_s:.0f}", ratio)
    console = Console()
    _print_machine(console)
    console.print(table)
    typer.echo(f"goals: {decoding.GOAL_SCAPY:g} x scapy, {decoding.GOAL_TSHARK:g} x tshark")


@app.command("timeline")
def timeline(
    seconds: Annotated[int, typer.Option(min=2, help="Length of the recording.")] = 120,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """The timeline of four axes at 4 ms against real time."""
    speed = following.run(seconds)
    if as_json:
        typer.echo(json.dumps({"timeline": document(speed)}, indent=2))
        return
    _print_machine(Console())
    typer.echo(
        f"timeline: {speed.recorded_s} s of traffic in {speed.cpu_s:.1f} s of CPU, {speed.factor:.0f} x as fast as real time "
        f"(goal {following.GOAL_FACTOR:g}); first line after {speed.first_line_s:.1f} s; {speed.peak_mib:.0f} MiB at most"
    )


@app.command("flood")
def flood_command(seconds: Seconds = 10, as_json: AsJson = False, realtime: RealTime = False) -> None:
    """Four axes at 4 ms while an unknown sender sends 20,000 datagrams/s to the cyclic, then to the acyclic port."""
    if realtime:
        use_real_time_priority()
    with _progress() as status:
        floods = _floods(status, seconds)
    if as_json:
        typer.echo(json.dumps(_document(realtime, floods=floods), indent=2))
        return
    _print_machine(console := Console(), realtime)
    _print_floods(console, floods)


@app.command("web")
def web_command(seconds: Seconds = 10, as_json: AsJson = False, realtime: RealTime = False) -> None:
    """Eight axes at 1 ms with twenty open pages and Prometheus, and while the page's process is flooded, paused and killed."""
    if realtime:
        use_real_time_priority()
    with _progress() as status:
        status.update("pages")
        item = watching.measure(seconds)
    if as_json:
        typer.echo(json.dumps(_document(realtime, web=item), indent=2))
        return
    _print_machine(console := Console(), realtime)
    table = _latencies(f"{watching.AXES} axes at 1 ms, {watching.PAGES} pages")
    for name, row in (
        ("no page", item.quiet),
        (f"looked at, {item.messages_per_s:.0f} messages/s", item.watched),
        (f"flooded, {item.requests_per_s:.0f} requests/s, stopped, killed", item.harmed),
    ):
        table.add_row(name, *_cells(row))
    table.add_row("looked at / no page", "", f"{item.ratio_p99:.2f}", "", "")
    table.add_row("flooded / no page", "", f"{item.ratio_p99_harmed:.2f}", "", "")
    console.print(table)


@app.command("stops")
def stops_command(
    trials: Annotated[int, typer.Option(min=1, max=10_000, help="Losses of each kind in virtual time.")] = 100,
    kills: Annotated[int, typer.Option(min=0, max=1_000, help="Gateway processes killed and stopped; 0: none.")] = 20,
    as_json: AsJson = False,
    junit: JUnitFile = None,
    html: HtmlFile = None,
) -> None:
    """Measure the time from each loss to the drive's stop; exit status 1 when one exceeds its bound."""
    rows = []
    with _progress() as status, _without_log():
        for row in chain(stops.virtual(trials), killed.real(kills) if kills else ()):
            status.update(row.cause)
            rows.append(row)
    told = {"machine": machine(), "stops": [row.document() for row in rows]}
    Report("python -m tests.long bench stops", measured=figures(told)).write(junit, html)
    if as_json:
        typer.echo(json.dumps(told, indent=2))
    else:
        _print_machine(console := Console(), realtime=False)
        table = Table("", "from ... to", "p50", "p99", "max", "bound", "clock", "samples")
        for row in rows:
            times = (f"{row.milliseconds(share):.1f} ms" for share in _STOP_SHARES)
            bound = f"{row.bound_ms:g} ms" if row.kept else f"[red]{row.bound_ms:g} ms[/red]"
            table.add_row(row.cause, row.measured, *times, bound, row.clock, str(len(row.times_ns)))
        console.print(table)
    if not all(row.kept for row in rows):
        raise typer.Exit(1)


@contextmanager
def _without_log() -> Iterator[None]:
    """Silence the gateways in this process: their events are the purpose of the benchmark."""
    gateway_log = logging.getLogger("gateway")
    before = gateway_log.disabled
    gateway_log.disabled = True
    try:
        yield
    finally:
        gateway_log.disabled = before


def _floods(status: Status, seconds: float) -> list[flood.Flood]:
    floods = []
    for port in (flood.CYCLIC, flood.ACYCLIC):
        status.update(f"an unknown sender floods the {port} port")
        floods.append(flood.measure(port, seconds))
    return floods


def _print_floods(console: Console, floods: list[flood.Flood]) -> None:
    title = f"{flood.AXES} axes at {flood.PERIOD_NS / MS:g} ms while a port is flooded"
    table = Table("", "datagrams/s", "p50", "p99", "p99.9", "missed", title=title)
    for item in floods:
        for name, rate, row in (("quiet", 0.0, item.quiet), (f"{item.port} port", item.datagrams_per_s, item.flooded)):
            micros = _cells(row)[:-1]
            table.add_row(name, f"{rate:.0f}", *micros, f"{row.missed} of {row.samples + row.missed}")
    console.print(table)


@contextmanager
def _progress() -> Iterator[Status]:
    with Console(stderr=True, quiet=not sys.stderr.isatty()).status("") as status:
        yield status


def _rows(console: Console, status: Status, seconds: float) -> list[Row | Refused]:
    """Print every row when it is measured. A rejected row has its reason; the other rows are still measured."""
    rows: list[Row | Refused] = []
    for axes, period_ns in ROWS:
        status.update(f"{axes} axes at {period_ns / MS:g} ms")
        try:
            rows.append(measure(axes, period_ns, seconds))
        except GatewayError as error:
            rows.append(Refused(axes, period_ns, str(error)))
        _print_row(console, rows[-1], first=len(rows) == 1)
    _print_costs(console, [row for row in rows if isinstance(row, Row)])
    return rows


def _print_translation(console: Console, costs: Sequence[TranslationCost], recorder: RecordingCost) -> None:
    table = Table("telegram", "axis-cycle", "goal", "share of goal", title="translation: frame -> RPDO, TPDO -> frame")
    for cost in costs:
        goal = f"{cost.goal_ns / US:g} us" if cost.goal_ns else ""
        share = f"{cost.total_ns / cost.goal_ns:.2f}" if cost.goal_ns else ""
        table.add_row(str(cost.telegram), f"{cost.total_ns / US:.2f} us", goal, share)
    console.print(table)
    console.print(
        f"flight recorder: {recorder.cycle_ns / US:.2f} us a cycle and {recorder.axis_ns / US:.2f} us an axis, "
        f"{recorder.frame_ns / US:.2f} us a CAN frame; counting cycle and answer times {recorder.times_ns / US:.2f} us"
    )


def _document(realtime: bool, **results: Any) -> dict[str, Any]:
    """Results as plain data, with the machine they are of."""
    return {"machine": machine() | {"realtime": realtime}} | {name: document(item) for name, item in results.items()}


def _print_machine(console: Console, realtime: bool = False) -> None:
    facts = machine()
    priority = "real-time" if realtime else "usual"
    build = f"{facts['date']}, pdgw {facts['version']}, {facts['build']}, {facts['python']}"
    system = f"{facts['system']} {facts['processor']}, {facts['cores']} cores, {priority} priority"
    console.print(f"{build}, {system}", highlight=False, soft_wrap=True)


def _share(value: float | None) -> str:
    return "?" if value is None else f"{100 * value:.1f} %"


def _latencies(title: str) -> Table:
    return Table("", "p50", "p99", "p99.9", "missed", title=title)


def _cells(item: Latency, period_ns: float = float("inf")) -> list[str]:
    """Percentiles and missed cycles. A value of a whole period means cycles without an answer and may be longer."""
    shown = [f"{'>= ' if value * US >= period_ns else ''}{value:.0f} us" for value in (item.p50, item.p99, item.p999)]
    return [*shown, f"{100 * item.missed_share:.2f} %"]


_WIDTHS = {"axes": 4, "cycle": 7, "": 18, "p50": 12, "p99": 12, "p99.9": 12, "missed": 8, "flat out": 20}
"""Widths of the columns. Every row is a table of its own, printed when it is measured."""


def _print_row(console: Console, row: Row | Refused, *, first: bool) -> None:
    title = "exchange with drives that answer at once, and a UDP echo of the same run; setpoints until they are on CAN"
    table = Table(title=title if first else None, show_header=first)
    for name, width in _WIDTHS.items():
        table.add_column(name, width=width)
    place = (str(row.axes), f"{row.period_ns / MS:g} ms")
    if isinstance(row, Refused):
        table.add_row(*place, "refused")
        console.print(table)
        console.print(f"refused: {row.why}", markup=False, highlight=False)
        return
    lost = f", {row.lost_flat_out} lost" if row.lost_flat_out else ""
    for name, item, rate in (
        (f"echo in {row.echo_in}", row.echo, f"{row.echo_per_s:.0f}/s"),
        ("gateway", row.gateway, f"{row.gateway_per_s:.0f}/s{lost}"),
        ("echo, at socket", row.echo_at_socket, ""),
        ("gateway, at socket", row.gateway_at_socket, ""),
        ("to CAN", row.to_can, ""),
    ):
        table.add_row(*place, name, *_cells(item, row.period_ns), rate)
        place = ("", "")
    table.add_row("", "", "ratio", f"{row.ratio_p50:.2f}", f"{row.ratio_p99:.2f}", "", "", "")
    console.print(table)


def _print_costs(console: Console, rows: Sequence[Row]) -> None:
    table = Table(
        "axes", "cycle", "CPU a cycle", "of a core", "memory", "start to online", title="what the gateway takes"
    )
    for row in rows:
        cost = "?" if row.cpu_ns_per_cycle is None else f"{row.cpu_ns_per_cycle / US:.0f} us"
        memory = "?" if row.resident_bytes is None else f"{row.resident_bytes / 2**20:.0f} MiB"
        table.add_row(
            str(row.axes), f"{row.period_ns / MS:g} ms", cost, _share(row.cpu_share), memory, f"{row.start_s:.2f} s"
        )
    console.print(table)
