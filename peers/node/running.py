"""A simulated node at work: a thread that runs a ``SimulatedNode`` on any python-can bus, in steps of 1 ms.

The edge of the simulators: here are the clock, the thread and the bus. A device profile adds the commands of its device.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, Self, TypeVar

import can
from pdgw.peers.node.node import MS, SendFunction, SimulatedNode

N = TypeVar("N", bound=SimulatedNode)


class RunningNode(Generic[N]):
    """``make`` is given the function that sends a frame and returns the node.

    The bus is the node's own and is shut down by ``stop``. Commands may be given from any thread.
    """

    def __init__(self, bus: can.BusABC, name: str, make: Callable[[SendFunction], N]) -> None:
        self.bus = bus
        self._lock = threading.Lock()
        self.node = make(self._send)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Between ``start`` and ``stop``."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Power on."""
        self._thread.start()

    def stop(self) -> None:
        """Power off for good and release the bus."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()
        self.bus.shutdown()

    def do(self, action: Callable[[N], None]) -> None:
        """Run an action on the node between two of its steps."""
        with self._lock:
            action(self.node)

    def _send(self, can_id: int, data: bytes) -> None:
        try:
            self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        except can.CanError:
            # A node that cannot transmit stays silent; its master notices by heartbeat and PDO supervision.
            return

    def _run(self) -> None:
        with self._lock:
            self.node.start(time.monotonic_ns())
        due = time.monotonic_ns()
        while not self._stopping.is_set():
            now = time.monotonic_ns()
            if now >= due:
                due = max(due + MS, now)
                with self._lock:
                    self.node.poll(now)
            try:
                # A node that needs more than its millisecond for a step still hears the bus.
                message = self.bus.recv(max(0, due - time.monotonic_ns()) / 1e9)
            except (can.CanError, OSError):
                return
            if message is None or message.is_error_frame or message.is_extended_id:
                continue
            with self._lock:
                if message.is_remote_frame:
                    self.node.receive_remote(message.arbitration_id, time.monotonic_ns())
                else:
                    self.node.receive(message.arbitration_id, bytes(message.data), time.monotonic_ns())
