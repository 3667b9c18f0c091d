"""The device side of a static cyclic relationship, sans-I/O: which frames count, and the frames sent back.

Source: docs/transport.md chapters 1 and 2. A frame is used only when it comes from the relationship's peer, has its FrameID
and length, is newer than the last one, is valid and primary; provider STOP and IOPS BAD are losses of the PLC. Everything
else is counted by its verdict and dropped.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

from pdgw.gateway.transport.udp import Address
from pdgw.profidrive.frame import (
    COUNTER_UNIT_NS,
    FRAME_ID_TO_CONTROLLER,
    FRAME_ID_TO_DEVICE,
    HEADER,
    IOPS_BAD,
    IOPS_GOOD,
    STATUS_DATA_VALID,
    STATUS_NORMAL,
    STATUS_PRIMARY,
    STATUS_RUN,
    TRAILER,
    CSduLayout,
    is_newer,
)
from pdgw.profidrive.telegrams import Direction, Telegram


class Verdict(enum.Enum):
    """What became of a received datagram; the value is the name of its counter."""

    ACCEPTED = "accepted"
    PROVIDER_STOP = "provider stop"
    FOREIGN_SENDER = "foreign sender"
    TRUNCATED = "truncated"
    OVERSIZED = "oversized"
    WRONG_FRAME_ID = "wrong FrameID"
    STALE = "stale cycle counter"
    WRONG_TELEGRAM = "data behind the last object: the PLC sends another telegram or more axes"
    NOT_VALID = "data not valid"
    NOT_PRIMARY = "not primary"


class CyclicEndpoint:
    """Consumer and provider of one static relationship with any number of axes.

    ``setpoints[i]`` are the raw values of axis i, None while that axis has no valid PLC. Times are monotonic nanoseconds.
    ``peer``: the only address frames are taken from; None takes the first valid sender until it is lost.
    """

    def __init__(
        self,
        telegrams: Sequence[Telegram],
        *,
        cycle_ns: int,
        watchdog_factor: int = 3,
        peer: str | None = None,
        setpoint_frame_id: int = FRAME_ID_TO_DEVICE,
        actual_frame_id: int = FRAME_ID_TO_CONTROLLER,
    ) -> None:
        self._consumer = CSduLayout(telegrams, Direction.SETPOINT)
        self._provider = CSduLayout(telegrams, Direction.ACTUAL)
        self._frame_id = setpoint_frame_id
        self._padding_start = HEADER.size + self._consumer.used
        self._padding = bytes(self._consumer.trailer - self._padding_start)
        self._frame = self._provider.new_frame(actual_frame_id)
        self._step = max(1, cycle_ns // COUNTER_UNIT_NS)
        self._counter = 0
        self._watchdog_ns = cycle_ns * watchdog_factor
        self._fixed_peer = peer
        self._last_counter = 0
        self._last_time = 0
        self._axes = tuple(
            (index, half.struct.unpack_from, offset, iops)
            for index, (half, offset, iops) in enumerate(
                zip(self._consumer.halves, self._consumer.offsets, self._consumer.iops, strict=True)
            )
        )
        provider = self._provider
        self._answers = tuple(
            (index, half.struct.pack_into, provider.offsets[index], provider.iops[index], provider.iocs[index])
            for index, half in enumerate(provider.halves)
        )
        self.setpoints: list[tuple[int, ...] | None] = [None] * len(telegrams)
        self.peer: Address | None = None
        """Where frames come from and go to; kept after a loss so that the PLC can watch the axes stop."""
        self.connected = False
        self.counters: dict[Verdict, int] = dict.fromkeys(Verdict, 0)
        self.watchdog_expiries = 0
        self.iops_bad = 0
        self.sent = 0

    @property
    def frame_size(self) -> int:
        """Bytes of a frame from the PLC."""
        return self._consumer.frame_size

    def continue_from(self, previous: CyclicEndpoint) -> None:
        """Follow an endpoint with other telegrams: its counts go on, and its cycle counter, or the PLC would see old frames."""
        self._counter = previous._counter
        self.counters = previous.counters
        self.watchdog_expiries = previous.watchdog_expiries
        self.iops_bad = previous.iops_bad
        self.sent = previous.sent

    def receive(self, data: bytes, source: Address, now: int) -> Verdict:
        """Take a datagram; on ACCEPTED (and on PROVIDER_STOP, then None) the setpoints are updated."""
        verdict = self._check(data, source)
        self.counters[verdict] += 1
        if verdict is Verdict.ACCEPTED:
            self._accept(data, source, now)
        elif verdict is Verdict.PROVIDER_STOP:
            self._last_time = now
            self.peer = source
            self.connected = True
            self.lose_setpoints()
        return verdict

    def _check(self, data: bytes, source: Address) -> Verdict:
        layout = self._consumer
        size = len(data)
        if self._fixed_peer is not None:
            if source[0] != self._fixed_peer:
                return Verdict.FOREIGN_SENDER
            if self.connected and source != self.peer:
                return Verdict.FOREIGN_SENDER
        elif self.connected and source != self.peer:
            return Verdict.FOREIGN_SENDER
        if size != layout.frame_size:
            return Verdict.TRUNCATED if size < layout.frame_size else Verdict.OVERSIZED
        if HEADER.unpack_from(data)[0] != self._frame_id:
            return Verdict.WRONG_FRAME_ID
        if data[self._padding_start : layout.trailer] != self._padding:
            return Verdict.WRONG_TELEGRAM
        counter, status, _ = TRAILER.unpack_from(data, layout.trailer)
        if self.connected and not is_newer(counter, self._last_counter):
            return Verdict.STALE
        if not status & STATUS_DATA_VALID:
            return Verdict.NOT_VALID
        if not status & STATUS_PRIMARY:
            return Verdict.NOT_PRIMARY
        self._last_counter = counter
        return Verdict.ACCEPTED if status & STATUS_RUN else Verdict.PROVIDER_STOP

    def _accept(self, data: bytes, source: Address, now: int) -> None:
        self._last_time = now
        self.peer = source
        self.connected = True
        setpoints = self.setpoints
        for index, unpack, offset, iops in self._axes:
            if data[iops] & IOPS_GOOD:
                setpoints[index] = unpack(data, offset)
            else:
                setpoints[index] = None
                self.iops_bad += 1

    def lose_setpoints(self) -> None:
        """No axis has a valid PLC until the next valid frame."""
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None

    def poll(self, now: int) -> bool:
        """The watchdog; True when it expires in this call."""
        if not self.connected or now - self._last_time <= self._watchdog_ns:
            return False
        self.connected = False
        self.watchdog_expiries += 1
        self.lose_setpoints()
        return True

    def build(self, actuals: Sequence[Sequence[int]], good: Sequence[bool]) -> bytearray:
        """The next frame to the PLC. ``good[i]``: axis i's actual values are valid (its IOPS). The buffer is reused."""
        frame = self._frame
        layout = self._provider
        setpoints = self.setpoints
        for index, pack_into, offset, iops, iocs in self._answers:
            pack_into(frame, offset, *actuals[index])
            frame[iops] = IOPS_GOOD if good[index] else IOPS_BAD
            frame[iocs] = IOPS_GOOD if setpoints[index] is not None else IOPS_BAD
        self._counter = (self._counter + self._step) & 0xFFFF
        TRAILER.pack_into(frame, layout.trailer, self._counter, STATUS_NORMAL, 0)
        self.sent += 1
        return frame
