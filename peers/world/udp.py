"""An IP network in virtual time: datagrams are lost, duplicated, delayed, reordered or blocked."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from pdgw.base.durations import MS
from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.udp import Address

_FIRST_FREE_PORT = 49152
_ANY = "0.0.0.0"
_ROOM = 256
"""Size of a port's queue in datagrams; more are lost."""


@dataclass(slots=True)
class Conditions:
    """Effects on datagrams: shares from 0 to 1, times in nanoseconds. Jitter above their distance changes their order."""

    loss: float = 0.0
    duplication: float = 0.0
    delay_ns: int = MS // 20
    jitter_ns: int = 0


class SimulatedUdpPort:
    """A bound port: a ``gateway.base.udp.DatagramPort``."""

    def __init__(self, network: SimulatedNetwork, address: Address) -> None:
        self.errors = 0
        self.received_at: int | None = None
        """Arrival time of the datagram that ``receive`` returned last."""
        self._network = network
        self._address = address
        self._waiting: deque[tuple[int, bytes, Address]] = deque()
        self._action: Callable[[], None] | None = None
        self._paused = False

    @property
    def address(self) -> Address:
        return self._address

    def start(self, action: Callable[[], None], *, urgent: bool = False) -> None:
        self._action = action
        self._paused = False
        self._network.loop.call_later(0, self._notify)

    def pause(self) -> None:
        self._paused = True

    def only_from(self, sender: Address | None) -> None:
        """No filter: without a kernel all senders are received, and the caller checks."""

    def receive(self) -> tuple[bytes, Address] | None:
        if not self._waiting:
            return None
        self.received_at, data, source = self._waiting.popleft()
        return data, source

    def send(self, data: bytes | bytearray, address: Address) -> None:
        self._network.carry(bytes(data), self._address, address)

    def close(self) -> None:
        self._action = None
        self._network.release(self)

    def arrive(self, data: bytes, source: Address) -> None:
        """A datagram has arrived."""
        if self._action is not None and len(self._waiting) < _ROOM:
            self._waiting.append((self._network.loop.now(), data, source))
            self._notify()

    def _notify(self) -> None:
        """Notify while datagrams are waiting."""
        if self._action is not None and self._waiting and not self._paused:
            self._action()
            if self._waiting:
                self._network.loop.call_later(0, self._notify)


class SimulatedNetwork:
    """All hosts, by name. ``conditions`` apply to every datagram."""

    def __init__(self, loop: Loop, random: Random) -> None:
        self.loop = loop
        self.conditions = Conditions()
        self.taps: list[Callable[[int, Address, Address, bytes], None]] = []
        """Called for every sent datagram: time, source, target, data."""
        self.arrivals: list[Callable[[int, Address, Address, bytes], None]] = []
        """Called for every datagram that arrives."""
        self._random = random
        self._ports: dict[Address, SimulatedUdpPort] = {}
        self._cut: set[str] = set()
        self._next_port = _FIRST_FREE_PORT

    def open(self, host: str, port: int, purpose: str) -> SimulatedUdpPort:
        """Bind a port, 0 for a free one; GatewayError when it is in use."""
        if port == 0:
            port, self._next_port = self._next_port, self._next_port + 1
        if (host, port) in self._ports:
            raise GatewayError(f"{purpose}: {host} port {port} cannot be used (in use)")
        opened = self._ports[host, port] = SimulatedUdpPort(self, (host, port))
        return opened

    def release(self, port: SimulatedUdpPort) -> None:
        """Release a port."""
        if self._ports.get(port.address) is port:
            del self._ports[port.address]

    def cut(self, host: str, off: bool = True) -> None:
        """Disconnect a host from the network, or connect it again. Datagrams on their way still arrive."""
        (self._cut.add if off else self._cut.discard)(host)

    def carry(self, data: bytes, source: Address, target: Address) -> None:
        """Send a datagram."""
        for tap in self.taps:
            tap(self.loop.now(), source, target, data)
        if self._cut and (source[0] in self._cut or target[0] in self._cut):
            return
        conditions = self.conditions
        if conditions.loss and self._random.random() < conditions.loss:
            return
        copies = 2 if conditions.duplication and self._random.random() < conditions.duplication else 1
        for _ in range(copies):
            delay = conditions.delay_ns
            if conditions.jitter_ns:
                delay += self._random.randrange(conditions.jitter_ns)
            self.loop.call_later(delay, lambda: self._arrive(data, source, target))

    def _arrive(self, data: bytes, source: Address, target: Address) -> None:
        port = self._ports.get(target) or self._ports.get((_ANY, target[1]))
        if port is not None:
            for tap in self.arrivals:
                tap(self.loop.now(), source, target, data)
            port.arrive(data, source)
