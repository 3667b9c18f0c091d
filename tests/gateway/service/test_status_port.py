"""The status port of a process that has no file descriptor left: it waits, spins for nothing, and answers later."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdgw.ds301.loop.loop import SystemLoop
from pdgw.durations import SECOND
from pdgw.gateway.daemon import Daemon
from pdgw.gateway.service import status as status_module
from pdgw.gateway.service.status import StatusServer


class Listener:
    """A listening socket that cannot have a connection ``failures`` times."""

    def __init__(self, real: socket.socket, failures: int) -> None:
        self.real = real
        self.failures = failures
        self.asked = 0

    def accept(self) -> Any:
        self.asked += 1
        if self.asked <= self.failures:
            raise OSError(errno.EMFILE, "Too many open files")
        return self.real.accept()

    def fileno(self) -> int:
        return self.real.fileno()

    def close(self) -> None:
        self.real.close()


@pytest.fixture
def loop() -> Iterator[SystemLoop]:
    made = SystemLoop()
    yield made
    made.close()


def server_of(loop: SystemLoop, failures: int) -> tuple[StatusServer, Listener, socket.socket]:
    """A server, its port, and a client with an unknown request."""
    server = StatusServer(cast(Daemon, SimpleNamespace(loop=loop)), 0)
    listener = Listener(server._listener, failures)
    server._listener = cast(socket.socket, listener)
    client = socket.create_connection(listener.real.getsockname())
    client.sendall(b"nonsense\n")
    server.start()
    return server, listener, client


def test_a_connection_that_cannot_be_had_does_not_wake_the_loop_again_and_again(
    loop: SystemLoop, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(status_module, "_PAUSE_NS", 3600 * SECOND)
    server, listener, client = server_of(loop, 1)
    turns = 0

    def turn() -> None:
        nonlocal turns
        turns += listener.asked > 0
        if turns < 10:
            loop.call_later(0, turn)
        else:
            loop.stop()

    with client:
        turn()
        loop.run()
        assert listener.asked == 1
        assert caplog.text.count("status port: cannot accept a connection (Too many open files)") == 1
        assert [item["value"] for item in loop.counters.values() if item["part"] == "status"] == [1]
        server.stop()


def test_who_waited_is_answered_when_there_are_descriptors_again(
    loop: SystemLoop, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(status_module, "_PAUSE_NS", 0)
    server, listener, client = server_of(loop, 3)
    with client:
        loop.add_reader(client.fileno(), loop.stop)
        loop.run()
        loop.remove_reader(client.fileno())
        assert b"allowed" in client.recv(1000)
        assert listener.asked == 4
        assert len(caplog.records) == 1, "told once while it lasts"
        server.stop()
