"""The server of the page: uvicorn on one address, with bounds on what strangers can hold of it."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from pdgw.gateway.config_web import WebConfig
from pdgw.gateway.errors import GatewayError
from pdgw.web.stream import Streams

CONNECTIONS_MAX = 64
_AT_ONCE = 1
"""Connections taken in one turn of asyncio's loop, which tries to take the others even when no descriptor is left, and has each
of these tries repeated a second later: more than one would grow to a storm."""
_REQUEST_WITHIN_S = 10.0
"""A connection that has not asked for anything by then is closed."""
_REQUEST_MAX = 16 * 1024
"""Bytes of a request line with its headers."""


class BoundedProtocol(H11Protocol):
    """uvicorn bounds requests; connections that never send one would still pile up."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > CONNECTIONS_MAX:
            transport.abort()
            return
        self.loop.call_later(_REQUEST_WITHIN_S, self._close_if_idle)

    def _close_if_idle(self) -> None:
        if self.cycle is None and not self.transport.is_closing():
            self.transport.close()


def listen(config: WebConfig) -> socket.socket:
    """The port of the page; GatewayError when it cannot be had."""
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


def made_server(app: ASGIApp, streams: Streams, config: WebConfig) -> PageServer:
    """A server that is not started; ``serve(sockets=[...])`` runs it until SIGINT or SIGTERM."""
    tls: dict[str, Any] = {}
    if config.tls_cert is not None:
        tls = {"ssl_certfile": config.tls_cert, "ssl_keyfile": config.tls_key}
    settings = uvicorn.Config(
        app,
        loop="asyncio",
        http=BoundedProtocol,
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
        **tls,
    )
    try:
        settings.load()
    except OSError as error:
        raise GatewayError(
            f"[web] tls_cert {config.tls_cert}, tls_key {config.tls_key}: cannot be used ({error})"
        ) from error
    return PageServer(settings, streams)
