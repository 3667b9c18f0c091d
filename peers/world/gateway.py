"""A gateway for a test: in a world of its own, with the simulated devices of its configuration and a PLC."""

from __future__ import annotations

from functools import cached_property
from types import TracebackType
from typing import Any

from pdgw.gateway.assembly import build_gateway
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.service.status import snapshot
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.world.plc import NOT_CONFIGURED, Plc, place_of
from pdgw.peers.world.world import World


class Gateway:
    """``with Gateway(config) as gateway``: runs until the end of the block, in virtual time.

    ``world`` and ``daemon`` exist before the block, so that a test can add devices that the configuration does not simulate.
    """

    def __init__(self, config: GatewayConfig, seed: int | str = 0) -> None:
        self.world = World(seed)
        self.world.simulate(config)
        self.daemon = build_gateway(config, self.world)

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

    def device(self, do_id: int) -> SimulatedDrive | SimulatedEncoder:
        """The simulated device of a drive object: ``inject`` raises one of its faults, ``clear`` removes the causes.

        GatewayError without such a device.
        """
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
