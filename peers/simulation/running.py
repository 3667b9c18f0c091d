"""Run simulated devices in the foreground: console, ports, signals."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack

from pdgw.ds301.bus.bus import open_bus
from pdgw.gateway.errors import GatewayError
from pdgw.peers.option_values import CONSOLE_COMMANDS
from pdgw.peers.simulation.config import ControlConfig
from pdgw.peers.simulation.console import Console, read_standard_input, serve
from pdgw.peers.simulation.devices import Simulation

_LOOK_S = 0.2


def run(simulation: Simulation, control: ControlConfig, title: str, *, attached: bool = False) -> None:
    """Run until SIGINT, SIGTERM or `quit`; open the ports before the devices are powered. ``attached``: end with the input.

    GatewayError when the bus is lost.
    """
    quit_ = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: quit_.set())
    console = Console(simulation, quit_)
    with ExitStack() as at_end:
        if control.port:
            server = serve(console, control.port)
            at_end.callback(server.server_close)
            at_end.callback(server.shutdown)
        at_end.callback(simulation.stop)
        simulation.start()
        read_standard_input(console, quit_.set if attached else None)
        print(f"{title}; commands: {CONSOLE_COMMANDS}", flush=True)
        # Sleep instead of waiting for the event: if another thread gets the signal, its handler would not run during the
        # wait.
        while not quit_.is_set():
            if lost := simulation.look():
                raise GatewayError(f"{title}: the bus is lost ({lost})")
            time.sleep(_LOOK_S)


def run_nodes(
    kind: str,
    place: tuple[str, str, int | None],
    nodes: Sequence[int],
    control: ControlConfig,
    title: str,
    **options: object,
) -> None:
    """Run devices of one type with the same ``options`` on one bus. ``place``: interface, channel and bit rate. ``title``:
    name of one device.
    """
    if len(set(nodes)) != len(nodes):
        raise GatewayError(f"--node-id: {nodes} contains a node twice")
    simulation = Simulation()
    for node in nodes:
        simulation.add(kind, open_bus(*place), node, node, **options)
    interface, channel, _ = place
    names = ", ".join(f"{title} {node}" for node in nodes)
    run(simulation, control, f"{names} on {interface} {channel}")
