"""A timeline from the records of both buses as they arrive: entries and packets in the order of time, in constant memory.

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.base.durations import MS
from pdgw.gateway.configuration.defaults import WATCHDOG_FACTOR
from pdgw.gateway.trace.pcapng import Description
from pdgw.gateway.trace.reader import Cycle
from pdgw.profidrive.frame import COUNTER_UNIT_NS, IOPS_GOOD, is_newer
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord, NmtRecord
from pdgw.tools.decoder.frames.profinet.connect import AlarmRecord, Change, Connection, RelationRecord
from pdgw.tools.decoder.frames.profinet.frame_telegrams import Axis
from pdgw.tools.decoder.frames.records import AcyclicRecord, BusKind, CyclicRecord, Record
from pdgw.tools.decoder.timeline.drive_object import RESPONSE_NS, ObjectFollower
from pdgw.tools.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Event, WordKind

HOLD_NS: Final = RESPONSE_NS + 100 * MS
"""Longer than anything an entry waits for."""
_TICK_NS: Final = 10 * MS
_UNUSED: Final = 8
"""Number of consecutive answers without use of the PLC's frames that cannot be a crossing of frames and answers."""
_STEPS_FOR_USUAL: Final = 16
"""Steps of the cycle counter after which its increment is known."""
_COUNTER_CYCLES: Final = 10
"""Tolerance in cycles of a counter that is a clock: a recorder and a busy sender wait."""
_NAMES: Final = {Direction.SETPOINT: "PLC -> gateway", Direction.ACTUAL: "gateway -> PLC"}
_RUN, _NO_PROBLEM = "run", "no_problem"
_MISSING: Final[dict[Direction | BusKind, str]] = {
    Direction.SETPOINT: "no frame from a PLC: the recording does not show what the PLC commanded",
    Direction.ACTUAL: "no frame to a PLC: the recording does not show what the gateway reported to the PLC",
    BusKind.CAN: "no CAN frame: the recording shows neither the commands to the drives nor their answers",
}
NO_STEPS: Final = "no steps of the gateway: a capture of another recorder has no reasons and no refusals"


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps of a cycle of the gateway; ``time_ns``: that of its last frame."""

    time_ns: int
    description: Description
    cycle: Cycle


class TimelineBuilder:
    """Both buses of one gateway. ``axes``: in the order of the frame, with their node-IDs. ``watchdog_factor``: the gateway's.
    ``uncertainty_ns``: of the clocks of both buses."""

    def __init__(
        self, axes: Sequence[Axis], *, cycle_ns: int, watchdog_factor: int = WATCHDOG_FACTOR, uncertainty_ns: int = 0
    ) -> None:
        self._axes = axes
        self._heap: list[tuple[int, int, Entry | Record]] = []
        self._count = 0
        self._due = 0
        self._nodes: dict[int, list[ObjectFollower]] = {}
        self._objects = {axis.do_id: ObjectFollower(axis, self._put, cycle_ns, uncertainty_ns) for axis in axes}
        for item in self._objects.values():
            self._nodes.setdefault(item.axis.node, []).append(item)
        self._exchange = _Exchange(self._objects, self._put, cycle_ns, watchdog_factor * cycle_ns)
        self._has_steps = False
        self._seen: set[Direction | BusKind | None] = set()
        self._last_ns = 0

    def add(self, record: Record | Steps) -> Sequence[Entry | Record]:
        """Add a record, roughly in order of time. Return the entries that are complete now, and the packets between them."""
        now = self._last_ns = record.time_ns
        if isinstance(record, CyclicRecord):
            self._seen.add(record.direction)
            self._exchange.take(record)
        elif isinstance(record, CanRecord):
            self._can(record)
        elif isinstance(record, Steps):
            self._step(record.description, record.cycle)
        elif isinstance(record, RelationRecord):
            self._exchange.relate(now, record.change, record.connection)
        elif isinstance(record, AlarmRecord):
            self._alarm(record)
        elif isinstance(record, AcyclicRecord) and not self._objects:
            self._put(Event(now, 0, "PLC", record.summary))
        if isinstance(record, Record):
            self._put(record)
        if now < self._due:
            return ()
        self._due = now + _TICK_NS
        self._exchange.watch(now)
        for item in self._objects.values():
            item.tick(now)
        return self.release(now - HOLD_NS)

    def _can(self, record: CanRecord) -> None:
        self._seen.add(BusKind.CAN)
        to_all = isinstance(record, NmtRecord) and not record.node
        for item in self._objects.values() if to_all else self._nodes.get(record.node, ()):
            if item.axis.bus in {"", record.channel}:
                item.take(record)

    def _step(self, description: Description, cycle: Cycle) -> None:
        self._has_steps = True
        for traced, step in zip(description.objects, cycle.steps, strict=True):
            if traced.do_id in self._objects:
                self._objects[traced.do_id].step(cycle.wall_ns, step, traced, description.reason)

    def _alarm(self, record: AlarmRecord) -> None:
        if record.ended is not None:
            self._exchange.relate(record.time_ns, Change.ENDED, record.ended)
        if record.is_notification:
            do_ids = {axis.slot or place: axis.do_id for place, axis in enumerate(self._axes, 1)}
            self._put(Event(record.time_ns, do_ids.get(record.slot, 0), "PLC", record.text))

    def finish(self) -> Sequence[Entry | Record]:
        """The rest, at the end of the recording."""
        for do_id, text in self._missing():
            self._put(Event(self._last_ns, do_id, "missing", text))
        return self.release()

    def _missing(self) -> Iterator[tuple[int, str]]:
        """Missing data by DO-ID (0: of all)."""
        if self._objects and not self._has_steps:
            yield 0, NO_STEPS
        yield from ((0, text) for what, text in _MISSING.items() if what not in self._seen)
        for do_id, item in self._objects.items():
            if not item.has_frames and BusKind.CAN in self._seen:
                yield do_id, f"no frame from node {item.axis.node}"

    def _put(self, entry: Entry | Record) -> None:
        self._count += 1
        heapq.heappush(self._heap, (entry.time_ns, self._count, entry))

    def release(self, until: int | None = None) -> Sequence[Entry | Record]:
        """The entries until a time, complete or not; None: all, where the recording is damaged."""
        heap = self._heap
        released = []
        while heap and (until is None or heap[0][0] <= until):
            entry = heapq.heappop(heap)[2]
            if isinstance(entry, Edge) and entry.cause is not None:
                entry.origin = entry.cause if entry.cause.kind is WordKind.CONTROL else entry.cause.origin
            released.append(entry)
        return released


class _CycleCounter:
    """The cycle counter of one direction: it makes the same step with each frame, or it is a clock in units of 31.25 us."""

    def __init__(self, cycle_ns: int) -> None:
        self._tolerance = _COUNTER_CYCLES * cycle_ns
        self.last: int | None = None
        """None: a new relationship counts from anywhere."""
        self._last_ns = 0
        self._steps: Counter[int] = Counter()
        self._usual = 0

    def found(self, counter: int, now: int) -> tuple[AnomalyKind, str] | None:
        """The anomaly of the next frame's counter, if any."""
        last, elapsed = self.last, now - self._last_ns
        self._last_ns = now
        if last is not None and not is_newer(counter, last):
            return AnomalyKind.STALE, f"counter {counter} after {last}"
        self.last = counter
        if last is None:
            return None
        step = (counter - last) & 0xFFFF
        self._steps[step] += 1
        if self._steps[step] > self._steps[self._usual]:
            self._usual = step
        if step == self._usual or self._steps.total() < _STEPS_FOR_USUAL:
            return None
        times, rest = divmod(step, self._usual)
        text = f"counter {last} -> {counter}"
        if not rest:
            return AnomalyKind.COUNTER, f"{text}, usual step {self._usual}, missing frames: {times - 1}"
        claimed_ns = step * COUNTER_UNIT_NS
        if abs(claimed_ns - elapsed % (COUNTER_UNIT_NS << 16)) <= self._tolerance:
            return None
        return AnomalyKind.COUNTER, f"{text} claims {claimed_ns / MS:.1f} ms, but {elapsed / MS:.1f} ms have passed"


class _Exchange:
    """The frames from and to the PLC. ``objects``: by DO-ID."""

    def __init__(
        self, objects: Mapping[int, ObjectFollower], put: Callable[[Entry], None], cycle_ns: int, watchdog_ns: int
    ) -> None:
        self._objects = objects
        self._put = put
        self._watchdog_ns = watchdog_ns
        self._counters = {direction: _CycleCounter(cycle_ns) for direction in Direction}
        self._last_ns: int | None = None
        """The last frame of the PLC; None: it is not expected to send."""
        self._is_lost = False
        self._wrong: list[str] = []
        self._unused = 0

    def relate(self, now: int, change: Change, connection: Connection) -> None:
        """A PROFINET relationship comes or goes."""
        if change in {Change.REQUESTED, Change.GRANTED}:
            for counter in self._counters.values():
                counter.last = None
        if change is Change.REQUESTED:
            return  # the answer names the station
        who = " and ".join(name for name in (connection.controller, connection.station) if name)
        self._put(Event(now, 0, "PLC", f"relationship of {who} {change.value}"))
        if change in {Change.ENDED, Change.PAUSED}:
            self._last_ns, self._is_lost = None, False  # no frame of the PLC is expected

    def take(self, record: CyclicRecord) -> None:
        """A cyclic frame of either direction."""
        direction, now = record.direction, record.time_ns
        if direction is None:
            return
        found = self._counters[direction].found(record.cycle_counter, now)
        if found is not None:
            self._report(now, found[0], f"{_NAMES[direction]}: {found[1]}")
        if direction is Direction.SETPOINT:
            self._frame(record)
        else:
            self._answer(record)
        for do_id, _, unit, first, iops, _ in record.layout.axes:
            item = self._objects.get(do_id)
            if item is not None and unit.telegram == item.axis.telegram:
                item.quality(now, direction, good=bool(record.values[iops] & IOPS_GOOD))
                kind = WordKind.CONTROL if direction is Direction.SETPOINT else WordKind.STATUS
                item.word(kind, now, record.values[first], unit.fields[0])

    def _frame(self, record: CyclicRecord) -> None:
        now = record.time_ns
        self.watch(now)
        if self._is_lost and self._last_ns is not None:
            silence = (now - self._last_ns) / MS
            self._put(Event(now, 0, "PLC", f"frames are back after {silence:.1f} ms"))
            self._is_lost = False
        self._last_ns = now
        wrong = [name for name in record.wrong if name != _NO_PROBLEM]
        if wrong and wrong != self._wrong:
            kind = AnomalyKind.STOPPED if wrong == [_RUN] else AnomalyKind.DROPPED
            self._report(now, kind, f"frame with counter {record.cycle_counter}: not {', '.join(wrong)}")
        self._wrong = wrong

    def _answer(self, record: CyclicRecord) -> None:
        """Only with UDP, the IOCS show whether the gateway uses the frames."""
        values, axes = record.values, record.layout.axes
        used = not axes or any(values[iocs] & IOPS_GOOD for *_, iocs in axes)
        self._unused = 0 if used or self._last_ns is None or self._is_lost else self._unused + 1
        if self._unused == _UNUSED:
            self._report(record.time_ns, AnomalyKind.DROPPED, "the gateway does not use the frames (IOCS BAD)")

    def watch(self, now: int) -> None:
        """Report a silence of the PLC."""
        last = self._last_ns
        if last is None or self._is_lost or now - last <= self._watchdog_ns:
            return
        self._is_lost = True
        text = f"no frame of the PLC for more than {self._watchdog_ns / MS:g} ms, the time of the watchdog"
        self._report(last + self._watchdog_ns, AnomalyKind.WATCHDOG, text)

    def _report(self, now: int, kind: AnomalyKind, text: str) -> None:
        self._put(Anomaly(now, 0, kind, text))
