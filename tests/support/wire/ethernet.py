"""An Ethernet interface whose other end is a test."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from pdgw.ds301.loop.loop import Loop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.udp import Address
from pdgw.profinet.rpc.dcerpc import ACYCLIC_PORT
from pdgw.profinet.station import IpSuite, Medium
from tests.support.wire.profinet import DEVICE_MAC, PLC_IP


class FakeEthernet:
    """An interface whose other end is a test."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.mac = DEVICE_MAC
        self.link_up = True
        self.medium = Medium()
        self.errors = 0
        self.address = IpSuite()
        self.may_set = True
        self.real_time: deque[bytes] = deque()
        self.other: deque[bytes] = deque()
        self.datagrams: deque[tuple[bytes, Address]] = deque()
        self.sent: deque[tuple[Address | None, bytes]] = deque()
        self.closed = False
        self.listening = True
        self.on_real_time: Callable[[], None] = lambda: None
        self.on_other: Callable[[], None] = lambda: None
        self.on_link: Callable[[], None] = lambda: None

    def start(
        self, on_real_time: Callable[[], None], on_other: Callable[[], None], on_link: Callable[[], None]
    ) -> None:
        self.on_real_time, self.on_other, self.on_link = on_real_time, on_other, on_link
        self.closed = False

    def listen(self, *, on: bool) -> None:
        self.listening = on
        if on and self.real_time:
            self.loop.call_later(0, self._received)

    def _received(self) -> None:
        if self.listening and self.real_time:
            self.on_real_time()

    def receive(self) -> bytes | None:
        return self.real_time.popleft() if self.real_time else None

    def receive_other(self) -> bytes | None:
        return self.other.popleft() if self.other else None

    def receive_datagram(self) -> tuple[bytes, Address] | None:
        return self.datagrams.popleft() if self.datagrams else None

    def send(self, frame: bytes | bytearray) -> None:
        self.sent.append((None, bytes(frame)))

    def send_datagram(self, data: bytes, address: Address) -> None:
        self.sent.append((address, data))

    def ip(self) -> IpSuite:
        return self.address

    def set_ip(self, suite: IpSuite) -> None:
        if not self.may_set:
            raise GatewayError("interface eth1: the address cannot be set")
        self.address = suite

    def close(self) -> None:
        self.closed = True

    def arrive(self, address: Address | None, data: bytes) -> None:
        if self.closed:
            return
        if address is not None:
            self.datagrams.append((data, (PLC_IP, ACYCLIC_PORT)))
            self.on_other()
        elif 0xFEFC <= int.from_bytes(data[14:16], "big") <= 0xFEFF or data[12:14] == b"\x88\xcc":
            self.other.append(data)
            self.on_other()
        else:
            self.real_time.append(data)
            self._received()
