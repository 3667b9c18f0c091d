"""A PLC for tests: its frames and those of one gateway, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from pdgw.durations import SECOND
from pdgw.gateway.configuration.config import AxisConfig
from pdgw.gateway.configuration.tables.encoder import EncoderConfig
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.errors import GatewayError
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.peers.world.world import World
from pdgw.profidrive.telegrams import telegram

NOT_CONFIGURED: Final = "not in the configuration"


def place_of(do_id: int | None, objects: Sequence[AxisConfig | EncoderConfig], what: str) -> int:
    """The place of a drive object among these; None is the first one. GatewayError with ``what`` they are if it is not there."""
    known = [item.do_id for item in objects]
    if do_id is None:
        return 0
    if do_id not in known:
        raise GatewayError(f"do_id = {do_id}: {what}, allowed: {known}")
    return known.index(do_id)


class Plc:
    """A PLC in a world: what ``endpoint`` sends and receives.

    It reads telegrams and cycle time from the gateway's configuration and sends only while a test calls it.
    """

    def __init__(self, world: World, gateway: Daemon) -> None:
        self.endpoint = PlcEndpoint([telegram(item.telegram) for item in gateway.config.objects], gateway.cycle_ns)
        self._world = world
        self._gateway = gateway
        self._port = world.network.open("plc", 0, "PLC")
        self._port.start(self._take)

    def _take(self) -> None:
        while (datagram := self._port.receive()) is not None:
            self.endpoint.receive(datagram[0], self._world.loop.now())

    @property
    def actuals(self) -> Sequence[Mapping[str, int] | None]:
        """Raw actual values by name, for each axis in the order of the configuration; None while they are invalid."""
        return self.endpoint.actuals

    def set(self, axis: int, values: Mapping[str, int]) -> None:
        """Change raw setpoints by name from the next frame on, of an axis in the order of the configuration."""
        self.endpoint.set(axis, values)

    def exchange(self, seconds: float, do_id: int | None = None, **setpoints: int) -> None:
        """Send one frame per cycle for this number of seconds. ``setpoints`` change first, as raw values by name.

        ``do_id``: None for the first drive object. Raises ProfidriveError for a signal that the telegram lacks or a value that
        does not fit, GatewayError for an unknown DO-ID.
        """
        self.endpoint.set(self._index(do_id), setpoints)
        for _ in range(max(1, round(seconds * SECOND) // self._gateway.cycle_ns)):
            self._cycle()

    def run(self, seconds: float, do_id: int | None = None, *, on: bool | None = None, **steps: Any) -> None:
        """Run steps for this number of seconds: ``run(2, on=True, speed="1500 rpm")``.

        ``on``: True sends OFF, then ON when the drive is ready; False is OFF1. ``steps``: those of a scenario of the PLC
        simulator by name, in order. 100 % of a speed in rpm is ``rated_speed_rpm`` of the axis, else 3000 rpm. Raises
        GatewayError for a step that the telegram does not have, AssertionError if a step does not succeed or needs more time.
        """
        index = self._index(do_id)
        named = ({} if on is None else {"enable" if on else "off1": True}) | steps
        numbers = [item.number for item in self.endpoint.telegrams]
        chosen = self._gateway.config.objects[index]
        rated = chosen.rated_speed_rpm if isinstance(chosen, AxisConfig) else None
        references = {} if rated is None else {"speed_rpm": float(rated)}
        scenario = scenario_of(numbers, [{"axis": index + 1, name: value} for name, value in named.items()], references)
        engine = Engine(scenario, self.endpoint)
        for _ in range(max(1, round(seconds * SECOND) // self._gateway.cycle_ns)):
            engine.step(self._world.loop.now())
            self._cycle()
        failed = [f"{result.name}: {result.measured}" for result in engine.results if not result.passed]
        if failed or not engine.finished:
            raise AssertionError("; ".join(failed) or f"{engine.current}: not within {seconds:g} s")

    def actual(self, name: str, do_id: int | None = None) -> int | None:
        """A raw actual value; None while the values are invalid. Raises KeyError for a signal that the telegram lacks."""
        values = self.actuals[self._index(do_id)]
        return None if values is None else values[name]

    def _index(self, do_id: int | None) -> int:
        return place_of(do_id, self._gateway.config.objects, NOT_CONFIGURED)

    def _cycle(self) -> None:
        now = self._world.loop.now()
        self.endpoint.poll(now)
        self._port.send(self.endpoint.build(now), self._gateway.address)
        self._world.loop.run_for(self._gateway.cycle_ns)

    def until(self, condition: Callable[[], object], what: str, seconds: float = 10) -> None:
        """Exchange frames until a condition is true; AssertionError with ``what`` after this number of seconds."""
        deadline = self._world.loop.now() + round(seconds * SECOND)
        while not condition():
            if self._world.loop.now() >= deadline:
                raise AssertionError(f"{what}: not within {seconds:g} s; actual values {self.actuals}")
            self.exchange(0)
