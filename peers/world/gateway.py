"""A gateway and its PLC for a test: in a world of their own, with the simulated devices of the configuration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Protocol

from pdgw.base.durations import SECOND
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.axis_config import AxisConfig
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.devices import EncoderConfig
from pdgw.gateway.configuration.file import load_config
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange import plc
from pdgw.peers.plc.notation import find
from pdgw.peers.plc.scenario_file import scenario_of
from pdgw.peers.world.world import GATEWAY, World


class SimulatedDevice(Protocol):
    """A simulated drive or encoder."""

    def inject(self, fault: int | str) -> None:
        """Raise a fault by its name (of a drive also its number, 1-12), or start a habit as ``simulate`` has it.

        ``inject("motor feedback")``, ``inject(5)``, ``inject("deaf")``, ``inject("slow-sdo delay_ms=100")``. The cause stays
        until ``clear``. CanopenError with all names for another one.
        """

    def clear(self) -> None:
        """Remove the causes of all faults, so that a fault reset is accepted, and end the habits."""


class Gateway:
    """``with Gateway(config) as gateway``: runs until the end of the block, in virtual time.

    ``config``: a configuration, or the path of its file; GatewayError if the file is wrong. ``world`` and ``daemon`` exist before
    the block, so that a test can add devices that the configuration does not simulate: ``world.drive("can0", 1)``. While no
    bus has a device, ``plc`` raises GatewayError.

    >>> import pdgw
    >>> config = pdgw.parse_config('''
    ... [can]
    ... interface = "virtual"
    ... channel = "bus"
    ... [[axis]]
    ... do_id = 1
    ... node_id = 1
    ... telegram = 1
    ... simulate = true
    ... ''')
    >>> with pdgw.Gateway(config) as gateway:
    ...     gateway.plc.run(3, on=True, speed="1500 rpm")
    ...     gateway.plc.actual("ZSW1.OPERATION_ENABLED"), round(gateway.plc.actual("NIST_A") / 0x4000, 2)
    ...     gateway.device(1).inject("motor feedback")
    ...     gateway.plc.exchange(0.1)
    ...     gateway.plc.actual("ZSW1.FAULT"), gateway.sentence(1).split(",")[0]
    (1, 0.5)
    (1, 'Fault: EMCY 7305h motor feedback')
    """

    def __init__(self, config: GatewayConfig | Path | str, seed: int | str = 0) -> None:
        chosen = config if isinstance(config, GatewayConfig) else load_config(config)
        self.world = World(seed)
        self.world.simulate(chosen)
        self.daemon = build_gateway(chosen, self.world)

    def __enter__(self) -> Gateway:
        self.daemon.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.daemon.stop()
        self.world.loop.until(self.daemon.stopped.is_set, "the end of the gateway")

    @cached_property
    def plc(self) -> Plc:
        """The PLC. It sends only while a test calls it."""
        return Plc(self.world, self.daemon)

    def device(self, do_id: int) -> SimulatedDevice:
        """The simulated device of a drive object. GatewayError without such a device."""
        config = self.daemon.config
        simulated = [item for item in config.objects if item.simulate]
        item = simulated[place_of(do_id, simulated, "no simulated device")]
        device = self.world.simulations[config.bus_of(item).name].device(item.node_id)
        assert isinstance(device, SimulatedDrive | SimulatedEncoder)
        return device

    def status(self) -> dict[str, Any]:
        """The document of ``pdgw status --json`` (docs/operation.md)."""
        return snapshot(self.daemon)

    def sentence(self, do_id: int) -> str:
        """Why an axis or encoder does not move, as in ``pdgw status``. GatewayError for an unknown DO-ID."""
        objects = self.daemon.objects
        return objects[place_of(do_id, self.daemon.config.objects, NOT_CONFIGURED)].enable_status.sentence


NOT_CONFIGURED: Final = "not in the configuration"
_LATER_NS: Final = 3600 * SECOND
"""Longer than a step waits."""


def place_of(do_id: int | None, objects: Sequence[AxisConfig | EncoderConfig], what: str) -> int:
    """The place of a drive object among these; None is the first one. GatewayError with ``what`` they are if it is not there."""
    known = [item.do_id for item in objects]
    if do_id is None:
        return 0
    if do_id not in known:
        raise GatewayError(f"do_id = {do_id}: {what}, allowed: {known}")
    return known.index(do_id)


class Plc(plc.Plc):
    """A PLC in a world: what ``endpoint`` sends and receives.

    It reads telegrams and cycle time from the gateway's configuration and sends only while a test calls it.
    """

    def __init__(self, world: World, gateway: Daemon) -> None:
        telegrams = [item.chosen for item in gateway.config.objects]
        super().__init__(world.loop, world.network.open("plc", 0, "PLC"), gateway.address, telegrams, gateway.cycle_ns)
        self._objects = gateway.config.objects
        self._buses = [world.bus(str(bus.channel)) for bus in gateway.config.can]

    def exchange(self, seconds: float, do_id: int | None = None, **setpoints: int) -> None:
        """Send one frame per cycle for this number of seconds. ``setpoints`` change first, as raw values by name.

        ``do_id``: None for the first drive object. Raises ProfidriveError for a signal that the telegram lacks or a value that
        does not fit, GatewayError for an unknown DO-ID.
        """
        self.endpoint.set(self._index(do_id), setpoints)
        for _ in range(max(1, round(seconds * SECOND) // self.cycle_ns)):
            self.cycle()

    def run(self, seconds: float, do_id: int | None = None, *, on: bool | None = None, **steps: Any) -> None:
        """Run steps for this number of seconds: ``run(2, on=True, speed="1500 rpm")``.

        ``on``: True sends OFF, then ON when the drive is ready; False is OFF1. ``steps``: those of a scenario of the PLC
        simulator by name, in order. 100 % of a speed in rpm is ``rated_speed_rpm`` of the axis, else 3000 rpm. Raises
        GatewayError for a step that the telegram does not have, AssertionError if a step does not succeed or needs more time.
        """
        index = self._index(do_id)
        named = ({} if on is None else {"enable" if on else "off1": True}) | steps
        chosen = self._objects[index]
        rated = chosen.rated_speed_rpm if isinstance(chosen, AxisConfig) else None
        references = {} if rated is None else {"speed_rpm": float(rated)}
        found = [{"axis": index + 1, name: value} for name, value in named.items()]
        scenario = scenario_of(self.endpoint.telegrams, found, references)
        engine = Engine(scenario, self.endpoint)
        for _ in range(max(1, round(seconds * SECOND) // self.cycle_ns)):
            engine.step(self.loop.now())
            self.cycle()
        current, late = engine.current, not engine.finished
        if late:
            engine.step(self.loop.now() + _LATER_NS)  # what it waits for fails, with the measured values
        failed = [f"{result.name}: {result.measured}" for result in engine.results if not result.passed]
        if late:
            failed.append(f"{current}: not within {seconds:g} s")
        if failed:
            raise AssertionError("; ".join(failed))

    def actual(self, name: str, do_id: int | None = None) -> int:
        """A raw actual value, or a bit of one (``"ZSW1.FAULT"``).

        GatewayError while the values are invalid, for a signal that the telegram lacks and for an unknown DO-ID.
        """
        index = self._index(do_id)
        word = find(name, self.endpoint.telegrams[index].actuals)
        values = self.actuals[index]
        if values is None:
            raise GatewayError(f"{name}: no valid actual values: {self.endpoint.why_no_values(index)}")
        return word.of(values)

    def _index(self, do_id: int | None) -> int:
        if not any(member.name != GATEWAY for bus in self._buses for member in bus.members):
            raise GatewayError(
                "no bus has a device: set simulate = true in [[axis]] or [[encoder]], or add devices to gateway.world"
            )
        return place_of(do_id, self._objects, NOT_CONFIGURED)
