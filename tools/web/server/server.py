"""The server of the page (uvicorn on one address), and which connections stay open: few for each unknown sender.

A connection is unknown until it shows the token or carries a stream. Unknown connections end in favour of newer ones, so a new
one always gets a place, a sender with many connections loses its own first, and /healthz is always answered.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Callable

import h11
import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from pdgw.gateway.base.errors import GatewayError
from pdgw.gateway.base.ports import bound
from pdgw.gateway.configuration.web import WebConfig
from pdgw.tools.web.stream import Streams

CONNECTIONS_MAX = 64
UNKNOWN_MAX = 48
"""The other places are for connections with the token, and for streams."""
UNKNOWN_OF_SENDER_MAX = 16
_IPV6_NETWORK_BITS = 64
"""One sender may use every address of such a network."""
Peer = tuple[str, int]
"""Address and port of the other side, as a socket and ASGI's ``client`` have them."""


def sender(host: str) -> str:
    """The part of an address that counts as one sender: the IPv4 address or the IPv6 network."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv4Address):
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.IPv6Network((address, _IPV6_NETWORK_BITS), strict=False))


class Places:
    """The connections that are open, oldest first."""

    def __init__(self) -> None:
        self._unknown: dict[Peer, Callable[[], None]] = {}
        self._known: set[Peer] = set()

    def enter(self, peer: Peer, end: Callable[[], None]) -> bool:
        """Take a place; ``end`` aborts this connection when a newer one needs it. False: known connections have all of them."""
        name = sender(peer[0])
        own = [other for other in self._unknown if sender(other[0]) == name]
        full = len(self._unknown) >= UNKNOWN_MAX or len(self._unknown) + len(self._known) >= CONNECTIONS_MAX
        replaced = own if len(own) >= UNKNOWN_OF_SENDER_MAX else list(self._unknown) if full else None
        if replaced is not None:
            if not replaced:
                return False
            self._unknown.pop(replaced[0])()
        self._unknown[peer] = end
        return True

    def keep(self, peer: Peer) -> None:
        """The connection showed the token, or carries a stream: no other one takes its place."""
        if self._unknown.pop(peer, None) is not None:
            self._known.add(peer)

    def keeps(self, peer: Peer) -> bool:
        return peer in self._known

    def leave(self, peer: Peer) -> None:
        """The connection is closed."""
        self._unknown.pop(peer, None)
        self._known.discard(peer)


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
    return bound("[web] listen", host, port, "choose another", CONNECTIONS_MAX)


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
