"""``pdgw timeline``: merge both buses by time, each edge with its cause and each rejection with its reason. ``pdgw replay``.

``pdgw replay``: check whether this version decides and sends the same as a recording of the gateway.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.base.durations import SECOND
from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.tools.options import Config, Files, Nodes, Offset, Station, Telegrams
from pdgw.tools.output.reports import to_be_written

if TYPE_CHECKING:
    from pdgw.tools.decoder.step_replay import Replayed
    from pdgw.tools.recording.recordings import Opening, Part


def timeline(
    files: Files,
    config: Config = None,
    telegram: Telegrams = None,
    node: Nodes = None,
    axis: Annotated[list[int] | None, typer.Option(help="Show only this axis.")] = None,
    offset: Offset = None,
    station: Station = "",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object for each entry.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Also show every packet and every temporary reason.")
    ] = False,
    begin: Annotated[str | None, typer.Option("--from", help="Seconds since the first frame, or an ISO time.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="As --from.")] = None,
    html: Annotated[
        Path | None,
        typer.Option(callback=to_be_written, help="Write an HTML page with curves and the timeline."),
    ] = None,
) -> None:
    """Merge captures of both buses: each command of the PLC with its result, its duration and the reason if it had no effect."""
    from pdgw.tools.decoder.capture.live import moment
    from pdgw.tools.recording.recordings import (
        Part,
        known_from,
        look_ahead,
        nanoseconds,
        print_notice,
        write_lines,
        write_page,
    )

    opening = look_ahead(
        files, known_from(config, telegram or [], node or [], files, station), nanoseconds(offset), print_notice
    )
    chosen = frozenset(axis or ())
    unknown = chosen - {item.do_id for item in opening.known.settings.axes}
    if unknown:
        raise GatewayError(f"--axis {min(unknown)}: the recording has no such axis")
    part = Part(
        moment(begin, "--from", opening.begin_ns) if begin is not None else None,
        moment(end, "--to", opening.begin_ns) if end is not None else None,
        chosen,
    )
    if html is not None:
        write_page(opening, part, html)
        return
    write_lines(_documents(opening, part) if as_json else _text(opening, part, verbose=verbose))


def _documents(opening: Opening, part: Part) -> Iterator[str]:
    from pdgw.tools.decoder.frames.records import Record
    from pdgw.tools.decoder.timeline.entries import Summary
    from pdgw.tools.recording.recordings import followed

    clocks = opening.clocks
    yield json.dumps(
        {
            "type": "clocks",
            "offset_ns": clocks.offset_ns,
            "uncertainty_ns": clocks.uncertainty_ns,
            "pairs": clocks.pairs,
            "edges": clocks.edges,
            "ambiguous": clocks.ambiguous,
            "origin": clocks.origin,
            "begin_ns": opening.begin_ns,
            "assumed": list(opening.assumed),
        }
    )
    summary = Summary(opening.known.age_limit_ns)
    for entry in followed(opening, part):
        summary.add(entry)
        if not isinstance(entry, Record):
            yield json.dumps(entry.document())
    yield json.dumps(summary.document())


def _text(opening: Opening, part: Part, *, verbose: bool) -> Iterator[str]:
    from pdgw.tools.decoder.frames.records import Record
    from pdgw.tools.decoder.timeline.entries import Summary
    from pdgw.tools.decoder.timeline.text import Repetitions, entry_lines, summary_lines
    from pdgw.tools.decoder.view.render import record_line
    from pdgw.tools.recording.recordings import followed

    summary = Summary(opening.known.age_limit_ns)
    zero_ns = opening.begin_ns
    repetitions = Repetitions(zero_ns)
    for entry in followed(opening, part):
        summary.add(entry)
        if isinstance(entry, Record):
            if verbose:
                yield record_line(entry, zero_ns)
            continue
        yield from repetitions.ended(entry.time_ns)
        if verbose or repetitions.is_new(entry):
            yield from entry_lines(entry, zero_ns, verbose=verbose)
    yield from repetitions.ended()
    yield ""
    yield from summary_lines(summary, opening.clocks, opening.assumed)


def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings of `pdgw run --record`, in their order.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Run a recording through this version of the gateway; exit status 1 if it decides or sends something else."""
    from pdgw.tools.decoder.step_replay import ReplayError
    from pdgw.tools.recording.recordings import replayed, write_lines

    failure = None
    try:
        outcomes = replayed([str(file) for file in files])
    except ReplayError as error:
        outcomes, failure = error.outcomes, error
    write_lines(
        iter([json.dumps([_replay_document(item) for item in outcomes])]) if as_json else _replay_text(outcomes)
    )
    if failure is not None:
        raise failure
    if any(item.differences for item in outcomes):
        raise typer.Exit(1)


def _replay_document(outcome: Replayed) -> dict[str, object]:
    differences = [
        {"time_ns": item.wall_ns, "field": item.field, "recorded": item.recorded, "now": item.now}
        for item in outcome.differences
    ]
    return {"object": outcome.who, "telegram": outcome.telegram, "steps": outcome.steps, "differences": differences}


def _replay_text(outcomes: list[Replayed]) -> Iterator[str]:
    for outcome in outcomes:
        result = "then a difference" if outcome.differences else "all equal"
        yield f"{outcome.who} (telegram {outcome.telegram}): {counted(outcome.steps, 'step')} compared, {result}"
        for item in outcome.differences:
            at = datetime.fromtimestamp(item.wall_ns / SECOND)
            yield f"{at:%H:%M:%S.%f}  {item.who}: {item.field}: recorded {item.recorded}, now {item.now}"
