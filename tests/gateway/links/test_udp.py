"""The UDP sockets of the machine: a flood of an unknown sender ends in the kernel, and a port can be paused."""

from __future__ import annotations

import socket
import sys
from collections import Counter
from collections.abc import Iterator

import pytest

from pdgw.ds301.loop.loop import SystemLoop
from pdgw.gateway.links.udp import Address, UdpSocket


@pytest.fixture
def port() -> Iterator[UdpSocket]:
    loop = SystemLoop()
    opened = UdpSocket(loop, "127.0.0.1", 0, "test")
    yield opened
    opened.close()
    loop.close()


@pytest.fixture
def senders() -> Iterator[list[socket.socket]]:
    """Two on different ports and one on another address."""
    made = []
    for host in ("127.0.0.1", "127.0.0.1", "127.0.0.2"):
        made.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made[-1].bind((host, 0))
    yield made
    for item in made:
        item.close()


def heard(port: UdpSocket) -> list[Address]:
    sources = []
    while (datagram := port.receive()) is not None:
        sources.append(datagram[1])
    return sources


def test_a_port_for_one_sender_hears_a_sample_of_others_until_it_is_for_all_again(
    port: UdpSocket, senders: list[socket.socket]
) -> None:
    """A second PLC can be named, and a flood costs little."""
    if sys.platform != "linux":
        pytest.skip("packet filters are of Linux")
    everybody = [item.getsockname() for item in senders]

    def all_send(times: int) -> Counter[Address]:
        found: Counter[Address] = Counter()
        for _ in range(times):
            for item in senders:
                item.sendto(b"x", port.address)
            found.update(heard(port))
        return found

    assert all_send(1) == Counter(everybody)
    for plc in (everybody[0], everybody[2]):
        port.only_from(plc)
        port.only_from(plc)
        found = all_send(3000)
        assert found.pop(plc) == 3000
        assert 2 <= found.total() <= 100, "of 6000, about 23; same number of port or not: address and port count"
    port.only_from(None)
    port.only_from(None)
    assert all_send(1) == Counter(everybody)


def test_a_paused_port_leaves_its_datagrams_in_the_kernel(port: UdpSocket, senders: list[socket.socket]) -> None:
    loop = port._loop
    seen: list[Address] = []
    port.start(lambda: seen.extend(heard(port)))
    port.pause()
    senders[0].sendto(b"x", port.address)
    loop.call_later(1_000_000, loop.stop)
    loop.run()
    assert seen == []

    def take() -> None:
        seen.extend(heard(port))
        loop.stop()

    port.start(take)
    loop.run()
    assert seen == [senders[0].getsockname()]
