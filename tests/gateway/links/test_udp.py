"""The UDP sockets of the machine: a flood of an unknown sender ends in the kernel, and a port can be paused."""

from __future__ import annotations

import socket
import sys
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


def test_a_port_for_one_sender_hears_nobody_else_until_it_is_for_all_again(
    port: UdpSocket, senders: list[socket.socket]
) -> None:
    if sys.platform != "linux":
        pytest.skip("packet filters are of Linux")
    plc = senders[0].getsockname()
    everybody = [item.getsockname() for item in senders]

    def all_send() -> list[Address]:
        for item in senders:
            item.sendto(b"x", port.address)
        return heard(port)

    assert all_send() == everybody
    port.only_from(plc)
    port.only_from(plc)
    assert all_send() == [plc]
    port.only_from(everybody[2])
    assert all_send() == [everybody[2]], "same number of port or not: address and port count"
    port.only_from(None)
    port.only_from(None)
    assert all_send() == everybody


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
