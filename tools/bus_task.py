"""Run one task on a CAN bus, for commands that end afterwards. The loop runs on this machine's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.platform import Platform, SystemPlatform, open_configured_bus
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.tools.options import quiet

if TYPE_CHECKING:
    import canopen

    from pdgw.gateway.commissioning.device import ConfiguredDevice

T = TypeVar("T")


def complete(loop: Loop, function: Callable[[], T]) -> T:
    """Run the loop until the function has ended as a task. Return its result or raise its exception."""
    future: Future[T] = Future()

    def run() -> None:
        resolve(future, function)
        loop.stop()

    loop.spawn(run, "command")
    while not future.done():  # the function may stop the loop early
        loop.run()
    return future.result(0)


@contextmanager
def blocking(config: CanConfig) -> Iterator[canopen.Network]:
    """A bus for python canopen, whose calls wait. CanopenError when the bus cannot be opened."""
    import canopen  # noqa: PLC0415 (slow to load)

    network = canopen.Network(open_configured_bus(config))
    network.connect()
    try:
        with quiet("canopen"):
            yield network
    finally:
        network.disconnect()


class Run(Protocol):
    """Runs a method of a device, alone on its bus."""

    def __call__(self, method: Callable[[], T], /) -> T: ...


@contextmanager
def asked(config: Path, do_id: int) -> Iterator[tuple[ConfiguredDevice, Run]]:
    """The device of a drive object of this file, alone on its bus, and a function that runs one of its methods.

    GatewayError and CanopenError name what is missing.
    """
    from pdgw.gateway.commissioning.device import ConfiguredDevice  # noqa: PLC0415 (slow to load)
    from pdgw.gateway.configuration.file import load_config  # noqa: PLC0415

    loaded = load_config(config)
    bus = next((loaded.bus_of(item) for item in loaded.objects if item.do_id == do_id), loaded.can[0])
    with opened(bus) as network:
        device = ConfiguredDevice(network, loaded, do_id)

        def run(method: Callable[[], T], /) -> T:
            def alone() -> T:
                with device.opened():
                    return method()

            return complete(network.loop, alone)

        yield device, run


@contextmanager
def opened(config: CanConfig, platform: Platform | None = None) -> Iterator[CanNetwork]:
    """Open a bus and receive its frames until the block ends; canopen's log is off. CanopenError when the bus cannot be
    opened.
    """
    used = SystemPlatform() if platform is None else platform
    try:
        network = CanNetwork(used.loop, partial(used.open_can, config), config.name, config.node_id)
        network.start()
        try:
            with quiet("canopen"):  # a missing answer is a result here, not an error
                yield network
        finally:
            network.close()
    finally:
        if platform is None:
            used.loop.close()
