"""The timeline: every edge of the control and status words on both buses with its cause, and what went wrong.

Made of a ``Recording`` and its replay (``decoder.replay``): the replay says in which step the gateway took which frame, what
it did about it, and why not (``Reason``, the translators' own table). Edges follow each other as the words do:

    STW1 -> Controlword -> Statusword -> ZSW1
                        <-            (the next command of a sequence)

An edge without a cause is the doing of the drive, of time, or of a value. Without I/O; ``decoder.timeline_text`` prints it.
"""

from __future__ import annotations

import enum
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from pdgw.decoder.clocks import Clocks
from pdgw.decoder.fields import Document, Field, entry_field, half_fields
from pdgw.decoder.recording import AxisWords, Frame, Recording, Word, changes
from pdgw.decoder.replay import AxisReplay, Step
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.states import Command, ControlBit, State, StatusBit, next_state, state_of
from pdgw.gateway.reasons import GATEWAY_FAULTS, Reason
from pdgw.gateway.translator.positioning import MODE_CONFIRM_NS
from pdgw.gateway.transport.cyclic import Verdict
from pdgw.profidrive.frame import is_newer
from pdgw.profidrive.telegrams import Direction

SETTLE_NS: Final = 100_000_000
"""What an edge has come to is judged so long after it, or at the next edge."""
RESPONSE_NS: Final = 1_000_000_000
"""A drive that has not answered a Controlword for so long has missed it."""
_RESET = 0
"""EMCY error code "error reset or no error"."""


class WordKind(enum.Enum):
    """The four words; the first and the last are called Controlword and Statusword in telegram 100."""

    CONTROL = "STW1"
    CONTROLWORD = "Controlword"
    STATUSWORD = "Statusword"
    STATUS = "ZSW1"


_CAN_WORDS = (WordKind.CONTROLWORD.value, WordKind.STATUSWORD.value)


@dataclass
class Edge:
    """A word that changed. ``latency_ns`` counts from ``cause``.

    On edges of the PLC's control word: ``reasons`` are those the gateway had until the next edge or for 100 ms, ``outcome`` the
    one that stood at the end of that and comes last (None: it obeys), ``note`` what else became of the frame.
    """

    time_ns: int
    do_id: int
    kind: WordKind
    field: Field
    before: int
    after: int
    cause: Edge | None = None
    reasons: tuple[Reason, ...] = ()
    outcome: Reason | None = None
    note: str = ""

    @property
    def name(self) -> str:
        """The word's name; telegram 100 calls the PLC's words as the drive's are called."""
        of_plc = self.kind in {WordKind.CONTROL, WordKind.STATUS}
        return f"PLC {self.field.name}" if of_plc and self.field.name in _CAN_WORDS else self.field.name

    def follow(self, cause: Edge) -> None:
        """Take an edge for the cause of this one, even if it was taken for a consequence before.

        Recordings are not exact to the step, and no word is the cause of its own cause.
        """
        link: Edge | None = cause
        while link is not None:
            if link.cause is self:
                link.cause = None
            link = link.cause
        self.cause = cause

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
    """Another reason stands (None: the axis obeys). ``settling``: it is part of what an edge came to."""

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
            "text": self.reason.value if self.reason else "obeys the PLC",
            "settling": self.settling,
        }


class AnomalyKind(enum.Enum):
    """What can go wrong; the value is its name in the summary."""

    STALE = "stale frames"
    DROPPED = "dropped frames"
    STOPPED = "provider stop"
    COUNTER = "jumps of the cycle counter"
    WATCHDOG = "watchdog gaps"
    IOPS_BAD = "IOPS BAD"
    HANDSHAKE = "missed handshakes"
    MODE = "mode not confirmed"
    EMERGENCY = "EMCY"
    LEFT_OPERATION = "drive left operation by itself"
    GATEWAY_FAULT = "faults of the gateway"
    DIFFERENCE = "not what today's translators do"


@dataclass
class Anomaly:
    """Something that should not be; ``do_id`` 0 concerns all axes."""

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
    """What a node did besides its words: NMT, state, error reset."""

    time_ns: int
    do_id: int
    kind: str
    text: str

    def document(self) -> Document:
        return {"type": "event", "time_ns": self.time_ns, "axis": self.do_id, "kind": self.kind, "text": self.text}


Entry = Edge | ReasonChange | Anomaly | Event


@dataclass(frozen=True)
class Latency:
    """How long one hop takes, in nanoseconds; percentiles by nearest rank."""

    name: str
    count: int
    p50_ns: int
    p99_ns: int
    max_ns: int

    @classmethod
    def of(cls, name: str, values: Sequence[int]) -> Latency:
        """At least one value."""
        ordered = sorted(values)

        def rank(percent: int) -> int:
            return ordered[max(0, -(-percent * len(ordered) // 100) - 1)]

        return cls(name, len(ordered), rank(50), rank(99), ordered[-1])

    def document(self) -> Document:
        return {
            "hop": self.name,
            "count": self.count,
            "p50_ns": self.p50_ns,
            "p99_ns": self.p99_ns,
            "max_ns": self.max_ns,
        }


HOPS: Final = {
    (WordKind.CONTROL, WordKind.CONTROLWORD): "STW1 -> Controlword",
    (WordKind.CONTROLWORD, WordKind.STATUSWORD): "Controlword -> Statusword",
    (WordKind.STATUSWORD, WordKind.STATUS): "Statusword -> ZSW1",
    (WordKind.STATUSWORD, WordKind.CONTROLWORD): "Statusword -> Controlword",
    (WordKind.CONTROL, WordKind.STATUS): "STW1 -> ZSW1 (gateway)",
}
WHOLE_WAY: Final = "STW1 -> ... -> ZSW1"


@dataclass
class Timeline:
    """Entries of all axes in the order of time, on the PLC's clock."""

    clocks: Clocks
    begin_ns: int
    entries: list[Entry] = field(default_factory=list)

    def between(self, begin_ns: int | None, end_ns: int | None, do_ids: frozenset[int] = frozenset()) -> Timeline:
        """The part of these times (both included) and axes (none: all)."""
        return Timeline(
            self.clocks,
            self.begin_ns,
            [
                entry
                for entry in self.entries
                if (begin_ns is None or entry.time_ns >= begin_ns)
                and (end_ns is None or entry.time_ns <= end_ns)
                and (not do_ids or entry.do_id in do_ids or not entry.do_id)
            ],
        )

    @property
    def latencies(self) -> list[Latency]:
        """Of each hop that occurred, and of the whole way to the first answer in ZSW1."""
        values: dict[str, list[int]] = {name: [] for name in (*HOPS.values(), WHOLE_WAY)}
        answered: set[int] = set()
        for entry in self.entries:
            if not isinstance(entry, Edge) or entry.cause is None or entry.latency_ns is None:
                continue
            values[HOPS[entry.cause.kind, entry.kind]].append(entry.latency_ns)
            root = entry
            while root.cause is not None:
                root = root.cause
            if entry.kind is WordKind.STATUS and root.kind is WordKind.CONTROL and id(root) not in answered:
                answered.add(id(root))
                values[WHOLE_WAY].append(entry.time_ns - root.time_ns)
        return [Latency.of(name, items) for name, items in values.items() if items]

    @property
    def anomalies(self) -> Counter[AnomalyKind]:
        """How many of each kind."""
        return Counter(entry.kind for entry in self.entries if isinstance(entry, Anomaly))

    @property
    def refusals(self) -> Counter[Reason]:
        """How many edges came to each reason."""
        return Counter(entry.outcome for entry in self.entries if isinstance(entry, Edge) and entry.outcome is not None)

    def summary(self) -> Document:
        """Latencies and anomalies as plain data."""
        return {
            "type": "summary",
            "latencies": [item.document() for item in self.latencies],
            "outcomes": {reason.name: count for reason, count in self.refusals.items()},
            "anomalies": {kind.name.lower().replace("_", "-"): count for kind, count in self.anomalies.items()},
        }


def make_timeline(recording: Recording, replays: Sequence[AxisReplay], clocks: Clocks) -> Timeline:
    """Put everything together; ``replays`` are those of the recording's axes that have a translator."""
    timeline = Timeline(clocks, recording.begin_ns)
    entries = timeline.entries
    entries += _exchange(recording)
    for replay in replays:
        axis = _AxisTimeline(replay, recording)
        entries += axis.entries()
    entries.sort(key=lambda entry: entry.time_ns)
    return timeline


# -- the exchange with the PLC ----------------------------------------------------------------------------------------


_VERDICTS = {Verdict.STALE: AnomalyKind.STALE, Verdict.PROVIDER_STOP: AnomalyKind.STOPPED}


def _exchange(recording: Recording) -> Iterator[Anomaly]:
    """What concerns all axes: frames not used, counters, silence."""
    plc = recording.plc
    standing: Verdict | None = None
    for received, frame in zip(plc.received, recording.frames[Direction.SETPOINT], strict=True):
        verdict = received.verdict
        if verdict is Verdict.STALE or (verdict is not Verdict.ACCEPTED and verdict is not standing):
            kind = _VERDICTS.get(verdict, AnomalyKind.DROPPED)
            yield Anomaly(received.time_ns, 0, kind, f"frame with counter {frame.counter}: {verdict.value}")
        standing = verdict
    for time_ns in plc.losses:
        if time_ns > recording.end_ns:
            continue
        last = max((item.time_ns for item in plc.received if item.time_ns < time_ns), default=time_ns)
        following = next((item.time_ns for item in plc.received if item.time_ns > time_ns), None)
        how_long = "to the end" if following is None else f"for {(following - last) / 1e6:.1f} ms"
        yield Anomaly(time_ns, 0, AnomalyKind.WATCHDOG, f"no frame of the PLC {how_long}: watchdog expired")
    for direction, who in ((Direction.SETPOINT, "PLC -> gateway"), (Direction.ACTUAL, "gateway -> PLC")):
        yield from _counters(recording.frames[direction], who)


def _counters(frames: Sequence[Frame], who: str) -> Iterator[Anomaly]:
    steps = [(b.counter - a.counter) & 0xFFFF for a, b in pairwise(frames)]
    usual = Counter(steps).most_common(1)[0][0] if steps else 0
    for (before, frame), step in zip(pairwise(frames), steps, strict=True):
        if step == usual or not is_newer(frame.counter, before.counter):
            continue
        missing = step // usual - 1 if usual and step % usual == 0 else 0
        text = f"{who}: counter {before.counter} -> {frame.counter}, usual step {usual}"
        if missing > 0:
            text += f", {missing} frame{'s' if missing > 1 else ''} missing"
        yield Anomaly(frame.time_ns, 0, AnomalyKind.COUNTER, text)


# -- one axis ---------------------------------------------------------------------------------------------------------


class _AxisTimeline:
    """Edges, reasons and anomalies of one axis."""

    def __init__(self, replay: AxisReplay, recording: Recording) -> None:
        self._recorded = replay.recording
        self._words: AxisWords = recording.words[self._recorded.do_id]
        self._steps = replay.steps
        self._replay = replay
        self._cycle_ns = recording.cycle_ns
        self._end_ns = recording.end_ns
        self._tolerance = 2 * recording.cycle_ns
        telegram = self._recorded.telegram
        self._fields = {
            WordKind.CONTROL: half_fields(telegram.setpoints)[0],
            WordKind.CONTROLWORD: entry_field(DRIVE_OBJECTS.attribute("controlword")),
            WordKind.STATUSWORD: entry_field(DRIVE_OBJECTS.attribute("statusword")),
            WordKind.STATUS: half_fields(telegram.actuals)[0],
        }
        self._edges = {
            WordKind.CONTROL: self._edges_of(WordKind.CONTROL, self._words.control),
            WordKind.CONTROLWORD: self._edges_of(WordKind.CONTROLWORD, self._words.controlword),
            WordKind.STATUSWORD: self._edges_of(WordKind.STATUSWORD, self._words.statusword),
            WordKind.STATUS: self._edges_of(WordKind.STATUS, self._words.status),
        }
        self._step_times = [step.time_ns for step in self._steps]
        self._setpoint_times = [event.time_ns for event in self._recorded.setpoints]
        self._feedback_times = [event.time_ns for event in self._recorded.feedback]
        self._taken_setpoints = [step.setpoints for step in self._steps]
        self._taken_feedback = [step.feedback for step in self._steps]

    def entries(self) -> Iterator[Entry]:
        self._link()
        self._explain()
        for edges in self._edges.values():
            yield from edges
        yield from self._reasons()
        yield from self._anomalies()

    def _edges_of(self, kind: WordKind, words: Sequence[Word]) -> list[Edge]:
        item = self._fields[kind]
        return [
            Edge(word.time_ns, self._recorded.do_id, kind, item, old.value, word.value) for old, word in changes(words)
        ]

    # -- causes -------------------------------------------------------------------------------------------------------

    def _link(self) -> None:
        """Give each edge its cause, by the step of the gateway that made the one out of the other."""
        control = {self._taking(self._taken_setpoints, self._setpoint_times, edge): edge for edge in self._control}
        status = {
            self._taking(self._taken_feedback, self._feedback_times, edge): edge
            for edge in self._edges[WordKind.STATUSWORD]
        }
        control.pop(None, None)
        status.pop(None, None)
        for edge, position in self._steps_of(WordKind.CONTROLWORD, lambda step: step.controlword):
            edge.cause = control.get(position) or status.get(position)
        for edge, position in self._steps_of(WordKind.STATUS, lambda step: step.actuals[0]):
            edge.cause = status.get(position) or control.get(position)
        self._link_drive()

    @property
    def _control(self) -> list[Edge]:
        return self._edges[WordKind.CONTROL]

    @staticmethod
    def _taking(taken: Sequence[int], times: Sequence[int], edge: Edge) -> int | None:
        """The step that took the event an edge came with; None when none did."""
        event = bisect_left(times, edge.time_ns)
        if event == len(times) or times[event] != edge.time_ns:
            return None
        step = bisect_left(taken, event + 1)
        return step if step < len(taken) else None

    def _steps_of(self, kind: WordKind, value: Callable[[Step], int]) -> Iterator[tuple[Edge, int]]:
        """Each recorded edge of a word the gateway makes, with the step in which its translator changed the word."""
        edges = self._edges[kind]
        start = 0
        for position, (before, step) in enumerate(pairwise(self._steps), 1):
            if value(before) == value(step):
                continue
            due = step.time_ns if step.answer is None or kind is WordKind.CONTROLWORD else step.answer.time_ns
            while start < len(edges) and edges[start].time_ns < due - self._tolerance:
                start += 1
            found = start
            while found < len(edges) and edges[found].time_ns <= due + self._tolerance:
                if edges[found].after == value(step):
                    yield edges[found], position
                    start = found + 1
                    break
                found += 1

    def _link_drive(self) -> None:
        """Statuswords that answer a Controlword: another state where one was commanded, the acknowledge of a set-point."""
        statuswords = self._words.statusword
        times = [word.time_ns for word in statuswords]
        edges = self._edges[WordKind.STATUSWORD]
        edge_times = [edge.time_ns for edge in edges]
        commands = self._edges[WordKind.CONTROLWORD]
        self._missed: list[tuple[Edge, str]] = []
        for position, command in enumerate(commands):
            index = bisect_right(times, command.time_ns)
            if not index:
                continue
            wanted = _expectation(statuswords[index - 1].value, command)
            if wanted is None:
                continue
            until = command.time_ns + RESPONSE_NS
            if position + 1 < len(commands):
                until = min(until, commands[position + 1].time_ns)
            first = bisect_right(edge_times, command.time_ns)
            answer = next((e for e in edges[first:] if e.time_ns <= until and (e.before ^ e.after) & wanted), None)
            if answer is not None and answer.cause is None:
                answer.follow(command)
            elif answer is None and until - command.time_ns >= RESPONSE_NS and until <= self._end_ns:
                self._missed.append((command, self._fields[WordKind.STATUSWORD].text(statuswords[index - 1].value)))

    # -- reasons ------------------------------------------------------------------------------------------------------

    def _explain(self) -> None:
        """What each edge of the PLC came to."""
        self._settling: list[tuple[int, int]] = []
        for position, edge in enumerate(self._control):
            first = self._taking(self._taken_setpoints, self._setpoint_times, edge)
            edge.note = self._dropped(edge)
            if first is None or edge.note:
                continue
            until = edge.time_ns + SETTLE_NS
            if position + 1 < len(self._control):
                until = min(until, self._control[position + 1].time_ns - 1)
            last = max(first + 1, bisect_right(self._step_times, until))
            steps = self._steps[first:last]
            edge.outcome = steps[-1].reason
            passed = dict.fromkeys(step.reason for step in steps if step.reason not in {None, edge.outcome})
            edge.reasons = tuple(reason for reason in (*passed, edge.outcome) if reason is not None)
            self._settling.append((first, last))

    def _dropped(self, edge: Edge) -> str:
        """Why no step took an edge."""
        position = bisect_right(self._setpoint_times, edge.time_ns)
        values = self._recorded.setpoints[position - 1].values if position else None
        if values is None:
            return "not evaluated: no valid frame (stale, stopped, or IOPS BAD)"
        return "" if values[0] == edge.after else "not evaluated: the frame was dropped or overtaken"

    def _reasons(self) -> Iterator[ReasonChange]:
        before: Step | None = None
        ranges = iter(self._settling)
        settling = next(ranges, None)
        for position, step in enumerate(self._steps):
            while settling is not None and position >= settling[1]:
                settling = next(ranges, None)
            if before is None or step.reason is not before.reason:
                inside = settling is not None and settling[0] <= position
                yield ReasonChange(step.time_ns, self._recorded.do_id, step.reason, inside)
            before = step

    # -- anomalies ----------------------------------------------------------------------------------------------------

    def _anomalies(self) -> Iterator[Anomaly | Event]:
        do_id = self._recorded.do_id
        for begin, end, who in self._words.iops_bad:
            text = f"data {who} bad for {(end - begin) / 1e6:.1f} ms"
            yield Anomaly(begin, do_id, AnomalyKind.IOPS_BAD, text)
        for command, status in self._missed:
            text = f"{command.field.text(command.after)}: no answer of the drive within 1 s, {status}"
            yield Anomaly(command.time_ns, do_id, AnomalyKind.HANDSHAKE, text)
        for edge in self._edges[WordKind.STATUSWORD]:
            if state_of(edge.before) is State.OPERATION_ENABLED and edge.cause is None:
                yield from self._left_operation(edge)
        yield from self._modes()
        for note in self._words.notes:
            if note.kind == "EMCY" and not note.text.partition(": ")[2].startswith(f"{_RESET:04X}h"):
                yield Anomaly(note.time_ns, do_id, AnomalyKind.EMERGENCY, note.text)
            else:
                yield Event(note.time_ns, do_id, note.kind, note.text)
        for step in self._steps:
            for event in step.events:
                text = f"{event.number} {GATEWAY_FAULTS[event.number].name}: {event.detail}"
                yield Anomaly(step.time_ns, do_id, AnomalyKind.GATEWAY_FAULT, text)
        for difference in self._replay.differences:
            text = f"{difference.what} differ in {', '.join(difference.names)}" if difference.names else difference.note
            yield Anomaly(difference.time_ns, do_id, AnomalyKind.DIFFERENCE, text)

    def _left_operation(self, edge: Edge) -> Iterator[Anomaly]:
        state = state_of(edge.after)
        commands = self._words.controlword
        index = bisect_right([word.time_ns for word in commands], edge.time_ns)
        commanded = index > 0 and Command.ENABLE_OPERATION.matches(commands[index - 1].value)
        if commanded and state not in {State.OPERATION_ENABLED, State.FAULT, State.FAULT_REACTION_ACTIVE}:
            text = f"{edge.field.text(edge.after)} while Enable Operation was commanded"
            yield Anomaly(edge.time_ns, self._recorded.do_id, AnomalyKind.LEFT_OPERATION, text)

    def _modes(self) -> Iterator[Anomaly]:
        """6060h that 6061h does not show within the translators' time."""
        modes, shown = self._words.mode, self._words.mode_display
        asked = [word for i, word in enumerate(modes) if not i or modes[i - 1].value != word.value]
        times = [word.time_ns for word in shown]
        for position, word in enumerate(asked):
            following = asked[position + 1].time_ns if position + 1 < len(asked) else self._end_ns
            deadline = word.time_ns + MODE_CONFIRM_NS
            if not word.value or deadline > following or not shown:
                continue
            standing = shown[max(0, bisect_right(times, word.time_ns) - 1) : bisect_right(times, deadline)]
            if all(item.value != word.value for item in standing):
                last = standing[-1].value if standing else 0
                text = f"6060h = {word.value}, 6061h = {last} for 1 s"
                yield Anomaly(word.time_ns, self._recorded.do_id, AnomalyKind.MODE, text)


_STATE_BITS = 0x6F


def _expectation(statusword: int, command: Edge) -> int | None:
    """Statusword bits of which one has to change for a Controlword; None when the drive has nothing to answer."""
    state = state_of(statusword)
    if state is not None and next_state(state, command.after, command.before) is not state:
        return _STATE_BITS
    raised = command.after & ~command.before & ControlBit.NEW_SETPOINT
    lowered = command.before & ~command.after & ControlBit.NEW_SETPOINT
    acknowledged = bool(statusword & StatusBit.MODE_12)
    if state is State.OPERATION_ENABLED and ((raised and not acknowledged) or (lowered and acknowledged)):
        return StatusBit.MODE_12
    return None
