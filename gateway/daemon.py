"""The daemon: one cyclic loop over PLC, axes and buses, and everything that starts and stops with it.

The gateway answers each valid PLC frame at once with the newest drive data; without frames it steps the axes every cycle and
sends by itself every second cycle. The gateway's heartbeat comes from this loop, so that a hung loop stops the drives.
"""

from __future__ import annotations

import gc
import logging
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Protocol

import can

from ds301.bus import open_bus
from ds301.network import CanNetwork
from dsp402.simulator import SimulatedDrive
from gateway.axis import Axis
from gateway.config import GATEWAY_NODE_ID, CanConfig, GatewayConfig
from gateway.store import ParameterStore
from gateway.transport.cyclic import CyclicEndpoint, Verdict
from gateway.transport.udp import UdpSocket
from profidrive.telegrams import Telegram, telegram

log = logging.getLogger("gateway")

MS = 1_000_000
_SHUTDOWN_NS = 5_000 * MS
_SWITCH_INTERVAL_S = 0.0001
_DATAGRAMS_AT_ONCE = 64
_FROM_PLC = (Verdict.ACCEPTED, Verdict.PROVIDER_STOP)


class Service(Protocol):
    """Something that runs beside the cyclic exchange, with threads of its own."""

    def start(self) -> None: ...

    def stop(self) -> None: ...


def open_configured_bus(config: CanConfig) -> can.BusABC:
    """The python-can bus of a [can] table."""
    return open_bus(config.interface, config.channel, config.bitrate, **config.extra)


class Daemon:
    """Owns sockets, buses, axes and services of one configuration.

    Raises GatewayError or CanopenError from the constructor when a port or a CAN interface cannot be had.
    """

    def __init__(self, config: GatewayConfig) -> None:
        self.config = config
        transport = config.transport
        self.cycle_ns = int(transport.cycle_time_ms * MS)
        self.store = ParameterStore(config.store, log.warning)
        self.networks: dict[str, CanNetwork] = {}
        self.simulated: list[SimulatedDrive] = []
        self.services: list[Service] = []
        self.started_ns = time.monotonic_ns()
        self.cycles = 0
        self.skipped = 0
        """Frames a newer one had overtaken before the axes saw them."""
        self._stopping = threading.Event()
        self._released = False
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self.socket = UdpSocket(str(transport.listen), transport.cyclic_port, "cyclic port")
        try:
            for bus in config.can:
                self.networks[bus.name] = CanNetwork(open_configured_bus(bus), bus.name)
            self.axes = [self._axis(axis_config.do_id) for axis_config in config.axis]
            for axis_config in config.axis:
                if axis_config.simulate:
                    drive_bus = open_configured_bus(config.bus_of(axis_config))
                    self.simulated.append(
                        SimulatedDrive(drive_bus, axis_config.node_id, serial_number=axis_config.do_id)
                    )
            # A stored telegram (P922) may differ from the configured one: the frame may not fit.
            self.endpoint = self._new_endpoint([axis.telegram for axis in self.axes])
        except BaseException:
            self.release()
            raise
        self._heartbeat_ns = min(axis.config.heartbeat_ms for axis in self.axes) * MS // 2
        self._synced = [n for n in self.networks.values() if any(a.config.sync and a.network is n for a in self.axes)]

    def _axis(self, do_id: int) -> Axis:
        axis_config = next(axis for axis in self.config.axis if axis.do_id == do_id)
        network = self.networks[self.config.bus_of(axis_config).name]
        number = self.store.parameters.drive_object(do_id).telegram
        return Axis(axis_config, network, self.config.transport.cycle_time_ms, number)

    def _new_endpoint(self, telegrams: Sequence[Telegram]) -> CyclicEndpoint:
        transport = self.config.transport
        return CyclicEndpoint(
            telegrams,
            cycle_ns=self.cycle_ns,
            watchdog_factor=transport.watchdog_factor,
            peer=str(transport.peer) if transport.peer else None,
        )

    # -- any thread ---------------------------------------------------------------------------------------------------

    def stop(self) -> None:
        """Ask the loop to end: drives stopped, disabled, then pre-operational. Safe from a signal handler."""
        self._stopping.set()

    def call(self, action: Callable[[], None]) -> Future[None]:
        """Run an action on the cyclic thread between two cycles."""
        future: Future[None] = Future()

        def run() -> None:
            try:
                action()
            except Exception as error:  # belongs to the caller
                future.set_exception(error)
            else:
                future.set_result(None)

        self._calls.put(run)
        return future

    def change_telegram(self, axis: Axis, number: int) -> Future[None]:
        """P922 of an axis; the frame layout follows. The future fails with GatewayError when it is not possible now."""

        def change() -> None:
            if number == axis.telegram.number:
                return
            telegrams = [telegram(number) if item is axis else item.telegram for item in self.axes]
            endpoint = self._new_endpoint(telegrams)
            axis.change_telegram(number)
            endpoint.continue_from(self.endpoint)
            self.endpoint = endpoint

        return self.call(change)

    # -- the loop -----------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run until ``stop``; returns after the drives are stopped and everything is released."""
        host, port = self.socket.address
        log.info("cyclic exchange on %s:%d, %d axes, cycle %g ms", host, port, len(self.axes), self.cycle_ns / MS)
        started: list[Service] = []
        # Threads of the parameter channel must not keep the cyclic one from running for Python's usual 5 ms.
        switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        try:
            for drive in self.simulated:
                drive.start()
            for network in self.networks.values():
                network.start()
            for axis in self.axes:
                axis.drive.start()
            for service in self.services:
                service.start()
                started.append(service)
            # What exists now lives until the end: keep the collector from walking it in the middle of a cycle.
            gc.collect()
            gc.freeze()
            self._loop()
            self._bring_to_rest()
        finally:
            sys.setswitchinterval(switch_interval)
            gc.unfreeze()
            for service in started:
                service.stop()
            for axis in self.axes:
                axis.drive.stop()
            self.release()
            log.info("stopped")

    def _loop(self) -> None:
        cycle = self.cycle_ns
        socket = self.socket
        last_sent = 0
        deadline = time.monotonic_ns()
        while not self._stopping.is_set():
            waiting = socket.wait(min(deadline, self._heartbeat_due) - time.monotonic_ns())
            now = time.monotonic_ns()
            # Also between the cycles: a long cycle must not starve the drives of it.
            self._heartbeats(now)
            accepted = waiting and self._receive(now)
            if not accepted and now < deadline:
                continue
            endpoint = self.endpoint
            if endpoint.poll(now):
                log.error("PLC lost: no valid frame for %d cycles", self.config.transport.watchdog_factor)
                for axis in self.axes:
                    axis.raise_fault(103, "watchdog expired", now)
            self._step(endpoint.setpoints, now)
            if endpoint.peer is not None and (accepted or now - last_sent >= 2 * cycle):
                self._send()
                last_sent = now
            deadline = now + (cycle + cycle // 2 if accepted else cycle)
            if not self._calls.empty():
                self._calls.get()()

    def _receive(self, now: int) -> bool:
        """Take everything that waits; True when a frame of the PLC was among it."""
        endpoint = self.endpoint
        taken = 0
        # Bounded, so that a flood of datagrams delays no cycle; a STOP is seen by the axes before what follows it.
        for _ in range(_DATAGRAMS_AT_ONCE):
            datagram = self.socket.receive()
            if datagram is None:
                break
            data, source = datagram
            connected = endpoint.connected
            verdict = endpoint.receive(data, source, now)
            if verdict in _FROM_PLC:
                taken += 1
                if not connected:
                    log.info("PLC %s:%d connected", *source)
            elif endpoint.counters[verdict] == 1:
                log.warning("frame from %s:%d dropped: %s (%d bytes)", *source, verdict.value, len(data))
            # Looking is cheaper than a refused read, which raises.
            if verdict is Verdict.PROVIDER_STOP or not self.socket.wait(0):
                break
        if taken > 1:
            self.skipped += taken - 1
        return taken > 0

    def _step(self, setpoints: Sequence[Sequence[int] | None], now: int) -> None:
        for index, axis in enumerate(self.axes):
            axis.step(setpoints[index], now)
        for network in self._synced:
            network.send_sync()
        self.cycles += 1

    _heartbeat_due = 0

    def _heartbeats(self, now: int) -> None:
        if now >= self._heartbeat_due:
            self._heartbeat_due = now + self._heartbeat_ns
            for network in self.networks.values():
                network.send_heartbeat(GATEWAY_NODE_ID)

    def _send(self) -> None:
        endpoint = self.endpoint
        if endpoint.peer is not None:
            frame = endpoint.build([axis.actuals for axis in self.axes], [axis.good for axis in self.axes])
            self.socket.send(frame, endpoint.peer)

    def _bring_to_rest(self) -> None:
        """As after a loss of the PLC: each axis stops its way; then power is off everywhere, or the time is over."""
        log.info("stopping the drives")
        deadline = time.monotonic_ns() + _SHUTDOWN_NS
        nothing = [None] * len(self.axes)
        pause = min(self.cycle_ns, self._heartbeat_ns) / 1e9
        self.endpoint.lose_setpoints()
        off_cycles = 0
        while off_cycles < 3:
            now = time.monotonic_ns()
            self._step(nothing, now)
            self._heartbeats(now)
            self._send()
            off_cycles = 0 if any(axis.powered for axis in self.axes) else off_cycles + 1
            if now > deadline:
                log.error("drives not stopped within %d s: power off by NMT", _SHUTDOWN_NS // (1000 * MS))
                break
            time.sleep(pause)

    def release(self) -> None:
        """Give sockets and buses back; ``run`` does it at its end. A second call does nothing."""
        if self._released:
            return
        self._released = True
        for drive in self.simulated:
            if drive.running:
                drive.stop()
            else:
                drive.bus.shutdown()
        for network in self.networks.values():
            network.close()
        self.socket.close()


def axis_of(daemon: Daemon, do_id: int) -> Axis | None:
    """The axis with a DO-ID."""
    return next((axis for axis in daemon.axes if axis.do_id == do_id), None)
