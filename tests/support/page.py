"""The web page of a gateway that the test simulates: the test sets its documents, in virtual time or not."""

from __future__ import annotations

import asyncio
import http.client
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.gateway.configuration.web import WebConfig
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.service.status import events_after, explanation, fault_status, snapshot
from pdgw.tools.recording.trace_keeper import captured
from pdgw.tools.web.app import Capture, Parameters, made_page
from pdgw.tools.web.server.guard import Token
from pdgw.tools.web.server.server import listen
from pdgw.tools.web.status import feed
from pdgw.tools.web.status.feed import Document
from pdgw.tools.web.status.watch import StatusPort, Watch
from pdgw.tools.web.support import RequestError
from tests.support.buses import PATIENCE_S

TOKEN = "a token of more than sixteen characters"


class ShownGateway(StatusPort):
    """Answers with what was shown last; ``failure``: it does not answer."""

    def __init__(self) -> None:
        super().__init__(0)
        self.document: Document = {}
        self.histories: dict[int, list[Document]] = {}
        self.happened: dict[int | None, list[Document]] = {}
        self.reported: list[Document] = []
        self.failure = ""
        self.asked = 0

    def show(self, daemon: Daemon) -> None:
        """What a daemon would answer now."""
        self.histories = {item.do_id: fault_status(item) for item in daemon.objects}
        self.happened = {item.do_id: explanation(daemon, [item]) for item in daemon.objects}
        self.happened[None] = explanation(daemon, daemon.objects)
        self.document = json.loads(json.dumps(snapshot(daemon)))
        self.reported = list(events_after(daemon, 0))

    def add_event(self, do_id: int, text: str) -> None:
        """One more event."""
        number = self.reported[-1]["number"] + 1
        self.reported.append(self.reported[-1] | {"number": number, "kind": "reason", "do_id": do_id, "text": text})
        self.document["last_event"] = number

    def status(self) -> Document:
        self.asked += 1
        if self.failure:
            raise GatewayError(self.failure)
        return json.loads(json.dumps(self.document))  # type: ignore[no-any-return]

    def events(self, number: int) -> list[Document]:
        if self.failure:
            raise GatewayError(self.failure)
        known = number if number <= self.document["last_event"] else 0
        return [event for event in self.reported if event["number"] > known]

    def faults(self, do_id: int) -> list[Document]:
        if self.failure:
            raise GatewayError(self.failure)
        return self.histories[do_id]

    def explanation(self, do_id: int | None) -> list[Document]:
        return self.happened[do_id]


class ShownParameters:
    """Has P922 of every drive object; a dump waits for ``slow``."""

    def __init__(self) -> None:
        self.slow = threading.Lock()
        self.waiting = False

    def read(self, do_id: int, text: str) -> list[dict[str, Any]]:
        if text != "P922":
            raise RequestError("pnu", f"parameter {text!r}: only P922 here")
        return [{"parameter": "P922", "name": "Telegram", "value": do_id, "unit": "", "meaning": "", "error": None}]

    def dump(self, do_id: int) -> dict[str, Any]:
        self.waiting = True
        with self.slow:
            return {"version": 1, "do_id": do_id, "parameters": []}

    def names(self, do_id: int) -> list[dict[str, Any]]:
        return [{"pnu": "P922", "name": "Telegram"}]


class Page:
    """A served page."""

    def __init__(self, port: int, watch: Watch, parameters: ShownParameters) -> None:
        self.port = port
        self.parameters = parameters
        self.watch = watch
        self.address = f"http://127.0.0.1:{port}"

    def ask(self, path: str, **headers: str) -> http.client.HTTPConnection:
        """A request on a connection of its own; the answer is waited for by ``getresponse``."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        connection.request("GET", path, headers={key.replace("_", "-"): value for key, value in headers.items()})
        return connection

    def get(self, path: str, **headers: str) -> http.client.HTTPResponse:
        """The answer to one request; its body can be read afterwards."""
        return self.ask(path, **headers).getresponse()

    def document(self, path: str, **headers: str) -> Any:
        """The JSON of an answer."""
        return json.loads(self.get(path, **headers).read())

    def heard(self) -> None:
        """Wait until the gateway was asked after now."""
        ticks = self.watch.feed.ticks
        until(lambda: self.watch.feed.ticks > ticks + 1, "the next look at the gateway")


def look(watch: Watch) -> None:
    """One look at the gateway. A busy machine makes no answer an old one."""
    with patch.object(feed, "ANSWER_WITHIN_S", PATIENCE_S):
        asyncio.run(watch.feed.once())


def until(condition: Any, what: str) -> None:
    """Wait for another thread."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


@contextmanager
def in_background(watch: Watch, parameters: Parameters, capture: Capture, token: Token | None = None) -> Iterator[int]:
    """Serve a page on a thread; gives its port."""
    server = made_page(watch, parameters, capture, token)
    with listen(watch.config.web) as port:
        thread = threading.Thread(target=lambda: asyncio.run(server.serve(sockets=[port])), name="page")
        thread.start()
        try:
            yield int(port.getsockname()[1])
        finally:
            server.should_exit = True
            thread.join()


@contextmanager
def page(
    config: GatewayConfig, gateway: ShownGateway, token: Token | str | None = None, port: int = 0
) -> Iterator[Page]:
    """The page of a gateway on loopback, served by a thread; ``port`` 0: a free one."""
    web = WebConfig(listen=f"127.0.0.1:{port}", hosts=config.web.hosts)
    watch = Watch(config.model_copy(update={"web": web}), gateway)
    watch.feed.unwatched_s = watch.feed.watched_s / 4
    parameters = ShownParameters()
    with (
        patch.object(feed, "ANSWER_WITHIN_S", PATIENCE_S),  # a busy machine makes no answer an old one
        in_background(watch, parameters, captured, Token(token) if isinstance(token, str) else token) as served,
    ):
        yield Page(served, watch, parameters)


def events_of(response: http.client.HTTPResponse, count: int) -> list[tuple[str, str, Any]]:
    """The next ``count`` messages of a stream: kind, id, data."""
    found: list[tuple[str, str, Any]] = []
    fields: dict[str, str] = {}
    while len(found) < count:
        line = response.readline().decode().rstrip("\n")
        if line:
            name, _, value = line.partition(": ")
            fields[name] = value
            continue
        if "data" in fields:
            found.append((fields.get("event", ""), fields.get("id", ""), json.loads(fields["data"])))
        fields = {}
    return found
