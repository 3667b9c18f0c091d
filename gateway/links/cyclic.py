"""Device side of a static cyclic relationship, sans-I/O: which frames count, and the answers.

Source: docs/transport.md chapters 1 and 2. A frame counts only if it comes from the relationship's peer, has its FrameID and
length, belongs to the sequence of frames of the connection (``sequence``), is valid and primary. Provider STOP and IOPS BAD are
losses of the PLC. All other frames are counted by their verdict and dropped. An order may need confirmation by the next frames
(``confirmation``).
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Callable, Sequence
from typing import Final

from pdgw.gateway.configuration.tables.defaults import WATCHDOG_FACTOR
from pdgw.gateway.links.confirmation import Confirmation
from pdgw.gateway.links.history import FrameHistory
from pdgw.gateway.links.sequence import FrameSequence, NewerFrames, Order
from pdgw.gateway.links.udp import Address
from pdgw.gateway.reasons import UnconfirmedOrder
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
)
from pdgw.profidrive.telegrams import Direction, Telegram

_COUNTER: Final = struct.Struct(">H")
_STATUS_OFFSET: Final = _COUNTER.size
"""DataStatus follows the CycleCounter."""
_STATUS_USED: Final = STATUS_DATA_VALID | STATUS_PRIMARY | STATUS_RUN


class Verdict(enum.Enum):
    """Result of a received datagram; the value is the name of its counter."""

    ACCEPTED = "accepted"
    PROVIDER_STOP = "provider stop"
    FOREIGN_SENDER = "foreign sender"
    TRUNCATED = "truncated"
    OVERSIZED = "oversized"
    WRONG_FRAME_ID = "wrong FrameID"
    STALE = "stale cycle counter"
    UNCONFIRMED = "not connected yet: the gateway waits for more frames in sequence"
    OVERDUE = "delayed in the gateway for longer than the watchdog time"
    WRONG_TELEGRAM = "data after the last object: the PLC sends another telegram or more axes"
    NOT_VALID = "data not valid"
    NOT_PRIMARY = "not primary"

    # Each member is a single object; Enum's own function is Python and would run in every cycle.
    __hash__ = object.__hash__


_Orders = tuple[tuple[int, ...] | None, ...]
"""The commands of a frame to each drive object; None where its IOPS is BAD."""
_Axis = tuple[Callable[[bytes, int], tuple[int, ...]], int, int, Callable[[Sequence[int]], tuple[int, ...]]]
"""Decoding of a drive object: its values, their place, that of its IOPS, and its command."""
_ACCEPTED: Final = Verdict.ACCEPTED
_PROVIDER_STOP: Final = Verdict.PROVIDER_STOP
_MISFITS: Final = (Verdict.TRUNCATED, Verdict.OVERSIZED, Verdict.WRONG_TELEGRAM)


class CyclicEndpoint:
    """Consumer and provider of one static relationship with any number of axes.

    ``setpoints[i]`` are the raw values of axis i, None while that axis has no valid PLC. Times are monotonic nanoseconds.
    ``peer``: the only accepted sender; None accepts the first valid one until it is lost. ``delays``: the network may delay
    frames for seconds, as UDP does; False on Ethernet and for recordings.
    ``unconfirmed_orders[i]``: orders of the PLC that axis i may lack.
    """

    def __init__(
        self,
        telegrams: Sequence[Telegram],
        *,
        cycle_ns: int,
        watchdog_factor: int = WATCHDOG_FACTOR,
        peer: str | None = None,
        delays: bool = True,
        setpoint_frame_id: int = FRAME_ID_TO_DEVICE,
        actual_frame_id: int = FRAME_ID_TO_CONTROLLER,
    ) -> None:
        self.consumer = CSduLayout(telegrams, Direction.SETPOINT)
        self.provider = CSduLayout(telegrams, Direction.ACTUAL)
        self._header = HEADER.pack(setpoint_frame_id)
        self._padding_start = HEADER.size + self.consumer.used
        self._padding = bytes(self.consumer.trailer - self._padding_start)
        self.frame = self.provider.new_frame(actual_frame_id)
        """The newest frame to the PLC; the buffer is used again."""
        self.received = b""
        """The newest frame of the PLC that was accepted."""
        self._step = max(1, cycle_ns // COUNTER_UNIT_NS)
        self._counter = 0
        self._watchdog_ns = cycle_ns * watchdog_factor
        self._fixed_peer = peer
        self._sequence = FrameSequence(cycle_ns, self._watchdog_ns) if delays else NewerFrames()
        self._needs_no_confirmation = not delays
        self._confirmations = tuple(Confirmation(half) for half in self.consumer.halves)
        self._in_force: list[tuple[int, ...] | None] = [None] * len(telegrams)
        self._waiting = False
        """An order waits to be confirmed."""
        self.settled: int | None = None
        """The bits of a frame whose orders were all in force before the newest frame; None: one changed, or waits."""
        self._last_time = 0
        self._last_orders: _Orders | None = None
        self._beside: int | None = None
        """Arrival of the newest frame of another sequence that runs beside the present one."""
        self._rival: tuple[int, _Orders | None] | None = None
        """The newest of these that is certainly no copy of a present one: its arrival and its orders, None in STOP."""
        self.contradicted = False
        """The newest loss of the PLC is that a frame of the other sequence had a stop."""
        self._read_at = 0
        self._read_before = 0
        self._late = False
        self._loss_to_report = False
        axes: list[_Axis] = []
        lives: list[int] = []
        mask = bytearray(self.frame_size)
        for half, offset, iops, confirmation in zip(
            self.consumer.halves, self.consumer.offsets, self.consumer.iops, self._confirmations, strict=True
        ):
            axes.append((half.struct.unpack_from, offset, iops, confirmation.read))
            mask[offset : offset + half.size] = confirmation.mask
            mask[iops] = IOPS_GOOD
            lives.extend(offset + place for place in confirmation.lives)
        self._axes = tuple(axes)
        self._values = tuple((index, unpack, offset) for index, (unpack, offset, _, _) in enumerate(axes))
        self._order_mask = int.from_bytes(mask, "big")
        """Mask of a frame: all bits that can start or stop something."""
        self._history = FrameHistory(cycle_ns, self._order_mask, lives)
        provider = self.provider
        self._answers = tuple(
            (index, half.struct.pack_into, provider.offsets[index], provider.iops[index], provider.iocs[index])
            for index, half in enumerate(provider.halves)
        )
        self.setpoints: list[tuple[int, ...] | None] = [None] * len(telegrams)
        self.unconfirmed_orders: list[UnconfirmedOrder] = [UnconfirmedOrder.NONE] * len(telegrams)
        self._dropped_before = 0
        self._released: Sequence[bool] = [False] * len(telegrams)
        self.peer: Address | None = None
        """Source and target of frames; kept after a loss, so that the PLC sees the axes stop."""
        self.connected = False
        self._telegrams = tuple(item.number for item in telegrams)
        self._misfit = ""
        self.counters: dict[Verdict, int] = dict.fromkeys(Verdict, 0)
        self.watchdog_expiries = 0
        """Losses of the PLC: silence, another sequence of frames, or a late gateway."""
        self.iops_bad = 0
        self.sent = 0

    @property
    def frame_size(self) -> int:
        """Bytes of a frame from the PLC."""
        return self.consumer.frame_size

    @property
    def layout_text(self) -> str:
        """The expected layout of the PLC's frames while another one seems to arrive; else empty."""
        if not self._misfit:
            return ""
        numbers = ", ".join(map(str, self._telegrams))
        return f"{self._misfit}; expected: {self.frame_size} bytes for telegrams {numbers}"

    def continue_from(self, previous: CyclicEndpoint) -> None:
        """Follow an endpoint with other telegrams: continue its counts and its cycle counter, or the PLC would see old frames."""
        self._counter = previous._counter
        self.counters = previous.counters
        self.watchdog_expiries = previous.watchdog_expiries
        self.iops_bad = previous.iops_bad
        self.sent = previous.sent
        self._dropped_before = previous.orders_dropped

    @property
    def orders_dropped(self) -> int:
        """Number of changes of control words that were in too few frames to be confirmed."""
        return self._dropped_before + sum(item.orders_dropped for item in self._confirmations)

    def receive(self, data: bytes, source: Address, now: int, received_at: int | None = None) -> Verdict:
        """Process a datagram; on ACCEPTED (and on PROVIDER_STOP, with None) the setpoints are updated.

        ``now``: when the caller read its socket, equal for all datagrams of one read; ``received_at``: when the kernel received
        the datagram, None if unknown. The next ``poll`` reports a loss that is found here. Until then no connection starts, so
        that the drive objects see every loss.
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
            verdict = self._check_sequence(data, source, arrived, verdict)
        elif verdict in _MISFITS:
            self._misfit = f"frame of {len(data)} bytes from {source[0]} does not fit"
        self.counters[verdict] += 1
        return verdict

    def _note_reading(self, now: int) -> None:
        self._read_before = self._read_at
        self._read_at = now
        self._late = now - self._read_before > self._watchdog_ns

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
        return Verdict.PROVIDER_STOP if status & STATUS_PRIMARY else Verdict.NOT_PRIMARY

    def _check_sequence(self, data: bytes, source: Address, arrived: int, verdict: Verdict) -> Verdict:
        """The verdict on a frame whose content is right, by its place in the sequence of frames."""
        sequence = self._sequence
        (counter,) = _COUNTER.unpack_from(data, self.consumer.trailer)
        runs = verdict is _ACCEPTED
        if not sequence.next(counter, arrived):
            orders = tuple(self._decode(data)[1]) if runs else None
            order = sequence.follow(source, counter, arrived, orders, may_connect=not self._loss_to_report)
            if order is Order.RESTARTED:
                self._lose()
            if order is Order.STALE or order is Order.BESIDE:
                self._contradict(data, counter, orders, arrived, beside=order is Order.BESIDE)
                return Verdict.STALE
            if order is not Order.NEXT:
                return Verdict.UNCONFIRMED
            self._connect(source, orders)
        self._last_time = arrived
        self.received = data
        if runs:
            self._accept(data)
        else:
            self._last_orders = None
            self.lose_setpoints()
        if not self._needs_no_confirmation:
            self._history.enter(data, sequence.elapsed_ns)
        return verdict

    def _contradict(self, data: bytes, counter: int, orders: _Orders | None, arrived: int, *, beside: bool) -> None:
        """A frame is too late for the sequence. If it differs from an accepted one, that one may be the old frame.

        ``beside``: it is of a sequence of its own. Unless its frames are only overtaken ones, the present sequence may be the
        old one, so a stop of either acts.
        """
        place = self._sequence.place(counter)
        rival = place is None or self._history.contradict(data, place)
        if self._waiting and orders != self._last_orders:
            self._restart_confirmation()
        if not beside:
            return
        if rival or self._is_recent(self._beside):
            self._beside = arrived
        if rival:
            self._rival = arrived, orders
            if self._stops(orders):
                self.contradicted = True
                self._tell_loss()

    def _is_recent(self, arrived: int | None) -> bool:
        """Whether a frame came less than the watchdog time before the newest one of the present sequence."""
        return arrived is not None and self._last_time - arrived <= self._watchdog_ns

    def _stops(self, orders: _Orders | None) -> bool:
        """Whether an order, STOP or IOPS BAD stops an axis that follows the present sequence."""
        for index, (confirmation, in_force) in enumerate(zip(self._confirmations, self._in_force, strict=True)):
            order = None if orders is None else orders[index]
            if in_force is not None and (
                order is None or confirmation.orders.stopped(order, in_force, released=True) != in_force
            ):
                return True
        return False

    def _restart_confirmation(self) -> None:
        """Orders that wait have to be confirmed from the beginning."""
        for confirmation in self._confirmations:
            confirmation.contradict()

    def _connect(self, source: Address, orders: _Orders | None) -> None:
        self.peer = source
        self.connected = True
        self._misfit = ""
        self._history.clear()
        for confirmation, order in zip(self._confirmations, orders or [None] * len(self._confirmations), strict=True):
            # The frame that completes the sequence is counted again where its order is checked.
            confirmation.restart(order, 0 if order is None else self._sequence.repeats - 1)

    def _decode(self, data: bytes) -> tuple[list[tuple[int, ...] | None], list[tuple[int, ...] | None]]:
        """Values and orders of the axes; None where the IOPS is BAD."""
        values: list[tuple[int, ...] | None] = []
        orders: list[tuple[int, ...] | None] = []
        for unpack, offset, iops, read in self._axes:
            if data[iops] & IOPS_GOOD:
                item = unpack(data, offset)
                values.append(item)
                orders.append(read(item))
            else:
                values.append(None)
                orders.append(None)
        return values, orders

    def _accept(self, data: bytes) -> None:
        ordered = int.from_bytes(data, "big") & self._order_mask
        if ordered == self.settled:
            setpoints = self.setpoints
            for index, unpack, offset in self._values:
                setpoints[index] = unpack(data, offset)
            if self._misfit:
                self._misfit = ""
        else:
            self.settled = None
            self._accept_orders(data, ordered)

    def _accept_orders(self, data: bytes, ordered: int) -> None:
        """A frame with new orders; ``ordered``: the bits that differ from those in force."""
        values, orders = self._decode(data)
        if None in orders:
            bad = orders.count(None)
            self.iops_bad += bad
            # Short frames of several layouts have equal lengths: one has its IOPS where another has padding.
            self._misfit = "every IOPS of the PLC is BAD" if bad == len(orders) else ""
        elif self._misfit:
            self._misfit = ""
        if orders == self._in_force and not self._waiting:
            self.setpoints[:] = values
            if None not in orders:
                self.settled = ordered
        else:
            self._confirm(data, values, orders)
        self._last_orders = tuple(orders)

    def _confirm(
        self, data: bytes, values: Sequence[tuple[int, ...] | None], orders: Sequence[tuple[int, ...] | None]
    ) -> None:
        """Some order is another than the one in force: it counts now, or waits with all values of its axis."""
        sequence = self._sequence
        # Nothing starts that the other sequence contradicts, and nothing before the axes have seen a loss.
        rival = self._rival
        if self._loss_to_report or (rival is not None and self._is_recent(rival[0]) and rival[1] != tuple(orders)):
            self._restart_confirmation()
        single = sequence.alone and not self._is_recent(self._beside)
        is_new = self._needs_no_confirmation or (single and self._history.is_new(data, sequence.elapsed_ns))
        self._waiting = False
        for index, (confirmation, order) in enumerate(zip(self._confirmations, orders, strict=True)):
            in_force = self._in_force[index]
            put = order
            if order is None:
                confirmation.restart(None, 0)
            else:
                put = confirmation.judge(order, in_force, is_new=is_new, released=self._released[index])
            unconfirmed = self.unconfirmed_orders[index] = confirmation.unconfirmed
            self._waiting |= unconfirmed is UnconfirmedOrder.WAITS or put != order
            if put == order:
                self.setpoints[index] = values[index]
            elif put is not None and put != in_force:
                kept = self.setpoints[index] or values[index]
                assert kept is not None, "an unconfirmed order exists"
                self.setpoints[index] = confirmation.orders.applied(put, kept)
            self._in_force[index] = put

    def lose_setpoints(self) -> None:
        """No axis has a valid PLC until the next valid frame."""
        self.settled = None
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None
            self._in_force[index] = None
            self.unconfirmed_orders[index] = UnconfirmedOrder.NONE
        for confirmation in self._confirmations:
            confirmation.forget()

    def _lose(self) -> None:
        self.connected = self.contradicted = False
        self._beside = self._rival = None
        self._sequence.lose()
        self._tell_loss()

    def _tell_loss(self) -> None:
        self.watchdog_expiries += 1
        self._loss_to_report = True
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
        lost, self._loss_to_report = self._loss_to_report, False
        return lost

    def build(
        self, actuals: Sequence[Sequence[int]], good: Sequence[bool], released: Sequence[bool] | None = None
    ) -> bytearray:
        """The next frame to the PLC; the buffer is reused.

        ``good[i]``: axis i's actual values are valid (its IOPS). ``released[i]``: its interlock is released, so that an OFF does
        nothing but stop it; without it an OFF that may be an old one waits for its confirmation.
        """
        if released is not None:
            self._released = released
        frame = self.frame
        layout = self.provider
        setpoints = self.setpoints
        for index, pack_into, offset, iops, iocs in self._answers:
            pack_into(frame, offset, *actuals[index])
            frame[iops] = IOPS_GOOD if good[index] else IOPS_BAD
            frame[iocs] = IOPS_GOOD if setpoints[index] is not None else IOPS_BAD
        self._counter = (self._counter + self._step) & 0xFFFF
        TRAILER.pack_into(frame, layout.trailer, self._counter, STATUS_NORMAL, 0)
        self.sent += 1
        return frame
