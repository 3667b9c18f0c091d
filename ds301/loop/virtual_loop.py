"""A loop with its own clock: the same code simulates a day in minutes, and the same run twice."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.jobs import resolve
from pdgw.ds301.loop.loop import Loop

T = TypeVar("T")


class VirtualLoop(Loop):
    """A loop on a clock of its own: what happens takes no time, and where nothing happens time jumps to the next timer.

    ``begin``: the first time; ``epoch``: what ``wall`` says then. One order of events, whatever the machine does.
    """

    def __init__(self, begin: int = SECOND, epoch: float = 1_700_000_000.0) -> None:
        super().__init__()
        self._now = self._begin = begin
        self._epoch = epoch

    def now(self) -> int:
        return self._now

    def wall(self) -> float:
        return self._epoch + (self._now - self._begin) / SECOND

    def call_threadsafe(self, action: Callable[[], None]) -> None:
        """In order with everything else: there is one thread."""
        self.call_at(self._now, action)

    def offload(self, function: Callable[[], T]) -> Future[T]:
        future: Future[T] = Future()
        self.call_at(self._now, lambda: resolve(future, function, BaseException))
        return future

    def add_reader(self, descriptor: int, action: Callable[[], None], *, urgent: bool = False) -> None:
        raise RuntimeError(f"descriptor {descriptor}: a virtual loop has links and buses, no descriptors")

    def remove_reader(self, descriptor: int) -> None:
        """None is watched."""

    def add_writer(self, descriptor: int, action: Callable[[], None]) -> None:
        self.add_reader(descriptor, action)

    def remove_writer(self, descriptor: int) -> None:
        """None is watched."""

    def close(self) -> None:
        self.end_tasks()

    @property
    def waiting(self) -> int:
        """Timers that are not due, with some cancelled ones."""
        return len(self._timers)

    def run(self) -> None:
        """Until ``stop``, or until nothing is left that could happen."""
        self._stopping = False
        while not self._stopping and self._turn(None):
            pass

    def run_until(self, when: int) -> None:
        """Run up to a time; the clock shows it afterwards, unless ``stop`` ended it before."""
        self._stopping = False
        while not self._stopping and self._turn(when):
            pass
        if not self._stopping:
            self._now = max(self._now, when)

    def run_for(self, duration: int) -> None:
        self.run_until(self._now + duration)

    def pause(self, duration: int) -> None:
        """Time passes and nothing runs, as while a machine is paused."""
        self._now += duration

    def until(self, condition: Callable[[], object], what: str, limit: int = 10 * SECOND) -> None:
        """Run until a condition is true after an event; TimeoutError with ``what`` if it is not within ``limit``."""
        end = self._now + limit
        self._stopping = False
        while not condition():
            if self._stopping or not self._turn(end):
                raise TimeoutError(f"not within {limit / SECOND:g} s: {what}")

    def complete(self, function: Callable[[], T], limit: int = 60 * SECOND) -> T:
        """Run a function as a task until it has ended; return its result or raise its exception."""
        future: Future[T] = Future()
        self.spawn(lambda: resolve(future, function), "complete")
        self.until(future.done, "end of the task", limit)
        return future.result(0)

    def _turn(self, end: int | None) -> bool:
        """One event; False when there is none up to ``end``."""
        due = self._next()
        if due is not None and due <= self._now:
            self._fire(self._now)
        elif self._slices:
            self._slices.popleft()()
        elif due is None or (end is not None and due > end):
            return False
        else:
            self._now = due
            self._fire(due)
        return True
