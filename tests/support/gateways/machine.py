"""A daemon on the machine's own clock and ports, with simulated devices on python-can's virtual bus: for what needs them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pdgw.gateway.base.platform import open_configured_bus
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.daemon.assembly import build_gateway
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.peers.simulation.config import add_device, simulated_devices
from pdgw.peers.simulation.devices import Simulation
from tests import conftest
from tests.support import buses
from tests.support.gateways import daemon as in_world
from tests.support.processes import PATIENT


def configuration() -> GatewayConfig:
    """One simulated axis on a bus of its own. Neither it nor the PLC is lost where this process is held up for a second."""
    can = f'[can]\ninterface = "virtual"\nchannel = "{buses.channel()}"\n'
    axis = in_world.axis(1, more=f"simulate = true\n{PATIENT}")
    return in_world.configuration(axis, can=can, transport="cycle_time_ms = 20\nwatchdog_factor = 255")


@contextmanager
def running(config: GatewayConfig, before: Callable[[Daemon], None] | None = None) -> Iterator[Daemon]:
    """Raises AssertionError in a test that is not marked to have the wall clock."""
    conftest.needs_the_mark("a gateway on the machine's clock")
    simulations = []
    for bus in config.can:
        simulation = Simulation()
        for device in simulated_devices(config, bus):
            add_device(simulation, device, open_configured_bus(bus))
        simulation.start()
        simulations.append(simulation)
    daemon = build_gateway(config)
    if before is not None:
        before(daemon)
    thread = threading.Thread(target=daemon.run)
    thread.start()
    try:
        yield daemon
    finally:
        daemon.stop()
        thread.join(buses.PATIENCE_S)
        for simulation in simulations:
            simulation.stop()
        assert not thread.is_alive(), "the daemon ends in bounded time"
