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

from pdgw.gateway.base.reasons import AxisState, Reason
from pdgw.tools.decoder.frames.fields import Document, Field
from pdgw.tools.decoder.frames.records import CyclicRecord, Record


class WordKind(enum.Enum):
    """The four words; the first and the last are called Controlword and Statusword in telegram 100."""

    CONTROL = "STW1"
    CONTROLWORD = "Controlword"
    STATUSWORD = "Statusword"
    STATUS = "ZSW1"

    __hash__ = object.__hash__  # members are single objects, and used as keys for every frame

    @property
    def on_can(self) -> bool:
        """Whether the word is in a PDO."""
        return self in {WordKind.CONTROLWORD, WordKind.STATUSWORD}


_ON: Final = 0b111
"""Bits of a control word without which it commands a stop or OFF."""
_OFF: Final = {AxisState.OFF, AxisState.STOPPING}
_RESOLUTION: Final = -3
"""Decimal place to which latencies are rounded: 1 us."""


@dataclass
class Edge:
    """A word that changed. ``latency_ns`` counts from ``cause``.

    On an edge of the PLC's control word, ``outcome`` is the reason that the gateway decided in the step with this word, or in the
    one in which the drive had started (None: the drive follows), ``result`` its text; empty where the recording has none.
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
    outcome: Reason | None = None
    result: str = ""
    origin: Edge | None = None
    """The edge of the PLC that led to it, once the edge is out."""
    answered: bool = False
    """Whether a ZSW1 that it led to was sent."""

    @property
    def name(self) -> str:
        """Name of the word; in telegram 100, the PLC's words have the names of the drive's words."""
        is_transparent = not self.kind.on_can and self.field.name in {"Controlword", "Statusword"}
        return f"PLC {self.field.name}" if is_transparent else self.field.name

    @property
    def text(self) -> str:
        """The word after the edge."""
        return self.field.text(self.after)

    @property
    def latency_ns(self) -> int | None:
        return None if self.cause is None else self.time_ns - self.cause.time_ns

    @property
    def refusal(self) -> Reason | None:
        """Why the command had no effect. The reason of a drive that an OFF has stopped is its effect."""
        is_effect = self.outcome is not None and self.outcome.state in _OFF and self.after & _ON != _ON
        return None if is_effect else self.outcome

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
            document |= {"outcome": self.outcome.name if self.outcome else None, "outcome_text": self.result}
        return document


@dataclass
class Event:
    """An event besides the words: NMT, state, error reset, relationship. ``do_id`` 0 concerns all axes."""

    time_ns: int
    do_id: int
    kind: str
    text: str

    def document(self) -> Document:
        return {"type": "event", "time_ns": self.time_ns, "axis": self.do_id, "kind": self.kind, "text": self.text}


class AnomalyKind(enum.StrEnum):
    """Kinds of anomalies; the value is the name in the summary."""

    STALE = "stale frames"
    DROPPED = "dropped frames"
    STOPPED = "provider stop"
    COUNTER = "jumps of the cycle counter"
    WATCHDOG = "watchdog gaps"
    IOPS_BAD = "IOPS BAD"
    HANDSHAKE = "missed handshakes"
    EMERGENCY = "EMCY"
    LEFT_OPERATION = "drive left operation by itself"
    GATEWAY_FAULT = "faults of the gateway"

    @property
    def identifier(self) -> str:
        """The name in documents."""
        return self.name.lower().replace("_", "-")


@dataclass
class Anomaly(Event):
    """An event that should not happen."""

    kind: AnomalyKind

    def document(self) -> Document:
        return super().document() | {"type": "anomaly", "kind": self.kind.identifier}


@dataclass
class ReasonChange(Event):
    """A new reason (None: the axis follows the PLC). ``settling``: it is part of the result of an edge."""

    reason: Reason | None
    settling: bool

    def document(self) -> Document:
        name = self.reason.name if self.reason else None
        return super().document() | {"type": "reason", "reason": name, "settling": self.settling}


Entry = Edge | Event


class Latency:
    """Latencies of one hop, rounded to 1 us. Percentiles are those of the nearest rank."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def add(self, value_ns: int) -> None:
        """One more."""
        self._counts[round(value_ns, _RESOLUTION)] += 1

    @property
    def count(self) -> int:
        return self._counts.total()

    def rank(self, percent: int) -> int:
        """The value in nanoseconds that this percentage of them does not exceed."""
        below = 0
        for value in sorted(self._counts):
            below += self._counts[value]
            if 100 * below >= percent * self.count:
                break
        return value

    def document(self) -> Document:
        return {"count": self.count, "p50_ns": self.rank(50), "p99_ns": self.rank(99), "max_ns": self.rank(100)}


FULL_PATH: Final = "STW1 -> ... -> ZSW1"


class Summary:
    """Summary of a timeline or a part of it. It gets entries and packets in order of time. ``age_limit_ns``: of the PLC's
    frames, None where no frame is late."""

    def __init__(self, age_limit_ns: int | None = None) -> None:
        self.age_limit_ns = age_limit_ns
        self.ages = Latency()
        """From the gateway's frame to that frame of the PLC that returns its tick."""
        self.anomalies: Counter[AnomalyKind] = Counter()
        """Number of anomalies of each kind."""
        self.refusals: Counter[Reason] = Counter()
        """Number of commands without effect by their reason."""
        self.latencies: dict[str, Latency] = {}
        """Of each hop, and from the PLC's edge to the first answer in ZSW1."""

    def add(self, entry: Entry | Record) -> None:
        """One more."""
        if isinstance(entry, CyclicRecord):
            if entry.age_ns is not None:
                self.ages.add(entry.age_ns)
        elif isinstance(entry, Anomaly):
            self.anomalies[entry.kind] += 1
        elif isinstance(entry, Edge):
            if entry.refusal is not None:
                self.refusals[entry.refusal] += 1
            if entry.cause is not None:
                self._measure(f"{entry.cause.kind.value} -> {entry.kind.value}", entry, entry.cause)
            origin = entry.origin
            if entry.kind is WordKind.STATUS and origin is not None and not origin.answered:
                origin.answered = True
                self._measure(FULL_PATH, entry, origin)

    def _measure(self, hop: str, entry: Edge, since: Edge) -> None:
        self.latencies.setdefault(hop, Latency()).add(entry.time_ns - since.time_ns)

    def document(self) -> Document:
        """Latencies and anomalies as plain data."""
        return {
            "type": "summary",
            "latencies": [{"hop": hop} | item.document() for hop, item in self.latencies.items()],
            "age": self.ages.document() | {"limit_ns": self.age_limit_ns} if self.ages.count else None,
            "outcomes": {reason.name: count for reason, count in self.refusals.items()},
            "anomalies": {kind.identifier: count for kind, count in self.anomalies.items()},
        }
