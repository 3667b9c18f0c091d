"""Which frames of a PLC are new, over a network that delays, repeats and reorders them. Sans-I/O, monotonic nanoseconds.

Source: docs/transport.md chapter 1. The CycleCounter is a clock of 31.25 us that wraps every 2.048 s. For a frame that may be
seconds late, "newer" is not enough: its advance must fit the time that passed. ``SEQUENCE_FRAMES`` consecutive frames with this
property make a connection. Frames outside the present sequence are followed as a possible new one, so a PLC that restarts with
any counter is connected after the same number of frames. A sequence that ran in parallel to an older present one, and continues
after it, is not a restart: these are old frames. Which of two sequences at a time is old is not known (``cyclic``). Not here:
the content of frames (``confirmation``).
"""

from __future__ import annotations

import enum
from collections.abc import Hashable
from typing import Final

from pdgw.durations import SECOND
from pdgw.profidrive.frame import COUNTER_UNIT_NS, is_newer

SEQUENCE_FRAMES: Final = 4
"""Number of consecutive frames that make a sequence."""
WRAP_NS: Final = (1 << 16) * COUNTER_UNIT_NS
"""Time after which the counter has the same value again: 2.048 s."""
_COUNTS: Final = 0xFFFF
_DRIFT: Final = 50
"""The clocks may differ by 1/50: twice the 1 % a PLC is allowed, as both directions are reckoned from the fastest frame."""
_CREDIT_MAX_NS: Final = WRAP_NS // 4
"""However long the watchdog is, a counter that runs ahead by more than this is not distinguishable from an old one."""
OLDEST_NS: Final = 5 * SECOND
"""No network keeps a frame longer."""
_FOLLOWED: Final = 8
"""Possible sequences followed at a time; of more, those with a single frame are forgotten first."""


class Order(enum.Enum):
    """Meaning of a frame's counter."""

    NEXT = "in sequence, and newer than the last frame"
    STALE = "not newer, or ahead of the elapsed time"
    BESIDE = "stale, and of another sequence that runs beside the present one"
    UNCONFIRMED = "part of another sequence that is not long enough yet"
    RESTARTED = "completes another sequence while the current one is silent"


class _Run:
    """Frames of one sequence.

    ``credit``: by how much (ns) the counter may advance more than the time that passed. ``repeats``: number of frames with the
    same ``command``, up to the newest. ``started_at``: frames of the present sequence at its start. ``old_until``: up to that
    time these are old frames.
    """

    def __init__(
        self, source: Hashable, counter: int, time: int, credit: int, command: Hashable, started_at: int
    ) -> None:
        self.source = source
        self.counter = counter
        self.first = self.time = time
        self.credit = credit
        self.frames = 1
        self.command = command
        self.repeats = 1
        self.started_at = started_at
        self.old_until: int | None = None

    def advance(self, counter: int, time: int, credit_max: int) -> int:
        """Take the next frame; its counter's advance in ns, 0 when it does not fit (then nothing changes)."""
        advance = (counter - self.counter & _COUNTS) * COUNTER_UNIT_NS
        elapsed = time - self.time if time > self.time else 0
        spare = self.credit + elapsed + elapsed // _DRIFT - advance
        if not advance or spare < 0:
            return 0
        if spare >= WRAP_NS:
            # After a silence longer than the counter's period, complete turns are missing in the difference.
            turns, spare = divmod(spare, WRAP_NS)
            advance += turns * WRAP_NS
        self.credit = spare if spare < credit_max else credit_max
        self.counter = counter
        self.time = time
        return advance

    def extend(self, counter: int, time: int, cycle_ns: int, command: Hashable) -> bool:
        """``advance`` of a sequence that is being followed: early by half a cycle at most, late by one."""
        advance = (counter - self.counter & _COUNTS) * COUNTER_UNIT_NS
        if time - self.time - advance > cycle_ns or not self.advance(counter, time, cycle_ns // 2):
            return False
        self.frames += 1
        self.repeats = self.repeats + 1 if command == self.command else 1
        self.command = command
        return True


class FrameSequence:
    """The counters of one relationship.

    ``watchdog_ns``: a sequence with a longer gap is over; no frame may be later against the fastest ones either.
    """

    def __init__(self, cycle_ns: int, watchdog_ns: int) -> None:
        self._cycle_ns = cycle_ns
        self._watchdog_ns = watchdog_ns
        # A frame that is later than this compared with earlier frames is too late in any case.
        self._credit_max = min(max(watchdog_ns - cycle_ns, cycle_ns), _CREDIT_MAX_NS)
        self._present: _Run | None = None
        self._followed: list[_Run] = []
        self.elapsed_ns = 0
        """Time by the PLC's clock since the start of the present sequence."""
        self.repeats = 0
        """Number of frames with the same command, up to the newest one, when a sequence becomes the present one."""

    def lose(self) -> None:
        """The PLC is lost: only a new sequence counts."""
        self._report_old()
        self._present = None

    def next(self, counter: int, time: int) -> bool:
        """Whether a frame is the next one of the present sequence; it is taken then."""
        present = self._present
        if present is None:
            return False
        advance = present.advance(counter, time, self._credit_max)
        if not advance:
            return False
        present.frames += 1
        self.elapsed_ns += advance
        return True

    @property
    def alone(self) -> bool:
        """No frame of before the present sequence can come any more."""
        present = self._present
        return present is not None and present.time - present.first >= OLDEST_NS

    def place(self, counter: int) -> int | None:
        """Where, in ``elapsed_ns``, a frame belongs that the newest one overtook; None when that was too long ago."""
        present = self._present
        if present is None:
            return None
        behind = (present.counter - counter & _COUNTS) * COUNTER_UNIT_NS
        return self.elapsed_ns - behind if behind <= self._watchdog_ns else None

    def follow(self, source: Hashable, counter: int, time: int, command: Hashable, *, may_connect: bool) -> Order:
        """Classify a frame that ``next`` did not accept. NEXT: its sequence is now the present one.

        ``command``: order of the frame, to count repetitions; ``may_connect`` False: a loss must be processed first.
        """
        # Frames older than the watchdog time belong to no sequence.
        self._followed = [run for run in self._followed if time - run.time <= self._watchdog_ns]
        for run in self._followed:
            if run.source == source and run.extend(counter, time, self._cycle_ns, command):
                break
        else:
            self._make_room()
            beside = self._present.frames if self._present is not None else 0
            run = _Run(source, counter, time, self._cycle_ns // 2, command, beside)
            self._followed.append(run)
        self._report_old()
        if self._present is not None:
            if run.frames < SEQUENCE_FRAMES:
                return Order.STALE
            return Order.RESTARTED if self._present.time < run.first else Order.BESIDE
        if run.old_until is not None and time < run.old_until:
            return Order.STALE
        if run.frames < SEQUENCE_FRAMES or not may_connect:
            return Order.UNCONFIRMED
        run.credit = self._credit_max
        self._followed.remove(run)
        self._present = run
        self.elapsed_ns = 0
        self.repeats = run.repeats
        return Order.NEXT

    def _report_old(self) -> None:
        present = self._present
        if present is None or not self.alone:
            return  # the older of two young sequences is unknown
        for run in self._followed:
            beside = present.frames - run.started_at
            if beside >= SEQUENCE_FRAMES and present.time - run.first > self._watchdog_ns:
                run.old_until = present.time + OLDEST_NS

    def _make_room(self) -> None:
        if len(self._followed) >= _FOLLOWED:
            self._followed.remove(min(self._followed, key=lambda run: (run.frames > 1, run.time)))


class NewerFrames:
    """The counters where no frame is delayed (Ethernet, recordings): the first frame connects, newer ones follow."""

    elapsed_ns = 0
    repeats = 1
    alone = True
    """Nothing is delayed."""

    def __init__(self) -> None:
        self._last: int | None = None

    def lose(self) -> None:
        """As ``FrameSequence.lose``."""
        self._last = None

    def place(self, counter: int) -> int | None:
        """As ``FrameSequence.place``; nothing depends on it here."""
        return None

    def next(self, counter: int, time: int) -> bool:
        """As ``FrameSequence.next``."""
        if self._last is None or not is_newer(counter, self._last):
            return False
        self._last = counter
        return True

    def follow(self, source: Hashable, counter: int, time: int, command: Hashable, *, may_connect: bool) -> Order:
        """As ``FrameSequence.follow``."""
        if self._last is not None:
            return Order.STALE
        if not may_connect:
            return Order.UNCONFIRMED
        self._last = counter
        return Order.NEXT
