"""A CAN bus in virtual time: arbitration by identifier, bit times, errors, bus-off, cut wires and short circuits.

Source: Bosch CAN 2.0A (arbitration, fault confinement). A frame takes its worst-case bit time (``ds301.bus.load``) by
default. A member has a queue of frames like SocketCAN; its oldest one takes part in the arbitration. A frame that no other
member acknowledges is repeated; its sender becomes error-passive, but not bus-off. A frame at another bit rate is destroyed. Not
simulated: error-passive timing, overload frames, what a silent member at another bit rate does to the frames of others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from random import Random
from typing import Final

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.can_frame import EXTENDED, EXTENDED_ID, REMOTE, STANDARD_ID
from pdgw.ds301.bus.load import frame_bits
from pdgw.ds301.bus.port import PortBusyError, PortLostError, Receiver, deliver
from pdgw.ds301.loop.loop import Loop, Timer

_EXTENDED_BITS: Final = 20
"""Additional bits of an extended identifier, without stuffing."""
_ERROR_BITS: Final = 23
"""Error flags, delimiter and interframe space."""
_TEC_PASSIVE, _TEC_BUS_OFF, _TEC_STEP = 128, 256, 8
_RECOVERY_BITS: Final = 128 * 11
PLACES: Final = 16
"""Default size of a controller's queue."""
_WORST_BITS = [frame_bits(size) for size in range(9)]

Tap = Callable[[int, "Member", int, bytes], None]
"""Called for frames with time, sender, identifier with the flags of ``can_frame``, data."""


class Member:
    """A controller on the bus: a ``ds301.bus.port.CanPort``.

    ``places``: size of its queue including the frame on the wire. ``restart_ns``: duration of bus-off; None: permanent.
    """

    def __init__(self, bus: SimulatedCan, name: str, places: int = PLACES) -> None:
        self.name = name
        self.places = places
        self.restart_ns: int | None = 100 * MS
        self.bus_off = False
        self.connected = True
        """Whether its wires are connected to the bus."""
        self.powered = True
        """Without power it neither receives nor acknowledges."""
        self.closed = False
        self.bitrate = bus.bitrate
        self.queue: deque[tuple[int, bytes]] = deque()
        self.errors = 0
        """The transmit error counter."""
        self.alone: Timer | None = None
        """Time at which it becomes error-passive without an acknowledgement."""
        self.droppable = False
        """Whether its queue can be cleared; SocketCAN's cannot."""
        self._bus = bus
        self._receiver: Receiver | None = None
        self._refused = False
        self._lost = ""
        self._listens = True
        self._waiting: deque[tuple[int, bytes, int]] = deque()

    # -- the port -------------------------------------------------------------------------------------------------------

    def start(self, receiver: Receiver) -> None:
        self._receiver = receiver

    def send(self, can_id: int, data: bytes) -> None:
        if self._lost:
            raise PortLostError(self._lost)
        if self.bus_off or len(self.queue) >= self.places:
            self._refused = True
            raise PortBusyError
        self.queue.append((can_id, bytes(data)))
        self._bus.contend(self, can_id, data)

    def listen(self, *, on: bool) -> None:
        self._listens = on
        if on and self._waiting:
            self._bus.loop.call_later(0, lambda: self.take(self._bus.loop.now()))

    def take(self, now: int) -> None:
        while self._waiting and self._receiver is not None:
            deliver(self._receiver, *self._waiting.popleft())

    def drop(self) -> None:
        if self.droppable:
            # The frame being sent is on the wire.
            kept = 1 if self._bus.sends(self) else 0
            while len(self.queue) > kept:
                self.queue.pop()

    def close(self) -> None:
        """Close like a socket: nothing is received any more, and queued frames are still sent."""
        self._receiver = None
        self.closed = True
        self._bus.leave(self)

    # -- events ---------------------------------------------------------------------------------------------------------

    @property
    def active(self) -> bool:
        """Whether it takes part in the traffic: it sends, receives and acknowledges."""
        return self.connected and self.powered and not self.bus_off

    def power(self, on: bool) -> None:
        """Switch its device on or off. Without power, the frames in its queue are lost."""
        if on is not self.powered:
            self.powered, self.bus_off, self.errors = on, False, 0
            if not on:
                self.queue.clear()
            self._bus.changed(self)

    def set_bitrate(self, bitrate: int) -> None:
        """Change its bit rate; 0: that of the bus."""
        self.bitrate = bitrate or self._bus.bitrate

    def connect(self, connected: bool) -> None:
        """Cut or connect its wires; when connected, it sends its queued frames."""
        self.connected = connected
        self._bus.changed(self)

    def unplug(self, text: str = "unplugged") -> None:
        """Remove the interface from the computer."""
        self._lost = text
        receiver = self._receiver
        self.queue.clear()
        self.close()
        if receiver is not None:
            receiver.on_lost(text)

    def deliver(self, can_id: int, data: bytes) -> None:
        """Receive a frame of another member."""
        now = self._bus.loop.now()
        if not self._listens or self._waiting:
            self._waiting.append((can_id, data, now))
        elif self._receiver is not None:
            deliver(self._receiver, can_id, data, now)

    def report_room(self) -> None:
        """Report a free place in the queue, or the end of bus-off."""
        if self._refused:
            self._refused = False
            if self._receiver is not None:
                self._receiver.on_room()

    def report_error(self) -> None:
        """Report an error frame on the bus."""
        if self._receiver is not None:
            self._receiver.on_error_frame(bus_off=self.bus_off, passive=self.errors >= _TEC_PASSIVE)


class SimulatedCan:
    """One bus. ``error_rate``: share of frames that are destroyed once; they are repeated."""

    def __init__(self, loop: Loop, name: str, bitrate: int, random: Random) -> None:
        self.name = name
        self.loop = loop
        self.bitrate = bitrate
        self.error_rate = 0.0
        self.taps: list[Tap] = []
        """Called for every transmitted frame."""
        self.offered: list[Tap] = []
        """Called for every frame passed to a controller."""
        self.frames = 0
        self.members: list[Member] = []
        self.shorted = False
        self.bits_of = _worst_bits
        """The bit times of a frame."""
        self._random = random
        self._bit_ns = SECOND / bitrate
        self._sender: Member | None = None
        self._began = -1
        self._timer: Timer | None = None
        self._delivering = False

    def join(self, name: str, places: int = PLACES) -> Member:
        """Add a controller with this size of its queue."""
        member = Member(self, name, places)
        self.members.append(member)
        self._begin()  # it acknowledges what others repeat
        return member

    def short(self, shorted: bool) -> None:
        """Short-circuit the bus: no frame passes, and a sender becomes bus-off."""
        self.shorted = shorted
        self._abort()
        for member in tuple(self.members):
            if shorted and member.queue:
                self._fail_soon(member)
            elif not shorted and member.bus_off:
                self._recover_later(member)
        self._begin()

    # -- services for the members ---------------------------------------------------------------------------------------

    def contend(self, member: Member, can_id: int, data: bytes) -> None:
        """A member has a new frame."""
        for tap in self.offered:
            tap(self.loop.now(), member, can_id, data)
        if self.shorted and member.connected:
            if len(member.queue) == 1:
                self._fail_soon(member)
        elif not member.connected:
            self._try_alone(member)
        elif self._sender is None:
            self._begin()
        elif self._began == self.loop.now() and len(member.queue) == 1:
            # Members that start at the same time take part in the arbitration.
            self._abort()
            self._begin()

    def sends(self, member: Member) -> bool:
        """Whether a frame of this member is on the wire."""
        return self._sender is member

    def leave(self, member: Member) -> None:
        """Remove a member after its queued frames are sent."""
        if member in self.members and not member.queue:
            self.members.remove(member)
            self.changed(member)

    def changed(self, member: Member) -> None:
        """A member was disconnected, connected or removed: the frame that it is sending is destroyed."""
        if self._sender is member:
            self._abort()
        if member.queue and not member.connected:
            self._try_alone(member)
        self._begin()

    # -- transmission -----------------------------------------------------------------------------------------------------

    def _abort(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._sender = None

    def _begin(self) -> None:
        """The bus is idle: send the lowest identifier. Without acknowledgement it waits for another member."""
        if self._sender is not None or self._delivering or self.shorted:
            return
        winner: Member | None = None
        first = listeners = 0
        for member in self.members:
            if member.active:
                listeners += self._hears(member)
                if member.queue:
                    rank = _rank(member.queue[0][0])
                    if winner is None or rank < first:
                        winner, first = member, rank
        if winner is None:
            return
        hears = self._hears(winner)
        if listeners < 1 + hears:
            self._try_alone(winner)
            return
        can_id, data = winner.queue[0]
        duration = int(self.bits_of(can_id, data) * self._bit_ns)
        self._sender = winner
        self._began = self.loop.now()
        if not hears or (self.error_rate and self._random.random() < self.error_rate):
            duration = int(duration * self._random.random() + _ERROR_BITS * self._bit_ns)
            self._timer = self.loop.call_at(self._began + duration, self._destroyed)
        else:
            self._timer = self.loop.call_at(self._began + duration, self._complete)

    def _try_alone(self, sender: Member) -> None:
        """Repeat a frame that no other member acknowledges. Each attempt counts until the sender is error-passive."""
        if sender.errors >= _TEC_PASSIVE or (sender.alone is not None and sender.alone.action is not None):
            return
        attempts = -((sender.errors - _TEC_PASSIVE) // _TEC_STEP)
        bits = attempts * (self.bits_of(*sender.queue[0]) + _ERROR_BITS)

        def passive() -> None:
            if sender.queue and not self._acknowledges(sender):
                sender.errors = _TEC_PASSIVE
                sender.report_error()

        sender.alone = self.loop.call_later(int(bits * self._bit_ns), passive)

    def _acknowledges(self, sender: Member) -> bool:
        """Whether another member acknowledges the frames of a sender."""
        others = (member for member in self.members if member is not sender)
        return sender.connected and any(member.active and self._hears(member) for member in others)

    def _hears(self, member: Member) -> bool:
        """Whether a member has the bit rate of the bus."""
        return member.bitrate == self.bitrate

    def _complete(self) -> None:
        sender = self._sender
        assert sender is not None
        self._sender = None
        if not self._acknowledges(sender):
            self._begin()
            return
        can_id, data = sender.queue.popleft()
        if sender.errors:
            sender.errors -= 1
        self.frames += 1
        self._delivering = True
        for tap in self.taps:
            tap(self.loop.now(), sender, can_id, data)
        for member in tuple(self.members):
            if member is sender or not member.active:
                continue
            if self._hears(member):
                member.deliver(can_id, data)
            else:
                member.report_error()
        sender.report_room()
        self._delivering = False
        if sender.closed:
            self.leave(sender)
        self._begin()

    def _destroyed(self) -> None:
        """The frame was replaced by an error frame; its sender tries again."""
        sender = self._sender
        assert sender is not None
        self._sender = None
        sender.errors += _TEC_STEP
        self._delivering = True
        if sender.errors >= _TEC_BUS_OFF:
            self._go_off(sender)
        for member in tuple(self.members):
            if member.active:
                member.report_error()
        self._delivering = False
        self._begin()

    # -- fault confinement ------------------------------------------------------------------------------------------------

    def _fail_soon(self, member: Member) -> None:
        """Every attempt is destroyed at its first bits."""
        tries = (_TEC_BUS_OFF - member.errors) // _TEC_STEP

        def fail() -> None:
            if self.shorted and member.connected and not member.bus_off:
                self._go_off(member)

        self.loop.call_later(int(tries * _ERROR_BITS * self._bit_ns), fail)

    def _go_off(self, member: Member) -> None:
        member.bus_off = True
        member.queue.clear()
        member.report_error()
        if member.closed:
            self.leave(member)
        if not self.shorted:
            self._recover_later(member)

    def _recover_later(self, member: Member) -> None:
        """Recover after the restart time and the required idle time of the bus."""
        if member.restart_ns is None:
            return

        def recover() -> None:
            if not self.shorted and member.bus_off:
                member.bus_off = False
                member.errors = 0
                member.report_room()
                self._begin()

        self.loop.call_later(max(member.restart_ns, int(_RECOVERY_BITS * self._bit_ns)), recover)


def _worst_bits(can_id: int, data: bytes) -> int:
    return _WORST_BITS[len(data)] + (_EXTENDED_BITS if can_id & EXTENDED else 0)


def _rank(can_id: int) -> int:
    """The order of arbitration: base identifier, standard before extended, data before remote."""
    if can_id <= STANDARD_ID:
        return can_id << 20
    if can_id & EXTENDED:
        identifier = can_id & EXTENDED_ID
        rank = (identifier >> 18) << 20 | 1 << 19 | (identifier & 0x3FFFF) << 1
    else:
        rank = (can_id & STANDARD_ID) << 20
    return rank | bool(can_id & REMOTE)
