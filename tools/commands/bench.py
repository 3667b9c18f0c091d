"""``pdgw bench``: what the gateway costs, as ratios against a floor measured in the same run."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer
from pdgw.ds301.load import frame_bits
from pdgw.tools.bench import decoding, following, roundtrip, storm, translation
from rich.console import Console
from rich.table import Table

app = typer.Typer(help="Benchmarks.", invoke_without_command=True)


@app.callback()
def bench(
    context: typer.Context,
    cycles: Annotated[int, typer.Option(min=10, help="Cycles of each latency comparison.")] = 5000,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Translation cost, round trip against a UDP echo for 1 and 8 axes, throughput, parameter storm."""
    if context.invoked_subcommand is not None:
        return
    costs = translation.run()
    trips = [roundtrip.run(axes, cycles) for axes in (1, 8)]
    parameters = storm.run(cycles)
    if as_json:
        document = {
            "translation": [asdict(cost) for cost in costs],
            "round_trip": [{**asdict(trip), "ratio_p50": trip.ratio} for trip in trips],
            "parameter_storm": {**asdict(parameters), "ratio_p99": parameters.ratio},
        }
        typer.echo(json.dumps(document, indent=2))
        return
    console = Console()
    table = Table("telegram", "axis-cycle", "goal", "share of goal", title="translation: frame -> RPDO, TPDO -> frame")
    for cost in costs:
        goal = f"{cost.goal_ns / 1000:g} us" if cost.goal_ns else ""
        share = f"{cost.total_ns / cost.goal_ns:.2f}" if cost.goal_ns else ""
        table.add_row(str(cost.telegram), f"{cost.total_ns / 1000:.2f} us", goal, share)
    console.print(table)
    table = Table("axes", "", "p50", "p99", "p99.9", "lost", title="round trip at 1 kHz, drives answering at once")
    for trip in trips:
        for name, row in (("echo", trip.echo), ("gateway", trip.gateway)):
            table.add_row(
                str(trip.axes), name, f"{row.p50:.0f} us", f"{row.p99:.0f} us", f"{row.p999:.0f} us", str(row.lost)
            )
        ratios = [a / b for a, b in ((trip.gateway.p50, trip.echo.p50), (trip.gateway.p99, trip.echo.p99))]
        table.add_row(str(trip.axes), "gateway / echo", f"{ratios[0]:.2f}", f"{ratios[1]:.2f}", "", "")
    console.print(table)
    physical = 1_000_000 / frame_bits(6)
    table = Table("axes", "cycles/s", "CAN frames/s", "of a 1 Mbit/s bus", title="flat out, telegram 1")
    for trip in trips:
        table.add_row(
            str(trip.axes),
            f"{trip.cycles_per_s:.0f}",
            f"{trip.can_frames_per_s:.0f}",
            f"{trip.can_frames_per_s / physical:.1f} x",
        )
    console.print(table)
    table = Table(
        "", "p50", "p99", "p99.9", "lost", title=f"{storm.AXES} axes at 1 kHz under a storm of parameter requests"
    )
    for name, row in (("quiet", parameters.quiet), (f"{parameters.requests_per_s:.0f} requests/s", parameters.storm)):
        table.add_row(name, f"{row.p50:.0f} us", f"{row.p99:.0f} us", f"{row.p999:.0f} us", str(row.lost))
    table.add_row("storm / quiet", "", f"{parameters.ratio:.2f}", "", "")
    console.print(table)
    console.print(
        f"goals: telegram 1 at most 10 us, telegram 9 at most 20 us, one axis at most {roundtrip.GOAL_RATIO:g} x the echo, "
        f"p99 under the storm at most {storm.GOAL_RATIO:g} x"
    )


@app.command("decode")
def decode(
    packets: Annotated[int, typer.Option(min=4, help="Packets of the capture.")] = 200_000,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """The decoder against scapy and tshark on the same capture of both buses."""
    console = Console(stderr=True)
    with console.status("") as status:
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
