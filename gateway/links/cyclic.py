"""Device side of a static cyclic relationship, sans-I/O: which frames count, and the answers.

Source: docs/plc.md "Frames over UDP". A frame counts only if it comes from the relationship's peer, has its FrameID and
length, is new (``new_frames``), is valid and primary. Provider STOP and IOPS BAD are losses of the PLC. All other frames are
counted by their verdict and dropped; ``finding`` names the reason.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from pdgw.base.durations import MS
from pdgw.gateway.base.reasons import Finding, Reason
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.defaults import WATCHDOG_FACTOR
from pdgw.gateway.links.losses import NAMED_NS, RepeatedLosses
from pdgw.gateway.links.new_frames import NewFrames, Verdict
from pdgw.gateway.links.refusals import STATUS_OFFSET, Refusals
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
    CSduLayout,
)
from pdgw.profidrive.telegrams import Direction, Telegram, TelegramHalf

_TICK_AND_COUNTER: Final = struct.Struct(">IH")
"""The end of a frame: the tick, then the CycleCounter."""
IDLE_NS: Final = 20 * MS
"""Longest time between two readings while no PLC is connected and no drive has power."""
_STATUS_USED: Final = STATUS_DATA_VALID | STATUS_PRIMARY | STATUS_RUN
_Axis = tuple[int, Callable[[bytes, int], tuple[int, ...]], int, int]
"""Decoding of a drive object: its number, its values, their place, that of its IOPS."""
_ACCEPTED: Final = Verdict.ACCEPTED
_PROVIDER_STOP: Final = Verdict.PROVIDER_STOP
USUAL: Final = (_ACCEPTED, _PROVIDER_STOP, Verdict.AFTER_LOSS, Verdict.OVERDUE, Verdict.CONNECTING)
"""Verdicts that the status explains without a further text."""


class Reading:
    """Of the socket. All datagrams of one reading have its time."""

    def __init__(self, at: int, before: int, late: bool) -> None:
        self.at = at
        self.before = before
        """Time of the reading before it."""
        self.late = late
        """The watchdog time is over since then."""


class Connection:
    """With a PLC, from the first frame that counts to its loss."""

    def __init__(self) -> None:
        self.arrived = 0
        """Arrival of the newest frame that counts."""
        self.runs = False
        """Provider state of the PLC."""


class Loss:
    """Of a PLC, until the next reading after ``poll`` has reported it to the axes: no other connection begins before."""

    def __init__(self, cause: Finding | None = None) -> None:
        self.cause = cause
        """Why the frames before it did not count; None if there were none."""
        self.reported = False
        """What waits in the socket at this reading is older."""


class Counts:
    """Of a link, over all layouts of its frames."""

    def __init__(self) -> None:
        self.frames: dict[Verdict, int] = dict.fromkeys(Verdict, 0)
        self.watchdog_expiries = 0
        """Losses of the PLC: silence, or a late gateway."""
        self.iops_bad = 0
        self.sent = 0
        self.cycle = 0
        """CycleCounter of the newest frame to the PLC."""


class Refused(NamedTuple):
    """A frame that does not count, at the time of its reading."""

    verdict: Verdict
    sender: Address
    data: bytes
    at: int


def control_mask(half: TelegramHalf) -> bytes:
    """Mask of a telegram's control words in its bytes: all bits that can start or stop something, but no sign of life."""
    mask = [0] * len(half.signals)
    for place, item in enumerate(half.signals):
        if "STW" in item.name or item.name == "Controlword":
            life = sum(bit.mask for bit in item.bits if bit.name == "SIGN_OF_LIFE")
            low, high = item.type.integer_range
            mask[place] = (high - low) & ~life
    return half.struct.pack(*mask)


class CyclicEndpoint:
    """Consumer and provider of one static relationship with any number of axes.

    ``setpoints[i]`` are the raw values of axis i, None while that axis has no valid PLC. Times are monotonic nanoseconds.
    ``peer``: the only accepted sender; None accepts the first valid one until it is lost. ``age_limit_ns``, ``tick_offset``: see
    ``NewFrames``. ``previous``: the endpoint with other telegrams that this one follows.
    """

    def __init__(
        self,
        telegrams: Sequence[Telegram],
        *,
        cycle_ns: int,
        watchdog_factor: int = WATCHDOG_FACTOR,
        peer: str | None = None,
        age_limit_ns: int | None = None,
        tick_offset: int = 0,
        previous: CyclicEndpoint | None = None,
        setpoint_frame_id: int = FRAME_ID_TO_DEVICE,
        actual_frame_id: int = FRAME_ID_TO_CONTROLLER,
    ) -> None:
        self.consumer = CSduLayout(telegrams, Direction.SETPOINT)
        self.provider = CSduLayout(telegrams, Direction.ACTUAL)
        self._header = HEADER.pack(setpoint_frame_id)
        self._padding_start = HEADER.size + self.consumer.used
        self._padding = bytes(self.consumer.tick - self._padding_start)
        self._actual_frame_id = actual_frame_id
        self.frame = b""
        """The newest frame to the PLC."""
        self.received = b""
        """The newest frame of the PLC that was accepted."""
        self._step = max(1, cycle_ns // COUNTER_UNIT_NS)
        self._watchdog_ns = cycle_ns * watchdog_factor
        self._fixed_peer = peer
        self.new_frames = NewFrames(age_limit_ns, tick_offset)
        self.received_ns: int | None = None
        """Arrival of the newest frame that counts; None: none yet."""
        self._heard = -NAMED_NS
        """Arrival of the last frame that fits, whether it counted or not."""
        self.losses = RepeatedLosses(self._watchdog_ns)
        self._reading = Reading(0, 0, late=False)
        self._connection: Connection | None = None
        """None: the first frame that counts begins one, but not during a loss."""
        self._loss: Loss | None = None
        # Other frames, but the same PLC, which would see old frames with another cycle counter.
        self.counts: Counts = Counts() if previous is None else previous.counts
        if previous is not None and previous._loss is not None and not previous._loss.reported:
            self._loss = Loss()
        axes: list[_Axis] = []
        mask = bytearray(self.frame_size)
        for index, (half, offset, iops) in enumerate(
            zip(self.consumer.halves, self.consumer.offsets, self.consumer.iops, strict=True)
        ):
            axes.append((index, half.struct.unpack_from, offset, iops))
            mask[offset : offset + half.size] = control_mask(half)
            mask[iops] = IOPS_GOOD
        mask[self.consumer.trailer + STATUS_OFFSET] = STATUS_RUN
        self._axes = tuple(axes)
        self._control_mask = int.from_bytes(mask, "big")
        self._controls = 0
        self.changed = False
        """The newest frame has other control words, IOPS or provider state than the one before: the axes step before the next."""
        self.setpoints: list[Sequence[int] | None] = [None] * len(telegrams)
        self.peer: Address | None = None
        """Source and target of frames; kept after a loss, so that the PLC sees the axes stop and gets a tick."""
        self.refusals = Refusals(self.consumer, self.provider, telegrams, self._header, self.new_frames, peer)
        self._refused: Refused | None = None
        """The newest frame of the PLC that does not count, if none has counted since."""
        self._foreign: Refused | None = None
        """The newest frame of another sender."""

    @property
    def connected(self) -> bool:
        """A PLC is connected."""
        return self._connection is not None

    @property
    def frame_size(self) -> int:
        """Bytes of a frame from the PLC."""
        return self.consumer.frame_size

    def finding(self, index: int | None = None) -> Finding | None:
        """Why the PLC's frames, or those of another sender, do not count; ``index``: for this axis. None if they do."""
        now = self._reading.at
        if (repeated := self.losses.finding(now)) is not None:
            return repeated
        refused, foreign, connection = self._refused, self._foreign, self._connection
        if connection is None:
            if refused is not None and now - refused.at <= NAMED_NS:
                found, host = self._why(refused), refused.sender[0]
                replaces = self.received_ns is not None and self.peer is not None and self.peer[0] != host
                return found._replace(reason=Reason.OTHER_SENDER) if replaces else found
        elif not connection.runs:
            return Finding.of(Reason.PLC_STOP)
        elif not any(item is not None for item in self.setpoints):
            # Short frames of several layouts have equal lengths: one has its IOPS where another has padding.
            text = "every IOPS of the PLC is BAD" if index is None else Reason.PLC_BAD.value
            return Finding.of(Reason.PLC_BAD, f"{text}; {self.refusals.expected}")
        elif index is not None and self.setpoints[index] is None:
            return Finding.of(Reason.PLC_BAD)
        if foreign is None or foreign.sender == self.peer or now - foreign.at > NAMED_NS:
            return None
        return self._why(foreign)

    def _why(self, refused: Refused) -> Finding:
        return self.refusals.why(refused.verdict, refused.sender, refused.data, self.peer)

    def receive(self, data: bytes, source: Address, now: int, received_at: int | None = None) -> Verdict:
        """Process a datagram; on ACCEPTED (and on PROVIDER_STOP, with None) the setpoints are updated.

        ``now``: when the caller read its socket, equal for all datagrams of one read; ``received_at``: when the kernel received
        the datagram, None if unknown. The next ``poll`` reports a loss that is found here.
        """
        reading = self._reading
        if now != reading.at:
            reading = self._begin_reading(now)
        if received_at is not None:
            arrived = earliest = received_at if received_at < now else now
        else:
            arrived = now
            # Without a time stamp it arrived at an unknown time since the last read of the socket.
            earliest = reading.before
        # The PLC is lost if that was too late, or if the socket was not read for too long.
        connection = self._connection
        if connection is not None and (reading.late or earliest - connection.arrived > self._watchdog_ns):
            self._lose(connection)
        verdict = Verdict.OVERDUE if now - arrived > self._watchdog_ns else self._check(data, source)
        if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
            if arrived - self._heard > self._watchdog_ns and source == self.peer and not reading.late:
                self.losses.returned(now, arrived - self._heard)
            verdict = self._check_new(data, source, arrived, now, verdict)
        if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
            self._take(data, source, arrived, runs=verdict is _ACCEPTED)
        elif verdict is Verdict.FOREIGN_SENDER:
            self._foreign = Refused(verdict, source, b"", now)
        elif verdict not in USUAL:
            self._refused = Refused(verdict, source, data, now)
        self.counts.frames[verdict] += 1
        return verdict

    def _begin_reading(self, now: int) -> Reading:
        before = self._reading.at
        idle = 0 if self._connection is not None else IDLE_NS
        reading = self._reading = Reading(now, before, now - before > self._watchdog_ns + idle)
        if self._loss is not None and self._loss.reported:
            self._loss = None
        return reading

    def _check(self, data: bytes, source: Address) -> Verdict:
        if self._connection is not None:
            if source != self.peer:
                return Verdict.FOREIGN_SENDER
        elif self._fixed_peer is not None and source[0] != self._fixed_peer:
            return Verdict.FOREIGN_SENDER
        layout = self.consumer
        size = len(data)
        if size != layout.frame_size:
            return Verdict.TRUNCATED if size < layout.frame_size else Verdict.OVERSIZED
        if not data.startswith(self._header):
            return Verdict.WRONG_FRAME_ID
        if not data.startswith(self._padding, self._padding_start):
            return Verdict.WRONG_TELEGRAM
        status = data[layout.trailer + STATUS_OFFSET]
        if status & _STATUS_USED == _STATUS_USED:
            return _ACCEPTED
        if not status & STATUS_DATA_VALID:
            return Verdict.NOT_VALID
        return _PROVIDER_STOP if status & STATUS_PRIMARY else Verdict.NOT_PRIMARY

    def _check_new(self, data: bytes, source: Address, arrived: int, now: int, verdict: Verdict) -> Verdict:
        """The verdict on a frame that fits: the same if it is new."""
        if self._loss is not None:
            if source == self.peer:
                self._heard = arrived
            return Verdict.AFTER_LOSS
        new_frames = self.new_frames
        if new_frames.age_limit_ns is not None and not self._answers_to(source, now):
            return Verdict.FOREIGN_SENDER
        self._heard = arrived
        tick, counter = _TICK_AND_COUNTER.unpack_from(data, self.consumer.tick)
        newness = new_frames.check(tick, counter, now)
        return verdict if newness is _ACCEPTED else newness

    def _answers_to(self, source: Address, now: int) -> bool:
        """Whether a sender gets the answers: before its frames count it needs a tick. One sender at a time."""
        if source == self.peer:
            return True
        if self.peer is not None and now - self._heard <= self._watchdog_ns:
            return False
        self.peer = source
        self.new_frames.restart()
        return True

    def _take(self, data: bytes, source: Address, arrived: int, *, runs: bool) -> None:
        """A frame that counts: all that it orders is in force."""
        connection = self._connection
        if connection is None:
            assert self._loss is None, "the axes have seen the last loss"
            connection = self._connection = Connection()
        self.peer = source
        connection.arrived = self.received_ns = arrived
        self.received = data
        self._refused = None
        controls = int.from_bytes(data, "big") & self._control_mask
        self.changed = controls != self._controls
        self._controls = controls
        setpoints = self.setpoints
        connection.runs = runs
        if not runs:
            self.lose_setpoints()
            return
        for index, unpack, offset, iops in self._axes:
            if data[iops] & IOPS_GOOD:
                setpoints[index] = unpack(data, offset)
            else:
                setpoints[index] = None
                self.counts.iops_bad += 1

    def lose_setpoints(self) -> None:
        """No axis has a valid PLC until the next valid frame."""
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None

    def _lose(self, connection: Connection) -> None:
        loss, refused = Loss(), self._refused
        if refused is not None and refused.at - connection.arrived > self._watchdog_ns >> 1:
            loss.cause = self._why(refused)
            self.losses.add(self._reading.at, 0, loss.cause)
        else:
            self._refused = None  # a copy, or a frame that others have overtaken; silence is the cause
        self._connection, self._loss = None, loss
        self.new_frames.lose()
        self.counts.watchdog_expiries += 1
        self.lose_setpoints()

    @property
    def lost_by(self) -> Finding | None:
        """Why the frames before the loss did not count that ``poll`` has just reported; None if there were none."""
        return None if self._loss is None else self._loss.cause

    def poll(self, now: int) -> bool:
        """The watchdog, after the datagrams that waited; True when the PLC was lost since the last call."""
        if now != self._reading.at:
            self._begin_reading(now)
        connection = self._connection
        if connection is not None and now - connection.arrived > self._watchdog_ns:
            self._lose(connection)
        loss = self._loss
        if loss is None or loss.reported:
            return False
        loss.reported = True
        return True

    def build(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int = 0) -> bytes:
        """The frame to the PLC that is sent now. ``good[i]``: axis i's values are valid (its IOPS)."""
        values = [self._actual_frame_id]
        for index, words in enumerate(actuals):
            values += words
            values.append(IOPS_GOOD if good[index] else IOPS_BAD)
        values += [IOPS_BAD if item is None else IOPS_GOOD for item in self.setpoints]
        counts = self.counts
        counts.cycle = (counts.cycle + self._step) & 0xFFFF
        values += (self.new_frames.tick(now), counts.cycle, STATUS_NORMAL, 0)
        self.frame = self.provider.struct.pack(*values)
        counts.sent += 1
        return self.frame
