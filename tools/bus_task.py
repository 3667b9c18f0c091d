"""Commands that ask something of a bus and end: a task on the loop of this machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from pdgw.ds301.bus.network import CanNetwork
from pdgw.ds301.loop.jobs import settle
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.configuration.tables.environment import CanConfig
from pdgw.gateway.platform import Platform, SystemPlatform
from pdgw.tools.log_level import quiet

T = TypeVar("T")


def complete(loop: Loop, function: Callable[[], T]) -> T:
    """Run a function as a task and the loop until it has ended; its result or exception is this call's."""
    future: Future[T] = Future()

    def run() -> None:
        settle(future, function)
        loop.stop()

    loop.spawn(run, "command")
    while not future.done():  # what it uses may stop the loop before
        loop.run()
    return future.result(0)


@contextmanager
def opened(config: CanConfig, platform: Platform | None = None) -> Iterator[CanNetwork]:
    """A bus that is listened to until the end of the block; canopen is quiet meanwhile. CanopenError when it cannot be had."""
    used = SystemPlatform() if platform is None else platform
    try:
        network = CanNetwork(used.loop, partial(used.open_can, config), config.name)
        network.start()
        try:
            with quiet("canopen"):  # a node that does not answer is an answer
                yield network
        finally:
            network.close()
    finally:
        if platform is None:
            used.loop.close()
