"""The PLC's side as the gateway saw it: which of the recorded frames counted, and when the PLC was lost. Without I/O."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from pdgw.decoder.connect import Connection
from pdgw.decoder.profinet_endpoint import ProfinetEndpoint
from pdgw.decoder.profinet_records import Change
from pdgw.decoder.recorded import Setpoints
from pdgw.gateway.transport.cyclic import CyclicEndpoint, Verdict
from pdgw.profidrive.telegrams import Telegram

_SENDER: Final = ("recorded", 0)
USED: Final = frozenset({Verdict.ACCEPTED, Verdict.PROVIDER_STOP})
"""Frames with these verdicts make the gateway step."""


class Frame(NamedTuple):
    """A cyclic frame of the PLC."""

    time_ns: int
    data: bytes


class Relation(NamedTuple):
    """A PROFINET relationship that comes or goes."""

    time_ns: int
    change: Change
    connection: Connection


class Received(NamedTuple):
    """What became of one frame of the PLC."""

    time_ns: int
    verdict: Verdict


@dataclass
class PlcInputs:
    """The PLC's side as the gateway's endpoint saw it. ``setpoints`` by axis; ``losses`` are expiries of the watchdog."""

    setpoints: list[list[Setpoints]]
    received: list[Received] = field(default_factory=list)
    losses: list[int] = field(default_factory=list)


class _Receiver:
    """Feeds an endpoint and keeps what it makes of it."""

    def __init__(self, endpoint: CyclicEndpoint | ProfinetEndpoint) -> None:
        self.inputs = PlcInputs([[] for _ in endpoint.setpoints])
        self.last_ns = 0
        self._endpoint = endpoint

    def note(self, now: int) -> None:
        """The setpoints as they are now."""
        for events, values in zip(self.inputs.setpoints, self._endpoint.setpoints, strict=True):
            if not events or events[-1].values != values:
                events.append(Setpoints(now, None if values is None else tuple(values)))

    def expire(self, before: int | None, watchdog_ns: int) -> None:
        """The watchdog, if it expires before a time."""
        expiry = self.last_ns + watchdog_ns + 1
        if (before is None or expiry < before) and self._endpoint.poll(expiry):
            self.inputs.losses.append(expiry)
            self.note(expiry)

    def take(self, frame: Frame) -> None:
        """A frame."""
        now = frame.time_ns
        verdict = self._endpoint.receive(frame.data, _SENDER, now, now)
        self.inputs.received.append(Received(now, verdict))
        if verdict in USED:
            self.last_ns = now
            self.note(now)


def receive_frames(
    frames: Sequence[tuple[int, bytes]], telegrams: Sequence[Telegram], *, cycle_ns: int, watchdog_factor: int = 3
) -> PlcInputs:
    """Feed recorded frames (time, RT frame) to a ``CyclicEndpoint``; all count as coming from one sender."""
    receiver = _Receiver(CyclicEndpoint(telegrams, cycle_ns=cycle_ns, watchdog_factor=watchdog_factor, delays=False))
    watchdog_ns = cycle_ns * watchdog_factor
    for now, data in frames:
        receiver.expire(now, watchdog_ns)
        receiver.take(Frame(now, data))
    receiver.expire(None, watchdog_ns)
    return receiver.inputs


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
    receiver.expire(None, endpoint.watchdog_ns)
    return receiver.inputs
