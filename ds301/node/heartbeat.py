"""Whether a node is there: its heartbeat or its answers to node guarding, and its boot-up messages (CiA DS 301)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from pdgw.base.durations import MS
from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import ERROR_CONTROL, GUARD_TOGGLE, HEARTBEAT_STATE, NMT_STATES, NmtCommand, NmtState
from pdgw.ds301.node.doubles import Doubles
from pdgw.ds301.node.node import Cause, TpdoSlot

_STATES: Final = 4
"""A, B, A, B: the states of two devices."""
OFTEN: Final = 10
"""Number of early heartbeats in a row that are a shorter period, not a burst."""
_PRODUCER: Final = "check the firmware of the device, and who writes 1017h"


class Heartbeat:
    """What a node reports under its error control COB-ID."""

    def __init__(self, network: CanNetwork, node_id: int, doubles: Doubles) -> None:
        self._network = network
        self._node_id = node_id
        self._doubles = doubles
        self.time = 0
        """Arrival of the last report, monotonic nanoseconds; 0: none."""
        self.gap = 0
        """Time between the last two reports, in nanoseconds; 0 if the first one was a boot-up message."""
        self._last = 0
        """As ``time``; 0 after a boot-up message."""
        self.state = NmtState.BOOT_UP.value
        """The NMT state in it."""
        self.stopped = False
        """It says Stopped."""
        self.foreign = 0
        """The last NMT command to the node, if another master sent it and it is not Start; else 0."""
        self.expected = False
        """The node reports without end; its silence is a loss."""
        self.by_requests = False
        """It answers remote requests with a toggle bit (node guarding)."""
        self._toggle = -1
        self._shortest = 0
        """A report after less than this time is early, in nanoseconds; 0: none is."""
        self._expected_gap = 0
        """The same from the second report on: the first may have had another period before it."""
        self.in_row = 0
        """Number of the last reports that were early; from ``OFTEN`` on, of all reports."""
        self._states: deque[int] = deque(maxlen=_STATES)
        """The last different states without an NMT command or a boot-up message between them."""

    def request(self) -> None:
        """Ask a node that uses node guarding for its state."""
        if self.by_requests:
            self._network.request(ERROR_CONTROL + self._node_id)

    def begin(self, period_ms: int) -> None:
        """The node is started now: what it reported before does not count."""
        self.state = NmtState.BOOT_UP.value
        self.stopped = False
        self._toggle = -1
        self.in_row = self._shortest = 0
        self._expected_gap = period_ms * MS * 6 // 10 if self.expected and not self.by_requests else 0

    def commanded(self, data: bytes = b"", _now: int = 0) -> None:
        """An NMT command was sent: the node may show another state. ``data``: that of another master."""
        self._states.clear()
        if not data or data[-1] in (0, self._node_id):
            self.foreign = data[0] if data and data[0] != NmtCommand.START else 0

    def receive(self, data: bytes, now: int) -> bool:
        """A report has arrived; True for a boot-up message."""
        if not data or data[0] & HEARTBEAT_STATE not in NMT_STATES:
            return False
        boots = data[0] == NmtState.BOOT_UP
        if self.by_requests:
            toggle, before = data[0] & GUARD_TOGGLE, self._toggle
            self._toggle = -1 if boots else toggle
            if toggle == before:
                return False  # a repeated answer is not a new one
        self.gap = now - self._last if self._last else 0
        early = 0 < self.gap < self._shortest
        self._shortest = self._expected_gap
        self.in_row = self.in_row + 1 if early or self.in_row >= OFTEN else 0
        self._doubles.early += early
        self.time, self._last = now, 0 if boots else now
        self.state = state = data[0] & HEARTBEAT_STATE
        self.stopped = state == NmtState.STOPPED
        states = self._states
        if boots:
            states.clear()
        elif not states or state != states[-1]:
            states.append(state)
            if len(states) == _STATES and states[0] == states[2] and states[1] == states[3]:
                self._doubles.proof = "heartbeats show two NMT states"
        return boots

    def lost(self, now: int, limit: int, tpdos: Iterable[TpdoSlot]) -> Cause | None:
        """Why the node is lost; None if it is there, or reports nothing at all."""
        if not self.expected or now - self.time <= limit:
            return None
        evidence = f"no heartbeat for {limit // MS} ms"
        if any(slot.time > self.time + limit // 2 for slot in tpdos):
            return Cause(f"{evidence} while its TPDOs arrive", _PRODUCER)
        return Cause(evidence)
