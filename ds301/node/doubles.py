"""Signs of two devices with one node-ID: second answers to an SDO request, and frames more often than one device sends them.

Pure. A healthy device shows none of them by late answers to repeated requests, answers to other clients, frames that waited for
the bus or for the gateway, and a frame that a CAN controller receives twice.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from pdgw.ds301.sdo_transfer import ABORT, BLOCK_SINK, BLOCK_SOURCE, COMMAND, CONFIRM, DOWNLOAD, UPLOAD, address_in

_REQUESTS: Final = (DOWNLOAD, UPLOAD)
_RESPONSES: Final = (CONFIRM, UPLOAD)
_BLOCKS: Final = (BLOCK_SINK, BLOCK_SOURCE)
_BLOCK_COMMAND: Final = COMMAND | 1
_OBJECTS: Final = 4096
"""Objects that are distinguished: data of other clients' block transfers may look like requests."""
_ANSWERS: Final = 8
_SECOND_ANSWERS: Final = 3
"""Number of second ones among the last answers: a disturbed frame that is received twice is rarer."""
_EARLY: Final = 5
_EARLY_PERIODS: Final = 100
"""Number of early frames, within this number of periods."""
_PAUSE_PERIODS: Final = 300
"""Longest pause, in periods, whose frames may arrive together afterwards."""


class SecondAnswers:
    """The SDO answers of one node, compared with the requests of all clients."""

    def __init__(self) -> None:
        self._open: dict[bytes, int] = {}
        """Requests without an answer by index and subindex; a lost answer stays open."""
        self._recent: deque[bool] = deque(maxlen=_ANSWERS)
        self.found = False
        """Two devices answer."""

    def begin(self) -> None:
        """Forget everything: another device may be connected."""
        self._open.clear()
        self._recent.clear()
        self.found = False

    def requested(self, request: bytes) -> None:
        """A frame of a client to the node. Segments name no object and are ignored."""
        if not request or (request[0] & COMMAND not in _REQUESTS and request[0] & _BLOCK_COMMAND not in _BLOCKS):
            return
        if len(self._open) > _OBJECTS:
            self._open.clear()
        address = address_in(request)
        self._open[address] = self._open.get(address, 0) + 1

    def answered(self, answer: bytes) -> None:
        """A frame of the node. An abort may also end a transfer whose first frame was answered: it is never a second answer."""
        if not answer or (answer[0] != ABORT and answer[0] & COMMAND not in _RESPONSES):
            return
        address = address_in(answer)
        count = self._open.get(address)
        if count:
            self._open[address] = count - 1
        if count is not None and answer[0] != ABORT:
            self._recent.append(count == 0)
            self.found = self._recent.count(True) >= _SECOND_ANSWERS


class FrameRate:
    """Frames of one COB-ID that one device sends once in each ``period``; times in any unit, such as a number of SYNC."""

    def __init__(self, period: int) -> None:
        self._period = period
        self._last: int | None = None
        self._pause = 0
        """Time without frames: these may still arrive."""
        self._early: deque[int] = deque(maxlen=_EARLY)
        self.found = False
        """Two devices send."""

    def see(self, now: int) -> None:
        """A frame has arrived."""
        period, last = self._period, self._last
        self._last = now
        if last is None:
            return
        gap = now - last
        if 10 * gap < 6 * period and self._pause + gap < period:
            self._pause = 0
            self._early.append(now)
            self.found = len(self._early) == _EARLY and now - self._early[0] <= _EARLY_PERIODS * period
        elif gap >= period or 10 * gap < 9 * period:  # a clock that is a little fast does not use up the pause
            self._pause = min(max(0, self._pause + gap - period), _PAUSE_PERIODS * period)
