"""Entries of a timeline for every drive object, drive or encoder: events of its node, data marked as bad. Without I/O."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.decoder.frames.canopen.records import CanRecord, EmcyRecord, HeartbeatRecord, NmtRecord
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.timeline.entries import Anomaly, AnomalyKind, Entry, Event
from pdgw.durations import MS, SECOND
from pdgw.profidrive.telegrams import Direction

_RESET: Final = 0
"""EMCY error code "error reset or no error"."""

Put = Callable[[Entry], None]


@dataclass
class _Bad:
    """Process data marked as bad, the side that marked it, and its entry."""

    who: str
    entry: Anomaly
    reported: bool = False


class ObjectFollower:
    """Follows one drive object. ``put`` takes the entries, whose details may still change for ``hold_ns``."""

    def __init__(self, axis: Axis, put: Put, hold_ns: int) -> None:
        self.axis = axis
        self._put = put
        self._hold_ns = hold_ns
        self._bad: dict[Direction, _Bad] = {}
        self.gateway_stops = False
        """The gateway itself is being stopped."""
        self.has_frames = False
        """Whether a frame of the node has arrived."""

    # -- parts of an axis ---------------------------------------------------------------------------------------------

    def control(self, now: int, word: int, setpoints: Sequence[int] | None) -> None:
        """The first signal of a frame of the PLC, and what the gateway has in force after the frame."""

    def status(self, now: int, values: Sequence[int], *, good: bool) -> None:
        """The actual values of an answer and whether the gateway marks them good."""

    def step(self, setpoints: Sequence[int] | None, now: int, *, fresh: bool = True) -> None:
        """The gateway made a step with these values of the PLC."""

    def finish(self) -> None:
        """The recording ends."""

    # -- common parts -------------------------------------------------------------------------------------------------

    def quality(self, now: int, direction: Direction, *, good: bool) -> None:
        """Whether the process data of one direction are marked good."""
        bad = self._bad.get(direction)
        if good is (bad is None):
            return
        if bad is None:
            who = "of the PLC" if direction is Direction.SETPOINT else "of the gateway"
            entry = Anomaly(now, self.axis.do_id, AnomalyKind.IOPS_BAD, f"data {who} bad until the end")
            self._bad[direction] = _Bad(who, entry)
            self._put(entry)
            return
        del self._bad[direction]
        how_long = f"{(now - bad.entry.time_ns) / MS:.1f} ms"
        if bad.reported:
            self._put(Event(now, self.axis.do_id, "IOPS", f"data {bad.who} good again after {how_long}"))
        else:
            bad.entry.text = f"data {bad.who} bad for {how_long}"

    def take(self, record: CanRecord) -> None:
        """A frame of the node or to it."""
        now, do_id = record.time_ns, self.axis.do_id
        if isinstance(record, NmtRecord):
            self._put(Event(now, do_id, "NMT", record.text))
        elif isinstance(record, HeartbeatRecord):
            if record.changed:
                self._put(Event(now, do_id, "state", f"node {record.node}: {record.text}"))
        elif isinstance(record, EmcyRecord):
            text = f"node {record.node}: {record.text}"
            if record.code == _RESET:
                self._put(Event(now, do_id, "EMCY", text))
            else:
                self._put(Anomaly(now, do_id, AnomalyKind.EMERGENCY, text))

    def tick(self, now: int) -> None:
        """Report overdue answers."""
        for bad in self._bad.values():
            if not bad.reported and now >= bad.entry.time_ns + self._hold_ns:
                bad.reported = True
                bad.entry.text = f"data {bad.who} bad for more than {self._hold_ns / SECOND:g} s"
