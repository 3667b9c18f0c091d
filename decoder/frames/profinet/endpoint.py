"""Which frames the gateway's PROFINET link used, by the same consumer as the link has. Without I/O.

Frames count from the controller's confirmation of ApplicationReady to the end of the relationship, or to PrmBegin; the axes
lose the PLC after ``watchdog_factor`` cycles of the controller without one, long before the data hold time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from pdgw.decoder.frames.profinet.connect import Connection
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.profinet.records import Change
from pdgw.gateway.links.new_frames import Verdict
from pdgw.gateway.links.udp import Address
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.profinet.connection import cpm
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.model import Subslot

_VERDICTS: Final = {
    cpm.Verdict.ACCEPTED: Verdict.ACCEPTED,
    cpm.Verdict.PROVIDER_STOP: Verdict.PROVIDER_STOP,
    cpm.Verdict.NO_DATA: Verdict.NOT_PRIMARY,
    cpm.Verdict.LENGTH: Verdict.WRONG_TELEGRAM,
    cpm.Verdict.TRANSFER_STATUS: Verdict.NOT_VALID,
    cpm.Verdict.NOT_VALID: Verdict.NOT_VALID,
    cpm.Verdict.STALE: Verdict.STALE,
}
_Output = tuple[int, Callable[[bytes, int], tuple[int, ...]], int, int]
"""Number of an axis, its codec, and the places of its data and IOPS in the frame."""


class ProfinetEndpoint:
    """The PLC side of a capture. ``setpoints[i]`` are the raw values of axis i, None while it has no valid PLC. Times are
    those of the capture.
    """

    def __init__(self, axes: Sequence[Axis], watchdog_factor: int) -> None:
        self._axes = tuple(axes)
        self._factor = watchdog_factor
        self._connection: Connection | None = None
        self._consumer: Consumer | None = None
        self._outputs: list[_Output] = []
        self._last_ns = 0
        self.watchdog_ns = 0
        """Longest silence of the PLC in nanoseconds."""
        self.ready = False
        """The relationship is confirmed."""
        self.setpoints: list[tuple[int, ...] | None] = [None] * len(self._axes)
        self.connected = False
        """Frames have come since the relationship is ready, the last one not too long ago."""

    def relate(self, change: Change, connection: Connection) -> None:
        """A relationship comes or goes."""
        if change is Change.GRANTED:
            self._grant(connection)
        elif self._connection is not None and connection.ar == self._connection.ar:
            self.ready = change is Change.READY
            if change in {Change.PAUSED, Change.ENDED}:
                self._lose()
            if change is Change.ENDED:
                self._connection = self._consumer = None

    def _grant(self, connection: Connection) -> None:
        plan = connection.plan(Direction.SETPOINT)
        if plan is None:
            return
        self._lose()
        self._connection, self.ready = connection, False
        self._consumer = consumer = Consumer(plan)
        self.watchdog_ns = self._factor * consumer.cycle_ns
        self._outputs = []
        for index, axis in enumerate(self._axes):
            half = telegram(axis.telegram).setpoints
            where = next(
                (found for place in _places(connection, axis, index) if (found := consumer.place(place))), None
            )
            if where is not None and where[1] - where[0] == half.size:
                self._outputs.append((index, half.struct.unpack_from, *where))

    def receive(self, data: bytes, source: Address, now: int, received_at: int | None = None) -> Verdict:
        """A frame of the output relationship from its FrameID on; the setpoints follow where it counts."""
        consumer = self._consumer
        if consumer is None:
            return Verdict.AFTER_LOSS
        verdict = _VERDICTS[consumer.receive(data, 0, now)]
        came = verdict in {Verdict.ACCEPTED, Verdict.PROVIDER_STOP}
        if came:
            self._last_ns = now
        if not self.ready:
            return Verdict.AFTER_LOSS
        if came:
            self.connected = True
            payload = consumer.payload
            for index, unpack_from, offset, iops in self._outputs:
                good = consumer.running and payload[iops] & IOPS_GOOD
                self.setpoints[index] = unpack_from(payload, offset) if good else None
        return verdict

    def poll(self, now: int) -> bool:
        """The watchdog; True when the PLC was lost since the last call."""
        lost = self.connected and now - self._last_ns > self.watchdog_ns
        if lost:
            self._lose()
        return lost

    def _lose(self) -> None:
        self.connected = False
        for index in range(len(self.setpoints)):
            self.setpoints[index] = None


def _places(connection: Connection, axis: Axis, index: int) -> list[Subslot]:
    """The submodules of the slot an axis is in."""
    slot = axis.slot or index + 1
    return [place for place in connection.places if place[0] == slot]
