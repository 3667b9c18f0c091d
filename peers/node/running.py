"""A running simulated node, and a loop in its own thread.

A loop in its own thread, for programs whose main thread does something else. A running simulated node: a ``SimulatedNode`` on
a bus, called for frames and at its own times. It connects the simulation to clock and bus. A device profile adds the commands
of its device.
"""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, Self, TypeVar

import can

from pdgw.base.phrases import did_you_mean
from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.bus.port import CanPort, PortBusyError, PortLostError, open_port
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.loop.loop import Loop, Timer
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.peers.node.behaviour import parse
from pdgw.peers.node.node import SendFunction, SimulatedNode

log = logging.getLogger("peers")

T = TypeVar("T")


class LoopThread:
    """Runs a ``SystemLoop`` from construction until the process ends."""

    def __init__(self, name: str) -> None:
        self.loop = SystemLoop()
        self._runner = threading.Thread(target=self._run, name=name, daemon=True)
        self._runner.start()

    def call(self, action: Callable[[], T]) -> T:
        """Run an action on the loop and wait for it, from any thread. Return its result or raise its exception."""
        if threading.current_thread() is self._runner:
            return action()
        future: Future[T] = Future()
        self.loop.call_threadsafe(lambda: resolve(future, action, BaseException))
        return future.result()

    def _run(self) -> None:
        while True:
            try:
                self.loop.run()
            except Exception:
                # An error of one device must not end the others.
                log.exception("a simulated device failed")


@functools.cache
def simulation_thread() -> LoopThread:
    """The thread that runs all simulated nodes of this process on real buses."""
    return LoopThread("simulation")


N = TypeVar("N", bound=SimulatedNode)


class RunningNode(Generic[N]):
    """``make`` gets the function that sends a frame and returns the node. The node receives the frames of its port.

    The node owns the bus (of python-can, or a port) and ``stop`` releases it. ``loop``: where it runs; then commands are
    allowed only in its thread. Without it, the node uses the thread for real buses, and commands are allowed from any
    thread.
    """

    def __init__(self, bus: can.BusABC | CanPort, make: Callable[[SendFunction], N], loop: Loop | None = None) -> None:
        self._shared = simulation_thread() if loop is None else None
        self.loop = simulation_thread().loop if loop is None else loop
        self.port: CanPort = open_port(self.loop, bus) if isinstance(bus, can.BusABC) else bus
        self.node = make(self._send)
        self._power: Callable[[bool], None] | None = getattr(self.port, "power", None)
        """Switches a port that has the supply of its device: without power it does not acknowledge frames."""
        self.node.bitrate_changed = getattr(self.port, "set_bitrate", self.node.bitrate_changed)
        if self._power is not None:
            self._power(False)
        self.running = False
        """Between ``start`` and ``stop``."""
        self.lost = ""
        """Why its bus is lost; empty while it is available."""
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
        """Power off permanently and release the bus, also for a node that was never started."""
        self._call(self._stop)

    def do(self, action: Callable[[N], object]) -> None:
        """Run an action on the node between two of its steps."""

        def act() -> None:
            self.node.catch_up(self.loop.now())
            action(self.node)
            self.node.touch()
            self._plan()

        self._call(act)

    def raise_fault(self, fault: int | str, raises: Callable[[N], object]) -> None:
        """Start a habit (``"slow-sdo delay_ms=100"``), else do ``raises``, which knows the faults of the device itself."""
        if isinstance(fault, str) and fault.split()[:1] and fault.split()[0] in self.node.catalogue:
            name, values = parse(fault)
            self.do(lambda node: node.start_fault(name, **values))
            return
        try:
            self.do(raises)
        except CanopenError as error:
            names = ", ".join(self.node.catalogue)
            raise CanopenError(
                "fault", fault, f"{error.allowed}; {names}{did_you_mean(str(fault), self.node.catalogue)}"
            ) from None

    def _call(self, action: Callable[[], None]) -> None:
        if self._shared is None:
            action()
        else:
            self._shared.call(action)

    def _start(self) -> None:
        self.running = True
        if self._power is not None:
            self.node.switched = self._power
        self.port.start(self)
        self.node.start(self.loop.now())
        self._plan()

    def _stop(self) -> None:
        self.running = False
        if self._timer is not None:
            self._timer.cancel()
        self.port.close()

    def _send(self, can_id: int, data: bytes) -> None:
        # A node that cannot transmit stays silent. Its master detects this by heartbeat and PDO supervision.
        try:
            self.port.send(can_id, data)
        except PortBusyError:
            return
        except PortLostError as error:
            self.on_lost(str(error))

    # -- events of the port ---------------------------------------------------------------------------------------------

    def on_frame(self, can_id: int, data: bytes, now: int) -> None:
        if self.node.receive(can_id, data, now):
            self._plan()

    def on_other_frame(self, can_id: int, data: bytes, *, extended: bool, remote: bool) -> None:
        if remote and not extended:
            self.node.receive_remote(can_id, self.loop.now())
            self._plan()

    def on_error_frame(self, *, bus_off: bool, passive: bool) -> None:
        """The device does not use this."""

    def on_room(self) -> None:
        """Rejected frames are not repeated."""

    def on_refused(self) -> None:
        """Rejected frames are dropped."""

    def on_lost(self, text: str) -> None:
        """The node stays silent. Its owner can read ``lost``."""
        self.lost = text

    def _plan(self) -> None:
        """Poll the node at its next event. An earlier timer plans again when it expires."""
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
