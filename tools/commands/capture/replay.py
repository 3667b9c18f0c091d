"""``pdgw replay``: check whether this version decides and sends the same as a recording of the gateway."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.durations import SECOND
from pdgw.phrases import counted

if TYPE_CHECKING:
    from pdgw.tools.decoder.step_replay import Replayed


def replay(
    files: Annotated[list[Path], typer.Argument(help="Recordings of `pdgw run --record`, in their order.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Run a recording through this version of the gateway; exit status 1 if it decides or sends something else."""
    from pdgw.tools.recording.recordings import replayed, write_lines

    outcomes = replayed([str(file) for file in files])
    write_lines(iter([json.dumps([_document(item) for item in outcomes])]) if as_json else _text(outcomes))
    if any(item.differences for item in outcomes):
        raise typer.Exit(1)


def _document(outcome: Replayed) -> dict[str, object]:
    differences = [
        {"time_ns": item.wall_ns, "field": item.field, "recorded": item.recorded, "now": item.now}
        for item in outcome.differences
    ]
    return {"object": outcome.who, "telegram": outcome.telegram, "steps": outcome.steps, "differences": differences}


def _text(outcomes: list[Replayed]) -> Iterator[str]:
    for outcome in outcomes:
        result = "then a difference" if outcome.differences else "all equal"
        yield f"{outcome.who} (telegram {outcome.telegram}): {counted(outcome.steps, 'step')} compared, {result}"
        for item in outcome.differences:
            at = datetime.fromtimestamp(item.wall_ns / SECOND)
            yield f"{at:%H:%M:%S.%f}  {item.who}: {item.field}: recorded {item.recorded}, now {item.now}"
