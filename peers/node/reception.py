"""Frames of a python-can bus to a loop: by its file descriptor, or by a thread that only hands them over."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable

import can
from pdgw.ds301.loop import Loop

_AT_ONCE = 64
"""Frames taken from one bus before the others get their turn."""
_THREAD_WAIT_S = 0.2

FrameTaker = Callable[[can.Message], None]


class Reception:
    """Calls ``take`` on the loop for every frame, until ``close`` or until the bus is gone."""

    def __init__(self, loop: Loop, bus: can.BusABC, take: FrameTaker) -> None:
        self._loop = loop
        self._bus = bus
        self._take = take
        self._open = True
        self._thread: threading.Thread | None = None
        self._descriptor = -1
        with contextlib.suppress(NotImplementedError):
            self._descriptor = bus.fileno()
        if self._descriptor >= 0:
            loop.add_reader(self._descriptor, self._drain)
        else:
            self._thread = threading.Thread(target=self._read, name="bus reader", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """On the loop: no frame is taken after this. A second call does nothing."""
        if self._open:
            self._open = False
            if self._thread is None:
                self._loop.remove_reader(self._descriptor)

    def wait_closed(self) -> None:
        """Until nobody reads the bus any more; not on a loop that others need meanwhile."""
        if self._thread is not None:
            self._thread.join()

    def _drain(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                message = self._bus.recv(0)
            except (can.CanError, OSError):
                self.close()
                return
            if message is None or not self._open:
                return
            self._take(message)

    def _read(self) -> None:
        while self._open:
            try:
                message = self._bus.recv(_THREAD_WAIT_S)
            except (can.CanError, OSError):
                return
            if message is not None:
                self._hand_over(message)

    def _hand_over(self, message: can.Message) -> None:
        self._loop.call_threadsafe(lambda: self._take(message) if self._open else None)
