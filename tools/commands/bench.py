"""``pdgw bench``: what the gateway costs, as ratios against a floor measured in the same run."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.status import Status
from rich.table import Table

from pdgw.tools.bench import decoding, following, storm, translation
from pdgw.tools.bench.build import machine, use_real_time_priority
from pdgw.tools.bench.measure import Latency
from pdgw.tools.bench.rows import ROWS, Row, idle, measure
from pdgw.tools.reports import HtmlFile, JUnitFile, Report, figures

app = typer.Typer(help="Benchmarks.", invoke_without_command=True)

Seconds = Annotated[float, typer.Option(min=0.01, max=600, help="About so long for each row.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
RealTime = Annotated[
    bool, typer.Option("--realtime", help="All processes with real-time priority (Linux; root or CAP_SYS_NICE).")
]
_MS = 1_000_000
_IDLE_AXES, _IDLE_PERIOD_NS = 4, 10 * _MS


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
    if context.invoked_subcommand is not None:
        return
    with _progress() as status:
        status.update("translation")
        costs = translation.run()
        if realtime:
            use_real_time_priority()
        rows = [_measured(status, axes, period_ns, seconds) for axes, period_ns in ROWS]
        status.update(f"{storm.AXES} axes under a storm of parameter requests")
        parameters = storm.measure(seconds)
        status.update("idle")
        idle_share = idle(_IDLE_AXES, _IDLE_PERIOD_NS, seconds)
    document = {
        "machine": machine() | {"realtime": realtime},
        "translation": [asdict(cost) for cost in costs],
        "rows": [_document(row) for row in rows],
        "parameter_storm": {
            "requests_per_s": parameters.requests_per_s,
            "quiet": _latency(parameters.quiet),
            "storm": _latency(parameters.storm),
            "ratio_p99": parameters.ratio_p99,
        },
        "idle_cpu_share": idle_share,
    }
    Report("pdgw bench", measured=figures(document)).write(junit, html)
    if as_json:
        typer.echo(json.dumps(document, indent=2))
        return
    console = Console()
    _print_machine(console, realtime)
    table = Table("telegram", "axis-cycle", "goal", "share of goal", title="translation: frame -> RPDO, TPDO -> frame")
    for cost in costs:
        goal = f"{cost.goal_ns / 1000:g} us" if cost.goal_ns else ""
        share = f"{cost.total_ns / cost.goal_ns:.2f}" if cost.goal_ns else ""
        table.add_row(str(cost.telegram), f"{cost.total_ns / 1000:.2f} us", goal, share)
    console.print(table)
    _print_rows(console, rows)
    table = Table("", "p50", "p99", "p99.9", "missed", title=f"{storm.AXES} axes at 1 ms under parameter requests")
    for name, row in (("quiet", parameters.quiet), (f"{parameters.requests_per_s:.0f} requests/s", parameters.storm)):
        table.add_row(name, f"{row.p50:.0f} us", f"{row.p99:.0f} us", f"{row.p999:.0f} us", _missed(row))
    table.add_row("storm / quiet", "", f"{parameters.ratio_p99:.2f}", "", "")
    console.print(table)
    console.print(f"idle, {_IDLE_AXES} axes at 10 ms without a PLC: {_share(idle_share)} of a core")


@app.command("cycle")
def cycle(
    axes: Annotated[int, typer.Option(min=1, max=64, help="Axes, three on a bus.")] = 1,
    cycle_time_ms: Annotated[float, typer.Option(min=0.25, max=512, help="Cycle time in milliseconds.")] = 1,
    seconds: Seconds = 3,
    as_json: AsJson = False,
    realtime: RealTime = False,
) -> None:
    """One row: so many axes at one cycle time against the echo."""
    if realtime:
        use_real_time_priority()
    with _progress() as status:
        row = _measured(status, axes, round(cycle_time_ms * _MS), seconds)
    if as_json:
        typer.echo(json.dumps({"machine": machine() | {"realtime": realtime}, "rows": [_document(row)]}, indent=2))
        return
    console = Console()
    _print_machine(console, realtime)
    _print_rows(console, [row])


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
        ratios = {f"ratio_{speed.name.split()[0]}": ours.rate / speed.rate for speed in speeds[1:]}
        rows = [{**asdict(speed), "packets_per_s": speed.rate} for speed in speeds]
        typer.echo(json.dumps({"decode": rows, **ratios}, indent=2))
        return
    table = Table("", "seconds", "packets/s", "decoder is", title=f"{packets} packets of both buses, start-up included")
    for speed in speeds:
        ratio = "" if speed is ours else f"{ours.rate / speed.rate:.1f} x as fast"
        table.add_row(speed.name, f"{speed.seconds:.2f}", f"{speed.rate:.0f}", ratio)
    Console().print(table)
    typer.echo(f"goals: {decoding.GOAL_SCAPY:g} x scapy, {decoding.GOAL_TSHARK:g} x tshark")


@app.command("timeline")
def timeline(
    seconds: Annotated[int, typer.Option(min=2, help="Length of the recording.")] = 120,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """The timeline of four axes at 4 ms against real time."""
    speed = following.run(seconds)
    if as_json:
        typer.echo(json.dumps({"timeline": {**asdict(speed), "factor": speed.factor}}, indent=2))
        return
    typer.echo(
        f"timeline: {speed.recorded_s} s of traffic in {speed.cpu_s:.1f} s of CPU, {speed.factor:.0f} x as fast as real time "
        f"(goal {following.GOAL_FACTOR:g}); first line after {speed.first_line_s:.1f} s; {speed.peak_mib:.0f} MiB at most"
    )


@contextmanager
def _progress() -> Iterator[Status]:
    with Console(stderr=True, quiet=not sys.stderr.isatty()).status("") as status:
        yield status


def _measured(status: Status, axes: int, period_ns: int, seconds: float) -> Row:
    status.update(f"{axes} axes at {period_ns / _MS:g} ms")
    return measure(axes, period_ns, seconds)


def _latency(item: Latency) -> dict[str, Any]:
    return {**asdict(item), "missed_share": item.missed_share}


def _document(row: Row) -> dict[str, Any]:
    latencies = {name: _latency(getattr(row, name)) for name in ("echo", "gateway", "to_can")}
    ratios = {name: getattr(row, name) for name in ("ratio_p50", "ratio_p99", "cpu_share")}
    return {**asdict(row), **latencies, **ratios}


def _print_machine(console: Console, realtime: bool) -> None:
    facts = machine()
    priority = "real-time" if realtime else "usual"
    console.print(
        f"pdgw {facts['version']}, {facts['build']}, Python {facts['python']}, {facts['system']} {facts['processor']}, "
        f"{facts['cores']} cores, {priority} priority",
        highlight=False,
    )


def _missed(item: Latency) -> str:
    return f"{100 * item.missed_share:.2f} %"


def _share(value: float | None) -> str:
    return "?" if value is None else f"{100 * value:.1f} %"


def _print_rows(console: Console, rows: list[Row]) -> None:
    title = "exchange with drives that answer at once, and a UDP echo of the same run; setpoints until they are on CAN"
    table = Table("axes", "cycle", "", "p50", "p99", "p99.9", "missed", "flat out", title=title)
    for row in rows:
        place = (str(row.axes), f"{row.period_ns / _MS:g} ms")
        for name, item, rate in (
            ("echo", row.echo, f"{row.echo_per_s:.0f}/s"),
            ("gateway", row.gateway, f"{row.gateway_per_s:.0f}/s"),
            ("to CAN", row.to_can, ""),
        ):
            micros = (f"{value:.0f} us" for value in (item.p50, item.p99, item.p999))
            table.add_row(*place, name, *micros, _missed(item), rate)
            place = ("", "")
        table.add_row("", "", "ratio", f"{row.ratio_p50:.2f}", f"{row.ratio_p99:.2f}", "", "", "")
    console.print(table)
    table = Table(
        "axes", "cycle", "CPU a cycle", "of a core", "memory", "start to online", title="what the gateway takes"
    )
    for row in rows:
        cost = "?" if row.cpu_ns_per_cycle is None else f"{row.cpu_ns_per_cycle / 1000:.0f} us"
        memory = "?" if row.resident_bytes is None else f"{row.resident_bytes / 2**20:.0f} MiB"
        table.add_row(
            str(row.axes), f"{row.period_ns / _MS:g} ms", cost, _share(row.cpu_share), memory, f"{row.start_s:.2f} s"
        )
    console.print(table)
