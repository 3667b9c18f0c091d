"""The server of the page: uvicorn on one address, with limits for unknown senders."""

from __future__ import annotations

import asyncio
import socket

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from pdgw.gateway.configuration.tables.web import WebConfig
from pdgw.gateway.errors import GatewayError
from pdgw.web.server.places import CONNECTIONS_MAX, Places
from pdgw.web.stream import Streams

_AT_ONCE = 1
"""Connections taken in one turn of asyncio's loop, which tries to take the others even when no descriptor is left, and has each
of these tries repeated a second later: more than one would grow to a storm."""
REQUEST_WITHIN_S = 10.0
"""A connection without a request by then is aborted."""
READ_WITHIN_S = 10.0
"""So is one that does not take the answer: its buffer has to be nearly empty once in this time, after the answer for good."""
_REQUEST_MAX = 16 * 1024
"""Bytes of a request line with its headers."""


class BoundedProtocol(H11Protocol):
    """uvicorn's protocol with a place for each connection and time limits for requests and readers. No pipelining."""

    places: Places

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._limit: asyncio.TimerHandle | None = None
        if self.client is not None and not self.places.enter(self.client, transport.abort):
            transport.abort()
            return
        self._abort_after(REQUEST_WITHIN_S)

    def connection_lost(self, exc: Exception | None) -> None:
        self._abort_after(None)
        if self.client is not None:
            self.places.leave(self.client)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        if self._answering and self.conn.their_state is h11.DONE:
            self.transport.abort()  # a second request before the answer to the first
            return
        super().data_received(data)

    def handle_events(self) -> None:
        super().handle_events()
        if self._answering and not self.flow.write_paused:
            self._abort_after(None)

    def on_response_complete(self) -> None:
        self._abort_after(READ_WITHIN_S)
        if self.conn.trailing_data[0]:
            self.transport.close()  # the next request arrived together with this one
        super().on_response_complete()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._abort_after(READ_WITHIN_S)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self._answering:
            self._abort_after(None)

    @property
    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _abort_after(self, seconds: float | None) -> None:
        if self._limit is not None:
            self._limit.cancel()
        self._limit = None if seconds is None else self.loop.call_later(seconds, self.transport.abort)


def bounded_protocol(places: Places) -> type[BoundedProtocol]:
    """The protocol of a server with these places: uvicorn makes one for each connection."""
    return type("BoundedProtocol", (BoundedProtocol,), {"places": places})


def listen(config: WebConfig) -> socket.socket:
    """The port of the page; GatewayError if it cannot be opened."""
    host, port = config.address
    made = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        made.listen(CONNECTIONS_MAX)
    except OSError as error:
        made.close()
        text = f"[web] listen: {host} port {port} cannot be used ({error.strerror or error}); choose another"
        raise GatewayError(text) from error
    return made


class PageServer(uvicorn.Server):
    """Ends the streams before it waits for the requests that are still served."""

    def __init__(self, settings: uvicorn.Config, streams: Streams) -> None:
        super().__init__(settings)
        self._streams = streams

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for port in sockets or ():
            port.listen(CONNECTIONS_MAX)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._streams.close()
        await super().shutdown(sockets)


def made_server(app: ASGIApp, streams: Streams, places: Places, config: WebConfig) -> PageServer:
    """A server that is not started; ``serve(sockets=[...])`` runs it until SIGINT or SIGTERM."""
    settings = uvicorn.Config(
        app,
        loop="asyncio",
        http=bounded_protocol(places),
        ws="none",
        lifespan="on",
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        backlog=_AT_ONCE,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=_REQUEST_MAX,
        ssl_certfile=config.tls_cert,
    )
    try:
        settings.load()
    except OSError as error:
        raise GatewayError(f"[web] tls_cert {config.tls_cert}: cannot be used ({error})") from error
    return PageServer(settings, streams)
