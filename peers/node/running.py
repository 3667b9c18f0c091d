"""A simulated node at work: a ``SimulatedNode`` on a bus, woken by frames and by its own times.

The edge of the simulators: here are the clock and the bus. A device profile adds the commands of its device.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Generic, Self, TypeVar

import can

from pdgw.ds301.bus.port import CanPort, PortBusyError, PortLostError, open_port
from pdgw.ds301.loop.loop import Loop, Timer
from pdgw.peers.node.host import simulation_thread
from pdgw.peers.node.node import SendFunction, SimulatedNode

N = TypeVar("N", bound=SimulatedNode)


class RunningNode(Generic[N]):
    """``make`` is given the function that sends a frame and returns the node. It is the receiver of its port.

    The bus, of python-can or a port, is the node's own and is released by ``stop``. ``loop``: where it runs, whose thread gives
    all commands then. Without one it shares the thread that simulates on real buses, and commands may come from any thread.
    """

    def __init__(self, bus: can.BusABC | CanPort, make: Callable[[SendFunction], N], loop: Loop | None = None) -> None:
        self._thread = simulation_thread() if loop is None else None
        self.loop = simulation_thread().loop if loop is None else loop
        self.port: CanPort = open_port(self.loop, bus) if isinstance(bus, can.BusABC) else bus
        self.node = make(self._send)
        self.running = False
        """Between ``start`` and ``stop``."""
        self.lost = ""
        """Why its bus is gone; empty while it is there."""
        self._timer: Timer | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Power on."""
        self._call(self._start)

    def stop(self) -> None:
        """Power off for good and release the bus; also of one that was never started."""
        self._call(self._stop)

    def do(self, action: Callable[[N], object]) -> None:
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
        self.running = True
        self.port.start(self)
        self.node.start(self.loop.now())
        self._plan()

    def _stop(self) -> None:
        self.running = False
        if self._timer is not None:
            self._timer.cancel()
        self.port.close()

    def _send(self, can_id: int, data: bytes) -> None:
        # A node that cannot transmit stays silent; its master notices by heartbeat and PDO supervision.
        try:
            with contextlib.suppress(PortBusyError):
                self.port.send(can_id, data)
        except PortLostError as error:
            self.on_lost(str(error))

    # -- what the port delivers -----------------------------------------------------------------------------------------

    def on_frame(self, can_id: int, data: bytes) -> None:
        if self.node.receive(can_id, data, self.loop.now()):
            self._plan()

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        if remote and not extended:
            self.node.receive_remote(can_id, self.loop.now())
            self._plan()

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        """The device does not see it."""

    def on_room(self) -> None:
        """What was refused is not repeated."""

    def on_refused(self) -> None:
        """What was not sent is not missed."""

    def on_lost(self, text: str) -> None:
        """The node stays silent; who runs it may look at ``lost``."""
        self.lost = text

    def _plan(self) -> None:
        """Have the node polled at its next event; a timer that is earlier plans again when it comes."""
        if not self.running:
            return
        event = self.node.next_event(self.loop.now())
        if event is None:
            return
        timer = self._timer
        if timer is not None and timer.action is not None:
            if timer.when <= event:
                return
            timer.cancel()
        self._timer = self.loop.call_at(event, self._poll)

    def _poll(self) -> None:
        self.node.poll(self.loop.now())
        self._plan()
