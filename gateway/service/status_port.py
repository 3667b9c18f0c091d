"""The status port: one JSON document, or another answer, for the one line of each connection on a loopback TCP port."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator
from typing import Any

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Event, Task, Timer
from pdgw.ds301.loop.readiness import NO_DESCRIPTOR
from pdgw.gateway.base.ports import bound
from pdgw.gateway.service.running import RunningGateway
from pdgw.gateway.service.status import encoded, events_after, explanation, fault_status

log = logging.getLogger("gateway")

_CONNECTIONS = 8
"""Answered at the same time; more are closed."""
_PATIENCE_NS = 5 * SECOND
_PAUSE_NS = SECOND
"""Pause before the next accept when no file descriptor was available."""
_REQUEST = 64
"""Bytes of the longest request."""


def answered(daemon: RunningGateway, request: bytes) -> Iterator[bytes]:
    """The answer to a request, in parts.

    Nothing asks for the status, ``events NUMBER`` for the events after this one, ``faults DO`` for all faults of a drive object,
    ``explain [DO]`` for what happened last.
    """
    match request.split():
        case []:
            yield from encoded(daemon)
        case [b"events", number] if number.isdigit():
            yield b'{"events": ['
            for place, event in enumerate(events_after(daemon, int(number))):
                yield (b", " if place else b"") + json.dumps(event).encode()
            yield b"]}\n"
        case [b"explain"]:
            yield json.dumps({"lines": explanation(daemon, daemon.objects)}).encode() + b"\n"
        case [(b"faults" | b"explain") as what, number]:
            item = next((item for item in daemon.objects if str(item.do_id).encode() == number), None)
            if item is None:
                known = ", ".join(str(item.do_id) for item in daemon.objects)
                yield _refused("do_id", f"unknown drive object, allowed: {known}")
                return
            document: dict[str, Any] = (
                {"faults": fault_status(item)} if what == b"faults" else {"lines": explanation(daemon, [item])}
            )
            yield json.dumps({"do_id": item.do_id} | document).encode() + b"\n"
        case _:
            yield _refused("request", "allowed: an empty line, events NUMBER, faults DO, explain, explain DO")


def _refused(field: str, text: str) -> bytes:
    return json.dumps({"error": text, "field": field}).encode() + b"\n"


class StatusServer:
    """Answers the one line of every connection on 127.0.0.1 (``answered``) and closes it."""

    def __init__(self, daemon: RunningGateway, port: int) -> None:
        self._daemon = daemon
        self._loop = daemon.loop
        self._tasks: set[Task] = set()
        self._silent: list[Task] = []
        """Those without a request yet, the oldest first."""
        self._pause: Timer | None = None
        self._full = False
        self._refused = 0
        daemon.loop.counters.add(
            "status", "refused", "times", "no file descriptor free for a connection", lambda: self._refused
        )
        remedy = "set status_port to another port, or to 0 for none"
        self._listener = bound("status port", "127.0.0.1", port, remedy, _CONNECTIONS)
        self._listener.setblocking(False)

    def start(self) -> None:
        self._loop.add_reader(self._listener.fileno(), self._accept)

    def stop(self) -> None:
        self._loop.remove_reader(self._listener.fileno())
        if self._pause is not None:
            self._pause.cancel()
        self._listener.close()
        for task in tuple(self._tasks):
            task.kill()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError as error:
            if error.errno in NO_DESCRIPTOR:
                self._wait_for_descriptors(error)
            return  # the client has disconnected already
        self._full = False
        connection.setblocking(False)
        if len(self._tasks) >= _CONNECTIONS:
            if not self._silent:
                connection.close()
                return
            self._silent.pop(0).kill()

        def answer() -> None:
            try:
                request = self._request(connection, self._loop.now() + _PATIENCE_NS)
                if task in self._silent:
                    self._silent.remove(task)
                if request is not None:
                    self._answer(connection, request)
            finally:
                self._loop.remove_writer(connection.fileno())
                connection.close()
                self._tasks.discard(task)

        task = self._loop.spawn(answer, "status")
        self._tasks.add(task)
        self._silent.append(task)

    def _wait_for_descriptors(self, error: OSError) -> None:
        """Stop reading the port: waiting clients would wake the loop in every turn without result."""
        self._refused += 1
        if not self._full:
            self._full = True
            log.error("status port: cannot accept a connection (%s); retry every second", error.strerror)
        self._loop.remove_reader(self._listener.fileno())
        self._pause = self._loop.call_later(_PAUSE_NS, self.start)

    def _answer(self, connection: socket.socket, request: bytes) -> None:
        deadline = self._loop.now() + _PATIENCE_NS
        writable = Event(self._loop)
        for part in answered(self._daemon, request):
            rest = memoryview(part)
            while rest:
                try:
                    rest = rest[connection.send(rest) :]
                except BlockingIOError:
                    writable.clear()
                    self._loop.add_writer(connection.fileno(), writable.set)
                    waited = writable.wait(max(0, deadline - self._loop.now()))
                    self._loop.remove_writer(connection.fileno())
                    if not waited:
                        return  # do not wait for a client that does not read
                except OSError:
                    return  # a client that disconnected early misses nothing
            self._loop.sleep(0)

    def _request(self, connection: socket.socket, deadline: int) -> bytes | None:
        """One line, or the text before the end of the data; None if the client sends neither in time."""
        readable = Event(self._loop)
        request = b""
        self._loop.add_reader(connection.fileno(), readable.set)
        try:
            while b"\n" not in request:
                if not readable.wait(max(0, deadline - self._loop.now())):
                    return None
                readable.clear()
                part = connection.recv(_REQUEST)
                request += part
                if not part or len(request) >= _REQUEST:
                    break
        except OSError:
            return None  # closed already
        finally:
            self._loop.remove_reader(connection.fileno())
        return request
