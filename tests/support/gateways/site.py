"""The gateway's network in a world of its own, with its heartbeat; the test runs the world while it waits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any, TypeVar

from pdgw.base.durations import MS, SECOND
from pdgw.ds301.bus.network import CanNetwork
from pdgw.gateway.configuration.environment import CanConfig
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.world import Member, World

T = TypeVar("T")
_BUS = "site"
_BEAT_NS = 20 * MS
_STEP_NS = 2 * MS
_worlds: list[World] = []
"""The one of the test that runs."""


@contextmanager
def guarded_network() -> Iterator[CanNetwork]:
    """A network that produces the gateway's heartbeat, as the daemon does."""
    world = World()
    _worlds.append(world)
    can_config = CanConfig(interface="virtual", channel=_BUS)
    network = CanNetwork(world.loop, lambda: world.open_can(can_config))
    network.start()

    def beat() -> None:
        network.send_heartbeat()
        world.loop.call_later(_BEAT_NS, beat)

    beat()
    try:
        yield network
    finally:
        network.close()
        _worlds.remove(world)


def drive(node_id: int, **options: Any) -> SimulatedDrive:
    """A drive on the network's bus, not yet powered."""
    return _worlds[-1].drive(_BUS, node_id, powered=False, **options)


def encoder(node_id: int, **options: Any) -> SimulatedEncoder:
    """An encoder on the network's bus, not yet powered."""
    return _worlds[-1].encoder(_BUS, node_id, powered=False, **options)


def gateway_port() -> Member:
    """The network's own controller."""
    return _worlds[-1].gateway_port(_BUS)


def other() -> Member:
    """Another participant."""
    return _worlds[-1].bus(_BUS).join("other")


def now() -> int:
    return _worlds[-1].loop.now()


def pass_time(duration: int) -> None:
    """Run the world for this number of nanoseconds."""
    _worlds[-1].loop.run_for(duration)


def wait_for(condition: Callable[[], object], what: str, seconds: float = 10) -> None:
    """Until the condition holds; fails after a time that nothing which works needs."""
    deadline = now() + int(seconds * SECOND)
    while not condition():
        assert now() < deadline, f"not within {seconds} s: {what}"
        pass_time(_STEP_NS)


def result(future: Future[T], seconds: float = 10) -> T:
    """What the loop answers."""
    wait_for(future.done, "an answer", seconds)
    return future.result(0)
