"""A PLC on any clock, on UDP: it exchanges frames with one gateway on request, or in every cycle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Loop, Timer
from pdgw.gateway.base.udp import Address, DatagramPort
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import Telegram


class Plc:
    """What ``endpoint`` sends to the address ``gateway`` from ``port``, and receives from there; what others send is counted."""

    def __init__(
        self, loop: Loop, port: DatagramPort, gateway: Address, telegrams: Sequence[Telegram], cycle_ns: int
    ) -> None:
        self.endpoint = PlcEndpoint(telegrams, cycle_ns)
        self.loop = loop
        self.port = port
        self.gateway = gateway
        self.cycle_ns = cycle_ns
        self.silent = False
        """Send nothing, but keep receiving."""
        self.before_frame: list[Callable[[int], None]] = []
        """Functions called with the time in each cycle, to change setpoints."""
        self._due = 0
        self._timer: Timer | None = None
        port.start(self.receive)

    @property
    def actuals(self) -> Sequence[Mapping[str, int] | None]:
        """Raw actual values by name, for each axis in the order of the configuration; None while they are invalid."""
        return self.endpoint.actuals

    def set(self, axis: int, values: Mapping[str, int]) -> None:
        """Change raw setpoints by name from the next frame on, of an axis in the order of the configuration."""
        self.endpoint.set(axis, values)

    def value(self, name: str, axis: int = 0) -> int:
        """A raw actual value; -1 while it is invalid."""
        values = self.actuals[axis]
        return -1 if values is None else values[name]

    def send(self) -> None:
        """The PLC's part of a cycle."""
        now = self.loop.now()
        self.endpoint.poll(now)
        for action in self.before_frame:
            action(now)
        if not self.silent:
            self.port.send(self.frame(now), self.gateway)

    def frame(self, now: int) -> bytes | bytearray:
        """The next frame."""
        return self.endpoint.build(now)

    def cycle(self) -> None:
        """Send a frame, and run the loop for a cycle."""
        self.send()
        self.loop.run_for(self.cycle_ns)

    def until(self, condition: Callable[[], object], what: str, seconds: float = 10) -> None:
        """Exchange frames until a condition is true; AssertionError with ``what`` after this number of seconds."""
        deadline = self.loop.now() + round(seconds * SECOND)
        while not condition():
            if self.loop.now() >= deadline:
                raise AssertionError(f"{what}: not within {seconds:g} s; {self.seen()}")
            self.cycle()

    def seen(self) -> str:
        """What ``until`` reports when its time is over."""
        return f"actual values {self.actuals}"

    def start(self) -> None:
        """Send in every cycle while the loop runs."""
        self._due = self.loop.now()
        self._timer = self.loop.call_at(self._due, self._next)

    def stop(self) -> None:
        """Stop permanently and release the port."""
        if self._timer is not None:
            self._timer.cancel()
        self.port.close()

    def _next(self) -> None:
        self.send()
        self._due = max(self._due + self.cycle_ns, self.loop.now())
        self._timer = self.loop.call_at(self._due, self._next)

    def receive(self) -> None:
        """Process what waits at the port."""
        while (datagram := self.port.receive()) is not None:
            data, source = datagram
            if source == self.gateway:
                self.endpoint.receive(data, self.loop.now())
            else:
                self.endpoint.counters["foreign"] += 1
