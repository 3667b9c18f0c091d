"""An unavailable Ethernet interface: one line with reason and remedy."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from pdgw.ds301.loop.loop import SystemLoop
from pdgw.gateway.errors import GatewayError
from pdgw.gateway.links.profinet.ethernet import RawEthernet


@pytest.fixture
def loop() -> Iterator[SystemLoop]:
    loop = SystemLoop()
    yield loop
    loop.close()


def test_an_interface_that_is_not_there_is_told_with_those_that_are(loop: SystemLoop) -> None:
    with pytest.raises(GatewayError, match=r"interface nowhere0: does not exist, allowed: .*lo"):
        RawEthernet(loop, "nowhere0")


def test_without_the_right_to_raw_frames_the_message_names_the_capability(
    loop: SystemLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> socket.socket:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(socket, "socket", refused)
    with pytest.raises(
        GatewayError, match=r"interface lo: no permission for raw Ethernet \(CAP_NET_RAW is missing\).*setcap"
    ):
        RawEthernet(loop, "lo")


def test_an_interface_that_is_no_ethernet_is_refused(loop: SystemLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[FakeSocket] = []

    class FakeSocket:
        closed = False

        def __init__(self, *_: object) -> None:
            opened.append(self)

        def getsockname(self) -> tuple[str, int, int, int, bytes]:
            return "lo", 0x8892, 4, 772, bytes(6)  # ARPHRD_LOOPBACK

        def setsockopt(self, *_: object) -> None: ...

        def bind(self, address: object) -> None: ...

        def fileno(self) -> int:
            return 1000

        def close(self) -> None:
            self.closed = True

    monkeypatch.setattr(socket, "socket", FakeSocket)
    with pytest.raises(GatewayError, match="interface lo: not an Ethernet interface"):
        RawEthernet(loop, "lo")
    assert opened
    assert all(item.closed for item in opened)
