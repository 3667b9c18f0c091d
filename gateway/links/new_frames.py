"""Which frames of a PLC are new. Sans-I/O, monotonic nanoseconds. Source: docs/plc.md "Which frames are new".

A network may delay, repeat and reorder frames. Nothing in a frame itself shows when it was sent: the CycleCounter is the PLC's
clock, and it repeats every 2.048 s. So the gateway writes a tick of its own clock into each frame that it sends, and the PLC
copies the newest tick into its frames. A PLC cannot know a tick before it was sent. Therefore a frame is younger than its tick,
whatever the network does, and the age of the tick is an upper limit of the age of the frame. A safety protocol on a black channel
uses the same principle.

* A tick counts if the gateway sent it to this PLC at most the age limit ago. The gateway keeps a list of these ticks. Membership
  in the list decides, not the number: so the tick may wrap, and a tick of an earlier start, of another layout or of an attacker
  who does not read the gateway's frames is in no list.
* A frame counts if its tick counts and it is newer than the last one that counted. It is newer if the gateway sent its tick after
  it had read that one: this also holds for a PLC that has restarted with any counter. With an earlier tick, as where the network
  needs more than a cycle, its tick must not be older and its CycleCounter must be newer. A later tick is not enough: a PLC copies
  the tick that it received last, and the network may have changed the order of these. An older frame that still counts was sent
  at most the age limit before, so a counter that is older by up to this time is not newer.

A frame that counts has no other condition: all its orders act at once.
"""

from __future__ import annotations

import enum
from collections import OrderedDict
from typing import Final

from pdgw.profidrive.frame import COUNTER_NEWEST, COUNTER_UNIT_NS

_TICKS: Final = 1 << 32
_COUNTS: Final = 0xFFFF
_DRIFT: Final = 1
"""Percent by which the PLC's clock may be too fast."""
_NEVER: Final = 1 << 63
"""No tick was sent after this time: only the counter decides."""


class Verdict(enum.Enum):
    """Result of a received datagram; the value is the name of its counter."""

    ACCEPTED = "accepted"
    PROVIDER_STOP = "provider stop"
    FOREIGN_SENDER = "foreign sender"
    TRUNCATED = "truncated"
    OVERSIZED = "oversized"
    WRONG_FRAME_ID = "wrong FrameID"
    STALE = "stale cycle counter"
    CONNECTING = "without a tick, before the first one of this gateway can have reached the PLC"
    NO_TICK = "without a tick that this gateway sent"
    TOO_OLD = "older than the age limit"
    AFTER_LOSS = "not connected yet: the axes have to see the loss of the PLC first"
    OVERDUE = "delayed in the gateway for longer than the watchdog time"
    WRONG_TELEGRAM = "data after the last object: the PLC sends another telegram or more axes"
    NOT_VALID = "data not valid"
    NOT_PRIMARY = "not primary"

    # Each member is a single object; Enum's own function is Python and would run in every cycle.
    __hash__ = object.__hash__


class NewFrames:
    """The frames of one PLC.

    ``age_limit_ns``: greatest age of a frame; None where no frame is late (Ethernet, loopback, ``direct``): there the
    CycleCounter alone decides. ``offset`` is added to the clock that is sent as tick: another one with each start.
    """

    def __init__(self, age_limit_ns: int | None, offset: int = 0) -> None:
        self.age_limit_ns = age_limit_ns
        self._offset = offset
        self._sent: OrderedDict[int, int] = OrderedDict()
        """The ticks that count, each with the time of its first frame."""
        self._last: tuple[int, int, int] | None = None
        """The last frame that counted: when its tick was sent, when it was read, and its CycleCounter."""
        self._ahead = COUNTER_NEWEST
        """A counter is newer if it is ahead by 1 to this number."""
        if age_limit_ns is not None:
            self._ahead = min(COUNTER_NEWEST, _COUNTS - age_limit_ns * (100 + _DRIFT) // (100 * COUNTER_UNIT_NS))
        self._listening_since: int | None = None
        self._refused = 0
        """The newest tick that did not count: it is not sent again, so that a PLC that always sends it is never connected."""
        self.age_ns: int | None = None
        """Greatest possible age of the last frame that counted; None where only the counter decides."""
        self.refused_age_ns = 0
        """Age of the last frame that was too old."""

    def tick(self, now: int) -> int:
        """The tick of a frame that is sent now."""
        tick = self._tick(now)
        if self.age_limit_ns is not None:
            if self._listening_since is None:
                self._listening_since = now
            if tick == self._refused:
                tick = tick % (_TICKS - 1) + 1
            if tick not in self._sent:
                self._sent[tick] = now
            self._forget_old(now)
        return tick

    def _tick(self, now: int) -> int:
        return (now // COUNTER_UNIT_NS + self._offset) % _TICKS or 1

    def _forget_old(self, now: int) -> None:
        assert self.age_limit_ns is not None
        sent, oldest = self._sent, now - self.age_limit_ns
        while sent and next(iter(sent.values())) < oldest:
            sent.popitem(last=False)

    def check(self, tick: int, counter: int, now: int) -> Verdict:
        """ACCEPTED for a new frame that is read now: it is the last one from now on. Otherwise why it does not count."""
        sent_at, read_at = 0, _NEVER
        if self.age_limit_ns is not None:
            self._forget_old(now)
            if tick not in self._sent:
                self._refused = tick
                return self._why_refused(tick, now)
            sent_at, read_at = self._sent[tick], now
        if self._last is not None:
            last_sent_at, last_read_at, last_counter = self._last
            ahead = counter - last_counter & _COUNTS
            if sent_at < last_read_at and (sent_at < last_sent_at or not 1 <= ahead <= self._ahead):
                return Verdict.STALE
        self._last = sent_at, read_at, counter
        self.age_ns = None if self.age_limit_ns is None else now - sent_at
        return Verdict.ACCEPTED

    def _why_refused(self, tick: int, now: int) -> Verdict:
        since = self._listening_since
        if not tick and (since is None or now - since <= (self.age_limit_ns or 0)):
            return Verdict.CONNECTING
        age_ns = (self._tick(now) - tick) % _TICKS * COUNTER_UNIT_NS
        if not tick or since is None or age_ns > now - since:
            return Verdict.NO_TICK
        self.refused_age_ns = age_ns
        return Verdict.TOO_OLD

    def lose(self) -> None:
        """The PLC is lost. Where only the counter decides, it may continue with any counter."""
        if self.age_limit_ns is None:
            self._last = None

    def restart(self) -> None:
        """Another PLC: no tick was sent to it yet."""
        self._sent.clear()
        self._listening_since = None
