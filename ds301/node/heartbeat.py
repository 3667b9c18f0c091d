"""Whether a node is there: its heartbeat or its answers to node guarding, and its boot-up messages (CiA DS 301)."""

from __future__ import annotations

from collections.abc import Iterable

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.communication import ERROR_CONTROL, GUARD_TOGGLE, HEARTBEAT_STATE, NMT_STATES, NmtState
from pdgw.ds301.node.doubles import FrameRate
from pdgw.ds301.node.node import TpdoSlot
from pdgw.durations import MS


class Heartbeat:
    """What a node reports under its error control COB-ID."""

    def __init__(self, network: CanNetwork, node_id: int) -> None:
        self._network = network
        self._node_id = node_id
        self.time = 0
        """Arrival of the last report, monotonic nanoseconds; 0: none."""
        self.state = NmtState.BOOT_UP.value
        """The NMT state in it."""
        self.stopped = False
        """It says Stopped."""
        self.expected = False
        """The node reports without end; its silence is a loss."""
        self.by_requests = False
        """It answers remote requests with a toggle bit (node guarding)."""
        self._toggle = -1
        self.rate: FrameRate | None = None
        """Of a heartbeat that the node sends by itself."""

    def request(self) -> None:
        """Ask a node that uses node guarding for its state."""
        if self.by_requests:
            self._network.request(ERROR_CONTROL + self._node_id)

    def begin(self, period_ms: int) -> None:
        """The node is started now: what it reported before does not count."""
        self.state = NmtState.BOOT_UP.value
        self.stopped = False
        self._toggle = -1
        self.rate = FrameRate(period_ms * MS) if self.expected and not self.by_requests else None

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
        self.time = now
        if self.rate is not None:
            self.rate.see(now)
        self.state = data[0] & HEARTBEAT_STATE
        self.stopped = self.state == NmtState.STOPPED
        return boots

    def lost(self, now: int, limit_ms: int, tpdos: Iterable[TpdoSlot]) -> str:
        """Why the node is lost; empty if it is there, or reports nothing at all."""
        if not self.expected:
            return ""
        if now - self.time > limit_ms * MS:
            runs = any(slot.time > self.time + limit_ms * MS // 2 for slot in tpdos)
            but = " while its TPDOs arrive; check the firmware of the device, and who writes 1017h" if runs else ""
            return f"no heartbeat for {limit_ms} ms{but}"
        if self.state != NmtState.OPERATIONAL:
            return f"the heartbeat of node {self._node_id} says {NmtState.text(self.state)}"
        return ""
