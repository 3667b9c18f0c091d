"""Repeated losses of a PLC, of both links: one reason for all of them."""

from __future__ import annotations

from collections import deque
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.finding_text import finding_line, with_count
from pdgw.gateway.base.reasons import Finding, Reason

NAMED_NS: Final = 10 * SECOND
"""Time for which another sender, frames that do not count, and repeated losses are named."""
_REPORTED_NS: Final = 60 * SECOND
"""Time between two reports of repeated losses."""
_REPEATED: Final = 3
"""Losses in this time that have one reason."""
_LONGEST_PAUSE_NS: Final = SECOND
"""A PLC that sends nothing for longer does not only send too slowly."""


class RepeatedLosses:
    """Losses of a PLC that keeps sending. Three of them in a short time have one reason until they end: the newest one."""

    def __init__(self, limit_ns: int) -> None:
        self._limit_ns = limit_ns
        self._losses: deque[tuple[int, int, Finding | None]] = deque(maxlen=_REPEATED)
        """When, the time without a frame, and why the frames did not count; None if there were none."""
        self._until = 0
        self._begin = self._last = -NAMED_NS
        """The first and the last loss of a series."""
        self._count = 0
        self._reported_at = 0

    def add(self, now: int, silence_ns: int, cause: Finding | None = None) -> None:
        """The PLC sends again at ``now``, or (``cause``) its frames have not counted for too long."""
        self._losses.append((now, silence_ns, cause))
        if len(self._losses) == _REPEATED and now - self._losses[0][0] <= NAMED_NS:
            self._until = now + NAMED_NS

    def report(self, text: str, now: int) -> str:
        """The text of a loss for log and fault. Repeated ones are reported with their number once a minute, and else empty."""
        if now - self._last >= NAMED_NS:
            self._begin, self._count, self._reported_at = now, 0, now - _REPORTED_NS
        self._last = now
        self._count += 1
        finding = self.finding(now)
        if finding is None:
            return text
        if now - self._reported_at < _REPORTED_NS:
            return ""
        self._reported_at = now
        return with_count(finding_line(finding), self._count, now - self._begin)

    def returned(self, now: int, silence_ns: int) -> None:
        """A frame came after this time without one."""
        if self._limit_ns < silence_ns <= _LONGEST_PAUSE_NS:
            self.add(now, silence_ns)

    def finding(self, now: int) -> Finding | None:
        """The reason of all losses, None unless they are repeated."""
        if not self._losses or now >= self._until:
            return None
        cause = self._losses[-1][2]
        if cause is not None:
            return cause
        pauses = sorted({f"{pause / MS:.0f}" for _, pause, why in self._losses if why is None}, key=int)
        apart = " to ".join(pauses[:1] + pauses[1:][-1:])
        return Finding.of(
            Reason.WATCHDOG_SHORT,
            f"the PLC is lost repeatedly: its frames come {apart} ms apart, the limit is {self._limit_ns / MS:g} ms",
        )
