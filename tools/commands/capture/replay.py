"""``pdgw replay``: check whether this version sends the same frames as a recording."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.durations import MS, SECOND
from pdgw.phrases import counted
from pdgw.recording.defaults import TOLERANCE_NS
from pdgw.tools.commands.capture.options import Config, Files, Nodes, Offset, Station, Telegrams

if TYPE_CHECKING:
    from pdgw.decoder.replay.result import AxisReplay, Difference
    from pdgw.recording.recordings import Loaded


def replay(
    files: Files,
    config: Config = None,
    telegram: Telegrams = None,
    node: Nodes = None,
    offset: Offset = None,
    station: Station = "",
    tolerance: Annotated[
        float, typer.Option(min=0, max=10_000, help="Tolerance of recorded times, in milliseconds.")
    ] = TOLERANCE_NS / MS,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Run a recording through this version of the gateway; exit status 1 if it sends something else."""
    from pdgw.recording.recordings import known_from, load, nanoseconds, print_notice, write_lines

    loaded = load(
        files, known_from(config, telegram or [], node or [], files, station), nanoseconds(offset), print_notice
    )
    outcomes = loaded.replay(tolerance_ns=round(tolerance * MS), first_only=True)
    write_lines(_document(loaded, outcomes) if as_json else _text(loaded, outcomes))
    if any(outcome.differences for outcome in outcomes):
        raise typer.Exit(1)


def _document(loaded: Loaded, outcomes: Sequence[AxisReplay]) -> Iterator[str]:
    yield json.dumps(
        {
            "equal": not any(outcome.differences for outcome in outcomes),
            "begin_ns": loaded.recording.begin_ns,
            "axes": [
                {
                    "axis": outcome.recording.do_id,
                    "telegram": outcome.recording.telegram.number,
                    "node": outcome.recording.node,
                    "steps": len(outcome.steps),
                    "compared": outcome.compared,
                    "not_compared": outcome.not_compared,
                    "first_difference": _difference(outcome.differences[0]) if outcome.differences else None,
                }
                for outcome in outcomes
            ],
        }
    )


def _difference(difference: Difference) -> dict[str, object]:
    return {
        "time_ns": difference.time_ns,
        "what": difference.what,
        "names": list(difference.names),
        "recorded": difference.recorded,
        "today": difference.today,
        "note": difference.note,
    }


def _text(loaded: Loaded, outcomes: Sequence[AxisReplay]) -> Iterator[str]:
    yield f"clocks: {loaded.clocks.text}"
    for outcome in outcomes:
        recording = outcome.recording
        who = f"axis {recording.do_id} (telegram {recording.telegram.number}, node {recording.node})"
        if not outcome.differences:
            equal = f"{outcome.compared} of {len(outcome.steps)} steps compared, all equal"
            yield (
                f"{who}: {equal}"
                if outcome.compared
                else (
                    f"{who}: nothing to compare: the recording contains neither a configuration of the node nor an OFF"
                )
            )
        for name in outcome.not_compared:
            yield f"{who}: {name} is not compared: the recording begins in operation, without the drive's own value"
        for difference in outcome.differences:
            seconds = (difference.time_ns - loaded.recording.begin_ns) / SECOND
            yield f"{who}: {counted(outcome.compared, 'step')} equal, then {difference.what} differs at {seconds:.6f} s"
            yield from _values(difference)


def _values(difference: Difference) -> Iterator[str]:
    if difference.note:
        yield f"  {difference.note}"
    for name in difference.names:
        yield f"  {name}: recorded {_shown(difference.recorded, name)}, today {_shown(difference.today, name)}"


def _shown(values: Mapping[str, int] | None, name: str) -> str:
    value = None if values is None else values.get(name)
    if value is None:
        return "nothing"
    return f"{value} ({value & 0xFFFF:04X}h)" if 0 <= value <= 0xFFFF else str(value)
