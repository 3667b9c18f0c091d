"""Writing recordings on a thread of its own, without ever holding up who records or growing without end."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from pdgw.ds301.counters import Counters

log = logging.getLogger("gateway")

T = TypeVar("T")
END_S = 2.0
"""Longest time that the end of the gateway waits for unwritten data."""
_WAITS = 20
_WAITING = 100_000
"""Items that may wait: some 10 s of a full bus at 1 Mbit/s."""


def wait_for_end(thread: threading.Thread) -> None:
    """Two seconds in short waits: if the process itself is paused, the thread loses only one of them."""
    for _ in range(_WAITS):
        thread.join(END_S / _WAITS)
        if not thread.is_alive():
            return


class BackgroundWriter(Generic[T]):
    """Hands items to ``write`` in their order, and calls ``close`` at the end.

    Both may raise OSError: it says so, with the name ``what``, and lets the rest go. Any other error loses the item alone.
    """

    def __init__(self, what: str, write: Callable[[T], object], close: Callable[[], None]) -> None:
        self._what = what
        self._write = write
        self._close = close
        self._items: queue.Queue[T | None] = queue.Queue(_WAITING)
        self._counting = threading.Lock()
        self.lost = 0
        self.failed = False
        self._mistaken = False
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)
        self._thread.start()

    def count_in(self, counters: Counters, part: str) -> None:
        """Count the lost records."""
        counters.add(part, "lost", "frames", "not recorded: the disk is full or too slow", lambda: self.lost)

    def put(self, item: T) -> None:
        """Never waits: what there is no room for is counted."""
        with self._counting:
            if not self.failed:
                try:
                    self._items.put_nowait(item)
                except queue.Full:
                    pass
                else:
                    return
            self.lost += 1

    @property
    def waiting(self) -> int:
        """Items not written yet."""
        return self._items.qsize()

    def stop(self) -> None:
        """Everything is written afterwards, as far as it is taken within two seconds."""
        try:
            self._items.put(None, timeout=END_S)
        except queue.Full:
            return
        wait_for_end(self._thread)

    def _run(self) -> None:
        try:
            while (item := self._items.get()) is not None:
                self._write_one(item)
        except OSError as error:
            self._fail(error)
        try:
            self._close()
        except OSError as error:
            self._fail(error)

    def _write_one(self, item: T) -> None:
        try:
            self._write(item)
        except OSError:
            raise
        except Exception:  # an error with this record: write the others
            if not self._mistaken:
                log.exception("%s: a part could not be recorded; further failures are only counted", self._what)
            self._mistaken = True
            with self._counting:
                self.lost += 1

    def _fail(self, error: OSError) -> None:
        if self.failed:
            return
        with self._counting, self._items.mutex:
            self.failed = True
            self.lost += len(self._items.queue) + 1
            self._items.queue.clear()
        log.error("%s: %s; the recording has stopped", self._what, error.strerror or error)
