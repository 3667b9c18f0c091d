"""Recent frames of a PLC, to recognise a delayed copy. Sans-I/O.

Source: docs/transport.md chapter 1. The cycle counter repeats every 2.048 s, so a frame that is delayed by one or two turns fits
the present sequence. Such a copy equals, in every byte, a frame that was sent one or two turns ago. A frame is new if the frames
of both moments are known and differ from it. The content of a lost frame is unknown, but its sign of life follows from adjacent
frames; this extends the period from 2 s to 30 s.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from typing import Final

from pdgw.gateway.links.sequence import OLDEST_NS, WRAP_NS
from pdgw.profidrive.frame import COUNTER_UNIT_NS
from pdgw.profidrive.sign_of_life import HIGHEST

_TURNS: Final = range(1, OLDEST_NS // WRAP_NS + 1)
_KEPT_NS: Final = _TURNS[-1] * WRAP_NS + WRAP_NS // 4
_MOST: Final = 1 << 16
"""Maximum number of frames; then the history is cleared, so that a flood of late frames costs no time."""
_COUNTED_CYCLES: Final = 4
"""The sign of life of lost frames is inferred across gaps up to this long."""
_LIFE_SHIFT: Final = 4
"""The sign of life is the high half of the first byte of its word (a test)."""


class FrameHistory:
    """The frames of one connection, by the PLC's clock in nanoseconds.

    ``order_mask``: the bits of a frame that can start or stop something, as one big-endian integer. ``lives``: offsets of the
    words with a sign of life.
    """

    def __init__(self, cycle_ns: int, order_mask: int, lives: Sequence[int]) -> None:
        self._step_ns = max(cycle_ns // COUNTER_UNIT_NS, 1) * COUNTER_UNIT_NS
        # A frame is missing between two with a greater distance.
        self._gap_ns = self._step_ns * 3 // 2
        self._order_mask = order_mask
        self._lives = tuple(lives)
        self._times: deque[int] = deque()
        self._frames: deque[bytes | None] = deque()

    def clear(self) -> None:
        """A new connection: nothing is known of the time before."""
        self._times.clear()
        self._frames.clear()

    def enter(self, data: bytes, elapsed_ns: int) -> None:
        """A frame was accepted."""
        times, frames = self._times, self._frames
        times.append(elapsed_ns)
        frames.append(data)
        oldest = elapsed_ns - _KEPT_NS
        while times[0] < oldest:
            times.popleft()
            frames.popleft()

    def contradict(self, data: bytes, time: int) -> bool:
        """Another frame of this time arrived late: if it differs, the content sent at that time is unknown.

        True: the PLC cannot have sent both. A frame that was overtaken has the command of an adjacent one.
        """
        times, frames = self._times, self._frames
        place = bisect_right(times, time) - 1
        if place < 0:
            return False
        before = frames[place]
        if times[place] == time:
            if before == data:
                return False
            frames[place] = None
            return before is not None
        after = frames[place + 1]
        if len(times) < _MOST:
            times.insert(place + 1, time)
            frames.insert(place + 1, None)
        else:
            self.clear()
        if before is None or after is None:
            return False
        return self._order(data) not in {self._order(before), self._order(after)}

    def is_new(self, data: bytes, elapsed_ns: int) -> bool:
        """Whether a frame of this time cannot be a copy of one sent a turn of the counter, or two, before."""
        return all(self._differs(data, elapsed_ns - turn * WRAP_NS) for turn in _TURNS)

    def _differs(self, data: bytes, time: int) -> bool:
        """Whether this is certainly no copy of a frame sent at that time."""
        times, frames = self._times, self._frames
        place = bisect_right(times, time) - 1
        if place < 0 or place + 1 == len(times):
            return False
        before, after = frames[place], frames[place + 1]
        if times[place] == time:
            return before is not None and before != data
        if before is None or after is None:
            return False
        if times[place + 1] - times[place] <= self._gap_ns:
            # No frame was sent in between. Or a PLC with jitter sent one that was lost and had the same command as the
            # adjacent ones.
            order = self._order(data)
            alike = order in (self._order(before), self._order(after))
            return not alike or any(_follows(before[at], after[at]) for at in self._lives)
        return self._counted(before, time - times[place], data, after, times[place + 1] - time)

    def _order(self, data: bytes) -> int:
        return int.from_bytes(data, "big") & self._order_mask

    def _counted(self, before: bytes, since: int, data: bytes, after: bytes, until: int) -> bool:
        """Whether the frame lost between two others had another sign of life, which both of them imply."""
        step = self._step_ns
        if since % step or until % step or since + until > _COUNTED_CYCLES * step:
            return False
        for offset in self._lives:
            first, here, last = (frame[offset] >> _LIFE_SHIFT for frame in (before, data, after))
            if first and here and last:
                lost = _count(first, since // step)
                if _count(lost, until // step) == last and here != lost:
                    return True
        return False


def _follows(before: int, after: int) -> bool:
    """No step of the sign of life between two bytes."""
    life = before >> _LIFE_SHIFT
    return life > 0 and after >> _LIFE_SHIFT == _count(life, 1)


def _count(life: int, cycles: int) -> int:
    """The sign of life after this number of cycles."""
    return (life - 1 + cycles) % HIGHEST + 1
