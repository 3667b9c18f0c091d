"""The link to the PLC. The loop uses a ``Link`` and knows no transport.

``UdpLink`` is the PROFINET cyclic frame over UDP (docs/plc.md).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol

from pdgw.base.durations import MS
from pdgw.ds301.counters import Counters
from pdgw.gateway.base.finding_text import finding_line
from pdgw.gateway.base.reasons import Finding
from pdgw.gateway.base.udp import Address, DatagramPort
from pdgw.gateway.configuration.environment import TransportConfig
from pdgw.gateway.links.cyclic import USUAL, CyclicEndpoint
from pdgw.gateway.links.frame_places import FramePlaces
from pdgw.gateway.links.new_frames import Verdict
from pdgw.profidrive.telegrams import Telegram
from pdgw.profinet.rpc.server import RpcServer

log = logging.getLogger("gateway")

AT_ONCE: Final = 64
"""Frames of one reading, so that a flood delays no cycle."""
_WAITED_AT_MOST: Final = 10_000
"""More than a socket buffer: a flood must not delay the gateway."""
_ACCEPTED: Final = Verdict.ACCEPTED
_PROVIDER_STOP: Final = Verdict.PROVIDER_STOP


def silence(cycles: int) -> str:
    """A loss by the watchdog, as in the log and fault 103."""
    return f"no valid frame for {cycles} cycles"


def is_punctual(since_ns: int, cycle_ns: int) -> bool:
    """The time since the frame before is about a cycle: no other frame waits then, and to look for one costs a system call."""
    half = cycle_ns >> 1
    return half < since_ns < cycle_ns + half


def discard_waiting(receive: Callable[[], object]) -> bool:
    """Receive and drop what waits; whether there was anything."""
    for number in range(_WAITED_AT_MOST):
        if receive() is None:
            return number > 0
    return True


def watch_calls(server: RpcServer[Address], counters: Counters, part: str) -> None:
    """Count the calls that are not served as others are, and log the first one of each caller that gets no answer."""
    add = partial(counters.add, part)
    add("malformed", "datagrams", "not RPC packets", lambda: server.malformed)
    add("repeated", "calls", "answered again", lambda: server.repeated)
    add("dropped", "calls", "not answered: older than the last call, or fragments missing", lambda: server.dropped)
    server.on_dropped = lambda source, why: log.warning("call from %s:%d not answered: %s", *source, why)


class FrameRecorder(Protocol):
    """Takes the frames of the PLC beside the cyclic ones."""

    def ethernet(self, frame: bytes) -> None:
        """A frame, sent or received now."""

    def datagram(self, source: Address, target: Address, data: bytes) -> None:
        """A datagram, sent or received now."""


class LinkState(Protocol):
    """What is known of the PLC, for logs and ``pdgw status``."""

    @property
    def connected(self) -> bool:
        """A PLC is exchanging data."""

    @property
    def peer_host(self) -> str | None:
        """Address of the connected PLC."""

    @property
    def received_ns(self) -> int | None:
        """Arrival of the newest valid frame; None: none yet."""

    @property
    def age_ns(self) -> int | None:
        """Greatest possible age of the last frame that counted; None where no frame is late."""

    def finding(self, index: int | None = None) -> Finding | None:
        """Why frames of the PLC, or of another sender, do not count; ``index``: for this drive object. None if they do."""

    def status(self) -> dict[str, object]:
        """Connection and verdicts, for ``pdgw status``."""


class LinkLayout(Protocol):
    """The frames and where the values are in them, for the recorder."""

    recorder: FrameRecorder | None

    layout_token: object
    """Another one with every new layout of the frames."""

    def set_layout(self, telegrams: Sequence[Telegram]) -> None:
        """Other telegrams from now on, in the order of the drive objects; GatewayError or ProfidriveError when not possible."""

    def places(self) -> FramePlaces:
        """The present layout of the frames."""

    def newest(self) -> tuple[bool, Address | None, bytes, bytes | bytearray]:
        """Whether a PLC is connected, its address on UDP, its newest frame and the newest one to it, empty before there was one.

        The buffer of the last one is used again.
        """


class Link(LinkState, LinkLayout, Protocol):
    """One relationship with a PLC, any number of drive objects: the cyclic exchange."""

    log_event: Callable[[str], object]
    """Called with the text when a PLC connects or is lost."""

    setpoints: list[Sequence[int] | None]
    """The raw values of each drive object, None while it has no valid PLC."""

    more: bool
    """Whether more data may wait after the last ``receive``."""

    @property
    def takes_together(self) -> bool:
        """The PLC's next frame is read at a known time, so soon that frames of the buses can wait for it."""

    def start(self, action: Callable[[], None]) -> None:
        """Call ``action`` in the loop whenever something of the PLC waits."""

    def receive(self, now: int, at_most: int = AT_ONCE) -> bool:
        """Process everything that waits, or this number of items; True if valid data of the PLC was among them."""

    def poll(self, now: int) -> str:
        """Check the watchdog; why the PLC is lost, if it expires in this call or the relationship has ended.

        Empty otherwise, and for one of repeated losses, which are counted.
        """

    def lose_setpoints(self) -> None:
        """No drive object has a valid PLC until its next data."""

    def send(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int) -> None:
        """Answer the PLC. ``good``: the values of that drive object are valid."""

    def close(self) -> None:
        """Close its ports."""


class UdpLink(Link):
    """Cyclic frames over UDP. ``tick_offset``: a random number, another one with each start (``NewFrames``)."""

    takes_together = False

    def __init__(
        self,
        port: DatagramPort,
        transport: TransportConfig,
        telegrams: Sequence[Telegram],
        counters: Counters,
        tick_offset: int = 0,
    ) -> None:
        self.port = port
        self._transport = transport
        self._cycle_ns = int(transport.cycle_time_ms * MS)
        self._tick_offset = tick_offset
        self.endpoint = self._endpoint(telegrams)
        self.setpoints = self.endpoint.setpoints
        self.skipped = 0
        self._received_at = 0
        self.more = True
        """Data after a punctual frame is processed in the next turn, which saves one system call in each cycle."""
        self._filtered = False
        """A connection exists, and only frames of its PLC are received."""
        self.layout_token = object()
        self.recorder: FrameRecorder | None = None
        self.log_event: Callable[[str], object] = lambda _: None
        self._register_counters(counters)

    def _register_counters(self, counters: Counters) -> None:
        add = partial(counters.add, "link")
        for verdict in Verdict:
            add(verdict.name.lower(), "frames", verdict.value, partial(self._count_of, verdict))
        add("sent", "frames", "to the PLC", lambda: self.endpoint.counts.sent)
        add("skipped", "frames", "overtaken by a newer frame before the axes read them", lambda: self.skipped)
        add(
            "watchdog_expiries",
            "times",
            "timeouts: no valid frame in time",
            lambda: self.endpoint.counts.watchdog_expiries,
        )
        add(
            "iops_bad",
            "values",
            "data of a drive object that the PLC marked as bad",
            lambda: self.endpoint.counts.iops_bad,
        )
        add("errors", "datagrams", "send or receive failed: peer not reachable", lambda: self.port.errors)

    def _count_of(self, verdict: Verdict) -> int:
        return self.endpoint.counts.frames[verdict]

    def _endpoint(self, telegrams: Sequence[Telegram], previous: CyclicEndpoint | None = None) -> CyclicEndpoint:
        transport = self._transport
        return CyclicEndpoint(
            telegrams,
            cycle_ns=self._cycle_ns,
            watchdog_factor=transport.watchdog_factor,
            peer=str(transport.peer) if transport.peer else None,
            age_limit_ns=transport.age_limit_ns,
            tick_offset=self._tick_offset,
            previous=previous,
        )

    @property
    def connected(self) -> bool:
        return self.endpoint.connected

    @property
    def peer_host(self) -> str | None:
        address = self.endpoint.peer
        return address[0] if address and self.connected else None

    def start(self, action: Callable[[], None]) -> None:
        # Discard frames received since the port was opened: they are old, and would be reported as a loss at the start.
        discard_waiting(self.port.receive)
        self.port.start(action, urgent=True)

    def receive(self, now: int, at_most: int = AT_ONCE) -> bool:
        endpoint, port = self.endpoint, self.port
        taken = 0
        for _ in range(at_most):
            datagram = port.receive()
            if datagram is None:
                break
            data, source = datagram
            verdict = endpoint.receive(data, source, now, port.received_at)
            if verdict is _ACCEPTED or verdict is _PROVIDER_STOP:
                taken += 1
                if endpoint.changed:
                    break  # the axes step, so that the next frame overwrites no order
            elif verdict not in USUAL and endpoint.counts.frames[verdict] == 1:
                log.warning("%s", finding_line(endpoint.refusals.why(verdict, source, data, endpoint.peer)))
        self.more = True
        if taken:
            self.skipped += taken - 1
            since, self._received_at = now - self._received_at, now
            self.more = not is_punctual(since, self._cycle_ns)
        if endpoint.connected and not self._filtered and endpoint.peer is not None:
            if endpoint.losses.finding(now) is None:
                log.info("PLC %s:%d connected", *endpoint.peer, extra={"event": "plc"})
            # The kernel drops the datagrams of unknown senders.
            self._listen_to(endpoint.peer)
        return taken > 0

    def _listen_to(self, peer: Address | None) -> None:
        if self._filtered is (peer is None):
            self.log_event("PLC not connected" if peer is None else f"PLC connected ({peer[0]}:{peer[1]})")
        self._filtered = peer is not None
        self.port.only_from(peer)

    def poll(self, now: int) -> str:
        endpoint = self.endpoint
        if not endpoint.poll(now):
            return ""
        if not endpoint.connected:
            self._listen_to(None)
        text, finding = silence(self._transport.watchdog_factor), endpoint.lost_by
        return endpoint.losses.report(text if finding is None else f"{text}: {finding_line(finding)}", now)

    def finding(self, index: int | None = None) -> Finding | None:
        return self.endpoint.finding(index)

    @property
    def age_ns(self) -> int | None:
        return self.endpoint.new_frames.age_ns

    def lose_setpoints(self) -> None:
        self.endpoint.lose_setpoints()

    def send(self, actuals: Sequence[Sequence[int]], good: Sequence[bool], now: int) -> None:
        endpoint = self.endpoint
        if endpoint.peer is not None:
            self.port.send(endpoint.build(actuals, good, now), endpoint.peer)

    def set_layout(self, telegrams: Sequence[Telegram]) -> None:
        endpoint = self._endpoint(telegrams, self.endpoint)
        self.endpoint, self.setpoints = endpoint, endpoint.setpoints
        self.layout_token = object()
        self._listen_to(None)

    def places(self) -> FramePlaces:
        endpoint = self.endpoint
        return FramePlaces("udp", endpoint.consumer.offsets, endpoint.provider.offsets)

    def newest(self) -> tuple[bool, Address | None, bytes, bytes | bytearray]:
        endpoint = self.endpoint
        return endpoint.connected, endpoint.peer, endpoint.received, endpoint.frame

    @property
    def received_ns(self) -> int | None:
        return self.endpoint.received_ns

    def status(self) -> dict[str, object]:
        endpoint = self.endpoint
        return {
            "connected": endpoint.connected,
            "peer": list(endpoint.peer) if endpoint.peer else None,
            "watchdog_ms": self._transport.cycle_time_ms * self._transport.watchdog_factor,
            "age_limit_ms": None if (limit_ns := endpoint.new_frames.age_limit_ns) is None else limit_ns / MS,
            "frames": {verdict.value: count for verdict, count in endpoint.counts.frames.items()},
        }

    def close(self) -> None:
        self.port.close()
