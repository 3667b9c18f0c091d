"""Run one task on a CAN bus, for commands that end afterwards. The loop runs on this machine's clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.platform import Platform, SystemPlatform
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.tools.options import quiet

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
