"""What happened at the gateway, in the user's words: faults, warnings, reasons, connections. What repeats is one line.

These lines have numbers of their own, which rise also over restarts of the web process (they begin at its start in
milliseconds), so that a browser can resume.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict, dataclass
from itertools import islice

KEPT = 1000
REPEATS_AMONG = 200
"""Number of newest events in which a repeated one is found."""


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened."""

    id: int
    time: str
    """Time of the gateway's clock, ISO with time zone."""
    kind: str
    """``fault``, ``warning``, ``reason``, ``plc``, ``bus``, ``node`` or ``gateway``."""
    do_id: int | None
    """The drive object it is about, if any."""
    text: str
    count: int = 1
    """Times it has happened; ``time`` is that of the last."""
    since: str = ""
    """When it happened first."""

    @property
    def message(self) -> bytes:
        """As an event of a stream."""
        return f"id: {self.id}\nevent: event\ndata: {json.dumps(asdict(self))}\n\n".encode()


class EventLog:
    """The last thousand. ``newest``: at least the last number of each earlier process, then that of the last event."""

    def __init__(self, newest: int) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self.newest = newest

    def add(self, time: str, kind: str, do_id: int | None, text: str) -> None:
        """Number it and keep it. What repeats takes the place of the older line, with a count."""
        count, since = 1, time
        for known in islice(reversed(self._events), REPEATS_AMONG):
            if (known.kind, known.do_id, known.text) == (kind, do_id, text):
                count, since = known.count + 1, known.since
                self._events.remove(known)
                break
        self.newest += 1
        self._events.append(Event(self.newest, time, kind, do_id, text, count, since))

    def after(self, number: int) -> list[Event]:
        """Events with a higher number, the oldest first. An unknown number gets all."""
        if number > self.newest:
            number = 0
        found: list[Event] = []
        for event in reversed(self._events):
            if event.id <= number:
                break
            found.append(event)
        found.reverse()
        return found
