"""The PLC's side as the gateway saw it: which of the recorded frames counted, and when the PLC was lost. Without I/O."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from pdgw.decoder.frames.profinet.connect import Connection
from pdgw.decoder.frames.profinet.endpoint import ProfinetEndpoint
from pdgw.decoder.frames.profinet.records import Change
from pdgw.decoder.replay.recorded import Setpoints
from pdgw.gateway.configuration.tables.defaults import WATCHDOG_FACTOR
from pdgw.gateway.links.confirmation import CONFIRMING_FRAMES, Orders
from pdgw.gateway.links.cyclic import CyclicEndpoint, Verdict
from pdgw.gateway.links.sequence import SEQUENCE_FRAMES
from pdgw.gateway.links.udp import Address
from pdgw.profidrive.telegrams import Telegram

SENDER: Final[Address] = ("", 0)
"""Sender of every frame."""
_NEVER: Final = (1 << 63) - 1
"""Later than every time."""
_NO_FRAME: Final = _NEVER
"""After the last frame."""
USED: Final = frozenset({Verdict.ACCEPTED, Verdict.PROVIDER_STOP})
"""Frames with these verdicts make the gateway step."""


class Frame(NamedTuple):
    """A cyclic frame of the PLC: when the gateway processed it, and when it arrived, if both are known."""

    time_ns: int
    data: bytes
    received_ns: int


class Relation(NamedTuple):
    """A PROFINET relationship that comes or goes."""

    time_ns: int
    change: Change
    connection: Connection


class Received(NamedTuple):
    """Result of one frame of the PLC."""

    time_ns: int
    verdict: Verdict


@dataclass
class PlcInputs:
    """The PLC's side as the gateway's endpoint saw it. ``setpoints`` by axis; ``losses`` are expiries of the watchdog."""

    setpoints: list[list[Setpoints]]
    received: list[Received] = field(default_factory=list)
    losses: list[int] = field(default_factory=list)


class _Found(NamedTuple):
    """Values from a time on; ``certain``: the frame with which they are certainly in force, None at once."""

    time_ns: int
    values: tuple[int, ...] | None
    certain: int | None
    dropped: bool
    gateway_stops: bool = False


class _Events:
    """The setpoints of one axis, and the frame (counted from 0) from which each is certainly in force.

    ``orders``: its control words, if the gateway may wait for a confirmation; None if orders act at once (Ethernet).
    """

    def __init__(self, orders: Orders | None) -> None:
        self._orders = orders
        self._order: tuple[int, ...] | None = None
        self._confirmed_by = 0
        """The latest frame that confirms the present order."""
        self._connected = False
        self._dropped = False
        """An order was replaced before it was certainly confirmed."""
        self._changed = -CONFIRMING_FRAMES
        """The frame that changed the order last."""
        self._stops = False
        """The gateway itself is being stopped."""
        self._found: list[_Found] = []

    def frame(self, number: int, now: int, values: tuple[int, ...] | None) -> None:
        """Orders in force after an accepted frame, without a wait for confirmation."""
        if self._orders is None:
            self.note(now, values)
            return
        if not self._connected:
            self._connected = True
            self._confirmed_by = number + SEQUENCE_FRAMES - 1
        order = None if values is None else self._orders.read(values)
        if self._stops:
            if order != self._order and order is not None:
                # With no order in force, a stop counts at once only if the telegram has no other control word.
                at_once = self._orders.stopped(order, None, released=False) == order
                self._confirmed_by = number if at_once else number + CONFIRMING_FRAMES - 1
            self._order = order
            self._found.append(_Found(now, values, max(number, self._confirmed_by), False, True))
            return
        if order != self._order:
            self._drop_unconfirmed(number)
            # A stop of only a few frames had an effect, and the gateway may hide its report of the task.
            self._dropped |= number <= max(self._confirmed_by, self._changed + CONFIRMING_FRAMES - 1)
            self._changed = number
        if order is not None and order != self._order:
            stopped = self._orders.stopped(order, self._order, released=False)
            if stopped != order:
                before = self._found[-1].values if self._found else None
                if stopped is not None and stopped != self._order and before is not None:
                    # The stops of the frame take effect at once, the rest waits.
                    self.note(now, self._orders.applied(stopped, before), max(number, self._confirmed_by))
                self._confirmed_by = max(self._confirmed_by, number + CONFIRMING_FRAMES - 1)
        self._order = order
        self.note(now, values, number if values is None else max(number, self._confirmed_by))

    def _drop_unconfirmed(self, number: int) -> None:
        """Mark the orders that are unconfirmed before frame ``number`` as never confirmed: another order replaces them."""
        for place in reversed(range(len(self._found))):
            item = self._found[place]
            if item.certain is None or item.certain < number:
                break
            self._found[place] = item._replace(certain=_NO_FRAME)

    def lost(self, now: int) -> None:
        """The PLC was lost."""
        self._connected = self._dropped = False
        self._order = None
        self.note(now, None)

    def stop(self, now: int) -> None:
        """The gateway itself begins to stop: the values of its last frame count once more."""
        self._stops = True
        self._found.append(_Found(now, self._found[-1].values if self._found else None, None, False, True))

    def note(self, now: int, values: tuple[int, ...] | None, certain: int | None = None) -> None:
        """``values`` from a time on, for certain with a frame, or at once."""
        if not self._found or self._found[-1].values != values:
            self._found.append(_Found(now, values, certain, self._dropped))

    def setpoints(self, taken: Sequence[int]) -> list[Setpoints]:
        """With the times of the accepted frames. What waits for frames that never came is never certain."""
        events: list[Setpoints] = []
        for now, values, certain, dropped, stops in reversed(self._found):
            when = now if certain is None else taken[certain] if certain < len(taken) else _NEVER
            # A later frame has replaced it by then, whether it was accepted or not.
            events.append(Setpoints(now, values, min(when, events[-1].certain_ns) if events else when, dropped, stops))
        events.reverse()
        return events


class _Receiver:
    """Passes frames to an endpoint and stores the results."""

    def __init__(self, endpoint: CyclicEndpoint | ProfinetEndpoint, orders: Sequence[Orders | None]) -> None:
        self._inputs = PlcInputs([])
        self._endpoint = endpoint
        self._events = [_Events(item) for item in orders]
        self._taken: list[int] = []
        self._last_ns = 0
        """When the last accepted frame had come."""

    def note(self, now: int) -> None:
        """The setpoints as they are now."""
        for events, values in zip(self._events, self._endpoint.setpoints, strict=True):
            events.note(now, None if values is None else tuple(values))

    def expire(self, before: int | None, watchdog_ns: int) -> None:
        """The watchdog, if it expires before a time."""
        expiry = self._last_ns + watchdog_ns + 1
        if (before is None or expiry < before) and self._endpoint.poll(expiry):
            self._lost(expiry)

    def _lost(self, now: int) -> None:
        self._inputs.losses.append(now)
        for events in self._events:
            events.lost(now)

    def stop(self, now: int) -> None:
        """The gateway itself begins to stop."""
        for events in self._events:
            events.stop(now)

    def take(self, frame: Frame) -> None:
        """A frame."""
        now = frame.time_ns
        verdict = self._endpoint.receive(frame.data, SENDER, now, frame.received_ns)
        self._inputs.received.append(Received(now, verdict))
        if not self._endpoint.connected and self._endpoint.poll(now):
            # The gateway was paused: it detects the loss when it reads this frame, although further frames are queued.
            self._lost(now)
        if verdict in USED:
            for events, values in zip(self._events, self._endpoint.setpoints, strict=True):
                events.frame(len(self._taken), now, None if values is None else tuple(values))
            self._last_ns = frame.received_ns
            self._taken.append(now)

    def end(self, watchdog_ns: int) -> PlcInputs:
        """Nothing comes any more."""
        self.expire(None, watchdog_ns)
        self._inputs.setpoints = [events.setpoints(self._taken) for events in self._events]
        return self._inputs


def receive_frames(
    frames: Sequence[Frame],
    telegrams: Sequence[Telegram],
    *,
    cycle_ns: int,
    watchdog_factor: int = WATCHDOG_FACTOR,
    stopped_ns: int | None = None,
) -> PlcInputs:
    """Send recorded frames to a ``CyclicEndpoint``, all from one sender.

    ``stopped_ns``: when the gateway began to stop, None if it did not. Whether the gateway waited for more frames
    before a confirmation depends on its own receive times to the microsecond. Here all orders act at once, and
    ``Setpoints.certain_ns`` has the longest possible wait of the gateway.
    """
    endpoint = CyclicEndpoint(telegrams, cycle_ns=cycle_ns, watchdog_factor=watchdog_factor, delays=False)
    receiver = _Receiver(endpoint, [Orders(item.setpoints) for item in telegrams])
    watchdog_ns = cycle_ns * watchdog_factor
    stops_ns = _NEVER if stopped_ns is None else stopped_ns
    for frame in frames:
        if frame.time_ns >= stops_ns:
            receiver.expire(stops_ns, watchdog_ns)
            receiver.stop(stops_ns)
            stops_ns = _NEVER
        receiver.expire(frame.received_ns, watchdog_ns)
        receiver.take(frame)
    if stops_ns != _NEVER:
        receiver.expire(stops_ns, watchdog_ns)
        receiver.stop(stops_ns)
    return receiver.end(watchdog_ns)


def receive_profinet(happened: Iterable[Frame | Relation], endpoint: ProfinetEndpoint) -> PlcInputs:
    """Feed what happened on a PROFINET link, in the order of time."""
    receiver = _Receiver(endpoint, [None] * len(endpoint.setpoints))
    for item in happened:
        receiver.expire(item.time_ns, endpoint.watchdog_ns)
        if isinstance(item, Frame):
            receiver.take(item)
        else:
            endpoint.relate(item.change, item.connection)
            receiver.note(item.time_ns)
    return receiver.end(endpoint.watchdog_ns)
