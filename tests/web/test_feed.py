"""The reader of the gateway's status continues after any faulty answer or listener."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

from pdgw.gateway.errors import GatewayError
from pdgw.tools.web.status.feed import Document, Feed


@pytest.mark.parametrize(
    "error", [GatewayError("gone"), KeyError("axes"), ValueError("9e99"), RuntimeError("no thread")]
)
def test_unusable_answer_marks_data_old_and_polling_continues(error: Exception) -> None:
    answers: Iterator[Document | Exception] = iter(({"n": 1}, error, {"n": 3}))
    seen: list[tuple[int, bool]] = []

    async def ask() -> Document:
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def took(before: Document | None, document: Document) -> None:
        """Nothing to note."""

    async def play() -> None:
        feed = Feed(ask, took)
        feed.watched_s = feed.unwatched_s = 0.0
        feed.listeners.append(lambda: seen.append(((feed.document or {})["n"], feed.stale)))
        asking = asyncio.create_task(feed.run())
        while len(seen) < 3 and not asking.done():
            await feed.next_tick(60.0)
        asking.cancel()

    asyncio.run(play())
    assert seen[:3] == [(1, False), (1, True), (3, False)]


def test_failing_listener_is_logged_and_blocks_no_other(caplog: pytest.LogCaptureFixture) -> None:
    told: list[int] = []

    async def ask() -> Document:
        return {}

    async def took(before: Document | None, document: Document) -> None:
        """Nothing to note."""

    def broken() -> None:
        raise ValueError("a mistake")

    async def play() -> None:
        feed = Feed(ask, took)
        feed.listeners += [broken, lambda: told.append(feed.ticks)]
        await feed.once()
        await feed.once()

    asyncio.run(play())
    assert told == [1, 2]
    assert "ValueError: a mistake" in caplog.text
