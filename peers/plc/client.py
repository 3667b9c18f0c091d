"""The PLC simulator on UDP: one thread sends in a fixed cycle and receives; capture and parameters run beside it."""

from __future__ import annotations

import abc
import select
import socket
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from pdgw.base.durations import SECOND
from pdgw.gateway.base.udp import Address
from pdgw.gateway.client.address import Target
from pdgw.gateway.client.session import Element, Session
from pdgw.gateway.client.udp import ParameterClient
from pdgw.peers.plc.engine import Engine
from pdgw.peers.plc.exchange.endpoint import PlcEndpoint
from pdgw.peers.plc.notation import parse_time
from pdgw.profidrive.frame import CYCLIC_PORT
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT


class PlcRunner(abc.ABC):
    """Runs an engine with a gateway on any link."""

    def __init__(self, endpoint: PlcEndpoint, cycle_ns: int) -> None:
        self.endpoint = endpoint
        self.cycle_ns = cycle_ns
        self.on_cycle: Callable[[], None] = lambda: None
        self._parameters: ParameterClient | None = None
        self._requests = ThreadPoolExecutor(1, "parameters")
        self._stopping = threading.Event()

    @abc.abstractmethod
    def _wait(self, ns: int) -> None:
        """Receive for this time."""

    @abc.abstractmethod
    def _send(self, *, muted: bool = False) -> None:
        """Send the setpoints, or with ``muted`` nothing in this cycle."""

    @abc.abstractmethod
    def _open_parameters(self) -> ParameterClient:
        """Open the parameter channel."""

    def _request(self, do_id: int, targets: Sequence[Target], values: Sequence[str]) -> Future[list[Element]]:
        if self._parameters is None:
            self._parameters = self._open_parameters()
        return self._requests.submit(_answer, self._parameters, do_id, targets, values)

    def close(self) -> None:
        """Release the link after the present parameter access, which has a timeout."""
        self._requests.shutdown()
        if self._parameters is not None:
            self._parameters.close()

    def stop(self) -> None:
        """End ``run`` after the present cycle."""
        self._stopping.set()

    def run(self, engine: Engine | None, drive: Callable[[str], None] = lambda _: None) -> None:
        """Exchange frames until the scenario ends or ``stop``. ``drive`` gets the scenario's drive commands.

        A scenario ends, too, when an expectation fails and no gateway has answered until then. One that waits for nothing
        lasts until the first answer, or its timeout.
        """
        due = time.monotonic_ns()
        until = due
        if engine is not None:
            engine.drive, engine.request = drive, self._request
            until += parse_time(engine.scenario.within)
        while not self._stopping.is_set():
            now = time.monotonic_ns()
            answered = self.endpoint.counters["received"] or now > until
            if engine is not None and engine.finished and (answered or not engine.passed):
                return
            if now < due:
                self._wait(due - now)
                continue
            due = max(due + self.cycle_ns, now)
            self.endpoint.poll(now)
            if engine is not None:
                engine.step(now)
                if not engine.passed and not self.endpoint.counters["received"]:
                    engine.abort()
            self._send(muted=engine is not None and engine.muted)
            self.on_cycle()


def _answer(client: ParameterClient, do_id: int, targets: Sequence[Target], values: Sequence[str]) -> list[Element]:
    client.do_id = do_id
    session = Session(client)
    return session.write_texts(list(zip(targets, values, strict=True))) if values else session.read_first(targets)


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

    def _open_parameters(self) -> ParameterClient:
        client = ParameterClient((self.gateway[0], self._acyclic_port), 1)
        if self._capture is not None:
            client.tap = self._capture(client.local_address, (self.gateway[0], ACYCLIC_PORT))
        return client

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
