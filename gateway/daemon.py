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
from typing import Any, Protocol

import can
from pdgw.ds301.bus import open_bus
from pdgw.ds301.client import NodeClient
from pdgw.ds301.network import CanNetwork
from pdgw.gateway.axis import Axis
from pdgw.gateway.config import GATEWAY_NODE_ID, AxisConfig, CanConfig, GatewayConfig
from pdgw.gateway.drive_object import DriveObject
from pdgw.gateway.encoder import EncoderNode, EncoderObject
from pdgw.gateway.store import ParameterStore
from pdgw.gateway.transport.cyclic import CyclicEndpoint, Verdict
from pdgw.gateway.transport.udp import UdpSocket
from pdgw.peers.drive import SimulatedDrive
from pdgw.peers.encoder import SimulatedEncoder
from pdgw.peers.encoder.motion import Motion, parse_motion
from pdgw.peers.node.running import RunningNode
from pdgw.profidrive.telegrams import Telegram, telegram

log = logging.getLogger("gateway")

MS = 1_000_000
_SHUTDOWN_NS = 5_000 * MS
_SWITCH_INTERVAL_S = 0.0005
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
        self.simulated_encoders: list[SimulatedEncoder] = []
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
            self.encoder_nodes: list[EncoderNode] = []
            self.axes: list[Axis] = [self._axis(item) for item in config.axis]
            self.encoders: list[EncoderObject] = self._encoders()
            self.objects: list[DriveObject] = [*self.axes, *self.encoders]
            """In the order of the frame."""
            by_do = {item.do_id: item for item in self.encoders}
            for axis in self.axes:
                if axis.config.g1 is not None:
                    axis.connect_sensor(by_do[axis.config.g1])
            self._simulate()
            # A stored telegram (P922) may differ from the configured one: the frame may not fit.
            self.endpoint = self._new_endpoint([item.telegram for item in self.objects])
        except BaseException:
            self.release()
            raise
        self._heartbeat_ns = min(client.settings.heartbeat_ms for client in self.clients) * MS // 2
        synced = {client.network.name for client in self.clients if client.settings.sync}
        self._synced = [network for name, network in self.networks.items() if name in synced]

    def _axis(self, config: AxisConfig) -> Axis:
        network = self.networks[self.config.bus_of(config).name]
        number = self.store.parameters.drive_object(config.do_id).telegram
        return Axis(config, network, self.config.transport.cycle_time_ms, number)

    def _encoders(self) -> list[EncoderObject]:
        made: dict[int, EncoderObject] = {}
        for bus in self.config.can:
            for channels in self.config.encoders_of(bus).values():
                node = EncoderNode(self.networks[bus.name], channels, self.config.transport.cycle_time_ms)
                self.encoder_nodes.append(node)
                for config in channels:
                    stored = self.store.parameters.drive_object(config.do_id)
                    number = config.telegram if stored.telegram is None else stored.telegram
                    made[config.do_id] = EncoderObject(config, node, number, stored.sign_of_life_tolerance)
        return [made[config.do_id] for config in self.config.encoder]

    def _simulate(self) -> None:
        shafts: dict[str, dict[int, Motion]] = {bus.name: {} for bus in self.config.can}
        for config in self.config.axis:
            if config.simulate:
                can_config = self.config.bus_of(config)
                drive = SimulatedDrive(open_configured_bus(can_config), config.node_id, serial_number=config.do_id)
                self.simulated.append(drive)
                shafts[can_config.name][config.node_id] = drive.shaft
        for can_config in self.config.can:
            for node_id, channels in self.config.encoders_of(can_config).items():
                if channels[0].simulate:
                    last = max(channels, key=lambda item: item.channel)
                    motions = {
                        item.channel: parse_motion(item.motion, shafts=shafts[can_config.name]) for item in channels
                    }
                    self.simulated_encoders.append(
                        SimulatedEncoder(
                            open_configured_bus(can_config),
                            node_id,
                            device=last.device,
                            motions=[motions.get(n, parse_motion("still")) for n in range(1, last.channel + 1)],
                            serial_number=channels[0].do_id,
                        )
                    )

    @property
    def _simulated_devices(self) -> list[RunningNode[Any]]:
        return [*self.simulated, *self.simulated_encoders]

    @property
    def clients(self) -> list[NodeClient[Any]]:
        """The client of every node."""
        return [*(axis.client for axis in self.axes), *(node.client for node in self.encoder_nodes)]

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

    def change_telegram(self, changed: DriveObject, number: int) -> Future[None]:
        """P922 of a drive object; the frame layout follows. The future fails with GatewayError when it is not possible now."""

        def change() -> None:
            if number == changed.telegram.number:
                return
            telegrams = [telegram(number) if item is changed else item.telegram for item in self.objects]
            endpoint = self._new_endpoint(telegrams)
            changed.change_telegram(number)
            endpoint.continue_from(self.endpoint)
            self.endpoint = endpoint

        return self.call(change)

    # -- the loop -----------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run until ``stop``; returns after the drives are stopped and everything is released."""
        host, port = self.socket.address
        count = len(self.objects)
        log.info("cyclic exchange on %s:%d, %d drive objects, cycle %g ms", host, port, count, self.cycle_ns / MS)
        started: list[Service] = []
        # Threads of the parameter channel must not keep the cyclic one from running for Python's usual 5 ms.
        switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL_S)
        try:
            for device in self._simulated_devices:
                device.start()
            for network in self.networks.values():
                network.start()
            for client in self.clients:
                client.start()
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
            for client in self.clients:
                client.stop()
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
                for item in self.objects:
                    item.raise_fault(103, "watchdog expired", now)
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
        for index, item in enumerate(self.objects):
            item.step(setpoints[index], now)
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
            frame = endpoint.build([item.actuals for item in self.objects], [item.good for item in self.objects])
            self.socket.send(frame, endpoint.peer)

    def _bring_to_rest(self) -> None:
        """As after a loss of the PLC: each axis stops its way; then power is off everywhere, or the time is over."""
        log.info("stopping the drives")
        deadline = time.monotonic_ns() + _SHUTDOWN_NS
        nothing = [None] * len(self.objects)
        pause = min(self.cycle_ns, self._heartbeat_ns) / 1e9
        self.endpoint.lose_setpoints()
        off_cycles = 0
        while off_cycles < 3:
            now = time.monotonic_ns()
            self._step(nothing, now)
            self._heartbeats(now)
            self._send()
            off_cycles = 0 if any(item.powered for item in self.objects) else off_cycles + 1
            if now > deadline:
                log.error("drives not stopped within %d s: power off by NMT", _SHUTDOWN_NS // (1000 * MS))
                break
            time.sleep(pause)

    def release(self) -> None:
        """Give sockets and buses back; ``run`` does it at its end. A second call does nothing."""
        if self._released:
            return
        self._released = True
        for device in self._simulated_devices:
            if device.running:
                device.stop()
            else:
                device.bus.shutdown()
        for network in self.networks.values():
            network.close()
        self.socket.close()
