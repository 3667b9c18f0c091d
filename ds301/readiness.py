"""Which file descriptors are ready: what the loop of the machine waits with, in microseconds."""

from __future__ import annotations

import contextlib
import select
from typing import Protocol


class Readiness(Protocol):
    """Watches descriptors."""

    def watch(self, descriptor: int, *, read: bool, write: bool, urgent: bool = False) -> None:
        """What to look for, instead of what was before; neither ends it. ``urgent``: read in nearly every cycle."""

    def wait(self, seconds: float) -> list[tuple[int, bool, bool]]:
        """Descriptors with whether they can be read and written, after so long at most; 0 only looks."""

    def close(self) -> None:
        """Release what it has itself."""


class SelectReadiness:
    """Readiness by ``select``: it takes microseconds, which ``poll`` does not, and sockets on every system."""

    def __init__(self) -> None:
        self._readers: list[int] = []
        self._writers: list[int] = []

    def watch(self, descriptor: int, *, read: bool, write: bool, urgent: bool = False) -> None:
        for wanted, descriptors in ((read, self._readers), (write, self._writers)):
            if wanted and descriptor not in descriptors:
                descriptors.append(descriptor)
            elif not wanted and descriptor in descriptors:
                descriptors.remove(descriptor)

    def wait(self, seconds: float) -> list[tuple[int, bool, bool]]:
        readable, writable, _ = select.select(self._readers, self._writers, (), seconds)
        return [(item, item in readable, item in writable) for item in dict.fromkeys((*readable, *writable))]

    def close(self) -> None:
        """Nothing to release."""


class EpollReadiness:
    """Readiness by Linux's ``epoll``, whose cost does not grow with the buses; ``select`` on it waits microseconds.

    Urgent descriptors stand beside it in ``select``: nothing more has to be asked where one of them is all that is ready.
    """

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._number = self._epoll.fileno()
        self._selected = [self._number]
        self._watched: set[int] = set()

    def watch(self, descriptor: int, *, read: bool, write: bool, urgent: bool = False) -> None:
        if descriptor in self._selected:
            self._selected.remove(descriptor)
        if urgent and read:
            self._selected.append(descriptor)
            read = False
        mask = (select.EPOLLIN if read else 0) | (select.EPOLLOUT if write else 0)
        if not mask:
            if descriptor in self._watched:
                self._watched.remove(descriptor)
                # A descriptor that was closed before is gone by itself.
                with contextlib.suppress(OSError):
                    self._epoll.unregister(descriptor)
        elif descriptor in self._watched:
            self._epoll.modify(descriptor, mask)
        else:
            self._watched.add(descriptor)
            self._epoll.register(descriptor, mask)

    def wait(self, seconds: float) -> list[tuple[int, bool, bool]]:
        selected = select.select(self._selected, (), (), seconds)[0]
        if not selected:
            return []
        number = self._number
        ready = [(item, True, False) for item in selected if item != number]
        if len(ready) < len(selected):
            write = select.EPOLLOUT
            ready += [(item, bool(mask & ~write), bool(mask & write)) for item, mask in self._epoll.poll(0)]
        return ready

    def close(self) -> None:
        self._epoll.close()


def best_readiness() -> Readiness:
    """What this system offers."""
    return EpollReadiness() if hasattr(select, "epoll") else SelectReadiness()
