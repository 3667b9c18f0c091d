"""A hub served by the loop that simulates on real buses, and the port of its devices on this loop."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Self

from pdgw.ds301.bus.can_frame import pack_frame, unpack_frame
from pdgw.ds301.bus.port import Receiver as FrameReceiver
from pdgw.ds301.bus.port import deliver
from pdgw.ds301.loop.loop import Loop
from pdgw.peers.bus.hub import Hub
from pdgw.peers.node.running import simulation_thread


class HubPort:
    """A member in the hub's own thread: a ``ds301.bus.port.CanPort``."""

    def __init__(self, loop: Loop, hub: Hub) -> None:
        self._loop = loop
        self._hub = hub
        self._receiver: FrameReceiver | None = None
        self._send = hub.attach(self._take)

    def start(self, receiver: FrameReceiver) -> None:
        self._receiver = receiver

    def send(self, can_id: int, data: bytes) -> None:
        self._send(pack_frame(can_id, data))

    def listen(self, *, on: bool) -> None:
        """Devices receive every frame when it arrives."""

    def take(self, now: int) -> None:
        """No frame waits."""

    def drop(self) -> None:
        """Nothing to drop: frames have no queue."""

    def close(self) -> None:
        self._receiver = None
        self._hub.detach(self._take)

    def _take(self, frame: bytes) -> None:
        if self._receiver is not None:
            deliver(self._receiver, *unpack_frame(frame), self._loop.now())


class _LoopReaders:
    """The sockets of a hub on a loop. Unlike a selector inside another one, this works on every system."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop

    def register(self, fileobj: socket.socket, _events: int, data: Callable[[], None], /) -> None:
        self._loop.add_reader(fileobj.fileno(), data)

    def unregister(self, fileobj: socket.socket, /) -> None:
        self._loop.remove_reader(fileobj.fileno())


class ServedBus:
    """A bus for other processes, from construction until ``stop``. GatewayError when the port cannot be opened."""

    def __init__(self, port: int = 0) -> None:
        self._thread = simulation_thread()
        self._hub = self._thread.call(lambda: Hub(_LoopReaders(self._thread.loop), port))
        self.channel = self._hub.channel

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def connect(self) -> HubPort:
        """Create a port for a device on the thread of all simulated devices."""
        return self._thread.call(lambda: HubPort(self._thread.loop, self._hub))

    def stop(self) -> None:
        """End the bus; members receive nothing any more."""
        self._thread.call(self._hub.close)
