"""``pdgw timeline``: both buses in one timeline, each edge with its cause and every refusal with its reason."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator
from typing import Annotated

import typer
from pdgw.decoder.capture.moments import moment
from pdgw.decoder.render import record_line
from pdgw.decoder.timeline import Timeline, make_timeline
from pdgw.decoder.timeline_text import entry_lines, summary_lines
from pdgw.gateway.errors import GatewayError
from pdgw.tools.commands.recording_options import Config, Files, Nodes, Offset, Telegrams
from pdgw.tools.recordings import Loaded, known_from, load, nanoseconds, tell, write_lines


def timeline(
    files: Files,
    config: Config = None,
    telegram: Telegrams = None,
    node: Nodes = None,
    axis: Annotated[list[int] | None, typer.Option(help="Show only this axis.")] = None,
    offset: Offset = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object for each entry.")] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Every packet and every passing reason too.")
    ] = False,
    begin: Annotated[str | None, typer.Option("--from", help="Seconds since the first frame, or an ISO time.")] = None,
    end: Annotated[str | None, typer.Option("--to", help="As --from.")] = None,
) -> None:
    """Merge captures of both buses: what the PLC asked, what became of it, how long it took, and why not."""
    loaded = load(files, known_from(config, telegram or [], node or []), nanoseconds(offset), tell)
    chosen = frozenset(axis or ())
    unknown = chosen - {item.do_id for item in loaded.recording.axes}
    if unknown:
        raise GatewayError(f"--axis {min(unknown)}: no axis of this recording")
    whole = make_timeline(loaded.recording, loaded.replay(), loaded.clocks)
    zero_ns = whole.begin_ns
    limits = (
        moment(begin, "--from", zero_ns) if begin is not None else None,
        moment(end, "--to", zero_ns) if end is not None else None,
    )
    part = whole.between(*limits, chosen)
    lines = _documents(part) if as_json else _text(part, loaded, limits, verbose=verbose)
    write_lines(lines)


def _documents(part: Timeline) -> Iterator[str]:
    clocks = part.clocks
    yield json.dumps(
        {
            "type": "clocks",
            "offset_ns": clocks.offset_ns,
            "uncertainty_ns": clocks.uncertainty_ns,
            "pairs": clocks.pairs,
            "edges": clocks.edges,
            "ambiguous": clocks.ambiguous,
            "origin": clocks.origin,
            "begin_ns": part.begin_ns,
        }
    )
    for entry in part.entries:
        yield json.dumps(entry.document())
    yield json.dumps(part.summary())


def _text(part: Timeline, loaded: Loaded, limits: tuple[int | None, int | None], *, verbose: bool) -> Iterator[str]:
    lines = (
        (entry.time_ns, line) for entry in part.entries for line in entry_lines(entry, part.begin_ns, verbose=verbose)
    )
    if verbose:
        lines = heapq.merge(_packets(loaded, limits), lines, key=lambda item: item[0])
    for _, line in lines:
        yield line
    yield ""
    yield from summary_lines(part)


def _packets(loaded: Loaded, limits: tuple[int | None, int | None]) -> Iterator[tuple[int, str]]:
    begin, end = limits
    for record in loaded.records(lambda _: None):
        if (begin is None or record.time_ns >= begin) and (end is None or record.time_ns <= end):
            yield record.time_ns, record_line(record, loaded.recording.begin_ns)
