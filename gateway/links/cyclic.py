"""Device side of a static cyclic relationship, sans-I/O: which frames count, and the answers.

Source: docs/plc.md "Frames over UDP". A frame counts only if it comes from the relationship's peer, has its FrameID and
length, is new (``new_frames``), is valid and primary. Provider STOP and IOPS BAD are losses of the PLC. All other frames are
counted by their verdict and dropped; ``finding`` names the reason.
"""

from __future__ import annotations

import enum
import struct
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.gateway.base.reasons import Finding, Reason, with_count
from pdgw.gateway.base.udp import Address
from pdgw.gateway.configuration.defaults import WATCHDOG_FACTOR
from pdgw.gateway.links.new_frames import NewFrames, Verdict
from pdgw.profidrive.frame import (
    C_SDU_MIN,
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
)
from pdgw.profidrive.telegrams import Direction, Telegram, TelegramHalf

_TICK_AND_COUNTER: Final = struct.Struct(">IH")
"""The end of a frame: the tick, then the CycleCounter."""
IDLE_NS: Final = 20 * MS
"""Longest time between two readings while no PLC is connected and no drive has power."""
_NAMED_NS: Final = 10 * SECOND
"""Time for which another sender, frames that do not count, and repeated losses are named."""
_REPORTED_NS: Final = 60 * SECOND
"""Time between two reports of repeated losses."""
_REPEATED: Final = 3
"""Losses in this time that have one reason."""
_LONGEST_PAUSE_NS: Final = SECOND
"""A PLC that sends nothing for longer does not only send too slowly."""
_STATUS_OFFSET: Final = 2
"""DataStatus follows the CycleCounter."""
_STATUS_USED: Final = STATUS_DATA_VALID | STATUS_PRIMARY | STATUS_RUN
_Axis = tuple[int, Callable[[bytes, int], tuple[int, ...]], int, int]
"""Decoding of a drive object: its number, its values, their place, that of its IOPS."""
_ACCEPTED: Final = Verdict.ACCEPTED
_PROVIDER_STOP: Final = Verdict.PROVIDER_STOP
USUAL: Final = (_ACCEPTED, _PROVIDER_STOP, Verdict.AFTER_LOSS, Verdict.OVERDUE, Verdict.CONNECTING)
"""Verdicts that the status explains without a further text."""


class _Connection(enum.Enum):
    """With a PLC. A loss is an event: no connection follows before ``poll`` has reported it to the axes."""

    NONE = "the first frame that counts begins one"
    CONNECTED = "connected"
    LOST = "lost, and the axes have not seen it"
    REPORTED = "lost: what waited in the socket at this reading is older"


_NONE: Final = _Connection.NONE
_CONNECTED: Final = _Connection.CONNECTED
_LOST: Final = _Connection.LOST
_REPORTED: Final = _Connection.REPORTED


def control_mask(half: TelegramHalf) -> bytes:
    """Mask of a telegram's control words in its bytes: all bits that can start or stop something, but no sign of life."""
    mask = [0] * len(half.signals)
    for place, item in enumerate(half.signals):
        if "STW" in item.name or item.name == "Controlword":
            life = sum(bit.mask for bit in item.bits if bit.name == "SIGN_OF_LIFE")
            low, high = item.type.integer_range
            mask[place] = (high - low) & ~life
    return half.struct.pack(*mask)


class RepeatedLosses:
    """Losses of a PLC that keeps sending. Three of them in a short time have one reason until they end: the newest one."""

    def __init__(self, limit_ns: int) -> None:
        self._limit_ns = limit_ns
        self._losses: deque[tuple[int, int, Finding | None]] = deque(maxlen=_REPEATED)
        """When, the time without a frame, and why the frames did not count; None if there were none."""
        self._until = 0
        self._begin = self._last = -_NAMED_NS
        """The first and the last loss of a series."""
        self._count = 0
        self._reported_at = 0

    def add(self, now: int, silence_ns: int, cause: Finding | None = None) -> None:
        """The PLC sends again at ``now``, or (``cause``) its frames have not counted for too long."""
        self._losses.append((now, silence_ns, cause))
        if len(self._losses) == _REPEATED and now - self._losses[0][0] <= _NAMED_NS:
            self._until = now + _NAMED_NS

    def report(self, text: str, now: int) -> str:
        """The text of a loss for log and fault. Repeated ones are reported with their number once a minute, and else empty."""
        if now - self._last >= _NAMED_NS:
            self._begin, self._count, self._reported_at = now, 0, now - _REPORTED_NS
        self._last = now
        self._count += 1
        finding = self.finding(now)
        if finding is None:
            return text
        if now - self._reported_at < _REPORTED_NS:
            return ""
        self._reported_at = now
        return with_count(finding.text, self._count, now - self._begin)

    def returned(self, now: int, silence_ns: int) -> None:
        """A frame came after this time without one."""
        if self._limit_ns < silence_ns <= _LONGEST_PAUSE_NS:
            self.add(now, silence_ns)

    def finding(self, now: int) -> Finding | None:
        """The reason of all losses, None unless they are repeated."""
        if not self._losses or now >= self._until:
            return None
        cause = self._losses[-1][2]
        if cause is not None:
            return cause
        pauses = sorted({f"{pause / MS:.0f}" for _, pause, why in self._losses if why is None}, key=int)
        apart = " to ".join(pauses[:1] + pauses[1:][-1:])
        return Finding.of(
            Reason.WATCHDOG_SHORT,
            f"the PLC is lost repeatedly: its frames come {apart} ms apart, the limit is {self._limit_ns / MS:g} ms",
        )


class CyclicEndpoint:
    """Consumer and provider of one static relationship with any number of axes.

    ``setpoints[i]`` are the raw values of axis i, None while that axis has no valid PLC. Times are monotonic nanoseconds.
    ``peer``: the only accepted sender; None accepts the first valid one until it is lost. ``age_limit_ns``, ``tick_offset``: see
    ``NewFrames``.
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
        self._counter = 0
        self._watchdog_ns = cycle_ns * watchdog_factor
        self._fixed_peer = peer
        self.new_frames = NewFrames(age_limit_ns, tick_offset)
        self._last_time = 0
        self._heard = -_NAMED_NS
        """Arrival of the last frame that fits, whether it counted or not."""
        self.losses = RepeatedLosses(self._watchdog_ns)
        self._read_at = 0
        self._read_before = 0
        self._late = False
        self._connection = _NONE
        axes: list[_Axis] = []
        mask = bytearray(self.frame_size)
        for index, (half, offset, iops) in enumerate(
            zip(self.consumer.halves, self.consumer.offsets, self.consumer.iops, strict=True)
        ):
            axes.append((index, half.struct.unpack_from, offset, iops))
            mask[offset : offset + half.size] = control_mask(half)
            mask[iops] = IOPS_GOOD
        mask[self.consumer.trailer + _STATUS_OFFSET] = STATUS_RUN
        self._axes = tuple(axes)
        self._control_mask = int.from_bytes(mask, "big")
        self._controls = 0
        self.changed = False
        """The newest frame has other control words, IOPS or provider state than the one before: the axes step before the next."""
        self.setpoints: list[Sequence[int] | None] = [None] * len(telegrams)
        self.peer: Address | None = None
        """Source and target of frames; kept after a loss, so that the PLC sees the axes stop and gets a tick."""
        self._runs = False
        """Provider state of the PLC."""
        self._telegrams = tuple(item.number for item in telegrams)
        self._refused: tuple[Verdict, Address, bytes] | None = None
        """The newest frame of the PLC that does not count, if none has counted since: why, its sender and its bytes."""
        self._refused_at = 0
        self.lost_by: Finding | None = None
        """Why the frames before the last loss did not count; None if there were none."""
        self._foreign: Address | None = None
        """Another sender than the PLC."""
        self._foreign_at = 0
        self.counters: dict[Verdict, int] = dict.fromkeys(Verdict, 0)
        self.watchdog_expiries = 0
        """Losses of the PLC: silence, or a late gateway."""
        self.iops_bad = 0
        self.sent = 0

    @property
    def connected(self) -> bool:
        """A PLC is connected."""
        return self._connection is _CONNECTED

    @property
    def frame_size(self) -> int:
        """Bytes of a frame from the PLC."""
        return self.consumer.frame_size

    def finding(self, index: int | None = None) -> Finding | None:
        """Why the PLC's frames, or those of another sender, do not count; ``index``: for this axis. None if they do."""
        now = self._read_at
        if (repeated := self.losses.finding(now)) is not None:
            return repeated
        if not self.connected:
            if self._refused is not None and now - self._refused_at <= _NAMED_NS:
                found, (_, (host, _), _) = self.why_refused(*self._refused), self._refused
                replaces = self._last_time and self.peer is not None and self.peer[0] != host
                return found._replace(reason=Reason.OTHER_SENDER) if replaces else found
        elif not self._runs:
            return Finding.of(Reason.PLC_STOP)
        elif not any(item is not None for item in self.setpoints):
            # Short frames of several layouts have equal lengths: one has its IOPS where another has padding.
            text = "every IOPS of the PLC is BAD" if index is None else Reason.PLC_BAD.value
            return Finding.of(Reason.PLC_BAD, f"{text}; {self._expected}")
        elif index is not None and self.setpoints[index] is None:
            return Finding.of(Reason.PLC_BAD)
        if self._foreign in (None, self.peer) or now - self._foreign_at > _NAMED_NS:
            return None
        return self.why_refused(Verdict.FOREIGN_SENDER, self._foreign)

    def _of_other(self, sender: Address) -> Finding:
        peer = self._fixed_peer if self.peer is None else "{}:{}".format(*self.peer)
        host, port = sender
        remedy = Reason.OTHER_SENDER.remedy
        if self._fixed_peer not in (None, host):
            remedy += (f'if {host} is the PLC, set peer = "{host}"',)
        return Finding(Reason.OTHER_SENDER, f"frames of {host}:{port} do not count: the PLC is {peer}", remedy)

    @property
    def _expected(self) -> str:
        return f"expected: {self.frame_size} bytes for telegrams {', '.join(map(str, self._telegrams))}"

    def why_refused(self, verdict: Verdict, source: Address, data: bytes = b"") -> Finding:
        """Why a frame does not count."""
        frames = "frames of {}:{} do not count".format(*source)
        new_frames, place = self.new_frames, self.consumer.tick
        match verdict:
            case Verdict.FOREIGN_SENDER:
                return self._of_other(source)
            case Verdict.NO_TICK:
                return Finding.of(Reason.FRAME_TICK, f"{frames}: without a tick of this gateway", self._copy_tick)
            case Verdict.TOO_OLD:
                limit_ns = new_frames.age_limit_ns or 0
                age = f"{new_frames.refused_age_ns / MS:.0f} ms old, limit {limit_ns / MS:g} ms"
                return Finding.of(Reason.FRAME_OLD, f"{frames}: they are {age}")
            case Verdict.STALE:
                return Finding.of(Reason.FRAME_COUNTER, f"{frames}: their cycle counter does not increase")
            case Verdict.WRONG_TELEGRAM:
                byte = next(at for at in range(self._padding_start, place) if data[at])
                text = f"{frames}: byte {byte} is not 0, and the last object ends before it; {self._expected}"
                return Finding.of(Reason.FRAME_LAYOUT, text)
            case Verdict.WRONG_FRAME_ID:
                text = f"{frames}: FrameID {data[: HEADER.size].hex().upper()}h, expected {self._header.hex().upper()}h"
                return Finding.of(Reason.FRAME_INVALID, text)
            case Verdict.NOT_VALID | Verdict.NOT_PRIMARY:
                status = data[self.consumer.trailer + _STATUS_OFFSET]
                bit = "bit 2 (data valid)" if verdict is Verdict.NOT_VALID else "bit 0 (primary)"
                text = f"{frames}: DataStatus {status:02X}h, {bit} is 0, expected {STATUS_NORMAL:02X}h"
                return Finding.of(Reason.FRAME_INVALID, text)
            case _:
                text = f"{frames}: {len(data)} bytes; {self._expected}"
                without_tick = HEADER.size + max(C_SDU_MIN, self.consumer.used) + TRAILER.size
                if len(data) == without_tick != self.frame_size:
                    return Finding.of(Reason.FRAME_TICK, f"{text}, this is the layout without a tick", self._copy_tick)
                return Finding.of(Reason.FRAME_LAYOUT, text)

    @property
    def _copy_tick(self) -> str:
        of_gateway, place = self.provider.tick, self.consumer.tick
        return (
            f"the PLC must receive the gateway's frames and copy bytes {of_gateway} to {of_gateway + 3} of the newest one to "
            f"bytes {place} to {place + 3} of its own, before the cycle counter (docs/plc.md)"
        )

    def continue_from(self, previous: CyclicEndpoint) -> None:
        """Follow an endpoint with other telegrams: continue its counts and its cycle counter, or the PLC would see old frames.

        A loss that the axes have not seen is still to be reported.
        """
        if previous._connection is _LOST:
            self._connection = _LOST
        self._counter = previous._counter
        self.counters = previous.counters
        self.watchdog_expiries = previous.watchdog_expiries
        self.iops_bad = previous.iops_bad
        self.sent = previous.sent

    def receive(self, data: bytes, source: Address, now: int, received_at: int | None = None) -> Verdict:
        """Process a datagram; on ACCEPTED (and on PROVIDER_STOP, with None) the setpoints are updated.

        ``now``: when the caller read its socket, equal for all datagrams of one read; ``received_at``: when the kernel received
        the datagram, None if unknown. The next ``poll`` reports a loss that is found here.
        """
        if now != self._read_at:
            self._note_reading(now)
        if received_at is not None:
            arrived = earliest = received_at if received_at < now else now
        else:
            arrived = now
            # Without a time stamp it arrived at an unknown time since the last read of the socket.
            earliest = self._read_before
        # The PLC is lost if that was too late, or if the socket was not read for too long.
        if self.connected and (self._late or earliest - self._last_time > self._watchdog_ns):
            self._lose()
        verdict = Verdict.OVERDUE if now - arrived > self._watchdog_ns else self._check(data, source)
        if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
            if arrived - self._heard > self._watchdog_ns and source == self.peer and not self._late:
                self.losses.returned(now, arrived - self._heard)
            verdict = self._check_new(data, source, arrived, now, verdict)
        if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
            self._take(data, source, arrived, runs=verdict is _ACCEPTED)
        elif verdict is Verdict.FOREIGN_SENDER:
            self._foreign, self._foreign_at = source, now
        elif verdict not in USUAL:
            self._refused, self._refused_at = (verdict, source, data), now
        self.counters[verdict] += 1
        return verdict

    def _note_reading(self, now: int) -> None:
        self._read_before = self._read_at
        self._read_at = now
        idle = 0 if self.connected else IDLE_NS
        self._late = now - self._read_before > self._watchdog_ns + idle
        if self._connection is _REPORTED:
            self._connection = _NONE

    def _check(self, data: bytes, source: Address) -> Verdict:
        if self.connected:
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
        status = data[layout.trailer + _STATUS_OFFSET]
        if status & _STATUS_USED == _STATUS_USED:
            return _ACCEPTED
        if not status & STATUS_DATA_VALID:
            return Verdict.NOT_VALID
        return _PROVIDER_STOP if status & STATUS_PRIMARY else Verdict.NOT_PRIMARY

    def _check_new(self, data: bytes, source: Address, arrived: int, now: int, verdict: Verdict) -> Verdict:
        """The verdict on a frame that fits: the same if it is new."""
        if self._connection is _LOST or self._connection is _REPORTED:
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
        if self._connection is not _CONNECTED:
            assert self._connection is _NONE, "the axes have seen the last loss"
            self._connection = _CONNECTED
        self.peer = source
        self._last_time = arrived
        self.received = data
        self._refused = None
        controls = int.from_bytes(data, "big") & self._control_mask
        self.changed = controls != self._controls
        self._controls = controls
        setpoints = self.setpoints
        self._runs = runs
        if not runs:
            self.lose_setpoints()
            return
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

    def _lose(self) -> None:
        self.lost_by = None
        if self._refused is not None and self._refused_at - self._last_time > self._watchdog_ns >> 1:
            self.lost_by = self.why_refused(*self._refused)
            self.losses.add(self._read_at, 0, self.lost_by)
        else:
            self._refused = None  # a copy, or a frame that others have overtaken; silence is the cause
        self._connection = _LOST
        self.new_frames.lose()
        self.watchdog_expiries += 1
        self.lose_setpoints()

    @property
    def received_ns(self) -> int | None:
        """Arrival of the newest valid frame; None: none yet."""
        return self._last_time or None

    def poll(self, now: int) -> bool:
        """The watchdog, after the datagrams that waited; True when the PLC was lost since the last call."""
        if now != self._read_at:
            self._note_reading(now)
        if self.connected and now - self._last_time > self._watchdog_ns:
            self._lose()
        lost = self._connection is _LOST
        if lost:
            self._connection = _REPORTED
        return lost

    def build(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int = 0) -> bytes:
        """The frame to the PLC that is sent now. ``good[i]``: axis i's values are valid (its IOPS)."""
        values = [self._actual_frame_id]
        for index, words in enumerate(actuals):
            values += words
            values.append(IOPS_GOOD if good[index] else IOPS_BAD)
        values += [IOPS_BAD if item is None else IOPS_GOOD for item in self.setpoints]
        self._counter = (self._counter + self._step) & 0xFFFF
        values += (self.new_frames.tick(now), self._counter, STATUS_NORMAL, 0)
        self.frame = self.provider.struct.pack(*values)
        self.sent += 1
        return self.frame
