"""Which frames the gateway's PROFINET link used, by the same consumer as the link has. Without I/O.

Frames count from the controller's confirmation of ApplicationReady to the end of the relationship, or to PrmBegin; the axes
lose the PLC after ``watchdog_factor`` cycles of the controller without one, long before the data hold time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from pdgw.decoder.frames.profinet.connect import Connection, Place
from pdgw.decoder.frames.profinet.cyclic import Axis
from pdgw.decoder.frames.profinet.records import Change
from pdgw.gateway.links.confirmation import Orders
from pdgw.gateway.links.cyclic import Verdict
from pdgw.gateway.links.udp import Address
from pdgw.profidrive.frame import IOPS_GOOD
from pdgw.profidrive.telegrams import Direction, telegram
from pdgw.profinet.connection import cpm
from pdgw.profinet.connection.cpm import Consumer
from pdgw.profinet.connection.redundancy import ArSet

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


@dataclass
class _Member:
    """A relationship with output data."""

    connection: Connection
    consumer: Consumer
    outputs: list[_Output]
    ready: bool = False


class ProfinetEndpoint:
    """The PLC side of a capture. ``setpoints[i]`` are the raw values of axis i, None while it has no valid PLC. Times are
    those of the capture.

    Of two relationships of system redundancy, the frames of the leader count: see ``profinet.connection.redundancy``.
    Controllers are identified by their MAC addresses.
    """

    def __init__(self, axes: Sequence[Axis], watchdog_factor: int) -> None:
        self._axes = tuple(axes)
        self._factor = watchdog_factor
        self._members: dict[bytes, _Member] = {}
        self._set: ArSet[bytes] = ArSet()
        self._leader = b""
        """Whose output data is in force, or was last."""
        self._last_ns = 0
        self._limit_ns = 0
        self.setpoints: list[tuple[int, ...] | None] = [None] * len(self._axes)
        self.connected = False
        """Frames have come since the relationship is ready, the last one not too long ago."""

    @property
    def watchdog_ns(self) -> int:
        """Longest silence of the PLC in nanoseconds; longer while another controller can take over."""
        allowed = min(self._last_ns + self._set.hold_ns, self._successor_until) - self._last_ns
        return max(self._limit_ns, allowed)

    @property
    def _successor_until(self) -> int:
        """Until when a controller that does not lead may take over: its relationship exchanges data, and it sends."""
        waiting = [
            member.consumer.last_ns + member.consumer.hold_ns - 1
            for controller, member in self._members.items()
            if controller in self._set.members and controller != self._set.primary
            if member.ready and member.consumer.last_ns is not None
        ]
        return max(waiting, default=0)

    @property
    def leads(self) -> str:
        """The name of the controller that leads, of system redundancy; empty where there is none."""
        member = self._members.get(self._set.primary or b"")
        return "" if member is None else member.connection.controller

    def follows(self, controller: bytes) -> bool:
        """Whether the frames of a controller's relationship are those that count: not while another one leads."""
        return len(self._members) < 2 or controller == (self._set.primary or self._leader or next(iter(self._members)))

    @property
    def ready(self) -> bool:
        """The relationship that counts is confirmed."""
        return any(member.ready for controller, member in self._members.items() if self.follows(controller))

    def relate(self, change: Change, connection: Connection, now: int) -> None:
        """A relationship comes or goes."""
        controller = connection.controller_mac
        member = self._members.get(controller)
        if change is Change.GRANTED:
            self._grant(connection, now)
        elif member is not None and connection.ar == member.connection.ar:
            member.ready = change is Change.READY
            if change is Change.PAUSED and self.follows(controller):
                self._lose()
            if change is Change.ENDED:
                self._leave(controller, now)

    def _grant(self, connection: Connection, now: int) -> None:
        plan = connection.plan(Direction.SETPOINT)
        if plan is None:
            return
        controller = connection.controller_mac
        if controller in self._members:
            self._leave(controller, now)
        if not connection.redundancy_hold_ns or not self._set.members:
            self._lose()
            self._members.clear()
            self._set, self._leader = ArSet(), b""
        consumer = Consumer(plan)
        self._limit_ns = self._factor * consumer.cycle_ns
        outputs: list[_Output] = []
        for index, axis in enumerate(self._axes):
            half = telegram(axis.telegram).setpoints
            where = next(
                (found for place in _places(connection, axis, index) if (found := consumer.place(place))), None
            )
            if where is not None and where[1] - where[0] == half.size:
                outputs.append((index, half.struct.unpack_from, *where))
        self._members[controller] = _Member(connection, consumer, outputs)
        if connection.redundancy_hold_ns:
            self._set.join(controller, connection.redundancy_hold_ns)

    def _leave(self, controller: bytes, now: int) -> None:
        counted = self.follows(controller)
        del self._members[controller]
        if controller in self._set.members:
            self._set.leave(controller, now)
        if counted and now > self._successor_until:
            self._lose()

    def receive(self, data: bytes, source: Address, now: int, received_at: int | None = None) -> Verdict:
        """A frame of the output relationship from its FrameID on; the setpoints follow where it counts.

        ``source``: MAC address of the controller as text; any text counts while there is one relationship.
        """
        controller = bytes.fromhex(source[0]) if len(self._members) > 1 else next(iter(self._members), b"")
        member = self._members.get(controller)
        if member is None:
            return Verdict.UNCONFIRMED
        consumer = member.consumer
        verdict = _VERDICTS[consumer.receive(data, 0, now)]
        if member.ready and controller in self._set.members:
            self._set.ask(controller, now, primary=consumer.primary)
            if self._set.primary != controller:
                return Verdict.NOT_PRIMARY if controller == self._leader else Verdict.UNCONFIRMED
        came = verdict in {Verdict.ACCEPTED, Verdict.PROVIDER_STOP}
        if came:
            self._last_ns = now
        if not member.ready:
            return Verdict.UNCONFIRMED
        if came:
            before = list(self.setpoints) if self._leader not in {b"", controller} else []
            self._leader, self.connected = controller, True
            self._limit_ns = self._factor * consumer.cycle_ns
            payload = consumer.payload
            for index, unpack_from, offset, iops in member.outputs:
                good = consumer.running and payload[iops] & IOPS_GOOD
                self.setpoints[index] = unpack_from(payload, offset) if good else None
            self._compare(before)
        return verdict

    def _compare(self, before: Sequence[tuple[int, ...] | None]) -> None:
        """A new leader that orders something else than is in force, and no stop, is a loss of the PLC for that axis."""
        for index, old in enumerate(before):
            new = self.setpoints[index]
            if old is not None and new is not None:
                orders = Orders(telegram(self._axes[index].telegram).setpoints)
                if not orders.repeats_commands(new, old):
                    self.setpoints[index] = None

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


def _places(connection: Connection, axis: Axis, index: int) -> list[Place]:
    """The submodules of the slot an axis is in."""
    slot = axis.slot or index + 1
    return [place for place in connection.places if place[0] == slot]
