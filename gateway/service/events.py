"""Events of a gateway with numbers: a client that asks for those after the last one misses none, however short it was."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from pdgw.base.durations import MS_PER_SECOND

KEPT: Final = 1000


class Event(NamedTuple):
    """One thing that happened."""

    number: int
    time: float
    """Seconds since 1970."""
    kind: str
    """``fault``, ``warning``, ``reason``, ``plc``, ``bus``, ``node`` or ``gateway``."""
    do_id: int | None
    """The drive object it is about, if any."""
    text: str
    fault: int
    """Number of the fault or warning; 0: neither."""


class EventLog:
    """The last thousand. ``wall``: seconds since 1970.

    The numbers are above those of each earlier gateway: they begin at the start in milliseconds.
    """

    def __init__(self, wall: Callable[[], float]) -> None:
        self._wall = wall
        self.newest = int(wall() * MS_PER_SECOND)
        """The last number."""
        self._events: deque[Event] = deque(maxlen=KEPT)

    def add(self, kind: str, do_id: int | None, text: str, fault: int = 0) -> None:
        """Number it and keep it."""
        self.newest += 1
        self._events.append(Event(self.newest, self._wall(), kind, do_id, text, fault))

    @property
    def last(self) -> Event:
        """The newest one; there is one from the start on."""
        return self._events[-1]

    def after(self, number: int) -> list[Event]:
        """Events with a higher number, the oldest first. A number of the future gets all: the clock was set back."""
        return [event for event in self._events if event.number > number or number > self.newest]
