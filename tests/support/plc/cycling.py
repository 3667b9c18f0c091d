"""A PLC as timed events on a loop: it sends a frame each cycle, whatever the gateway answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pdgw.ds301.loop.loop import Loop, Timer
from pdgw.gateway.links.udp import Address
from pdgw.gateway.platform import DatagramPort
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import Telegram


class CyclingPlc:
    """Exchanges frames with a gateway."""

    def __init__(
        self,
        loop: Loop,
        port: DatagramPort,
        gateway: Address,
        telegrams: Sequence[Telegram],
        cycle_ns: int,
    ) -> None:
        self.endpoint = PlcEndpoint(telegrams, cycle_ns)
        self.gateway = gateway
        self.silent = False
        """Send nothing, but keep receiving."""
        self.before_frame: list[Callable[[int], None]] = []
        """Functions called with the time in each cycle, to change setpoints."""
        self._loop = loop
        self._port = port
        self._cycle_ns = cycle_ns
        self._due = loop.now()
        self._timer: Timer | None = None

    def start(self) -> None:
        """Start the exchange."""
        self._port.start(self._receive)
        self._timer = self._loop.call_at(self._due, self._cycle)

    def restart(self, port: DatagramPort, telegrams: Sequence[Telegram] | None = None) -> None:
        """Restart the PLC: another port, a new relationship, the same setpoints. Other telegrams start with zeros."""
        self._port.close()
        before = self.endpoint
        self.endpoint = PlcEndpoint(before.telegrams if telegrams is None else telegrams, self._cycle_ns)
        if telegrams is None:
            self.endpoint.setpoints = before.setpoints
        self._port = port
        port.start(self._receive)

    def stop(self) -> None:
        """Stop permanently and release the port."""
        if self._timer is not None:
            self._timer.cancel()
        self._port.close()

    def set(self, values: Mapping[str, int], axis: int = 0) -> None:
        """Change setpoints from the next frame on; see ``PlcEndpoint.set``."""
        self.endpoint.set(axis, values)

    def value(self, name: str, axis: int = 0) -> int | None:
        """The last actual value; None while no valid one is available."""
        actuals = self.endpoint.actuals[axis]
        return None if actuals is None else actuals[name]

    def _cycle(self) -> None:
        now = self._loop.now()
        self.endpoint.poll(now)
        for action in self.before_frame:
            action(now)
        if not self.silent:
            self._port.send(self.endpoint.build(now), self.gateway)
        self._due = max(self._due + self._cycle_ns, now)
        self._timer = self._loop.call_at(self._due, self._cycle)

    def _receive(self) -> None:
        while (datagram := self._port.receive()) is not None:
            data, source = datagram
            if source == self.gateway:
                self.endpoint.receive(data, self._loop.now())
            else:
                self.endpoint.counters["foreign"] += 1
