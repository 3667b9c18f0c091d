"""A daemon in this process, with real sockets on loopback, simulated drives on virtual buses, and a PLC."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TypeVar

from pdgw.gateway.config import GatewayConfig, parse_config
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.status import snapshot
from pdgw.gateway.transport.acyclic import AcyclicServer
from pdgw.peers.plc.endpoint import PlcEndpoint
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.parameters.client import ParameterClient

from tests.support import buses

T = TypeVar("T")
OFF, ON = 0x047E, 0x047F
MS = 1_000_000


def configuration(axes: str, *, can: str = "", transport: str = "") -> GatewayConfig:
    """Free ports, buses of their own, a watchdog that a busy machine does not trip; ``axes`` are complete tables."""
    if "watchdog_factor" not in transport and "cycle_time_ms" not in transport:
        transport = f"watchdog_factor = 75\n{transport}"
    can = can or f'[can]\ninterface = "virtual"\nchannel = "{buses.channel()}"\n'
    head = f"{can}[transport]\ncyclic_port = 0\nacyclic_port = 0\nstatus_port = 0\n{transport}\n"
    return parse_config(head + axes)


def axis(number: int, *, telegram_number: int = 1, more: str = "simulate = true") -> str:
    return f"[[axis]]\ndo_id = {number}\nnode_id = {number}\ntelegram = {telegram_number}\n{more}\n"


class Plc:
    """Sends a frame for each one it takes; ``silent`` only listens."""

    def __init__(self, daemon: Daemon, numbers: list[int], source: str = "127.0.0.1") -> None:
        self.daemon = daemon
        self.endpoint = PlcEndpoint([telegram(n) for n in numbers], daemon.cycle_ns)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((source, 0))
        self.socket.connect(daemon.address)
        self.socket.settimeout(max(0.004, daemon.cycle_ns / 1e9))
        self.silent = False

    def exchange(self) -> None:
        if not self.silent:
            self.socket.send(self.endpoint.build(time.monotonic_ns()))
        try:
            while True:
                self.endpoint.receive(self.socket.recv(2048))
        except TimeoutError:
            return

    def until(self, condition: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + 10
        while not condition():
            assert time.monotonic() < deadline, f"{what}: {self.endpoint.actuals} {snapshot(self.daemon)}"
            self.exchange()

    def value(self, name: str, index: int = 0) -> int:
        actuals = self.endpoint.actuals[index]
        return -1 if actuals is None else actuals[name]

    def state(self, index: int = 0) -> int:
        return self.value("ZSW1", index) & 0x4F

    def enable(self, index: int = 0) -> None:
        self.endpoint.set(index, {"STW1": OFF})
        self.until(lambda: self.state(index) == 0x01, "ready")
        self.endpoint.set(index, {"STW1": ON})
        self.until(lambda: self.state(index) == 0x07, "operation")


def on_loop(daemon: Daemon, action: Callable[[], T], seconds: float = 10) -> T:
    """Run an action on the daemon's loop, from the test's thread; its result or exception."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(action())
        except Exception as error:  # the caller's
            future.set_exception(error)

    daemon.loop.call_threadsafe(run)
    return future.result(seconds)


@contextmanager
def running(config: GatewayConfig, before: Callable[[Daemon], None] | None = None) -> Iterator[Daemon]:
    daemon = Daemon(config)
    if before is not None:
        before(daemon)
    thread = threading.Thread(target=daemon.run)
    thread.start()
    try:
        yield daemon
    finally:
        daemon.stop()
        thread.join(20)
        assert not thread.is_alive(), "the daemon ends in bounded time"


@contextmanager
def serving(config: GatewayConfig, do_id: int | None = None) -> Iterator[tuple[Daemon, ParameterClient]]:
    """A daemon whose nodes are online, and a client of its parameter channel (of the first drive object)."""
    servers: list[AcyclicServer] = []

    def before(daemon: Daemon) -> None:
        servers.append(AcyclicServer(daemon))
        daemon.services.append(servers[0])

    with running(config, before) as daemon:
        buses.wait_for(lambda: all(client.generation for client in daemon.clients), "nodes online")
        first = daemon.objects[0].do_id if do_id is None else do_id
        with ParameterClient(servers[0].address, first) as client:
            yield daemon, client


@contextmanager
def exchanging(plc: Plc) -> Iterator[None]:
    """The PLC goes on exchanging frames beside the test."""
    stopping = threading.Event()

    def exchange() -> None:
        while not stopping.is_set():
            plc.exchange()

    thread = threading.Thread(target=exchange)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()
