"""The next sender on a bus whose interface is full: stops first, then the sender that has waited longest.

The queue contains senders, not frames: a sender sends its newest values when it is served. Sans-I/O.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

from pdgw.ds301.communication import NMT

_LIMIT: Final = 256
"""Frames that may wait in one ``FrameQueue``."""


class Sender(Protocol):
    """Something that has frames for the bus."""

    def send_waiting(self) -> bool:
        """Send what waits; False as soon as the interface has no room."""


class SendQueue:
    """Senders that wait for room, each of them once. A sender that waits already keeps its place."""

    def __init__(self) -> None:
        self._stops: dict[Sender, None] = {}
        self._others: dict[Sender, None] = {}

    def add(self, sender: Sender, *, stop: bool) -> None:
        """Wait after all others; ``stop``: only after other stops. A stop stays a stop until it is sent."""
        if stop:
            self._others.pop(sender, None)
            self._stops[sender] = None
        elif sender not in self._stops:
            self._others[sender] = None

    def flush(self) -> bool:
        """Give each sender its turn; False when the interface has no room for one that still waits."""
        for senders in (self._stops, self._others):
            while senders:
                sender = next(iter(senders))
                if not sender.send_waiting():
                    return False
                senders.pop(sender, None)
        return True


class FrameQueue:
    """A ``Sender`` of frames that go out in their order: NMT, SDO, SYNC, heartbeat.

    ``put`` sends one frame, False when the interface has no room.
    """

    def __init__(self, put: Callable[[int, bytes], bool]) -> None:
        self._put = put
        self._frames: deque[tuple[int, bytes]] = deque()

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, can_id: int, data: bytes) -> bool:
        """Another frame; False when too many wait. One that waits already is not sent twice, except an NMT command."""
        frame = can_id, data
        if can_id != NMT and frame in self._frames:
            return True
        if len(self._frames) >= _LIMIT:
            return False
        self._frames.append(frame)
        return True

    def send_waiting(self) -> bool:
        while self._frames:
            if not self._put(*self._frames[0]):
                return False
            self._frames.popleft()
        return True
