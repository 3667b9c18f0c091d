"""What happened, in the user's words: faults, warnings, reasons, connections. Found by comparing one status with the next.

Faults carry an id and their own time, so that none is missed between two looks; of the others the change counts that was seen.
Numbers of events rise also over restarts of the web process (they begin at its start in milliseconds), so that a browser can
resume.
"""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import islice

from pdgw.tools.web.status.feed import Document

KEPT = 1000
REPEATS_AMONG = 200
"""Number of newest events in which a repeated one is found."""
_SINCE = re.compile(r", since \d\d:\d\d:\d\d")
"""The time in a sentence; the event has its own."""


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
    """The last thousand; ``first_id`` is above every number of an earlier process."""

    def __init__(self, first_id: int) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._next = first_id

    def add(self, time: str, kind: str, do_id: int | None, text: str) -> None:
        """Number it and keep it. What repeats takes the place of the older line, with a count."""
        text = _SINCE.sub("", text)
        count, since = 1, time
        for known in islice(reversed(self._events), REPEATS_AMONG):
            if (known.kind, known.do_id, known.text) == (kind, do_id, text):
                count, since = known.count + 1, known.since
                self._events.remove(known)
                break
        self._events.append(Event(self._next, time, kind, do_id, text, count, since))
        self._next += 1

    def after(self, number: int) -> list[Event]:
        """Events with a higher number, the oldest first. An unknown number gets all."""
        if number >= self._next:
            number = 0
        found: list[Event] = []
        for event in reversed(self._events):
            if event.id <= number:
                break
            found.append(event)
        found.reverse()
        return found

    def add_fault(self, do_id: int, fault: Document) -> None:
        """A fault or warning as in the status, with its time."""
        kind = "warning" if fault["is_warning"] else "fault"
        self.add(fault["time"], kind, do_id, f"{kind} {fault['number']}: {fault['text']}")

    def take(self, before: Document | None, document: Document) -> None:
        """Enter the changes since the last status; without one, the present state."""
        time = document["time"]
        if before is not None and document["uptime_s"] < before["uptime_s"]:
            before = None
            self.add(time, "gateway", None, f"gateway started again, version {document['version']}")
        for kind, do_id, text in _changes(before, document):
            self.add(time, kind, do_id, text)


def _objects(document: Document) -> Iterable[Document]:
    return (*document["axes"], *document["encoders"])


def changed_faults(before: Document | None, document: Document) -> Iterator[tuple[int, int]]:
    """Drive objects whose faults differ from the status before: DO-ID, and the id of the last known fault.

    A status has only the newest fault of each, and whether it is active; the history has all of them.
    """
    same_life = before is not None and document["uptime_s"] >= before["uptime_s"]
    known = {item["do_id"]: item for item in _objects(before)} if before is not None and same_life else {}
    for item in _objects(document):
        old = known.get(item["do_id"])
        last = 0 if old is None else _newest(old)
        # The acknowledgement of an older one is visible in the later state of the object.
        if _newest(item) and (old is None or any(old[key] != item[key] for key in ("state_id", "reason_id"))):
            yield item["do_id"], last
        elif old is not None and _fault_states(old) != _fault_states(item):
            yield item["do_id"], last


def _newest(item: Document) -> int:
    """Id of the newest fault; 0 for none."""
    return max((fault["id"] for fault in item["faults"]), default=0)


def _fault_states(item: Document) -> list[tuple[int, bool]]:
    return [(fault["id"], fault["active"]) for fault in item["faults"]]


def _changes(before: Document | None, document: Document) -> Iterator[tuple[str, int | None, str]]:
    plc = _plc_text(document["plc"])
    if before is None or _plc_text(before["plc"]) != plc:
        yield "plc", None, plc
    buses = {} if before is None else {bus["name"]: bus["healthy"] for bus in before["buses"]}
    for bus in document["buses"]:
        if buses.get(bus["name"]) != bus["healthy"]:
            yield "bus", None, f"bus {bus['name']}: {'healthy' if bus['healthy'] else 'LOST'}"
    known = {} if before is None else {item["do_id"]: item for item in _objects(before)}
    for item in _objects(document):
        do_id, old = item["do_id"], known.get(item["do_id"], {})
        if old.get("drive") != item["drive"]:
            yield "node", do_id, f"node {item['node_id']}: {item['drive']}"
        if old.get("state_id") != item["state_id"] or old.get("reason_id") != item["reason_id"]:
            yield "reason", do_id, item["sentence"]


def _plc_text(plc: Document) -> str:
    peer = "" if not plc["peer"] else f" ({':'.join(map(str, plc['peer']))})"
    return f"PLC {'connected' if plc['connected'] else 'not connected'}{peer}"
