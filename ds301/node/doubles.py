"""Two devices with one node-ID: what is a suspicion, and what proves it.

A frame before its time is a suspicion: healthy devices send such heartbeats. The node is then asked: each of two devices
answers an SDO request. Pure. A healthy device gives no proof by late answers to repeated requests, answers to other clients,
frames that waited for the bus or for the gateway, and a frame that a CAN controller receives twice.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.pdo import Pdo
from pdgw.ds301.sdo_frames import ABORT, BLOCK_SINK, BLOCK_SOURCE, COMMAND, CONFIRM, DOWNLOAD, UPLOAD, address_in

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
_EARLY_SYNCS: Final = 100
"""Number of second TPDOs that prove two devices, within this number of SYNC; and of jumps during the questions."""
_LATE_SYNCS: Final = 300
"""Longest pause, in SYNC, whose TPDOs may arrive together afterwards."""
_ANSWERED_NS: Final = SECOND
"""Longest time until two devices have answered the questions."""
_PAUSE_NS: Final = 2 * SECOND
"""Time between two examinations."""


class Doubles:
    """Of one node: its SDO answers, compared with the requests of all clients, and its early frames."""

    def __init__(self) -> None:
        self._open: dict[bytes, int] = {}
        """Requests without an answer by index and subindex; a lost answer stays open."""
        self._recent: deque[bool] = deque(maxlen=_ANSWERS)
        """Which of the last answers are second ones."""
        self.early = 0
        """Heartbeats and second TPDOs for one SYNC that came before their time."""
        self._examined = 0
        """Number of them when the last examination began,"""
        self._since = -_PAUSE_NS
        """and when that was, monotonic nanoseconds."""
        self.questions = 0
        """SDO requests that are still to be sent."""
        self.proof = ""
        """Empty, or what shows two devices."""

    def begin(self) -> None:
        """Forget everything: another device may be connected."""
        self._open.clear()
        self._recent.clear()
        self._examined, self._since, self.questions, self.proof = self.early, -_PAUSE_NS, 0, ""

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
            if self._recent.count(True) >= _SECOND_ANSWERS:
                self.proof = "SDO requests are answered twice"

    def begins(self, now: int) -> bool:
        """Whether frames were early since the last examination: another one begins, with questions to the node."""
        if self.early == self._examined or now - self._since < _PAUSE_NS:
            return False
        self._examined, self._since, self.questions = self.early, now, _ANSWERS
        return True

    def contradicted(self, sign: str, now: int) -> None:
        """A sign other than early frames: it counts if it persists, although the questions have proved nothing."""
        if _ANSWERED_NS <= now - self._since < _PAUSE_NS:
            self.proof = sign


class SecondTpdos:
    """The frames of a TPDO that one device sends once for each SYNC. ``name``: of the TPDO."""

    def __init__(self, doubles: Doubles, name: str) -> None:
        self._doubles = doubles
        self._name = name
        self._last = -1
        self._missing = 0
        """SYNC without a frame: it may still arrive."""
        self._early: deque[int] = deque(maxlen=_EARLY)

    def see(self, syncs: int) -> None:
        """A frame has arrived after this number of SYNC."""
        missing = self._missing + syncs - self._last - 1 if self._last >= 0 else 0
        self._last = syncs
        self._missing = min(max(0, missing), _LATE_SYNCS)
        if missing < 0:
            self._doubles.early += 1
            self._early.append(syncs)
            if len(self._early) == _EARLY and syncs - self._early[0] <= _EARLY_SYNCS:
                self._doubles.proof = f"{self._name} more often than SYNC"


class Jumps:
    """The positions in the frames of a TPDO: those of two devices jump there and back. ``turn``: position units of a revolution.

    Noise moves a position by less than an eighth of a revolution, and one that wraps by whole revolutions.
    """

    def __init__(self, doubles: Doubles, pdo: Pdo, attribute: str, turn: int) -> None:
        self._doubles = doubles
        self._pdo = pdo
        self._place = pdo.attributes.index(attribute)
        self._turn = turn
        self._last = self._before = self._count = 0

    def see(self, data: bytes, now: int) -> None:
        """A frame with other values than the last one."""
        turn, position = self._turn, self._pdo.struct.unpack_from(data)[self._place]
        jump, back = position - self._last, position - self._before
        self._before, self._last = self._last, position
        if turn < 8 * (jump % turn) < 7 * turn and 4 * abs(back) < abs(jump):
            self._count += 1
            if self._count >= _EARLY:
                self._doubles.contradicted(f"{self._pdo} shows two positions", now)
