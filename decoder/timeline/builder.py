"""A timeline from the records of both buses as they arrive: entries in the order of time, in constant memory.

Connection of the PLC (IOCS of the answers) and of the drive (IOPS) are recorded facts. Without answers, and over PROFINET,
whose IOCS do not show it, the watchdog decides. An entry is delayed until it is complete (``HOLD_NS`` of recorded time). Without
I/O; one clock (``decoder.timeline.lookahead`` finds the offset).

    >>> builder = TimelineBuilder(axes, settings, cycle_ns=4_000_000)
    >>> for record in records:
    ...     entries = builder.add(record)
    >>> entries = builder.finish()
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from pdgw.decoder.frames.canopen.records import CanRecord, EmcyRecord, HeartbeatRecord, NmtRecord, PdoRecord, SdoRecord
from pdgw.decoder.frames.profinet.connect import Connection
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.profinet.endpoint import ProfinetEndpoint
from pdgw.decoder.frames.profinet.records import AlarmRecord, Change, RelationRecord
from pdgw.decoder.frames.records import CyclicRecord, Record
from pdgw.decoder.replay.cycles import SILENT_CYCLES
from pdgw.decoder.replay.plc_inputs import SENDER
from pdgw.decoder.timeline.axis import RESPONSE_NS, AxisFollower
from pdgw.decoder.timeline.drive_object import ObjectFollower, Put
from pdgw.decoder.timeline.entries import Anomaly, AnomalyKind, Edge, Entry, Event
from pdgw.ds301.pdo import PdoDirection
from pdgw.durations import MS
from pdgw.gateway.axis.settings import AxisSettings
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.gateway.configuration.tables.defaults import WATCHDOG_FACTOR, WATCHDOG_FACTOR_MAX
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.profidrive.frame import COUNTER_UNIT_NS, IOPS_GOOD, is_newer
from pdgw.profidrive.telegrams import Direction, telegram

HOLD_NS: Final = RESPONSE_NS + 100 * MS
"""Longer than anything an entry waits for."""
_TICK_NS: Final = 10 * MS
_UNUSED: Final = 8
"""Number of consecutive answers without use of the PLC's frames that cannot be a crossing of frames and answers."""
_JUDGED: Final = 16
"""Steps of the cycle counter after which its increment is known."""
_COUNTER_CYCLES: Final = 10
"""Tolerance in cycles of a counter that is a clock: a recorder and a busy sender wait."""
_VERDICTS = {Verdict.STALE: AnomalyKind.STALE, Verdict.PROVIDER_STOP: AnomalyKind.STOPPED}
_NOTHING: Final[tuple[Entry, ...]] = ()


class TimelineBuilder:
    """Both buses of one gateway.

    ``axes``: in the order of the frame, with their node-IDs; ``settings``: the user's settings by DO-ID, defaults for others.
    ``watchdog_factor``: the gateway's, None if unknown. ``one_clock``: both buses were recorded with one clock, so no edge is
    before its cause.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        settings: Mapping[int, AxisSettings] | None = None,
        *,
        cycle_ns: int,
        watchdog_factor: int | None = None,
        one_clock: bool = False,
    ) -> None:
        self.horizon_ns: int | None = None
        """All entries up to this time have been given out."""
        self._heap: list[tuple[int, int, Entry]] = []
        self._count = 0
        self._due = 0
        given = settings or {}
        self._objects = [
            _follower(axis, given.get(axis.do_id), self._put, cycle_ns, one_clock=one_clock) for axis in axes
        ]
        self._nodes: dict[int, list[ObjectFollower]] = {}
        for item in self._objects:
            self._nodes.setdefault(item.axis.node, []).append(item)
        self._exchange = _Exchange(self._objects, self._put, cycle_ns, watchdog_factor)
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
                    if not item.has_frames:
                        item.has_frames = _is_from_node(record)
                    item.take(record)
        elif isinstance(record, CyclicRecord):
            self._exchange.take(record)
        elif isinstance(record, RelationRecord):
            self._exchange.relate(record.time_ns, record.change, record.connection)
        elif isinstance(record, AlarmRecord):
            self._alarm(record)
        if now < self._due:
            return _NOTHING
        self._due = now + _TICK_NS
        for item in self._objects:
            item.tick(now)
        self.horizon_ns = now - HOLD_NS
        return self._release(self.horizon_ns)

    def _alarm(self, record: AlarmRecord) -> None:
        if record.ended is not None:
            self._exchange.relate(record.time_ns, Change.ENDED, record.ended)
        if record.is_notification:
            do_id = next(
                (item.axis.do_id for place, item in enumerate(self._objects, 1) if _slot(item, place) == record.slot), 0
            )
            self._put(Event(record.time_ns, do_id, "PLC", record.text))

    def finish(self) -> Sequence[Entry]:
        """The rest, at the end of the recording."""
        for item in self._objects:
            item.finish()
        for do_id, text in self._missing():
            self._put(Event(self._last_ns, do_id, "missing", text))
        return self._release(None)

    def _missing(self) -> Iterator[tuple[int, str]]:
        """Missing data by DO-ID (0: of all)."""
        seen = self._exchange.seen
        if Direction.SETPOINT not in seen:
            yield 0, "no frame from a PLC: the recording does not show what the PLC commanded"
        if Direction.ACTUAL not in seen:
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


def _follower(axis: Axis, settings: AxisSettings | None, put: Put, cycle_ns: int, *, one_clock: bool) -> ObjectFollower:
    if axis.telegram not in DRIVE_TELEGRAM_NUMBERS:
        return ObjectFollower(axis, put, HOLD_NS)
    chosen = settings or AxisSettings()
    return AxisFollower(
        axis, chosen, put, cycle_ns=cycle_ns, hold_ns=HOLD_NS, one_clock=one_clock, assumed=settings is None
    )


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

    def jump(self, counter: int, now: int) -> str:
        """The anomaly of the next frame's counter; empty if normal or for an old frame."""
        last, self._last = self._last, counter
        elapsed, self._last_ns = now - self._last_ns, now
        if last is None or not is_newer(counter, last):
            return ""
        step = (counter - last) & 0xFFFF
        self._steps[step] += 1
        self._count += 1
        if self._steps[step] > self._steps[self._usual]:
            self._usual = step
        usual = self._usual
        if step == usual or self._count < _JUDGED:
            return ""
        text = f"{self._who}: counter {last} -> {counter}"
        claimed_ns = step * COUNTER_UNIT_NS
        agrees = abs(claimed_ns - elapsed % (COUNTER_UNIT_NS << 16)) <= self._tolerance
        self._clock |= agrees and step % usual != 0
        if self._clock or 2 * self._steps[usual] <= self._count:
            if agrees:
                return ""
            return f"{text} claims {claimed_ns / MS:.1f} ms, but {elapsed / MS:.1f} ms have passed"
        text += f", usual step {usual}"
        missing = step // usual - 1 if step % usual == 0 else 0
        return f"{text}, {missing} frame{'s' if missing > 1 else ''} missing" if missing > 0 else text


class _Exchange:
    """The exchange with the PLC: which frames the gateway used, when it had lost the PLC, and its steps."""

    def __init__(
        self,
        objects: Sequence[ObjectFollower],
        put: Put,
        cycle_ns: int,
        watchdog_factor: int | None,
    ) -> None:
        self._objects = {item.axis.do_id: item for item in objects}
        self._order = tuple(objects)
        self._put = put
        self._cycle_ns = cycle_ns
        self._factor = watchdog_factor
        telegrams = [telegram(item.axis.telegram) for item in objects]
        self._endpoint: CyclicEndpoint | ProfinetEndpoint = CyclicEndpoint(
            telegrams, cycle_ns=cycle_ns, watchdog_factor=WATCHDOG_FACTOR_MAX
        )
        self._watchdog_ns = (watchdog_factor or WATCHDOG_FACTOR) * cycle_ns
        self._counters = {
            Direction.SETPOINT: _CycleCounter("PLC -> gateway", cycle_ns),
            Direction.ACTUAL: _CycleCounter("gateway -> PLC", cycle_ns),
        }
        self._last_verdict: Verdict | None = None
        self.seen: set[Direction] = set()
        """Directions of the frames seen until now."""
        self._last_frame = 0
        self._lost_since: int | None = None
        self._answered = False
        self._stepped = False
        """A step was made for a frame whose answer has not come yet."""
        self._unused = 0
        self._in_use = False
        """The gateway used the last frames."""
        self._stops = False
        """The gateway itself is being stopped: of each frame only OFF2 and OFF3 count."""

    def relate(self, now: int, change: Change, connection: Connection) -> None:
        """A PROFINET relationship comes or goes: from now on its frames count as the link counts them."""
        endpoint = self._endpoint
        if not isinstance(endpoint, ProfinetEndpoint):
            axes = [item.axis for item in self._order]
            endpoint = self._endpoint = ProfinetEndpoint(axes, self._factor or WATCHDOG_FACTOR)
        endpoint.relate(change, connection)
        if change is Change.GRANTED:
            self._restart_counters()
        who = " and ".join(name for name in (connection.controller, connection.station) if name)
        self._put(Event(now, 0, "PLC", f"relationship of {who} {change.value}"))
        if change in {Change.ENDED, Change.PAUSED}:
            self._step(now)  # no later frame triggers a step of the axes

    def take(self, record: CyclicRecord) -> None:
        """A cyclic frame of either direction."""
        direction = record.direction
        if direction is None:
            return
        self.seen.add(direction)
        if direction is Direction.SETPOINT:
            self._frame(record)
        else:
            self._count(record, direction)
            self._answer(record)

    def _count(self, record: CyclicRecord, direction: Direction) -> None:
        jump = self._counters[direction].jump(record.cycle_counter, record.time_ns)
        if jump:
            self._put(Anomaly(record.time_ns, 0, AnomalyKind.COUNTER, jump))

    def _restart_counters(self) -> None:
        for counter in self._counters.values():
            counter.restart()

    def _frame(self, record: CyclicRecord) -> None:
        now, endpoint = record.time_ns, self._endpoint
        if not self._answered:
            self._watch(now)
        verdict = endpoint.receive(record.data, SENDER, now, now)
        self._count(record, Direction.SETPOINT)
        if verdict is Verdict.AFTER_LOSS and isinstance(endpoint, ProfinetEndpoint):
            if not endpoint.connected:
                self._last_frame = now
            # frames do not count before ApplicationReady is confirmed or after PrmBegin
            return
        if verdict is Verdict.STALE or (verdict is not Verdict.ACCEPTED and verdict is not self._last_verdict):
            kind = _VERDICTS.get(verdict, AnomalyKind.DROPPED)
            self._put(Anomaly(now, 0, kind, f"frame with counter {record.cycle_counter}: {verdict.value}"))
        self._last_verdict = verdict
        values = record.values
        in_force = {item.axis.do_id: s for item, s in zip(self._order, endpoint.setpoints, strict=True)}
        for do_id, _, unit, first, iops, _ in record.layout.axes:
            item = self._objects.get(do_id)
            if item is not None and unit.telegram == item.axis.telegram:
                item.control(now, values[first], in_force[do_id])
                item.quality(now, Direction.SETPOINT, good=bool(values[iops] & IOPS_GOOD))
        if verdict in {Verdict.ACCEPTED, Verdict.PROVIDER_STOP}:
            if self._lost_since is not None:
                silence = (now - self._last_frame) / MS
                self._put(Event(now, 0, "PLC", f"frames are back after {silence:.1f} ms"))
                self._lost_since = None
            self._last_frame = now
            self._step(now)
            self._stepped = True

    def _answer(self, record: CyclicRecord) -> None:
        now, values = record.time_ns, record.values
        # On PROFINET neither IOCS nor the time of an answer shows whether the gateway accepts the PLC's frames.
        answers = self._answered = isinstance(self._endpoint, CyclicEndpoint)
        used = False
        for do_id, _, unit, first, iops, iocs in record.layout.axes:
            used |= bool(values[iocs] & IOPS_GOOD)
            item = self._objects.get(do_id)
            if item is not None and unit.telegram == item.axis.telegram:
                good = bool(values[iops] & IOPS_GOOD)
                item.status(now, values[first:iops], good=good)
                item.quality(now, Direction.ACTUAL, good=good)
        if not answers:
            self._watch(now)
        elif record.layout.axes:
            self._used(now, used=used)
        if not self._stepped:
            self._step(now)
        self._stepped = False

    def _used(self, now: int, *, used: bool) -> None:
        """Whether the gateway had the PLC when it made an answer: its IOCS say so."""
        if used:
            self._unused, self._in_use, self._stops = 0, True, False
            return
        if not self._stops:
            if not any(item is not None for item in self._endpoint.setpoints):
                self._in_use = False
                return
            silence = now - self._last_frame
            if silence > SILENT_CYCLES * self._cycle_ns:
                self._in_use = False
                self._lose()
                self._lost_since = now
                self._put(self._unused_after(silence, now))
                return
            if self._in_use:
                self._stops, self._stepped = True, False
        self._unused += 1
        if self._unused == _UNUSED:
            text = "the gateway does not use the frames (IOCS BAD)"
            if self._stops:
                text = "the gateway uses only OFF2 and OFF3 of the frames (IOCS BAD), as while it is being stopped"
            self._put(Anomaly(now, 0, AnomalyKind.DROPPED, text))

    def _unused_after(self, silence: int, now: int) -> Entry:
        """IOCS BAD after a silence: a loss, or a gateway that ends; of a watchdog that is not known both are possible."""
        text = f"no frame of the PLC for {silence / MS:.1f} ms"
        if self._factor is None:
            text += ": the gateway has lost the PLC or is ending (IOCS BAD)"
        elif silence < self._watchdog_ns - self._cycle_ns // 2:
            text += f", less than the watchdog time of {self._watchdog_ns / MS:g} ms: IOCS BAD as when the gateway ends"
            return Event(now, 0, "gateway", text)
        else:
            text += ": the gateway has lost the PLC (IOCS BAD)"
        return Anomaly(now, 0, AnomalyKind.WATCHDOG, text)

    def _watch(self, now: int) -> None:
        """Without answers of the gateway, only the silence of the PLC shows its watchdog."""
        watchdog_ns = self._silence_ns
        silence = now - self._last_frame
        if not self._endpoint.connected or silence <= watchdog_ns:
            return
        self._lose()
        expiry = self._last_frame + watchdog_ns
        known = "the watchdog's" if self._factor else "if the watchdog has its default"
        text = f"no frame of the PLC for {silence / MS:.1f} ms: lost after {watchdog_ns / MS:g} ms, {known}"
        self._put(Anomaly(expiry, 0, AnomalyKind.WATCHDOG, text))
        self._step(expiry)

    def _lose(self) -> None:
        self._endpoint.poll(self._last_frame + max(WATCHDOG_FACTOR_MAX * self._cycle_ns, self._silence_ns) + 1)

    @property
    def _silence_ns(self) -> int:
        """Longest silence of the PLC in nanoseconds."""
        endpoint = self._endpoint
        return endpoint.watchdog_ns if isinstance(endpoint, ProfinetEndpoint) else self._watchdog_ns

    def _step(self, now: int) -> None:
        ignored = self._unused >= _UNUSED and not self._stops
        for item, setpoints in zip(self._order, self._endpoint.setpoints, strict=True):
            item.gateway_stops = self._stops
            item.step(None if ignored else setpoints, now)
        if self._stops and isinstance(self._endpoint, CyclicEndpoint):
            self._endpoint.lose_setpoints()
