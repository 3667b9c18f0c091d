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
from pdgw.gateway.links.cyclic import CyclicEndpoint
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.links.udp import Address
from pdgw.profidrive.telegrams import Telegram

SENDER: Final[Address] = ("", 0)
"""Sender of every frame."""
_NEVER: Final = (1 << 63) - 1
"""Later than every time."""
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


class _Events:
    """The setpoints of one axis."""

    def __init__(self) -> None:
        self._stops = False
        """The gateway itself is being stopped."""
        self.setpoints: list[Setpoints] = []

    def frame(self, now: int, values: tuple[int, ...] | None) -> None:
        """Values in force after an accepted frame."""
        if self._stops:
            self.setpoints.append(Setpoints(now, values, now, True))
        else:
            self.note(now, values)

    def stop(self, now: int) -> None:
        """The gateway itself begins to stop: the values of its last frame count once more."""
        self._stops = True
        self.setpoints.append(Setpoints(now, self.setpoints[-1].values if self.setpoints else None, now, True))

    def note(self, now: int, values: tuple[int, ...] | None) -> None:
        """``values`` from a time on."""
        if not self.setpoints or self.setpoints[-1].values != values:
            self.setpoints.append(Setpoints(now, values, now))


class _Receiver:
    """Passes frames to an endpoint and stores the results."""

    def __init__(self, endpoint: CyclicEndpoint | ProfinetEndpoint) -> None:
        self._inputs = PlcInputs([])
        self._endpoint = endpoint
        self._events = [_Events() for _ in endpoint.setpoints]
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
            events.note(now, None)

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
                events.frame(now, None if values is None else tuple(values))
            self._last_ns = frame.received_ns

    def end(self, watchdog_ns: int) -> PlcInputs:
        """Nothing comes any more."""
        self.expire(None, watchdog_ns)
        self._inputs.setpoints = [events.setpoints for events in self._events]
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

    ``stopped_ns``: when the gateway began to stop, None if it did not.
    """
    endpoint = CyclicEndpoint(telegrams, cycle_ns=cycle_ns, watchdog_factor=watchdog_factor)
    receiver = _Receiver(endpoint)
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
    receiver = _Receiver(endpoint)
    for item in happened:
        receiver.expire(item.time_ns, endpoint.watchdog_ns)
        if isinstance(item, Frame):
            receiver.take(item)
        else:
            endpoint.relate(item.change, item.connection)
            receiver.note(item.time_ns)
    return receiver.end(endpoint.watchdog_ns)
