"""The loop on the machine's clock and file descriptors."""

from __future__ import annotations

import contextlib
import socket
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Final, TypeVar

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Loop
from pdgw.ds301.loop.readiness import WRITABLE, Readiness, best_readiness

T = TypeVar("T")
SLICE_NS: Final = 200_000
"""A slice of a task is nearly always shorter: it starts only if nothing is expected for this time."""
_LONGEST_WAIT_S: Final = 3600.0
MACHINE_CLOCK: Final[Callable[[], int]] = (
    partial(time.clock_gettime_ns, time.CLOCK_BOOTTIME)
    if hasattr(time, "CLOCK_BOOTTIME") and hasattr(time, "clock_gettime_ns")
    else time.monotonic_ns
)
"""Nanoseconds of a clock that also runs while the machine is suspended.

After a suspend all received data is old, and the gateway stops the drives.
"""


class SystemLoop(Loop):
    """A loop on the machine's clock and file descriptors. ``close`` gives its own descriptors back.

    ``clock``: another one that never runs ahead of the machine's, in nanoseconds.
    """

    def __init__(self, readiness: Readiness | None = None, clock: Callable[[], int] = MACHINE_CLOCK) -> None:
        super().__init__()
        self._clock: Final = clock
        self._readiness: Readiness = best_readiness() if readiness is None else readiness
        self._readers: dict[int, Callable[[], None]] = {}
        self._urgent: set[int] = set()
        self._writers: dict[int, Callable[[], None]] = {}
        self._calls: deque[Callable[[], None]] = deque()
        self._awake, self._waker = socket.socketpair()
        self._awake.setblocking(False)
        self._waker.setblocking(False)
        self._workers: ThreadPoolExecutor | None = None
        self.add_reader(self._awake.fileno(), self._take_calls)

    def now(self) -> int:
        return self._clock()

    def wall(self) -> float:
        return time.time()

    def call_threadsafe(self, action: Callable[[], None]) -> None:
        self._calls.append(action)
        # A full pipe wakes the loop as well as one byte. A closed pipe has no reader to wake.
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def _take_calls(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._awake.recv(4096)
        for _ in range(len(self._calls)):
            self._calls.popleft()()

    def offload(self, function: Callable[[], T]) -> Future[T]:
        if self._workers is None:
            self._workers = ThreadPoolExecutor(1, thread_name_prefix="disk")
        future: Future[T] = Future()

        def run() -> None:
            try:
                result = function()
            except BaseException as error:  # the caller of the task gets it
                failure = error
                self.call_threadsafe(lambda: future.set_exception(failure))
            else:
                self.call_threadsafe(lambda: future.set_result(result))

        self._workers.submit(run)
        return future

    def add_reader(self, descriptor: int, action: Callable[[], None], *, urgent: bool = False) -> None:
        self._readers[descriptor] = action
        if urgent:
            self._urgent.add(descriptor)
        self._watch(descriptor)

    def remove_reader(self, descriptor: int) -> None:
        if self._readers.pop(descriptor, None) is not None:
            self._urgent.discard(descriptor)
            self._watch(descriptor)

    def add_writer(self, descriptor: int, action: Callable[[], None]) -> None:
        self._writers[descriptor] = action
        self._watch(descriptor)

    def remove_writer(self, descriptor: int) -> None:
        if self._writers.pop(descriptor, None) is not None:
            self._watch(descriptor)

    def _watch(self, descriptor: int) -> None:
        self._readiness.watch(descriptor, read=descriptor in self._readers, write=descriptor in self._writers)

    def run(self) -> None:
        self._stopping = False
        while not self._stopping:
            self._turn()

    def run_for(self, duration: int) -> None:
        end = self.call_later(duration, self.stop)
        self.run()
        end.cancel()

    def _turn(self) -> None:
        due = self._next()
        if self._slices and self._may_slice():
            wait = 0.0
        elif due is None:
            wait = _LONGEST_WAIT_S
        else:
            wait = min(max(0, due - self._clock()) / SECOND, _LONGEST_WAIT_S)
        ready = self._readiness.wait(wait)
        if len(ready) > 1:
            ready.sort(key=lambda item: item[0] not in self._urgent)
        for descriptor, state in ready:
            # An error of one action must not end the supervision of another.
            if state != WRITABLE and (action := self._readers.get(descriptor)) is not None:
                action()
            if state & WRITABLE and (action := self._writers.get(descriptor)) is not None:
                action()
        if self._timers and self._timers[0][0] <= (now := self._clock()):
            self._fire(now)
        if self._slices and self._may_slice():
            self._slice_due = False
            self._slices.popleft()()

    def _may_slice(self) -> bool:
        return self._slice_due or not self.expected or self._clock() + SLICE_NS <= self.expected

    def close(self) -> None:
        self.end_tasks()
        if self._workers is not None:
            self._workers.shutdown()
        self._take_calls()
        self._readiness.close()
        self._awake.close()
        self._waker.close()
