"""Which file descriptors are ready: what the loop of the machine waits with, in microseconds."""

from __future__ import annotations

import contextlib
import errno
import select
from typing import Final, Protocol

READABLE: Final = 0x001
WRITABLE: Final = 0x004
"""Bits in the state of a ready descriptor. Any other bit (error, end of the peer) is reported to the reader."""
NO_DESCRIPTOR: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
"""Errors of ``accept`` when the system has no resources for another connection. The port stays readable meanwhile."""
_AT_ONCE: Final = 64
"""Number of descriptors in one call; the kernel continues with the others in the next one."""


class Readiness(Protocol):
    """Watches descriptors."""

    def watch(self, descriptor: int, *, read: bool, write: bool) -> None:
        """Replace the monitored events of a descriptor; neither ends its monitoring."""

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        """Descriptors with their states, after this time at most; 0 does not wait. It may return earlier with none."""

    def close(self) -> None:
        """Release its own resources."""


class SelectReadiness(Readiness):
    """Readiness by ``select``: it takes microseconds, which ``poll`` does not, and sockets on every system."""

    def __init__(self) -> None:
        self._readers: list[int] = []
        self._writers: list[int] = []

    def watch(self, descriptor: int, *, read: bool, write: bool) -> None:
        for requested, descriptors in ((read, self._readers), (write, self._writers)):
            if requested and descriptor not in descriptors:
                descriptors.append(descriptor)
            elif not requested and descriptor in descriptors:
                descriptors.remove(descriptor)

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        readable, writable, _ = select.select(self._readers, self._writers, (), seconds)
        states = dict.fromkeys(readable, READABLE)
        for item in writable:
            states[item] = states.get(item, 0) | WRITABLE
        return list(states.items())

    def close(self) -> None:
        """Nothing to release."""


class EpollReadiness(Readiness):
    """Readiness by Linux's ``epoll``, whose cost does not grow with the number of buses.

    ``epoll`` itself waits for whole milliseconds, so ``select`` waits for it in microseconds: one wake for each time.
    """

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._self = (self._epoll.fileno(),)
        self._watched: set[int] = set()

    def watch(self, descriptor: int, *, read: bool, write: bool) -> None:
        mask = (READABLE if read else 0) | (WRITABLE if write else 0)
        if not mask:
            if descriptor in self._watched:
                self._watched.remove(descriptor)
                # A descriptor that is already closed was removed automatically.
                with contextlib.suppress(OSError):
                    self._epoll.unregister(descriptor)
        elif descriptor in self._watched:
            self._epoll.modify(descriptor, mask)
        else:
            self._watched.add(descriptor)
            self._epoll.register(descriptor, mask)

    def wait(self, seconds: float) -> list[tuple[int, int]]:
        if seconds and not select.select(self._self, (), (), seconds)[0]:
            return []
        return self._epoll.poll(0, _AT_ONCE)

    def close(self) -> None:
        self._epoll.close()


def best_readiness() -> Readiness:
    """The best implementation that this system supports."""
    return EpollReadiness() if hasattr(select, "epoll") else SelectReadiness()
