"""``python -m tests.long conformance``: conformance tests of the gateway in this process."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from pdgw import __version__
from pdgw.gateway.errors import GatewayError
from pdgw.peers.drive import SHAPES, shape
from pdgw.tools.log_level import quiet
from pdgw.tools.output.reports import Check, HtmlFile, JUnitFile, Report
from tests.long.conformance.faults import CASES, Result, run_case
from tests.long.conformance.shapes import TELEGRAMS
from tests.long.conformance.shapes import Outcome as Field
from tests.long.conformance.shapes import run_case as run_shape
from tests.long.conformance.shared import NUMBERS, walk
from tests.long.conformance.telegrams import CASES as BITS
from tests.long.conformance.telegrams import Outcome, run_walk
from tests.long.conformance.telegrams import run_case as run_bits
from tests.long.conformance.tested import text_of

Case = TypeVar("Case")
Found = TypeVar("Found")

app = typer.Typer(help="Conformance tests of the gateway.", no_args_is_help=True)


@app.callback()
def conformance() -> None:
    """Conformance tests of the gateway."""


@app.command("faults")
def faults(
    only: Annotated[list[str] | None, typer.Argument(help="Names of faults; all without.", show_default=False)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
    junit: JUnitFile = None,
    html: HtmlFile = None,
) -> None:
    """Give simulated drives and encoders every known fault and check the gateway's reaction. Exit status 1 if a case fails."""
    known = {case.fault: None for case in CASES}
    for name in only or ():
        if name not in known:
            raise GatewayError(f"fault {name!r} does not exist, allowed: {', '.join(known)}")
    with quiet("gateway", "canopen"):
        timed = list(_timed(run_case, (case for case in CASES if not only or case.fault in only)))
    results = [result for result, _ in timed]
    checks = [replace(_check(result), seconds=seconds) for result, seconds in timed]
    _finish("faults", results, checks, matrix(results), as_json, junit, html)


@app.command("telegrams")
def telegrams(
    only: Annotated[list[int] | None, typer.Argument(help="Telegrams; all without.", show_default=False)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
    junit: JUnitFile = None,
    html: HtmlFile = None,
) -> None:
    """Set the bits of the motion telegrams one by one and show what both sides see. Exit status 1 if a case fails."""
    known = sorted({case.telegram for case in BITS} | set(NUMBERS))
    for number in only or ():
        if number not in known:
            raise GatewayError(f"telegram {number} has no cases, allowed: {', '.join(map(str, known))}")
    with quiet("gateway", "canopen"):
        timed = list(_timed(run_bits, (case for case in BITS if not only or case.telegram in only)))
        walks = [walk(number) for number in NUMBERS if not only or number in only]
        for found, seconds in _timed(run_walk, walks):
            timed += [(outcome, seconds / len(found)) for outcome in found]
    outcomes = [outcome for outcome, _ in timed]
    table = Table("telegram", "word and bit", "done", "seen by the PLC", "on CAN", "")
    for item in outcomes:
        case = item.case
        name = f"{case.word}.{case.bit}"
        table.add_row(str(case.telegram), name, case.did, item.seen_by_plc, item.seen_on_can, _verdict(item))
    checks = [replace(_check_bits(item), seconds=seconds) for item, seconds in timed]
    _finish("telegrams", outcomes, checks, table, as_json, junit, html)


@app.command("shapes")
def shapes(
    only: Annotated[list[str] | None, typer.Argument(help="Names of shapes; all without.", show_default=False)] = None,
    seed: Annotated[int, typer.Option(help="Decides the latency of each drive.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
    junit: JUnitFile = None,
    html: HtmlFile = None,
) -> None:
    """Run telegrams 1, 3, 9 and 100 with every variant of a simulated drive: each must follow or be rejected with a reason."""
    for name in only or ():
        shape(name)
    with quiet("gateway", "canopen"):
        cases = [(name, number) for name in only or SHAPES for number in TELEGRAMS]
        timed = list(_timed(lambda case: run_shape(*case, seed), cases))
    fields = [item for item, _ in timed]
    checks = [
        Check(item.shape, f"telegram {item.telegram}", item.text, (item.failure,) if item.failure else (), seconds)
        for item, seconds in timed
    ]
    table = Table("shape", "telegram", "latency: command, status (ms)", "what it did", "")
    for item in fields:
        latency = f"{item.latency.command_ms}, {item.latency.status_ms}"
        table.add_row(item.shape, str(item.telegram), latency, item.text, _verdict(item))
    _finish("shapes", fields, checks, table, as_json, junit, html)


def _timed(run: Callable[[Case], Found], cases: Iterable[Case]) -> Iterator[tuple[Found, float]]:
    """The result of each case with its duration in seconds."""
    for case in cases:
        began = perf_counter()
        found = run(case)
        yield found, perf_counter() - began


def _verdict(item: Result | Outcome | Field) -> str:
    return "[green]pass[/green]" if item.passed else "[red]FAIL[/red]"


def _finish(
    name: str,
    results: Sequence[Result | Outcome | Field],
    checks: Sequence[Check],
    table: Table,
    as_json: bool,
    junit: Path | None,
    html: Path | None,
) -> None:
    """Write the reports and print the results. Raises typer.Exit(1) if one failed."""
    failed = sum(not result.passed for result in results)
    configuration = text_of(result.tested for result in results if result.tested is not None)
    Report(f"python -m tests.long conformance {name}", tuple(checks), configuration).write(junit, html)
    if as_json:
        cases = [result.as_dict() for result in results]
        document = {"version": __version__, "configuration": configuration, "failed": failed, "cases": cases}
        typer.echo(json.dumps(document, indent=2))
    else:
        console = Console()
        console.print(table)
        for check in checks:
            for failure in check.failures:
                console.print(f"[red]{check.group}, {check.name}[/red]: {failure}", highlight=False)
        console.print(f"{len(results) - failed} of {len(results)} as they must be")
    if failed:
        raise typer.Exit(1)


def _check_bits(outcome: Outcome) -> Check:
    case = outcome.case
    seen = f"done: {case.did}; seen by the PLC: {outcome.seen_by_plc}; on CAN: {outcome.seen_on_can}"
    return Check(f"telegram {case.telegram}", f"{case.word}.{case.bit}", seen, outcome.failures)


def _check(result: Result) -> Check:
    case = result.case
    seen = [f"sent: {', '.join(result.sent) or 'nothing'}", f"told: {', '.join(map(str, result.numbers)) or 'nothing'}"]
    seen += [text for text in (result.stopped, result.reason) if text]
    name = f"{case.title} ({case.activity.value}, telegram {case.telegram})"
    return Check(case.device.value, name, "; ".join(seen), tuple(result.failures))


def matrix(results: list[Result]) -> Table:
    """The results as a table."""
    titles = (
        "device",
        "fault",
        "what the gateway did",
        "fault number",
        "drive stopped",
        "restarted by itself",
        "verdict",
    )
    table = Table(*titles)
    for result in results:
        sent = result.sent if len(result.sent) <= _SHOWN else [*result.sent[:_SHOWN], "..."]
        did = [", ".join(sent) or "nothing sent"]
        if result.shown:
            did.append(f"shown: {' > '.join(result.shown)}")
        table.add_row(
            result.case.device.value,
            f"{result.case.title} ({result.case.activity.value})",
            "; ".join(did),
            ", ".join(map(str, result.numbers)) or "none",
            result.stopped or "no drive",
            "[red]yes[/red]" if result.restarted else "no",
            _verdict(result),
        )
    return table


_SHOWN = 6
"""Number of commands shown for each case; ``--json`` has all."""
