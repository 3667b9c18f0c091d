"""The connection of a parameter client to a gateway in the world.

In a task of the loop the client waits like other tasks. Outside of tasks it runs the world while it waits.
"""

from __future__ import annotations

import contextlib
from collections import deque

from pdgw.ds301.loop.loop import Event
from pdgw.durations import SECOND
from pdgw.gateway.links.udp import Address
from pdgw.peers.world.world import World


class WorldChannel:
    """Datagrams between ``host`` and a gateway."""

    def __init__(self, world: World, gateway: Address, host: str = "engineer") -> None:
        self._loop = world.loop
        self._gateway = gateway
        self._port = world.network.open(host, 0, "parameter client")
        self._received: deque[bytes] = deque()
        self._arrived = Event(world.loop)
        self._port.start(self._take)

    @property
    def local_address(self) -> Address:
        return self._port.address

    def send(self, data: bytes) -> None:
        self._port.send(data, self._gateway)

    def receive(self, timeout_s: float) -> bytes | None:
        timeout = int(timeout_s * SECOND)
        if not self._received:
            self._arrived.clear()
            if self._loop.running is not None:
                self._arrived.wait(timeout)
            else:
                with contextlib.suppress(TimeoutError):
                    self._loop.until(self._arrived.is_set, "a datagram", timeout)
        return self._received.popleft() if self._received else None

    def now(self) -> float:
        return self._loop.now() / SECOND

    def sleep(self, seconds: float) -> None:
        if self._loop.running is not None:
            self._loop.sleep(int(seconds * SECOND))
        else:
            self._loop.run_for(int(seconds * SECOND))

    def close(self) -> None:
        self._port.close()

    def _take(self) -> None:
        while (datagram := self._port.receive()) is not None:
            self._received.append(datagram[0])
            self._arrived.set()
