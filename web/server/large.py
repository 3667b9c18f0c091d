"""Answers of megabytes: a few at a time, sent in parts, so that readers who take nothing cannot fill the memory."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from pdgw.web.server.guard import refusal

AT_ONCE = 3
PART = 64 * 1024
"""Bytes handed to the connection before it reports that they are read."""
_ROOM_WITHIN_S = 15.0
"""Longer than a reader may take nothing (``server.READ_WITHIN_S``): the room of one that hangs is free by then."""


class LargeAnswers:
    """Makes large answers on threads, while there is room."""

    def __init__(self) -> None:
        self._room = asyncio.Semaphore(AT_ONCE)

    def __call__(self, make: Callable[[], Response]) -> ASGIApp:
        """An answer that ``make`` computes when it is its turn."""

        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            try:
                async with asyncio.timeout(_ROOM_WITHIN_S):
                    await self._room.acquire()
            except TimeoutError:
                await refusal(503, "too many large answers at once", "request", retry_after="5")(scope, receive, send)
                return
            try:
                await _send(await run_in_threadpool(make), send)
            finally:
                self._room.release()

        return answer


async def _send(response: Response, send: Send) -> None:
    await send({"type": "http.response.start", "status": response.status_code, "headers": response.raw_headers})
    body = bytes(response.body)
    for begin in range(0, len(body), PART):
        await send({"type": "http.response.body", "body": body[begin : begin + PART], "more_body": True})
    await send({"type": "http.response.body", "body": b""})
