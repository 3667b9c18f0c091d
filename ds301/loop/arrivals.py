"""Times at which the kernel received frames and datagrams (Linux), as times of a loop."""

from __future__ import annotations

import socket
import struct
import time
from typing import Final

from pdgw.base.durations import SECOND
from pdgw.ds301.loop.loop import Loop

SO_TIMESTAMPNS: Final = 35
"""Option of Linux; Python has no name for it before 3.14."""
_TIMESPEC: Final = struct.Struct("@ll")
ANCILLARY: Final = socket.CMSG_SPACE(_TIMESPEC.size) if hasattr(socket, "CMSG_SPACE") else 0
"""Size of the ancillary data of ``recvmsg`` with the time."""


def arrival(stamp: int, wall: int, now: int, earliest: int) -> int:
    """Monotonic arrival time of what the kernel stamped with the wall clock; all in nanoseconds.

    ``wall`` and ``now`` were read together. A change of the wall clock cannot move it after ``now``, or before ``earliest``,
    when nothing waited or when the datagram before it arrived.
    """
    return max(earliest, min(now, now - (wall - stamp)))


class Arrivals:
    """The times of one socket with ``SO_TIMESTAMPNS``."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._earliest = loop.now()
        """Nothing that waits has arrived before."""

    def end(self, now: int) -> None:
        """Nothing waits any more."""
        self._earliest = now

    def time(self, ancillary: list[tuple[int, int, bytes]], latest: int) -> int | None:
        """The time in the first ancillary message, ``latest`` at most; no other message is requested. None without one."""
        if not ancillary:
            return None
        _, kind, data = ancillary[0]
        if kind != SO_TIMESTAMPNS or len(data) != _TIMESPEC.size:
            return None
        seconds: int
        nanoseconds: int
        seconds, nanoseconds = _TIMESPEC.unpack(data)
        stamp = seconds * SECOND + nanoseconds
        self._earliest = min(latest, arrival(stamp, time.time_ns(), self._loop.now(), self._earliest))
        return self._earliest
