"""The page and its interface, version 1: routes over a ``Watch``. Nothing here can change anything.

Answers are JSON with snake_case keys and the unit in the key; readers ignore keys they do not know. Errors are ``{"error":
text, "field": name}``. ``pdgw web`` as a process is here too: the server, the watch and, if configured, the MQTT publisher,
until a signal ends it.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.configuration.config import GatewayConfig
from pdgw.profidrive.errors import ProfidriveError
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.web.metrics import CONTENT_TYPE, exposition
from pdgw.tools.web.parameters import states_document, telegram_document
from pdgw.tools.web.server.guard import Guard, LargeAnswers, Token, allowed_hosts, refusal
from pdgw.tools.web.server.server import PageServer, Places, listen, made_server
from pdgw.tools.web.status.watch import StatusPort, Watch, log
from pdgw.tools.web.stream import EventStream, Streams
from pdgw.tools.web.support import RequestError, about_document, support_archive
from pdgw.tools.web.trend import BINS_MAX, SECONDS_MAX, Traces, csv_text

STATIC = Path(__file__).parent / "static"
READS_PER_S = 5
_DIGITS_MAX = 16


class Parameters(Protocol):
    """The parameter channel, read on threads; RequestError for an invalid text, GatewayError without an answer."""

    def read(self, do_id: int, text: str) -> list[dict[str, Any]]:
        """Elements with name, unit and what they say."""

    def dump(self, do_id: int) -> dict[str, Any]:
        """All parameters of a drive object, as ``pdgw param dump`` writes them."""

    def names(self, do_id: int) -> list[dict[str, Any]]:
        """The parameters the drive object lists, with their names."""


Capture = Callable[[Path, float], bytes]
"""The last seconds of a ring as a pcapng file with this configuration, on a thread; GatewayError when it cannot be read."""


class Allowance:
    """Maximum number of reads in any second."""

    def __init__(self, per_s: int) -> None:
        self._times: deque[float] = deque(maxlen=per_s)

    def take(self, now: float) -> bool:
        """False: not yet. ``now``: monotonic seconds."""
        if len(self._times) == self._times.maxlen and now < self._times[0] + 1:
            return False
        self._times.append(now)
        return True


class Interface:
    """The routes of one gateway."""

    def __init__(self, watch: Watch, parameters: Parameters, capture: Capture, places: Places) -> None:
        self._watch = watch
        self._capture = capture
        self._places = places
        self._large = LargeAnswers()
        self._feed = watch.feed
        self._parameters = parameters
        self._one_at_a_time = asyncio.Lock()
        self._allowance = Allowance(READS_PER_S)
        self.streams = Streams(watch.feed, watch.log)
        self._exposition = exposition(watch)
        self._traces = Traces(watch.feed.status)

    @property
    def routes(self) -> Sequence[BaseRoute]:
        """The routes of the page."""
        do = "/api/v1/objects/{do_id}"
        return (
            Route("/", self._page),
            Route("/api/v1/status", self._status),
            Route("/api/v1/events", self._events),
            Route("/api/v1/states", self._states),
            Route("/api/v1/telegrams/{number}", self._telegram),
            Route("/api/v1/explain", self._explain),
            Route(f"{do}/explain", self._explain),
            Route(f"{do}/faults", self._faults),
            Route(f"{do}/trace", self._trace),
            Route(f"{do}/parameters", self._read),
            Route(f"{do}/parameters/dump", self._dump),
            Route("/api/v1/capture", self._captured),
            Route("/api/v1/about", self._about),
            Route("/api/v1/support", self._support),
            Route("/metrics", self._metrics),
            Route("/healthz", self._health),
            Route("/readyz", self._ready),
            Mount("/static", StaticFiles(directory=STATIC)),
        )

    async def _page(self, _: Request) -> Response:
        return FileResponse(STATIC / "index.html", headers={"cache-control": "no-cache"})

    async def _status(self, _: Request) -> Response:
        return JSONResponse(self._feed.status(), 503 if self._feed.stale else 200)

    async def _events(self, request: Request) -> ASGIApp:
        if self.streams.full:
            return refusal(503, f"{self.streams.open} pages are open; that is the maximum", "streams", retry_after="5")
        header = request.headers.get("last-event-id")
        after = ("Last-Event-ID", header) if header else ("after", request.query_params.get("after") or "0")
        trace = request.query_params.get("trace")
        do_id = None if trace is None else self._known("trace", _integer("trace", trace))
        samples = None if do_id is None else lambda: self._traces.live(do_id, self._feed.ticks)
        stream = EventStream(self.streams, _integer(*after), samples)
        if request.client is not None:
            self._places.keep((request.client.host, request.client.port))
        return stream

    async def _states(self, _: Request) -> Response:
        return JSONResponse(states_document())

    async def _telegram(self, request: Request) -> Response:
        try:
            number = _integer("number", request.path_params["number"])
            return JSONResponse(telegram_document(telegram(number, self._watch.config.telegrams)))
        except ProfidriveError as error:
            raise RequestError("number", str(error), 404) from error

    async def _trace(self, request: Request) -> ASGIApp:
        do_id = self._do_id(request)
        query = request.query_params
        seconds = _integer("seconds", query.get("seconds", "10"), 1, SECONDS_MAX)
        bins = _integer("bins", query["bins"], 1, BINS_MAX) if "bins" in query else None
        names = [name for name in query.get("signals", "").split(",") if name]
        as_csv = query.get("format") == "csv" or "text/csv" in request.headers.get("accept", "")

        def made() -> Response:
            document = self._traces.history(do_id, seconds, names, bins)
            if not as_csv:
                return JSONResponse(document)
            name = f'attachment; filename="trend-do{do_id}.csv"'
            return PlainTextResponse(csv_text(document), media_type="text/csv", headers={"content-disposition": name})

        return self._large(made)

    async def _faults(self, request: Request) -> Response:
        do_id = self._do_id(request)
        return JSONResponse({"do_id": do_id, "faults": await self._watch.faults(do_id)})

    async def _explain(self, request: Request) -> Response:
        do_id = self._do_id(request) if "do_id" in request.path_params else None
        return JSONResponse({"lines": await self._watch.explanation(do_id)})

    async def _read(self, request: Request) -> Response:
        do_id = self._do_id(request)
        text = request.query_params.get("pnu")
        async with self._parameter_channel():
            if text is None:
                return JSONResponse(
                    {"do_id": do_id, "parameters": await run_in_threadpool(self._parameters.names, do_id)}
                )
            return JSONResponse(
                {"do_id": do_id, "elements": await run_in_threadpool(self._parameters.read, do_id, text)}
            )

    async def _dump(self, request: Request) -> Response:
        do_id = self._do_id(request)
        async with self._parameter_channel():
            document = await run_in_threadpool(self._parameters.dump, do_id)
        name = f'attachment; filename="parameters-do{do_id}.json"'
        return JSONResponse(document, headers={"content-disposition": name})

    @contextlib.asynccontextmanager
    async def _parameter_channel(self) -> AsyncIterator[None]:
        if self._one_at_a_time.locked() or not self._allowance.take(time.monotonic()):
            raise HTTPException(429, f"one read at a time, at most {READS_PER_S} per second", {"retry-after": "1"})
        async with self._one_at_a_time:
            yield

    def _do_id(self, request: Request) -> int:
        return self._known("do_id", _integer("do_id", request.path_params["do_id"]))

    def _known(self, field: str, do_id: int) -> int:
        known = [item.do_id for item in self._watch.config.objects]
        if do_id not in known:
            raise RequestError(
                field, f"drive object {do_id} does not exist, allowed: {', '.join(map(str, known))}", 404
            )
        return do_id

    async def _about(self, _: Request) -> Response:
        return JSONResponse(about_document(self._watch.config))

    async def _captured(self, request: Request) -> ASGIApp:
        seconds = _integer("seconds", request.query_params.get("seconds", "10"), 1, SECONDS_MAX)
        headers = {"content-disposition": 'attachment; filename="pdgw.pcapng"'}
        return self._large(lambda: Response(self._last(seconds), media_type="application/x-pcapng", headers=headers))

    def _last(self, seconds: float) -> bytes:
        return self._capture(self._traces.path, seconds)

    async def _support(self, _: Request) -> ASGIApp:
        headers = {"content-disposition": 'attachment; filename="pdgw-support.zip"'}
        return self._large(
            lambda: Response(support_archive(self._watch, self._last), media_type="application/zip", headers=headers)
        )

    async def _metrics(self, _: Request) -> Response:
        return Response(self._exposition(), headers={"content-type": CONTENT_TYPE})

    async def _health(self, _: Request) -> Response:
        alive = self._watch.document is not None
        return PlainTextResponse("ok\n" if alive else "the gateway does not answer\n", 200 if alive else 503)

    async def _ready(self, _: Request) -> Response:
        ready = self._watch.ready
        return PlainTextResponse("ok\n" if ready else "not all nodes are online, or no PLC\n", 200 if ready else 503)


def _integer(name: str, text: str, low: int = 0, high: int = 1 << 53) -> int:
    """Parse a number of a query; RequestError names the allowed values."""
    if len(text) > _DIGITS_MAX or not text.isascii() or not text.isdecimal() or not low <= int(text) <= high:
        raise RequestError(name, f"{name} = {text[:20]!r}: expected a whole number from {low} to {high}")
    return int(text)


async def _http_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    field = "path" if error.status_code == 404 else "request"
    return JSONResponse({"error": error.detail, "field": field}, error.status_code, error.headers)


async def _gateway_error(_: Request, error: Exception) -> Response:
    if isinstance(error, RequestError):
        return refusal(error.status, str(error), error.field)
    return refusal(502, str(error), "gateway")


def made_page(watch: Watch, parameters: Parameters, capture: Capture, token: Token | None) -> PageServer:
    """The server of the page with its limits, not started; while it runs, the gateway is watched."""
    places = Places()
    interface = Interface(watch, parameters, capture, places)
    web = watch.config.web

    def check_token() -> None:
        if token is not None and token.refresh():
            interface.streams.close()

    watch.feed.listeners.append(check_token)

    @contextlib.asynccontextmanager
    async def watching(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(watch.feed.run())
        try:
            yield
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    app = Starlette(
        routes=interface.routes,
        exception_handlers={HTTPException: _http_error, GatewayError: _gateway_error},
        lifespan=watching,
    )
    guard = Guard(app, allowed_hosts(web), token, places, time.monotonic, secure=web.tls_cert is not None)
    return made_server(guard, interface.streams, places, web)


def serve(config: GatewayConfig, parameters: Parameters, capture: Capture) -> None:
    """Serve the page of the gateway with this configuration until SIGINT or SIGTERM.

    GatewayError when its port, token or certificate cannot be used, or when the gateway has no status port.
    """
    status_port = config.transport.status_port
    if not status_port:
        raise GatewayError("[transport] status_port = 0: the page needs the status port; set another port")
    web = config.web
    token = None if web.token_file is None else Token.of(web.token_file)
    watch = Watch(config, StatusPort(status_port))
    publisher = None
    if config.mqtt is not None:
        from pdgw.tools.web.mqtt import Publisher  # noqa: PLC0415 (of an extra of its own)

        publisher = Publisher(config.mqtt, watch)
        watch.feed.listeners.append(publisher.publish_changes)
    server = made_page(watch, parameters, capture, token)
    with listen(web) as port:
        log.info("page at %s", page_address(port, tls=web.tls_cert is not None))
        if publisher is not None:
            publisher.start()
        try:
            asyncio.run(server.serve(sockets=[port]))
        finally:
            if publisher is not None:
                publisher.stop()


def page_address(port: socket.socket, *, tls: bool) -> str:
    """The address to open in a browser."""
    host, number = port.getsockname()[:2]
    name = f"[{host}]" if ":" in host else host
    return f"http{'s' if tls else ''}://{name}:{number}/"
