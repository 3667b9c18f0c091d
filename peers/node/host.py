"""A loop in its own thread, for programs whose main thread does something else."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from pdgw.ds301.loop.jobs import settle
from pdgw.ds301.loop.loop import SystemLoop

log = logging.getLogger("peers")

T = TypeVar("T")


class LoopThread:
    """Runs a ``SystemLoop`` from construction until the process ends."""

    def __init__(self, name: str) -> None:
        self.loop = SystemLoop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def call(self, action: Callable[[], T]) -> T:
        """Run an action on the loop and wait for it, from any thread. Return its result or raise its exception."""
        if threading.current_thread() is self._thread:
            return action()
        future: Future[T] = Future()
        self.loop.call_threadsafe(lambda: settle(future, action, BaseException))
        return future.result()

    def _run(self) -> None:
        while True:
            try:
                self.loop.run()
            except Exception:
                # An error of one device must not end the others.
                log.exception("a simulated device failed")


@functools.cache
def simulation_thread() -> LoopThread:
    """The thread that runs all simulated nodes of this process on real buses."""
    return LoopThread("simulation")
