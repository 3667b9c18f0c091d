"""Jobs for the task of a node, with futures as answers, and turns that limit how many tasks work at a time.

A client of a node adds a call; the node's task runs the calls one after the other between its own work. Turns are given in the
order of their requests."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeVar

from pdgw.ds301.loop.loop import Event, Loop


class Turns:
    """``with turns:`` inside a task waits until fewer than ``limit`` tasks have a turn."""

    def __init__(self, loop: Loop, limit: int) -> None:
        self.limit = limit
        self._loop = loop
        self._taken = 0
        self._waiting: deque[Event] = deque()

    def __enter__(self) -> None:
        if self._taken < self.limit:
            self._taken += 1
            return
        turn = Event(self._loop)
        self._waiting.append(turn)
        try:
            turn.wait()
        except BaseException:
            # The task is killed: its present and following work passes to the next task.
            if turn.is_set():
                self._pass_on()
            else:
                self._waiting.remove(turn)
            raise

    def __exit__(self, *_: object) -> None:
        self._pass_on()

    def _pass_on(self) -> None:
        if self._waiting:
            self._waiting.popleft().set()
        else:
            self._taken -= 1


T = TypeVar("T")


def resolve(future: Future[T], function: Callable[[], T], errors: type[BaseException] = Exception) -> None:
    """The future has the result or the error of the function, for its caller."""
    try:
        result = function()
    except errors as error:
        future.set_exception(error)
    else:
        future.set_result(result)


class Jobs:
    """The jobs that wait, oldest first."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[Future[Any], Callable[[], None]]] = deque()

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, job: Callable[[], T]) -> Future[T]:
        """Another one; its future has what the job returns or raises."""
        future: Future[T] = Future()
        self._waiting.append((future, partial(resolve, future, job)))
        return future

    def run_next(self) -> None:
        """Run the oldest job, unless its caller has stopped waiting."""
        future, run = self._waiting.popleft()
        if future.set_running_or_notify_cancel():
            run()

    def fail(self, error: Callable[[], Exception]) -> None:
        """None of them is run."""
        while self._waiting:
            future, _ = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                future.set_exception(error())
