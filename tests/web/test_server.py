"""The server of the page when the process has no file descriptor left."""

from __future__ import annotations

import asyncio
import errno
import socket
from types import SimpleNamespace
from typing import Any, cast

from pdgw.gateway.configuration.web import WebConfig
from pdgw.tools.web.server.server import CONNECTIONS_MAX, Places, made_server
from pdgw.tools.web.stream import Streams


class Port(socket.socket):
    """Has no descriptor for a connection; ``asked`` how often in one turn of the loop."""

    def __init__(self) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_STREAM)
        self.bind(("127.0.0.1", 0))
        self.tries = 0
        self.asked: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def listen(self, backlog: int = 0, /) -> None:
        super().listen(backlog)
        self.room = backlog

    def accept(self) -> Any:
        if not self.tries:
            asyncio.get_running_loop().call_soon(lambda: self.asked.set_result(self.tries))
        self.tries += 1
        raise OSError(errno.EMFILE, "Too many open files")


async def application(scope: Any, receive: Any, send: Any) -> None:
    while (await receive())["type"] == "lifespan.startup":
        await send({"type": "lifespan.startup.complete"})
    await send({"type": "lifespan.shutdown.complete"})


def test_failed_accept_is_retried_once_a_second() -> None:
    """asyncio tries to accept ``backlog`` connections at once, and repeats each failed try later."""

    async def play() -> tuple[int, int]:
        with Port() as port, socket.socket() as visitor:
            server = made_server(application, cast(Streams, SimpleNamespace(close=list)), Places(), WebConfig())
            server.lifespan = server.config.lifespan_class(server.config)
            await server.startup(sockets=[port])
            visitor.setblocking(False)
            await asyncio.get_running_loop().sock_connect(visitor, port.getsockname())
            tries = await port.asked
            room = port.room
            await server.shutdown(sockets=[port])
            return tries, room

    assert asyncio.run(play()) == (1, CONNECTIONS_MAX), "who waits to be taken has his place all the same"
