"""Connections of the page: limits for unknown senders, places for known ones, and time limits on both directions."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any, cast

import pytest
import uvicorn
from starlette.responses import JSONResponse
from uvicorn.server import ServerState

from pdgw.tools.web.server.guard import AT_ONCE, PART, LargeAnswers
from pdgw.tools.web.server.server import (
    CONNECTIONS_MAX,
    READ_WITHIN_S,
    REQUEST_WITHIN_S,
    UNKNOWN_MAX,
    UNKNOWN_OF_SENDER_MAX,
    Places,
    bounded_protocol,
)
from tests.support.gateways.daemon import axis, configuration, running
from tests.support.page import TOKEN, Page, ShownGateway, page

REQUEST = b"GET /static/app.js HTTP/1.1\r\nHost: localhost\r\n\r\n"


class RecordedPlaces(Places):
    """Remembers which connections were ended."""

    def __init__(self) -> None:
        super().__init__()
        self.ended: list[tuple[str, int]] = []

    def open(self, host: str, port: int) -> bool:
        return self.enter((host, port), lambda: self.ended.append((host, port)))


def test_the_oldest_connection_of_a_sender_ends_when_it_opens_too_many() -> None:
    recorded = RecordedPlaces()
    recorded.open("10.0.0.9", 1)
    assert all(recorded.open("10.0.0.1", port) for port in range(UNKNOWN_OF_SENDER_MAX + 2))
    assert recorded.ended == [("10.0.0.1", 0), ("10.0.0.1", 1)]


def test_the_oldest_unknown_connection_ends_when_all_their_places_are_taken() -> None:
    recorded = RecordedPlaces()
    assert all(recorded.open(f"10.0.0.{number}", 1) for number in range(UNKNOWN_MAX + 1))
    assert recorded.ended == [("10.0.0.0", 1)]


def test_a_known_connection_never_ends_for_another_one() -> None:
    recorded = RecordedPlaces()
    recorded.open("10.0.0.1", 0)
    recorded.keep(("10.0.0.1", 0))
    assert recorded.keeps(("10.0.0.1", 0))
    for port in range(1, 3 * CONNECTIONS_MAX):
        assert recorded.open("10.0.0.1", port)
        assert recorded.open(f"10.0.1.{port}", 1)
    assert ("10.0.0.1", 0) not in recorded.ended


def test_a_newcomer_is_refused_only_when_known_connections_have_all_places() -> None:
    recorded = RecordedPlaces()
    for number in range(CONNECTIONS_MAX):
        assert recorded.open("10.0.0.1", number)
        recorded.keep(("10.0.0.1", number))
    assert not recorded.open("10.0.0.2", 1)
    recorded.leave(("10.0.0.1", 0))
    assert not recorded.keeps(("10.0.0.1", 0))
    assert recorded.open("10.0.0.2", 1)
    assert recorded.open("10.0.0.3", 1), "takes the place of the one before"
    assert recorded.ended == [("10.0.0.2", 1)]


def test_a_connection_that_ended_is_not_known_afterwards() -> None:
    recorded = RecordedPlaces()
    recorded.keep(("10.0.0.1", 1))
    assert not recorded.keeps(("10.0.0.1", 1))


@pytest.mark.parametrize("hosts", ["2001:db8::{:x}", "::ffff:10.0.0.1", "fe80::{:x}%eth0"])
def test_addresses_of_one_ipv6_network_are_one_sender(hosts: str) -> None:
    recorded = RecordedPlaces()
    for number in range(1, UNKNOWN_OF_SENDER_MAX + 2):
        recorded.open(hosts.format(number), number)
    assert len(recorded.ended) == 1


# -- one connection, in virtual time ---------------------------------------------------------------------------------------


class Transport:
    """Takes what is written and has a buffer that the test fills."""

    def __init__(self) -> None:
        self.written = b""
        self.closing = self.aborted = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return ("127.0.0.1", 5) if name == "peername" else default

    def write(self, data: bytes) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return self.closing

    def close(self) -> None:
        self.closing = True

    def abort(self) -> None:
        self.closing = self.aborted = True

    def pause_reading(self) -> None: ...
    def resume_reading(self) -> None: ...


class Clock:
    """The timers and tasks of a loop; a test moves the time."""

    def __init__(self) -> None:
        self.now = 0.0
        self.timers: list[tuple[float, SimpleNamespace, Callable[[], None]]] = []
        self.tasks: list[Any] = []
        self.asyncio = asyncio.new_event_loop()

    def call_later(self, delay: float, callback: Callable[[], None]) -> SimpleNamespace:
        handle = SimpleNamespace(cancelled=False)
        handle.cancel = lambda: setattr(handle, "cancelled", True)
        self.timers.append((self.now + delay, handle, callback))
        return handle

    def create_task(self, made: Any, **_: Any) -> Any:
        self.tasks.append(made)
        return asyncio.Future(loop=self.asyncio)

    def advance(self, seconds: float) -> None:
        self.now += seconds
        due = [item for item in self.timers if item[0] <= self.now]
        self.timers = [item for item in self.timers if item[0] > self.now]
        for _, handle, callback in due:
            if not handle.cancelled:
                callback()


async def answering(_scope: Any, _receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


class Connection:
    """A connection to the server."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.transport = Transport()
        self.places = Places()
        settings = uvicorn.Config(answering, http=bounded_protocol(self.places), log_config=None, lifespan="off")
        settings.load()
        self.protocol = cast(Any, settings.http_protocol_class)(
            config=settings, server_state=ServerState(), app_state={}, _loop=self.clock
        )
        self.protocol.connection_made(self.transport)

    def receive(self, data: bytes) -> None:
        self.protocol.data_received(data)

    def answer(self) -> None:
        """Let the page answer the request."""
        task = self.clock.tasks.pop(0)
        with pytest.raises(StopIteration):
            task.send(None)


@pytest.fixture
def connection() -> Iterator[Connection]:
    made = Connection()
    yield made
    for task in made.clock.tasks:
        task.close()
    made.clock.asyncio.close()


def test_a_connection_without_a_request_ends(connection: Connection) -> None:
    connection.receive(b"GET / HT")
    connection.clock.advance(REQUEST_WITHIN_S)
    assert connection.transport.aborted


def test_a_connection_whose_answer_is_awaited_stays(connection: Connection) -> None:
    connection.receive(REQUEST)
    connection.clock.advance(10 * REQUEST_WITHIN_S)
    assert not connection.transport.closing


def test_an_answer_that_is_not_read_ends_the_connection(connection: Connection) -> None:
    connection.receive(REQUEST)
    connection.protocol.pause_writing()
    connection.clock.advance(READ_WITHIN_S)
    assert connection.transport.aborted


def test_slowly_read_answer_continues(connection: Connection) -> None:
    connection.receive(REQUEST)
    for _ in range(5):
        connection.protocol.pause_writing()
        connection.clock.advance(READ_WITHIN_S / 2)
        connection.protocol.resume_writing()
        connection.clock.advance(READ_WITHIN_S)
    assert not connection.transport.closing


def test_the_rest_of_an_answer_that_is_not_read_ends_the_connection(connection: Connection) -> None:
    """Below the transport's high-water mark nothing pauses, and close() waits for the reader."""
    connection.receive(REQUEST)
    connection.answer()
    connection.clock.advance(READ_WITHIN_S)
    assert connection.transport.aborted


def test_an_unfinished_second_request_ends_the_connection(connection: Connection) -> None:
    connection.receive(REQUEST)
    connection.answer()
    for _ in range(9):
        connection.receive(b"G" if connection.clock.now == 0 else b"E")
        connection.clock.advance(READ_WITHIN_S / 8)
    assert connection.transport.aborted


def test_a_second_request_in_time_keeps_the_connection(connection: Connection) -> None:
    connection.receive(REQUEST)
    connection.answer()
    connection.clock.advance(1)
    connection.receive(REQUEST)
    connection.clock.advance(10 * READ_WITHIN_S)
    assert not connection.transport.closing


@pytest.mark.parametrize("together", [True, False])
def test_a_request_before_the_answer_to_the_last_one_is_not_served(connection: Connection, together: bool) -> None:
    connection.receive(REQUEST * 2 if together else REQUEST)
    if not together:
        connection.receive(REQUEST)
        assert connection.transport.aborted
        return
    connection.answer()
    assert connection.transport.closing
    assert connection.clock.tasks == []


def test_a_closed_connection_leaves_its_place(connection: Connection) -> None:
    connection.places.keep(("127.0.0.1", 5))
    assert connection.places.keeps(("127.0.0.1", 5))
    connection.protocol.connection_lost(None)
    assert not connection.places.keeps(("127.0.0.1", 5))


# -- the page --------------------------------------------------------------------------------------------------------------


@pytest.fixture(params=[None, TOKEN], ids=["no token", "token"])
def served(request: pytest.FixtureRequest) -> Iterator[Page]:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        gateway.show(daemon)
        with page(daemon.config, gateway, request.param) as made:
            made.heard()
            yield made


def test_unread_answers_do_not_keep_others_out(served: Page) -> None:
    with ExitStack() as at_end:
        for _ in range(2 * CONNECTIONS_MAX):
            unread = at_end.enter_context(socket.create_connection(("127.0.0.1", served.port)))
            unread.sendall(b"GET /static/vendor/uplot/uPlot.esm.js HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert served.get("/healthz").status == 200
        assert served.get("/api/v1/status", authorization=f"Bearer {TOKEN}").status == 200


def test_connections_without_the_token_carry_one_request(served: Page) -> None:
    assert served.get("/static/app.js").headers["connection"] == "close"


def test_a_connection_with_the_token_carries_more_requests() -> None:
    gateway = ShownGateway()
    with running(configuration(axis(1))) as daemon:
        gateway.show(daemon)
        with page(daemon.config, gateway, TOKEN) as served:
            served.heard()
            connection = served.ask("/api/v1/status", authorization=f"Bearer {TOKEN}")
            answer = connection.getresponse()
            assert "connection" not in answer.headers
            answer.read()
            connection.request("GET", "/api/v1/states", headers={"authorization": f"Bearer {TOKEN}"})
            assert connection.getresponse().status == 200


# -- large answers -----------------------------------------------------------------------------------------------------------


def test_large_answers_are_made_only_while_there_is_room() -> None:
    """A reader that accepts nothing keeps one answer in memory; its further requests keep none."""
    size = 5 * PART
    made: list[int] = []

    async def run_clients() -> list[int]:
        answers = LargeAnswers()
        unread = asyncio.Event()
        statuses: list[int] = []

        async def send(message: Any) -> None:
            if message["type"] == "http.response.start":
                statuses.append(message["status"])
            elif message.get("more_body"):
                assert len(message["body"]) <= PART
                await unread.wait()

        def make() -> JSONResponse:
            made.append(1)
            return JSONResponse("x" * size)

        scope = {"type": "http", "method": "GET", "headers": []}
        tasks = [
            asyncio.create_task(answers(make)(cast(Any, scope), cast(Any, None), cast(Any, send))) for _ in range(20)
        ]
        while len(statuses) < AT_ONCE:
            await asyncio.sleep(0)
        for _ in range(100):
            await asyncio.sleep(0)
        held = len(made)
        unread.set()
        await asyncio.gather(*tasks)
        return [held, len(statuses)]

    assert asyncio.run(run_clients()) == [AT_ONCE, 20]
