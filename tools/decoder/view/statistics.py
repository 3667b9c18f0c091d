"""Statistics of a capture: rates, jitter, gaps of the cycle counter, bus load by identifier.

Constant memory: means and deviations are kept, not the times. Bus load counts data frames without and with the most stuff bits
possible (``ds301.bus.load``); the true value is between them.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from pdgw.base.durations import SECOND, US
from pdgw.ds301.bus.load import frame_bits
from pdgw.profidrive.frame import COUNTER_UNIT_NS, is_newer
from pdgw.profidrive.telegrams import Direction
from pdgw.tools.decoder.frames.canopen.can_records import CanRecord, PdoRecord
from pdgw.tools.decoder.frames.fields import Document
from pdgw.tools.decoder.frames.records import CyclicRecord, Record

_MAX_STEPS = 64
"""Different steps of one cycle counter that are counted apart."""


@dataclass(slots=True)
class Intervals:
    """Times between packets of one stream, in nanoseconds."""

    count: int = 0
    mean: float = 0.0
    shortest: int = 0
    longest: int = 0
    _squares: float = 0.0

    def add(self, interval: int) -> None:
        """One more interval (Welford's recurrence)."""
        self.count += 1
        delta = interval - self.mean
        self.mean += delta / self.count
        self._squares += delta * (interval - self.mean)
        self.shortest = interval if self.count == 1 else min(self.shortest, interval)
        self.longest = interval if self.count == 1 else max(self.longest, interval)

    @property
    def deviation(self) -> float:
        """Standard deviation: the jitter."""
        return math.sqrt(self._squares / self.count) if self.count else 0.0


@dataclass(slots=True)
class Counters:
    """Cycle counter of one FrameID."""

    last: int | None = None
    steps: Counter[int] = field(default_factory=Counter)
    stale: int = 0
    """Frames not newer than the one before (repeated or overtaken)."""

    def add(self, counter: int) -> None:
        """The counter of the next frame."""
        if self.last is not None:
            step = counter - self.last & 0xFFFF
            if not is_newer(counter, self.last):
                self.stale += 1
                return
            if step in self.steps or len(self.steps) < _MAX_STEPS:
                self.steps[step] += 1
        self.last = counter

    @property
    def step(self) -> int | None:
        """The usual step, in units of 31.25 us."""
        return self.steps.most_common(1)[0][0] if self.steps else None

    @property
    def gaps(self) -> int:
        """Times the counter made more than the usual step."""
        usual = self.step
        return sum(count for step, count in self.steps.items() if usual is not None and step > usual)

    @property
    def missing(self) -> int:
        """Frames that did not come, by these gaps."""
        usual = self.step
        if not usual:
            return 0
        return sum(count * (round(step / usual) - 1) for step, count in self.steps.items() if step > usual)


@dataclass(slots=True)
class Stream:
    """All packets of one FrameID, COB-ID or kind."""

    bus: str
    channel: str
    identifier: str
    name: str
    count: int = 0
    size: int = 0
    bits: int = 0
    worst_bits: int = 0
    first_ns: int = 0
    last_ns: int = 0
    intervals: Intervals = field(default_factory=Intervals)
    counters: Counters = field(default_factory=Counters)

    @property
    def rate(self) -> float:
        """Packets per second, from the first to the last."""
        duration = self.last_ns - self.first_ns
        return (self.count - 1) * SECOND / duration if duration > 0 else 0.0

    def document(self) -> Document:
        document: Document = {
            "bus": self.bus,
            "channel": self.channel,
            "identifier": self.identifier,
            "name": self.name,
            "packets": self.count,
            "bytes": self.size,
            "rate_per_s": self.rate,
            "interval_mean_us": self.intervals.mean / US,
            "interval_min_us": self.intervals.shortest / US,
            "interval_max_us": self.intervals.longest / US,
            "jitter_us": self.intervals.deviation / US,
        }
        if self.counters.last is not None:
            step = self.counters.step
            document |= {
                "counter_step_us": None if step is None else step * COUNTER_UNIT_NS / US,
                "counter_gaps": self.counters.gaps,
                "missing_frames": self.counters.missing,
                "stale_frames": self.counters.stale,
            }
        return document


class Statistics:
    """Feed every packet; read ``streams`` and ``document`` at the end."""

    def __init__(self) -> None:
        self._streams: dict[object, Stream] = {}
        self.packets = 0
        self.first_ns: int | None = None
        self.last_ns = 0

    def add(self, record: Record) -> None:
        """One more packet."""
        self.packets += 1
        time_ns = record.time_ns
        if self.first_ns is None:
            self.first_ns = self.last_ns = time_ns
        self.last_ns = max(self.last_ns, time_ns)
        key = (record.channel, record.stream)
        stream = self._streams.get(key)
        if stream is None:
            stream = self._streams[key] = _new_stream(record)
        else:
            stream.intervals.add(time_ns - stream.last_ns)
        stream.count += 1
        stream.size += len(record.data)
        stream.last_ns = time_ns
        if isinstance(record, CyclicRecord):
            stream.counters.add(record.cycle_counter)
        elif isinstance(record, CanRecord):
            size = min(8, len(record.data))
            stream.bits += frame_bits(size, worst=False)
            stream.worst_bits += frame_bits(size)

    @property
    def streams(self) -> list[Stream]:
        """All streams: the PLC's first, then by channel and identifier."""
        return sorted(self._streams.values(), key=lambda s: (s.bus != "plc", s.channel, s.identifier))

    @property
    def seconds(self) -> float:
        """Time from the first packet to the last."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) / SECOND

    def load(self, stream: Stream, bitrate: int) -> tuple[float, float]:
        """Least and most share of its bus a CAN identifier takes, 1.0 = full."""
        if not self.seconds:
            return 0.0, 0.0
        return stream.bits / self.seconds / bitrate, stream.worst_bits / self.seconds / bitrate

    def document(self, bitrate: int) -> Document:
        """All of it as plain data."""
        streams = []
        for stream in self.streams:
            item = stream.document()
            if stream.bits:
                item["load"], item["load_worst"] = self.load(stream, bitrate)
            streams.append(item)
        return {"packets": self.packets, "seconds": self.seconds, "bitrate": bitrate, "streams": streams}


def _new_stream(record: Record) -> Stream:
    identifier, name = record.kind, ""
    if isinstance(record, CyclicRecord):
        identifier = f"{record.frame_id:04X}h"
        name = {Direction.SETPOINT: "PLC -> gateway", Direction.ACTUAL: "gateway -> PLC", None: ""}[record.direction]
    elif isinstance(record, CanRecord):
        identifier = f"{record.cob_id:03X}h"
        name = record.layout.name if isinstance(record, PdoRecord) else record.kind
        name += f" node {record.node}" if record.node else ""
    return Stream(record.bus.value, record.channel, identifier, name, first_ns=record.time_ns)
