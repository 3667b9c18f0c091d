"""Objects that a node has in no TPDO: they are read by SDO in turn, and each value has an age.

The device has a value at a moment between request and answer, so the time of a value is that of its request. Without I/O.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.objects import Entry

POLL_NS: Final = 100 * MS
"""An object is read with this period, or as often as the answers to all objects allow."""
_POLLS: Final = 3
"""A value of more polls is old. Three are longer than twice the slowest answer, which a regular value may be old."""
OLDEST_NS: Final = SECOND
"""An older value is old in any case."""
_MEMORY_NS: Final = 60 * SECOND
"""Time in which the slowest answer counts."""
_ANSWER_NS: Final = 2 * SECOND
"""Until this time after a request that timed out, its answer may come, and look like that to the next request of the object."""
_NEVER: Final = 1 << 62


class PolledObject:
    """One object. Times are monotonic nanoseconds."""

    def __init__(self, entry: Entry, now: int) -> None:
        self.entry = entry
        self.due = now
        """When it has to be read again."""
        self.asked_ns = 0
        """When its newest value was requested; 0: there is none."""
        self.until_ns = 0
        """Afterwards this value is old: unknown."""
        self.answered_ns = now
        """When its newest value came."""
        self.failures = 0
        """Number of requests in a row that were not answered."""
        self._open: list[int] = []
        """When the requests were sent to which an answer may still come, the oldest first."""
        self._slow: deque[tuple[int, int]] = deque()
        """When an answer came and how long it took: the slowest, and after each one the slowest that came later."""

    def ask(self, now: int) -> None:
        """A request is about to be sent."""
        self.due = now + POLL_NS
        self.failures += 1

    def answer(self, asked: int, now: int) -> None:
        """The answer to a request that was sent at ``asked``: it may be that to an earlier one."""
        slow, taken = self._slow, now - asked
        waiting = [*(time for time in self._open if now - time < _ANSWER_NS), asked]
        self.asked_ns, *self._open = waiting
        self.answered_ns, self.failures = now, 0
        while slow and slow[-1][1] <= taken:
            slow.pop()
        slow.append((now, taken))
        while slow[0][0] < now - _MEMORY_NS:
            slow.popleft()

    def miss(self, asked: int) -> None:
        """No answer in time to the request that was sent at ``asked``."""
        self._open.append(asked)

    @property
    def slowest_ns(self) -> int:
        """The slowest answer of the last minute."""
        return self._slow[0][1] if self._slow else 0


class Polling:
    """The objects of one node."""

    def __init__(self) -> None:
        self.objects: tuple[PolledObject, ...] = ()
        self.due = _NEVER
        """When one of them has to be read."""
        self.age_ns = _POLLS * POLL_NS
        """An older value is old."""

    def begin(self, entries: Iterable[Entry], now: int) -> None:
        """Another plan."""
        self.objects = tuple(PolledObject(entry, now) for entry in entries)
        self.schedule()

    def find(self, attribute: str) -> PolledObject | None:
        """The object of an image attribute; None: it is not read."""
        return next((item for item in self.objects if item.entry.attribute == attribute), None)

    def schedule(self) -> None:
        """An object was read, or is about to be."""
        self.due = min((item.due for item in self.objects), default=_NEVER)

    def next(self, now: int) -> PolledObject:
        """The object whose turn it is. It is asked."""
        item = min(self.objects, key=lambda item: item.due)
        item.ask(now)
        self.schedule()
        return item

    def answered(self, item: PolledObject, asked: int, now: int) -> None:
        """The answer to a request that was sent at ``asked``."""
        item.answer(asked, now)
        poll = max(POLL_NS, sum(item.slowest_ns for item in self.objects))
        self.age_ns = min(_POLLS * poll, OLDEST_NS)
        item.until_ns = item.asked_ns + self.age_ns

    def resume(self, now: int) -> None:
        """The node is online: nothing was read for a while, and everything is now."""
        for item in self.objects:
            item.due = item.answered_ns = now
        self.schedule()

    def unread(self, times: int, within_ns: int, now: int) -> str:
        """What could not be read ``times`` times in a row, or for longer than ``within_ns``, as text; empty: nothing."""
        if sum(item.failures for item in self.objects) >= times:
            return f"objects without PDO could not be read {times} times"
        if any(now - item.answered_ns > within_ns for item in self.objects):
            return f"objects without PDO were not read for {within_ns // MS} ms"
        return ""
