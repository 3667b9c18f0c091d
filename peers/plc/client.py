"""The PLC simulator on UDP: one thread sends in a fixed cycle, receives and traces; capture and parameters run beside it."""

from __future__ import annotations

import abc
import csv
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pdgw.durations import MS, SECOND
from pdgw.gateway.errors import writing
from pdgw.gateway.links.udp import Address
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.exchange.parameters import ParameterWorker
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profidrive.signals import SignalQuantity
from pdgw.profidrive.telegrams import ApplicationMode, TelegramHalf
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT

TRACE_COLUMNS = ("time_s", "axis", "telegram", "control", "status", "setpoint", "actual")
_TRACE_NS = 10 * MS


class PlcRunner(abc.ABC):
    """Runs an engine with a gateway on any link."""

    def __init__(self, endpoint: PlcEndpoint, cycle_ns: int) -> None:
        self.endpoint = endpoint
        self.cycle_ns = cycle_ns
        self.trace: list[tuple[Any, ...]] = []
        self.on_cycle: Callable[[], None] = lambda: None
        self._parameters: ParameterWorker | None = None
        self._stopping = threading.Event()
        self._trace_due = 0
        self._start = 0

    @abc.abstractmethod
    def _wait(self, ns: int) -> None:
        """Receive for this time."""

    @abc.abstractmethod
    def _send(self, *, muted: bool = False) -> None:
        """Send the setpoints, or with ``muted`` nothing in this cycle."""

    @abc.abstractmethod
    def _worker(self) -> ParameterWorker:
        """Open the parameter channel."""

    def close(self) -> None:
        """Release the link."""
        if self._parameters is not None:
            self._parameters.close()

    def stop(self) -> None:
        """End ``run`` after the present cycle."""
        self._stopping.set()

    def run(self, engine: Engine | None, drive: Callable[[str], None] = lambda _: None) -> None:
        """Exchange frames until the scenario ends or ``stop``. ``drive`` gets the scenario's drive commands.

        A scenario ends, too, when an expectation fails and no gateway has answered until then.
        """
        self._start = due = time.monotonic_ns()
        while not self._stopping.is_set() and not (engine is not None and engine.finished):
            now = time.monotonic_ns()
            if now < due:
                self._wait(due - now)
                continue
            due = max(due + self.cycle_ns, now)
            self.endpoint.poll(now)
            if engine is not None:
                engine.step(now)
                if not engine.passed and not self.endpoint.counters["received"]:
                    engine.abort()
                while engine.drive_commands:
                    drive(engine.drive_commands.pop(0))
                while engine.accesses:
                    if self._parameters is None:
                        self._parameters = self._worker()
                    self._parameters.submit(engine.accesses.pop(0))
            self._send(muted=engine is not None and engine.muted)
            self._sample(now)
            self.on_cycle()

    def _sample(self, now: int) -> None:
        if now < self._trace_due:
            return
        self._trace_due = now + _TRACE_NS
        for index, item in enumerate(self.endpoint.telegrams):
            actuals = self.endpoint.actuals[index]
            if actuals is None:
                continue
            setpoints = self.endpoint.setpoints[index]
            demand_name = _main_value(item.setpoints, item.mode)
            actual_name = _main_value(item.actuals, item.mode)
            self.trace.append(
                (
                    round((now - self._start) / SECOND, 4),
                    index + 1,
                    item.number,
                    next(iter(setpoints.values())),
                    next(iter(actuals.values())),
                    setpoints[demand_name] if demand_name else 0,
                    actuals[actual_name] if actual_name else 0,
                )
            )

    def write_trace(self, path: Path) -> None:
        """The samples as CSV; GatewayError when the file cannot be written."""
        with writing(f"--trace {path}"), path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(TRACE_COLUMNS)
            writer.writerows(self.trace)


class PlcClient(PlcRunner):
    """A PLC on UDP. ``acyclic_port``: the gateway's port for parameters.

    ``capture`` gets the addresses of a conversation and returns a function for its datagrams (sent, data).
    """

    def __init__(
        self,
        gateway: Address,
        endpoint: PlcEndpoint,
        cycle_ns: int,
        capture: Callable[[Address, Address], Callable[[bool, bytes], None]] | None = None,
        acyclic_port: int = ACYCLIC_PORT,
    ) -> None:
        super().__init__(endpoint, cycle_ns)
        self.gateway = gateway
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1" if gateway[0].startswith("127.") else "0.0.0.0", 0))
        self._socket.setblocking(False)
        self._capture = capture
        self._record: Callable[[bool, bytes], None] = lambda sent, data: None
        if capture is not None:
            # With PROFINET's ports for the gateway every reader dissects the capture without settings.
            self._record = capture(self._socket.getsockname(), (gateway[0], CYCLIC_PORT))
        self._acyclic_port = acyclic_port

    def _wait(self, ns: int) -> None:
        select.select((self._socket,), (), (), ns / SECOND)
        self._receive()

    def close(self) -> None:
        super().close()
        self._socket.close()

    def _worker(self) -> ParameterWorker:
        capture, host = self._capture, self.gateway[0]
        return ParameterWorker(
            (host, self._acyclic_port),
            None if capture is None else lambda local: capture(local, (host, ACYCLIC_PORT)),
        )

    def _send(self, *, muted: bool = False) -> None:
        if muted:
            return
        frame = self.endpoint.build(time.monotonic_ns())
        try:
            self._socket.sendto(frame, self.gateway)
        except OSError:
            self.endpoint.counters["send errors"] += 1
            return
        self._record(True, bytes(frame))

    def _receive(self) -> None:
        while True:
            try:
                data, source = self._socket.recvfrom(2048)
            except BlockingIOError:
                return
            except OSError:
                self.endpoint.counters["receive errors"] += 1
                return
            if source != self.gateway:
                self.endpoint.counters["foreign"] += 1
                continue
            self.endpoint.receive(data, time.monotonic_ns())
            self._record(False, data)


_MAIN_QUANTITIES = {
    ApplicationMode.VELOCITY: (SignalQuantity.SPEED,),
    ApplicationMode.POSITIONING: (SignalQuantity.POSITION,),
    ApplicationMode.TRANSPARENT: (SignalQuantity.SPEED,),
    ApplicationMode.ENCODER: (SignalQuantity.SPEED, SignalQuantity.POSITION),
}


def _main_value(half: TelegramHalf, mode: ApplicationMode) -> str | None:
    """The traced signal: the first with the quantity that the application mode controls or measures; None without one."""
    signals = [item for item in half.signals if item.name != "Velocity Demand Value"]
    return next((item.name for wanted in _MAIN_QUANTITIES[mode] for item in signals if item.quantity is wanted), None)
