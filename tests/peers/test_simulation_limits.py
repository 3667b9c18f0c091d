"""The simulators' console against long lines, wrong lengths and callers that go away."""

from __future__ import annotations

import errno
import socket
import socketserver
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import cast

import pytest

from pdgw.peers.simulation import console as console_module
from pdgw.peers.simulation.console import Console, PatientServer, serve
from pdgw.peers.simulation.devices import Simulation
from tests.support.buses import PATIENCE_S

NOTHING = cast(Simulation, SimpleNamespace(nodes=[]))


@pytest.fixture
def console() -> Iterator[int]:
    server = serve(Console(NOTHING, threading.Event()), 0)
    yield int(server.server_address[1])
    server.shutdown()
    server.server_close()


def talk(port: int, data: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        try:
            while part := connection.recv(65536):
                answer += part
        except ConnectionResetError:
            pass
        return answer


def test_a_command_of_any_length_is_answered_or_refused(console: int) -> None:
    assert talk(console, b"\n") == b"ok\n"
    answer = talk(console, b"x" * 1001)
    assert answer == b"error: a command has at most 1000 characters\n"
    with socket.create_connection(("127.0.0.1", console), timeout=PATIENCE_S) as connection:
        connection.sendall(b"x" * 50_000)
        assert connection.recv(1000).startswith(b"error: a command has at most")


def test_clients_that_disconnect_early_cause_no_messages(console: int, capsys: pytest.CaptureFixture[str]) -> None:
    for data in [b"status\n" * 1000, b"s"] * 5:
        connection = socket.create_connection(("127.0.0.1", console), timeout=PATIENCE_S)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        connection.sendall(data)
        connection.close()  # with a reset
    assert talk(console, b"\n") == b"ok\n"
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(("number", "pauses"), [(errno.EMFILE, 1), (errno.ECONNABORTED, 0)])
def test_a_server_without_descriptors_pauses_where_its_port_would_keep_it_busy(
    number: int, pauses: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr(console_module, "time", SimpleNamespace(sleep=slept.append))

    def accept() -> None:
        raise OSError(number, "not now")

    with PatientServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server, server.socket:
        server.socket = cast(socket.socket, SimpleNamespace(accept=accept, close=server.socket.close))
        with pytest.raises(OSError, match="not now"):
            server.get_request()
    assert len(slept) == pauses
