"""A simulated node at work: a ``SimulatedNode`` on a bus, woken by frames and by its own times.

The edge of the simulators: here are the clock and the bus. A device profile adds the commands of its device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Self, TypeVar

import can
from pdgw.ds301.loop import Loop, Timer
from pdgw.peers.node.host import simulation_thread
from pdgw.peers.node.node import SendFunction, SimulatedNode
from pdgw.peers.node.reception import Reception

N = TypeVar("N", bound=SimulatedNode)


class RunningNode(Generic[N]):
    """``make`` is given the function that sends a frame and returns the node.

    The bus is the node's own and is shut down by ``stop``. ``loop``: where it runs, whose thread gives all commands then.
    Without one it shares the thread that simulates on real buses, and commands may be given from any thread.
    """

    def __init__(self, bus: can.BusABC, make: Callable[[SendFunction], N], loop: Loop | None = None) -> None:
        self.bus = bus
        self._thread = simulation_thread() if loop is None else None
        self.loop = simulation_thread().loop if loop is None else loop
        self.node = make(self._send)
        self._reception: Reception | None = None
        self._timer: Timer | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        """Between ``start`` and ``stop``."""
        return self._reception is not None

    def start(self) -> None:
        """Power on."""
        self._call(self._start)

    def stop(self) -> None:
        """Power off for good and release the bus."""
        reception = self._reception
        self._call(self._stop)
        if reception is not None:
            reception.wait_closed()
        self.bus.shutdown()

    def do(self, action: Callable[[N], None]) -> None:
        """Run an action on the node between two of its steps."""

        def act() -> None:
            self.node.catch_up(self.loop.now())
            action(self.node)
            self.node.touch()
            self._plan()

        self._call(act)

    def _call(self, action: Callable[[], None]) -> None:
        if self._thread is None:
            action()
        else:
            self._thread.call(action)

    def _start(self) -> None:
        self._reception = Reception(self.loop, self.bus, self._take)
        self.node.start(self.loop.now())
        self._plan()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self._reception is not None:
            self._reception.close()
            self._reception = None

    def _send(self, can_id: int, data: bytes) -> None:
        try:
            self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        except can.CanError:
            # A node that cannot transmit stays silent; its master notices by heartbeat and PDO supervision.
            return

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame or message.is_extended_id:
            return
        if message.is_remote_frame:
            self.node.receive_remote(message.arbitration_id, self.loop.now())
        else:
            self.node.receive(message.arbitration_id, bytes(message.data), self.loop.now())
        self._plan()

    def _plan(self) -> None:
        """Have the node polled at its next event; a timer that is earlier plans again when it comes."""
        if self._reception is None:
            return
        event = self.node.next_event(self.loop.now())
        timer = self._timer
        if event is None or (timer is not None and timer.action is not None and timer.when <= event):
            return
        if timer is not None:
            timer.cancel()
        self._timer = self.loop.call_at(event, self._poll)

    def _poll(self) -> None:
        self.node.poll(self.loop.now())
        self._plan()
