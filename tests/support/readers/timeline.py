"""The timeline of a recording, all of it at once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pdgw.tools.decoder.frames.records import Record
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Summary, WordKind
from pdgw.tools.recording.recordings import Opening, Part, followed, known_from, look_ahead
from tests.support.axis.recorded import RecordedRig


@dataclass
class Timeline:
    """All entries at once."""

    opening: Opening
    entries: list[Entry]

    @property
    def summary(self) -> Summary:
        summary = Summary()
        for entry in self.entries:
            summary.add(entry)
        return summary


EVERYTHING = Part()


def entries_of(opening: Opening, part: Part = EVERYTHING) -> list[Entry]:
    """The timeline of a part without packets."""
    return [item for item in followed(opening, part) if not isinstance(item, Record)]


def timeline(rig: RecordedRig, folder: Path, *, clock_ns: int = 0) -> Timeline:
    opening = rig.open(folder, clock_ns=clock_ns)
    return Timeline(opening, entries_of(opening))


def own_timeline(file: str) -> Timeline:
    """That of a gateway's own recording."""
    opening = look_ahead([file], known_from(None, [], [], [file]), None, lambda _: None)
    return Timeline(opening, entries_of(opening))


def edges(found: Timeline, kind: WordKind) -> list[Edge]:
    return [entry for entry in found.entries if isinstance(entry, Edge) and entry.kind is kind]


def texts(found: Timeline, kind: AnomalyKind) -> list[str]:
    return [entry.text for entry in found.entries if isinstance(entry, Anomaly) and entry.kind is kind]
