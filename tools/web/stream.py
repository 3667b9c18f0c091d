"""The one stream a page has: status, events and, for the axis it shows, the trace, as Server-Sent Events.

Everything is taken when it is sent: the newest status, the events the page has not seen, the samples since the last ones. A
browser that reads slowly skips; the server ends one that does not read.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

from starlette.types import Receive, Scope, Send

from pdgw.tools.web.status.events import EventLog
from pdgw.tools.web.status.feed import Feed

STREAMS_MAX = 20
_COMMENT_AFTER_S = 5.0
_RETRY_MS = 1000
Samples = Callable[[], bytes]
"""The next message with samples, empty while there are none."""


async def parts(feed: Feed, log: EventLog, last_id: int, samples: Samples | None) -> AsyncIterator[bytes]:
    """The parts of a stream. ``last_id``: the last event of the page."""
    yield f"retry: {_RETRY_MS}\n\n".encode()
    while True:
        message = b""
        for event in log.after(last_id):
            message += event.message
            last_id = event.id
        if feed.ticks:
            message += feed.message
        if samples is not None:
            message += samples()
        if message:
            yield message
        while not await feed.next_tick(_COMMENT_AFTER_S):
            yield b": alive\n\n"


class Streams:
    """All open streams: a bounded number."""

    def __init__(self, feed: Feed, log: EventLog) -> None:
        self._feed = feed
        self._log = log
        self.open = 0
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def full(self) -> bool:
        return self.open >= STREAMS_MAX

    def close(self) -> None:
        """End all of them; the browsers try again by themselves."""
        for task in self._tasks:
            task.cancel()

    async def serve(self, last_id: int, samples: Samples | None, receive: Receive, send: Send) -> None:
        """Send until the browser disconnects or stops reading."""
        self.open += 1
        try:
            async with self._feed.watched():
                await self._until_gone(last_id, samples, receive, send)
        finally:
            self.open -= 1

    async def _until_gone(self, last_id: int, samples: Samples | None, receive: Receive, send: Send) -> None:
        async def sending() -> None:
            headers = [(b"content-type", b"text/event-stream"), (b"x-accel-buffering", b"no")]
            await send({"type": "http.response.start", "status": 200, "headers": headers})
            async for part in parts(self._feed, self._log, last_id, samples):
                await send({"type": "http.response.body", "body": part, "more_body": True})

        task = asyncio.create_task(sending())
        gone = asyncio.create_task(_gone(receive))
        self._tasks.add(task)
        try:
            await asyncio.wait((task, gone), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._tasks.discard(task)
            for each in (task, gone):
                each.cancel()
            result, _ = await asyncio.gather(task, gone, return_exceptions=True)
        if isinstance(result, Exception):
            raise result
        if gone.cancelled():  # the client is still connected
            await send({"type": "http.response.body", "body": b""})


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


class EventStream:
    """The ASGI answer to ``/api/v1/events``."""

    def __init__(self, streams: Streams, last_id: int, samples: Samples | None) -> None:
        self._streams = streams
        self._last_id = last_id
        self._samples = samples

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._streams.serve(self._last_id, self._samples, receive, send)
