"""What a timeline is made of: edges of the control and status words on both buses, reasons, anomalies; and their summary.

``decoder.timeline.builder`` makes the entries of a stream of records, ``decoder.timeline.text`` prints them. Edges follow each
other as the words do:

    STW1 -> Controlword -> Statusword -> ZSW1
                        <-            (the next command of a sequence)

An edge without a cause is the doing of the drive, of time, or of a value. Without I/O.
"""

from __future__ import annotations

import dataclasses
import enum
from collections import Counter
from dataclasses import dataclass
from typing import Final

from pdgw.decoder.frames.fields import Document, Field
from pdgw.gateway.reasons import Reason


class WordKind(enum.Enum):
    """The four words; the first and the last are called Controlword and Statusword in telegram 100."""

    CONTROL = "STW1"
    CONTROLWORD = "Controlword"
    STATUSWORD = "Statusword"
    STATUS = "ZSW1"

    __hash__ = object.__hash__  # members are single objects, and used as keys for every frame


_DIGITS: Final = 3
_CAN_WORDS = (WordKind.CONTROLWORD.value, WordKind.STATUSWORD.value)


@dataclass
class Edge:
    """A word that changed. ``latency_ns`` counts from ``cause``.

    On edges of the PLC's control word: ``decided`` are the reasons of the gateway until the next edge or for 100 ms (1 s while
    the drive has not started), ``outcome`` the last one (None: the drive follows), ``note`` another result of the frame.
    """

    time_ns: int
    do_id: int
    kind: WordKind
    field: Field
    before: int
    after: int
    cause: Edge | None = None
    effects: set[WordKind] = dataclasses.field(default_factory=set)
    """Kinds of words that it has caused."""
    decided: dict[Reason | None, None] = dataclasses.field(default_factory=dict)
    """Each reason once; empty: the recording does not have them."""
    outcome: Reason | None = None
    note: str = ""
    root: Edge | None = None
    """The first cause of all, once the edge is out."""
    answered: bool = False
    """Whether a ZSW1 caused by this edge was sent."""

    def decide(self, reason: Reason | None) -> None:
        """The gateway has this reason now."""
        self.decided[reason] = None
        self.outcome = reason

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """All reasons, the outcome last."""
        found = [*(reason for reason in self.decided if reason is not self.outcome), self.outcome]
        return tuple(reason for reason in found if reason is not None)

    @property
    def name(self) -> str:
        """Name of the word; in telegram 100, the PLC's words have the names of the drive's words."""
        of_plc = self.kind in {WordKind.CONTROL, WordKind.STATUS}
        return f"PLC {self.field.name}" if of_plc and self.field.name in _CAN_WORDS else self.field.name

    @property
    def latency_ns(self) -> int | None:
        return None if self.cause is None else self.time_ns - self.cause.time_ns

    @property
    def bits(self) -> tuple[list[str], list[str]]:
        """Names of the bits that were set and cleared."""
        changed = [bit for bit in self.field.bits if (self.before ^ self.after) & bit.mask]
        return [bit.name for bit in changed if self.after & bit.mask], [
            bit.name for bit in changed if not self.after & bit.mask
        ]

    def document(self) -> Document:
        raised, lowered = self.bits
        document: Document = {
            "type": "edge",
            "time_ns": self.time_ns,
            "axis": self.do_id,
            "word": self.name,
            "before": self.before,
            "after": self.after,
            "set": raised,
            "cleared": lowered,
            "text": self.field.explain(self.after) if self.field.explain else "",
            "cause": self.cause.name if self.cause else None,
            "cause_time_ns": self.cause.time_ns if self.cause else None,
            "latency_ns": self.latency_ns,
        }
        if self.kind is WordKind.CONTROL:
            document["reasons"] = [reason.name for reason in self.reasons]
            document["outcome"] = self.outcome.name if self.outcome else None
            document["outcome_text"] = self.outcome.value if self.outcome else ""
            document["note"] = self.note
        return document


@dataclass
class ReasonChange:
    """A new reason (None: the axis follows the PLC). ``settling``: it is part of the result of an edge."""

    time_ns: int
    do_id: int
    reason: Reason | None
    settling: bool = False

    def document(self) -> Document:
        return {
            "type": "reason",
            "time_ns": self.time_ns,
            "axis": self.do_id,
            "reason": self.reason.name if self.reason else None,
            "text": self.reason.value if self.reason else "in operation",
            "settling": self.settling,
        }


class AnomalyKind(enum.Enum):
    """Kinds of anomalies; the value is the name in the summary."""

    STALE = "stale frames"
    DROPPED = "dropped frames"
    STOPPED = "provider stop"
    COUNTER = "jumps of the cycle counter"
    WATCHDOG = "watchdog gaps"
    IOPS_BAD = "IOPS BAD"
    HANDSHAKE = "missed handshakes"
    MODE = "mode of operation not confirmed"
    EMERGENCY = "EMCY"
    LEFT_OPERATION = "drive left operation by itself"
    GATEWAY_FAULT = "faults of the gateway"


@dataclass
class Anomaly:
    """An anomaly; ``do_id`` 0 concerns all axes."""

    time_ns: int
    do_id: int
    kind: AnomalyKind
    text: str

    def document(self) -> Document:
        return {
            "type": "anomaly",
            "time_ns": self.time_ns,
            "axis": self.do_id,
            "kind": self.kind.name.lower().replace("_", "-"),
            "text": self.text,
        }


@dataclass
class Event:
    """An event of a node besides its words: NMT, state, error reset."""

    time_ns: int
    do_id: int
    kind: str
    text: str

    def document(self) -> Document:
        return {"type": "event", "time_ns": self.time_ns, "axis": self.do_id, "kind": self.kind, "text": self.text}


Entry = Edge | ReasonChange | Anomaly | Event


class Latency:
    """Latencies of one hop in nanoseconds, to three digits each: as many as there are different ones, not as many as edges.

    Percentiles are those of the nearest rank.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = self.max_ns = 0
        self._counts: Counter[int] = Counter()

    def add(self, value_ns: int) -> None:
        """One more."""
        digits = len(str(abs(value_ns))) - _DIGITS
        self._counts[round(value_ns, -digits) if digits > 0 else value_ns] += 1
        self.max_ns = max(self.max_ns, value_ns) if self.count else value_ns
        self.count += 1

    def rank(self, percent: int) -> int:
        """The value that this percentage of them does not exceed."""
        below = 0
        for value in sorted(self._counts):
            below += self._counts[value]
            if 100 * below >= percent * self.count:
                break
        return min(value, self.max_ns)

    def document(self) -> Document:
        return {
            "hop": self.name,
            "count": self.count,
            "p50_ns": self.rank(50),
            "p99_ns": self.rank(99),
            "max_ns": self.max_ns,
        }


HOPS: Final = {
    (WordKind.CONTROL, WordKind.CONTROLWORD): "STW1 -> Controlword",
    (WordKind.CONTROLWORD, WordKind.STATUSWORD): "Controlword -> Statusword",
    (WordKind.STATUSWORD, WordKind.STATUS): "Statusword -> ZSW1",
    (WordKind.STATUSWORD, WordKind.CONTROLWORD): "Statusword -> Controlword",
    (WordKind.CONTROL, WordKind.STATUS): "STW1 -> ZSW1 (gateway)",
}
FULL_PATH: Final = "STW1 -> ... -> ZSW1"


class Summary:
    """Summary of a timeline or a part of it. It gets the entries in order of time."""

    def __init__(self) -> None:
        self.anomalies: Counter[AnomalyKind] = Counter()
        """Number of anomalies of each kind."""
        self.refusals: Counter[Reason] = Counter()
        """Number of edges with each reason."""
        self._hops = {name: Latency(name) for name in (*HOPS.values(), FULL_PATH)}

    def add(self, entry: Entry) -> None:
        """One more entry."""
        if isinstance(entry, Anomaly):
            self.anomalies[entry.kind] += 1
        elif isinstance(entry, Edge):
            if entry.outcome is not None:
                self.refusals[entry.outcome] += 1
            if entry.cause is not None:
                self._hops[HOPS[entry.cause.kind, entry.kind]].add(entry.time_ns - entry.cause.time_ns)
                self._measure_path(entry)

    def _measure_path(self, entry: Edge) -> None:
        """Measure the time from an edge of the PLC to the first ZSW1 that it causes."""
        root = entry.root
        if entry.kind is WordKind.STATUS and root is not None and root.kind is WordKind.CONTROL and not root.answered:
            root.answered = True
            self._hops[FULL_PATH].add(entry.time_ns - root.time_ns)

    @property
    def latencies(self) -> list[Latency]:
        """Latencies of each hop, and from the PLC's edge to the first answer in ZSW1."""
        return [item for item in self._hops.values() if item.count]

    def document(self) -> Document:
        """Latencies and anomalies as plain data."""
        return {
            "type": "summary",
            "latencies": [item.document() for item in self.latencies],
            "outcomes": {reason.name: count for reason, count in self.refusals.items()},
            "anomalies": {kind.name.lower().replace("_", "-"): count for kind, count in self.anomalies.items()},
        }
