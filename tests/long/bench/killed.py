"""Time until the drive stops when the gateway's process is killed or paused: the drive's own guarding, in real time.

The gateway runs as `pdgw run` starts it. A simulated drive on a loopback bus and a PLC run in a thread of this process.
After a pause (SIGSTOP) the gateway continues while the PLC still sends ON: it must not start the drive again.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random

from pdgw.dsp402.states import State
from pdgw.durations import MS
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.udp import UdpSocket
from pdgw.peers.bus import INTERFACE, ServedBus
from pdgw.peers.drive import DriveModel, SimulatedDrive
from pdgw.peers.node.host import simulation_thread
from pdgw.peers.plc.exchange.cycling import CyclingPlc
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.demo.links import free_ports
from tests.long.bench.stops import NODE, OFF, ON, SPEED, Stop

_PATIENCE_S = 60.0
_LOOK_S = 0.01
_CYCLE_NS = 4 * MS
_STANDS_STILL_S = 1.0
_CONFIGURATION = """
[can]
interface = "{interface}"
channel = "{channel}"
[transport]
cyclic_port = {port}
acyclic_port = 0
status_port = 0
cycle_time_ms = 4
watchdog_factor = 100
[[axis]]
do_id = 1
node_id = {node}
telegram = 1
"""
"""The long watchdog tolerates a busy machine; the measured times do not depend on it."""
_MEASURED = "the signal to the drive's own stop (1016h, 6007h)"
_BOUND = "3 x 100 ms without a heartbeat of the gateway + 50 ms for the machine"
KILLED = Stop("gateway killed (SIGKILL)", _MEASURED, 350, _BOUND, "real")
STOPPED = Stop("gateway stands still (SIGSTOP)", _MEASURED, 350, _BOUND, "real")


class Plant:
    """Bus, drive and PLC of this process."""

    def __init__(self, bus: ServedBus, port: int) -> None:
        self.thread = simulation_thread()
        self.drive = SimulatedDrive(bus.connect(), NODE)
        self.left = 0
        """Time at which the drive left operation, monotonic nanoseconds; 0 while it operates."""
        self.starts = 0
        """Number of entries to Operation Enabled."""
        loop = self.thread.loop
        own = self.thread.call(lambda: UdpSocket(loop, "127.0.0.1", 0, "PLC"))
        self._plc = CyclingPlc(loop, own, ("127.0.0.1", port), [telegram(1)], _CYCLE_NS)
        self._operating = False

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run drive and PLC until the block ends."""
        self.drive.start()
        self.drive.do(lambda node: node.model.disguises.append(self._watch))
        self.thread.call(self._plc.start)
        try:
            yield
        finally:
            self.thread.call(self._plc.stop)
            self.drive.stop()

    def _watch(self, model: DriveModel, _now: int) -> None:
        operating = model.state is State.OPERATION_ENABLED
        if operating and not self._operating:
            self.left = 0
            self.starts += 1
        elif self._operating and not operating:
            self.left = time.monotonic_ns()
        self._operating = operating

    def turn(self) -> None:
        """Send OFF until the axis follows, then ON and full speed. Repeat if a busy machine has stopped the drive meanwhile."""
        self._set(OFF)
        self.until(self._turns, "the drive turns")

    def _turns(self) -> bool:
        state = self._state()
        if state is State.READY_TO_SWITCH_ON:
            self._set(ON)
        elif state is State.SWITCH_ON_DISABLED:
            self._set(OFF)
        return self._operating and self.drive.model.velocity_actual > 0

    def _set(self, word: int) -> None:
        self.thread.call(lambda: self._plc.set({"STW1": word, "NSOLL_A": SPEED}))

    def _state(self) -> State:
        return self.drive.model.state

    def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait for a condition; GatewayError when it does not become true."""
        deadline = time.monotonic() + _PATIENCE_S
        while not condition():
            if time.monotonic() > deadline:
                raise GatewayError(f"benchmark of stops: not within {_PATIENCE_S:g} s: {what}")
            time.sleep(_LOOK_S)

    def stopped_after(self, begin: int) -> int:
        """Wait for standstill. Return the time from ``begin`` until the drive left operation, in nanoseconds."""
        self.until(lambda: self.left, "the drive's own stop")
        took = self.left - begin
        self.until(lambda: self.drive.model.velocity_actual == 0, "standstill")
        return took


def real(trials: int) -> Iterator[Stop]:
    """Both rows with this number of trials. GatewayError if a drive starts again by itself."""
    chance = Random(1)
    killed, stopped = replace(KILLED, times_ns=[]), replace(STOPPED, times_ns=[])
    with ExitStack() as at_end:
        bus = at_end.enter_context(ServedBus())
        folder = Path(at_end.enter_context(tempfile.TemporaryDirectory()))
        (port,) = free_ports(socket.SOCK_DGRAM, 1)
        config = folder / "gateway.toml"
        config.write_text(
            _CONFIGURATION.format(interface=INTERFACE, channel=bus.channel, port=port, node=NODE), encoding="utf-8"
        )
        plant = Plant(bus, port)
        at_end.enter_context(plant.running())
        for _ in range(trials):
            with _gateway(config) as gateway:
                plant.turn()
                time.sleep(chance.random() * 0.1)
                stopped.times_ns.append(_stand_still(gateway, plant))
                plant.turn()
                time.sleep(chance.random() * 0.1)
                begin = time.monotonic_ns()
                gateway.kill()
                killed.times_ns.append(plant.stopped_after(begin))
    yield killed
    yield stopped


def _stand_still(gateway: subprocess.Popen[bytes], plant: Plant) -> int:
    starts = plant.starts
    begin = time.monotonic_ns()
    gateway.send_signal(signal.SIGSTOP)
    try:
        took = plant.stopped_after(begin)
        time.sleep(_STANDS_STILL_S)
    finally:
        gateway.send_signal(signal.SIGCONT)
    time.sleep(_STANDS_STILL_S)
    if plant.starts != starts:
        raise GatewayError("benchmark of stops: the active ON started the drive again")
    return took


@contextmanager
def _gateway(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(
        [sys.executable, "-m", "pdgw", "run", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield process
        finally:
            process.kill()
