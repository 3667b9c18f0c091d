"""Virtual buses with a name of their own, and waiting for conditions instead of sleeping."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can
from pdgw.ds301.bus import open_bus
from pdgw.ds301.network import CanNetwork

_numbers = itertools.count()


def channel() -> str:
    """A virtual channel no other test uses."""
    return f"test-{next(_numbers)}"


def bus(name: str) -> can.BusABC:
    return open_bus("virtual", name)


def wait_for(condition: Callable[[], object], what: str, seconds: float = 10) -> None:
    """Until the condition holds; fails after a generous time that no healthy run needs."""
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
        pause.wait(0.002)


@contextmanager
def guarded_network(name: str, node_id: int = 127) -> Iterator[CanNetwork]:
    """A network that produces the gateway's heartbeat, as the daemon's cyclic loop does."""
    network = CanNetwork(bus(name))
    network.start()
    stopping = threading.Event()

    def beat() -> None:
        while not stopping.wait(0.02):
            network.send_heartbeat(node_id)

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        yield network
    finally:
        stopping.set()
        thread.join()
        network.close()
