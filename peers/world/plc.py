"""A PLC for tests: its frames and those of one gateway, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

from pdgw.durations import SECOND
from pdgw.gateway.daemon import Daemon
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.world.world import World
from pdgw.profidrive.telegrams import telegram


class Plc(PlcEndpoint):
    """A PLC in a world. ``actuals`` maps names to values for each axis; None while they are invalid.

    It reads telegrams and cycle time from the gateway's configuration and sends only while a test calls it.
    """

    def __init__(self, world: World, gateway: Daemon) -> None:
        super().__init__([telegram(item.telegram) for item in gateway.config.objects], gateway.cycle_ns)
        self._world = world
        self._gateway = gateway
        self._port = world.network.open("plc", 0, "PLC")
        self._port.start(self._take)

    def _take(self) -> None:
        while (datagram := self._port.receive()) is not None:
            self.receive(datagram[0], self._world.loop.now())

    def exchange(self, seconds: float, axis: int = 0, **setpoints: int) -> None:
        """Send one frame per cycle for this number of seconds. ``setpoints`` of an axis change first, as raw values by name.

        Raises ProfidriveError for a signal that the telegram lacks or a value that does not fit.
        """
        self.set(axis, setpoints)
        for _ in range(max(1, round(seconds * SECOND) // self._gateway.cycle_ns)):
            now = self._world.loop.now()
            self.poll(now)
            self._port.send(self.build(now), self._gateway.address)
            self._world.loop.run_for(self._gateway.cycle_ns)

    def until(self, condition: Callable[[], object], what: str, seconds: float = 10) -> None:
        """Exchange frames until a condition is true; AssertionError with ``what`` after this number of seconds."""
        deadline = self._world.loop.now() + round(seconds * SECOND)
        while not condition():
            if self._world.loop.now() >= deadline:
                raise AssertionError(f"{what}: not within {seconds:g} s; actual values {self.actuals}")
            self.exchange(0)
