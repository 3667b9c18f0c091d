"""One reader of the daemon's status for all who look: asked five times a second while a page is open, else once.

What was last heard stays, marked as old, when the gateway does not answer. Every answer or failure is a tick that wakes all
streams; they take the newest, so that a slow browser skips and nothing queues.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from pdgw.gateway.base.errors import GatewayError

Document = dict[str, Any]
log = logging.getLogger("gateway")

_WATCHED_S = 0.2
_UNWATCHED_S = 1.0
ANSWER_WITHIN_S = 1.5
"""A gateway that hangs is reported within three seconds."""


class Feed:
    """The newest status of a gateway. ``on_document`` is called with each new document before waiting clients are woken."""

    def __init__(
        self,
        ask: Callable[[], Awaitable[Document]],
        on_document: Callable[[Document], Awaitable[None]],
    ) -> None:
        self._ask = ask
        self._on_document = on_document
        self.document: Document | None = None
        """The gateway's last answer; None: none yet."""
        self.answered: float | None = None
        """When, seconds of the wall clock."""
        self.stale = True
        """Whether the last request failed."""
        self.failure = "not read yet"
        self.watched_s, self.unwatched_s = _WATCHED_S, _UNWATCHED_S
        """Intervals of the requests."""
        self.ticks = 0
        self.listeners: list[Callable[[], None]] = []
        """Called after each tick; they do not wait for anything."""
        self._tick = asyncio.Event()
        self._watchers = 0
        self._requested = asyncio.Event()
        self._message: bytes | None = None

    async def run(self) -> None:
        """Request the status permanently."""
        while True:
            begin = time.monotonic()
            await self.once()
            self._requested.clear()
            interval = self.watched_s if self._watchers else self.unwatched_s
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(0.0, begin + interval - time.monotonic())):
                    await self._requested.wait()

    async def once(self) -> None:
        """Ask once, and wake who waits for it."""
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                document = await self._ask()
                await self._on_document(document)
        except (GatewayError, TimeoutError) as error:
            self.failure = str(error) or "no answer in time"
            self.stale = True
        except Exception as error:
            # The next status may be good after any error of this one. Until then the displayed one is marked old.
            self.failure = f"the status has an unexpected format; is the gateway of another version? ({error!r})"
            self.stale = True
        else:
            self.document = document
            self.answered = time.time()
            self.stale = False
        self._message = None
        self.ticks += 1
        for listener in self.listeners:
            try:
                listener()
            except Exception:  # an error of one page must not end the queries
                log.exception("the status could not be sent to the pages")
        tick, self._tick = self._tick, asyncio.Event()
        tick.set()

    def status(self) -> Document:
        """The answer of ``/api/v1/status``: the newest document, whether it is old, since when, and why."""
        return (self.document or {}) | {
            "stale": self.stale,
            "answered": self.answered,
            "failure": self.failure if self.stale else "",
        }

    @property
    def message(self) -> bytes:
        """The same as an event of a stream: made once for all of them."""
        if self._message is None:
            self._message = b"event: status\ndata: " + json.dumps(self.status()).encode() + b"\n\n"
        return self._message

    async def next_tick(self, patience_s: float) -> bool:
        """Wait for the next answer or failure; False when none came."""
        tick = self._tick
        try:
            async with asyncio.timeout(patience_s):
                await tick.wait()
        except TimeoutError:
            return False
        return True

    @asynccontextmanager
    async def watched(self) -> AsyncIterator[None]:
        """A client reads: request the status more often."""
        self._watchers += 1
        self._requested.set()
        try:
            yield
        finally:
            self._watchers -= 1
