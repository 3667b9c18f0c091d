"""The status of a gateway that has no file descriptor left, and of one that has ended."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.system_loop import SystemLoop
from pdgw.ds301.loop.virtual_loop import VirtualLoop
from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service import status_port as port_module
from pdgw.gateway.service.last_words import LastWords, kept_last_words, last_words
from pdgw.gateway.service.status_client import fetch
from pdgw.gateway.service.status_port import StatusServer
from pdgw.tools.output.status_text import Health
from tests.support.cli import pdgw
from tests.support.gateways.daemon import axis
from tests.support.processes import free_tcp_port

# -- no file descriptor: it waits and answers later ---------------------------------------------------------------


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


def test_a_connection_that_cannot_be_accepted_does_not_keep_the_loop_awake(
    loop: SystemLoop, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(port_module, "_PAUSE_NS", 3600 * SECOND)
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
    monkeypatch.setattr(port_module, "_PAUSE_NS", 0)
    server, listener, client = server_of(loop, 3)
    with client:
        loop.add_reader(client.fileno(), loop.stop)
        loop.run()
        loop.remove_reader(client.fileno())
        assert b"allowed" in client.recv(1000)
        assert listener.asked == 4
        assert len(caplog.records) == 1, "reported once while it is present"
        server.stop()


# -- connections without a request: the oldest ends for another one ------------------------------------------------


def test_silent_connections_leave_the_port_to_who_asks(loop: SystemLoop) -> None:
    server = StatusServer(cast(Daemon, SimpleNamespace(loop=loop)), 0)
    address = server._listener.getsockname()
    server.start()
    with ExitStack() as opened:
        silent = [opened.enter_context(socket.create_connection(address)) for _ in range(8)]
        asking = opened.enter_context(socket.create_connection(address))
        asking.sendall(b"nonsense\n")
        loop.add_reader(asking.fileno(), loop.stop)
        loop.run()
        loop.remove_reader(asking.fileno())
        assert b"allowed" in asking.recv(1000)
        silent[0].settimeout(0)
        assert silent[0].recv(1) == b"", "the oldest has ended"
        for other in silent[1:]:
            other.settimeout(0)
            with pytest.raises(BlockingIOError):
                other.recv(1)
        server.stop()


# -- the reason why a gateway ended -------------------------------------------------------------------------------


OTHER_MASTER = "CAN bus can: another master sends RPDO1 of drive 1 (COB-ID 201h); allowed: one gateway per bus"


@pytest.fixture(autouse=True)
def run_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def port() -> int:
    """No program listens here."""
    return free_tcp_port()


@pytest.mark.parametrize(
    ("error", "text"),
    [(GatewayError(OTHER_MASTER), OTHER_MASTER), (RuntimeError("x"), "unexpected error: RuntimeError('x')")],
)
def test_status_of_an_ended_gateway_has_its_last_words(port: int, error: Exception, text: str) -> None:
    with pytest.raises(type(error)), kept_last_words(port):
        raise error
    with pytest.raises(GatewayError, match="no gateway answers") as asked:
        fetch(port)
    assert str(asked.value).endswith(text)
    assert "the last one ended on 20" in str(asked.value)


def test_stop_as_commanded_is_not_an_error(port: int) -> None:
    with kept_last_words(port):
        pass
    assert last_words(port).endswith("stopped as commanded")


def test_start_deletes_the_words_of_the_gateway_before(port: int) -> None:
    with pytest.raises(GatewayError), kept_last_words(port):
        raise GatewayError(OTHER_MASTER)
    with kept_last_words(port):
        assert last_words(port) == ""


def test_a_killed_gateway_is_reported_with_its_last_event(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    loop, words = VirtualLoop(), LastWords(port)
    words.keep(loop, dict, lambda: "axis 1: In operation")
    loop.run_for(1)
    assert last_words(port) == "", "it runs"

    def is_gone(_process: int, _signal: int) -> None:
        raise ProcessLookupError

    monkeypatch.setattr(os, "kill", is_gone)
    with pytest.raises(GatewayError, match="no gateway answers") as asked:
        fetch(port)
    assert "the last one was killed or has crashed, its last sign of life was on 20" in str(asked.value)
    assert str(asked.value).endswith("; its last event: axis 1: In operation")


def test_a_running_gateway_leaves_a_sign_of_life_every_five_seconds(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    loop, words = VirtualLoop(), LastWords(port)
    monkeypatch.setattr(words, "write", lambda *values: written.append(values))
    words.keep(loop, dict, lambda: "the same event")
    loop.run_for(60 * SECOND)
    assert len(written) == 13


def test_the_next_gateway_with_the_same_process_number_knows_that_the_last_one_was_killed(port: int) -> None:
    """In a container each gateway has process 1."""
    LastWords(port).write("", {})
    assert last_words(port) == "", "a process with this number exists"
    assert "killed or has crashed" in LastWords(port).text


def test_words_of_another_port_are_not_shown(port: int) -> None:
    with kept_last_words(port + 1):
        pass
    assert last_words(port) == ""


def test_gateway_without_a_status_port_keeps_nothing(tmp_path: Path) -> None:
    with kept_last_words(0):
        pass
    assert not list(tmp_path.rglob("ended-*"))


def test_check_of_an_ended_gateway_says_why(port: int) -> None:
    with pytest.raises(GatewayError), kept_last_words(port):
        raise GatewayError(OTHER_MASTER)
    result = pdgw("status", "--check", "--port", str(port))
    assert result.returncode == Health.UNKNOWN
    assert OTHER_MASTER in result.stdout


def test_gateway_that_cannot_start_leaves_its_error(port: int, tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other:
        other.bind(("127.0.0.1", 0))
        cyclic = other.getsockname()[1]
        file.write_text(
            '[can]\ninterface = "virtual"\n[trace]\nenabled = false\n'
            f"[transport]\ncyclic_port = {cyclic}\nacyclic_port = 0\nstatus_port = {port}\n{axis(1, more='')}"
        )
        assert pdgw("run", str(file), "--log-file", str(tmp_path / "log")).returncode == 1
    assert f"cyclic port: 127.0.0.1 port {cyclic} cannot be used" in last_words(port)
