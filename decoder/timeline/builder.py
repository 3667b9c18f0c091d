"""A timeline from the records of both buses as they arrive: entries in the order of time, in constant memory.

Edges, latencies and anomalies are from the frames. A recording of the gateway also has its steps: reasons, faults and results
are those that it decided then. An entry is delayed until it is complete (``HOLD_NS`` of recorded time). Without I/O; one clock.

    >>> builder = TimelineBuilder(axes, cycle_ns=4_000_000)
    >>> for record in records:
    ...     entries = builder.add(record)
    >>> entries = builder.finish()
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from pdgw.decoder.frames.canopen.records import CanRecord, EmcyRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.profinet.records import AlarmRecord, Change, RelationRecord
from pdgw.decoder.frames.records import AcyclicRecord, CyclicRecord, Record, StepRecord
from pdgw.decoder.timeline.drive_object import RESPONSE_NS, ObjectFollower
from pdgw.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Event, WordKind
from pdgw.ds301.pdo import PdoDirection
from pdgw.durations import MS
from pdgw.gateway.configuration.tables.defaults import WATCHDOG_FACTOR
from pdgw.gateway.trace.reader import Cycle, Parser
from pdgw.profidrive.frame import (
    COUNTER_UNIT_NS,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_PRIMARY,
    STATUS_RUN,
    is_newer,
)
from pdgw.profidrive.telegrams import Direction

HOLD_NS: Final = RESPONSE_NS + 100 * MS
"""Longer than anything an entry waits for."""
_TICK_NS: Final = 10 * MS
_UNUSED: Final = 8
"""Number of consecutive answers without use of the PLC's frames that cannot be a crossing of frames and answers."""
_JUDGED: Final = 16
"""Steps of the cycle counter after which its increment is known."""
_COUNTER_CYCLES: Final = 10
"""Tolerance in cycles of a counter that is a clock: a recorder and a busy sender wait."""
_NOTHING: Final[tuple[Entry, ...]] = ()
NO_STEPS: Final = "no steps of the gateway: a capture of another recorder has no reasons and no refusals"


class TimelineBuilder:
    """Both buses of one gateway. ``axes``: in the order of the frame, with their node-IDs. ``watchdog_factor``: the gateway's,
    None if unknown. ``uncertainty_ns``: of the clocks of both buses."""

    def __init__(
        self, axes: Sequence[Axis], *, cycle_ns: int, watchdog_factor: int | None = None, uncertainty_ns: int = 0
    ) -> None:
        self.horizon_ns: int | None = None
        """All entries up to this time have been given out."""
        self._heap: list[tuple[int, int, Entry]] = []
        self._count = 0
        self._due = 0
        self._objects = [ObjectFollower(axis, self._put, cycle_ns, uncertainty_ns) for axis in axes]
        self._by_do = {item.axis.do_id: item for item in self._objects}
        self._nodes: dict[int, list[ObjectFollower]] = {}
        for item in self._objects:
            self._nodes.setdefault(item.axis.node, []).append(item)
        self._exchange = _Exchange(self._objects, self._put, cycle_ns, watchdog_factor)
        self._steps = Parser("the recording")
        self._can_seen = False
        self._last_ns = 0

    def add(self, record: Record) -> Sequence[Entry]:
        """Add a record, roughly in order of time. Return the entries that are complete now."""
        now = self._last_ns = record.time_ns
        if isinstance(record, CanRecord):
            self._can_seen = True
            to_all = isinstance(record, NmtRecord) and not record.node
            for item in self._objects if to_all else self._nodes.get(record.node, ()):
                if item.axis.bus in {"", record.channel}:
                    item.has_frames |= _is_from_node(record)
                    item.take(record)
        elif isinstance(record, StepRecord):
            for step in self._steps.feed(record.data):
                if isinstance(step, Cycle):
                    self._step(step)
        elif isinstance(record, CyclicRecord):
            self._exchange.take(record)
        elif isinstance(record, RelationRecord):
            self._exchange.relate(record)
        elif isinstance(record, AlarmRecord):
            self._alarm(record)
        elif isinstance(record, AcyclicRecord) and not self._objects:
            self._put(Event(now, 0, "PLC", record.summary))
        if now < self._due:
            return _NOTHING
        self._due = now + _TICK_NS
        self._exchange.watch(now)
        for item in self._objects:
            item.tick(now)
        self.horizon_ns = now - HOLD_NS
        return self._release(self.horizon_ns)

    def _step(self, cycle: Cycle) -> None:
        description = self._steps.description
        assert description is not None
        for traced, step in zip(description.objects, cycle.steps, strict=True):
            item = self._by_do.get(traced.do_id)
            if item is not None:
                item.step(cycle.wall_ns, step, traced, description.reasons)

    def _alarm(self, record: AlarmRecord) -> None:
        if record.ended is not None:
            self._put(Event(record.time_ns, 0, "PLC", f"relationship {Change.ENDED.value}"))
            self._exchange.end()
        if record.is_notification:
            do_id = next(
                (item.axis.do_id for n, item in enumerate(self._objects, 1) if _slot(item, n) == record.slot), 0
            )
            self._put(Event(record.time_ns, do_id, "PLC", record.text))

    def finish(self) -> Sequence[Entry]:
        """The rest, at the end of the recording."""
        for do_id, text in self._missing():
            self._put(Event(self._last_ns, do_id, "missing", text))
        return self._release(None)

    def _missing(self) -> Iterator[tuple[int, str]]:
        """Missing data by DO-ID (0: of all)."""
        if self._objects and self._steps.description is None:
            yield 0, NO_STEPS
        if Direction.SETPOINT not in self._exchange.seen:
            yield 0, "no frame from a PLC: the recording does not show what the PLC commanded"
        if Direction.ACTUAL not in self._exchange.seen:
            yield 0, "no frame to a PLC: the recording does not show what the gateway reported to the PLC"
        if not self._can_seen:
            yield 0, "no CAN frame: the recording shows neither the commands to the drives nor their answers"
            return
        for item in self._objects:
            if not item.has_frames:
                yield item.axis.do_id, f"no frame from node {item.axis.node}"

    def _put(self, entry: Entry) -> None:
        self._count += 1
        heapq.heappush(self._heap, (entry.time_ns, self._count, entry))

    def _release(self, until: int | None) -> Sequence[Entry]:
        heap = self._heap
        released = []
        while heap and (until is None or heap[0][0] <= until):
            entry = heapq.heappop(heap)[2]
            if isinstance(entry, Edge) and entry.cause is not None:
                entry.root = entry.cause.root or entry.cause
            released.append(entry)
        return released


def _is_from_node(record: CanRecord) -> bool:
    """Whether a frame that belongs to a node was sent by it."""
    if isinstance(record, PdoRecord):
        return record.layout.name.startswith(PdoDirection.TPDO.label)
    return isinstance(record, HeartbeatRecord | EmcyRecord) or (
        isinstance(record, SdoRecord) and not record.from_client
    )


def _slot(item: ObjectFollower, place: int) -> int:
    """The PROFINET slot of a drive object."""
    return item.axis.slot or place


class _CycleCounter:
    """The cycle counter of one direction: it makes the same step with each frame, or it is a clock in units of 31.25 us."""

    def __init__(self, who: str, cycle_ns: int) -> None:
        self._who = who
        self._tolerance = _COUNTER_CYCLES * cycle_ns
        self._last: int | None = None
        self._last_ns = 0
        self._steps: Counter[int] = Counter()
        self._usual = 0
        self._count = 0
        self._clock = False
        """A step was not a multiple of the usual one and matched the time that had passed."""

    def restart(self) -> None:
        """A new relationship counts from anywhere."""
        self._last = None

    def found(self, counter: int, now: int) -> tuple[AnomalyKind, str] | None:
        """The anomaly of the next frame's counter, if any."""
        last, self._last = self._last, counter
        elapsed, self._last_ns = now - self._last_ns, now
        if last is None:
            return None
        if not is_newer(counter, last):
            self._last = last
            return AnomalyKind.STALE, f"{self._who}: counter {counter} after {last}"
        step = (counter - last) & 0xFFFF
        self._steps[step] += 1
        self._count += 1
        if self._steps[step] > self._steps[self._usual]:
            self._usual = step
        usual = self._usual
        if step == usual or self._count < _JUDGED:
            return None
        text = f"{self._who}: counter {last} -> {counter}"
        claimed_ns = step * COUNTER_UNIT_NS
        agrees = abs(claimed_ns - elapsed % (COUNTER_UNIT_NS << 16)) <= self._tolerance
        self._clock |= agrees and step % usual != 0
        if self._clock or 2 * self._steps[usual] <= self._count:
            if agrees:
                return None
            return AnomalyKind.COUNTER, f"{text} claims {claimed_ns / MS:.1f} ms, but {elapsed / MS:.1f} ms have passed"
        text += f", usual step {usual}"
        missing = step // usual - 1 if step % usual == 0 else 0
        more = f", {missing} frame{'s' if missing > 1 else ''} missing" if missing > 0 else ""
        return AnomalyKind.COUNTER, text + more


class _Exchange:
    """The frames from and to the PLC."""

    def __init__(
        self, objects: Sequence[ObjectFollower], put: Callable[[Entry], None], cycle_ns: int, factor: int | None
    ) -> None:
        self._objects = {item.axis.do_id: item for item in objects}
        self._put = put
        self._watchdog_ns = (factor or WATCHDOG_FACTOR) * cycle_ns
        self._known = "" if factor else " (if the watchdog has its default)"
        self._counters = {
            Direction.SETPOINT: _CycleCounter("PLC -> gateway", cycle_ns),
            Direction.ACTUAL: _CycleCounter("gateway -> PLC", cycle_ns),
        }
        self.seen: set[Direction] = set()
        """Directions of the frames seen until now."""
        self._last_ns: int | None = None
        """The last frame of the PLC; None: it is not expected to send."""
        self._is_lost = False
        self._problem = ""
        self._unused = 0

    def relate(self, record: RelationRecord) -> None:
        """A PROFINET relationship comes or goes."""
        change, connection = record.change, record.connection
        if change in {Change.REQUESTED, Change.GRANTED}:
            for counter in self._counters.values():
                counter.restart()
        if change is Change.REQUESTED:
            return  # the answer names the station
        who = " and ".join(name for name in (connection.controller, connection.station) if name)
        self._put(Event(record.time_ns, 0, "PLC", f"relationship of {who} {change.value}"))
        if change in {Change.ENDED, Change.PAUSED}:
            self.end()

    def end(self) -> None:
        """No frame of the PLC is expected."""
        self._last_ns, self._is_lost = None, False

    def take(self, record: CyclicRecord) -> None:
        """A cyclic frame of either direction."""
        direction, now = record.direction, record.time_ns
        if direction is None:
            return
        self.seen.add(direction)
        found = self._counters[direction].found(record.cycle_counter, now)
        if found is not None:
            self._put(Anomaly(now, 0, *found))
        if direction is Direction.SETPOINT:
            self._frame(record)
        else:
            self._answer(record)
        for do_id, _, unit, first, iops, _ in record.layout.axes:
            item = self._objects.get(do_id)
            if item is not None and unit.telegram == item.axis.telegram:
                item.quality(now, direction, good=bool(record.values[iops] & IOPS_GOOD))
                kind = WordKind.CONTROL if direction is Direction.SETPOINT else WordKind.STATUS
                item.word(kind, now, record.values[first])

    def _frame(self, record: CyclicRecord) -> None:
        now, status = record.time_ns, record.data_status
        self.watch(now)
        if self._is_lost and self._last_ns is not None:
            silence = (now - self._last_ns) / MS
            self._put(Event(now, 0, "PLC", f"frames are back after {silence:.1f} ms"))
            self._is_lost = False
        self._last_ns = now
        usable = status & STATUS_DATA_VALID and status & STATUS_PRIMARY
        problem = (
            "" if usable and status & STATUS_RUN else "provider in STOP" if usable else "data not valid or not primary"
        )
        if problem and problem != self._problem:
            kind = AnomalyKind.STOPPED if usable else AnomalyKind.DROPPED
            self._put(Anomaly(now, 0, kind, f"frame with counter {record.cycle_counter}: {problem}"))
        self._problem = problem

    def _answer(self, record: CyclicRecord) -> None:
        """Only with UDP, the IOCS show whether the gateway uses the frames."""
        values, axes = record.values, record.layout.axes
        used = not axes or any(values[iocs] & IOPS_GOOD for *_, iocs in axes)
        self._unused = 0 if used or self._last_ns is None or self._is_lost else self._unused + 1
        if self._unused == _UNUSED:
            text = "the gateway does not use the frames (IOCS BAD)"
            self._put(Anomaly(record.time_ns, 0, AnomalyKind.DROPPED, text))

    def watch(self, now: int) -> None:
        """Report a silence of the PLC."""
        last = self._last_ns
        if last is None or self._is_lost or now - last <= self._watchdog_ns:
            return
        self._is_lost = True
        text = f"no frame of the PLC for more than {self._watchdog_ns / MS:g} ms, the time of the watchdog{self._known}"
        self._put(Anomaly(last + self._watchdog_ns, 0, AnomalyKind.WATCHDOG, text))
