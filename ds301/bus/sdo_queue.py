"""SDO requests: which ones are open, and a gap between them, so that the bus stays free for other frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.loop.loop import Loop, Timer

_LENGTH: Final = 1024
"""Requests that may wait."""
_OPEN_NS: Final = 1_000 * MS
"""A request is open for this time at most."""


class SdoQueue:
    """Of one bus. ``send`` sends a frame, or queues it until the interface has room."""

    def __init__(self, loop: Loop, send: Callable[[int, bytes], bool]) -> None:
        self._loop = loop
        self._send = send
        self.gap_ns = 0
        """Time between two requests; 0: they need none."""
        self.asked: set[int] = set()
        """The COB-IDs of requests that are not answered,"""
        self._asked_until = 0
        """before this time."""
        self._next = 0
        self._frames: deque[tuple[int, bytes]] = deque()
        self._due: Timer | None = None

    def ask(self, cob_id: int, now: int) -> None:
        """A request is made whose answer is to be received when it arrives."""
        self.asked.add(cob_id)
        self._asked_until = now + _OPEN_NS

    def awaits_answer(self, now: int) -> bool:
        """A request is open."""
        return bool(self.asked) and now < self._asked_until

    def add(self, cob_id: int, data: bytes) -> bool:
        """Send a request when its time has come, unless the same one waits. False: too many wait."""
        if (cob_id, data) in self._frames:
            return True
        if len(self._frames) >= _LENGTH:
            return False
        self._frames.append((cob_id, data))
        if self._due is None:
            self._send_next()
        return True

    def _send_next(self) -> None:
        now = self._loop.now()
        if now >= self._next:
            self._send(*self._frames.popleft())
            self._next = now + self.gap_ns
        self._due = self._loop.call_at(self._next, self._send_next) if self._frames else None

    def clear(self) -> None:
        """Drop what waits."""
        self._frames.clear()
        if self._due is not None:
            self._due.cancel()
            self._due = None
